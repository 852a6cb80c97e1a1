"""Files read with care and written whole: text, YAML, HDF5, headers of FITS."""
