"""Safe reading and atomic writing of files: text, YAML, HDF5, FITS headers."""
