"""Light of objects: spectra, dust, photometry."""
