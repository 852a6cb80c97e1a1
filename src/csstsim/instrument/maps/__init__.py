"""Laboratory maps of the chips: FITS images in place of drawn flats, pixel responses and defects; bias structure."""
