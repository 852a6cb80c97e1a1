"""Laboratory maps of the chips: FITS images that replace simulated flats, pixel responses, defects, bias structure."""
