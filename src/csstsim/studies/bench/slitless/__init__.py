"""The benchmark of spectra on grating chips."""
