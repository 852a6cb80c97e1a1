"""Losses of light: flat field, shutter, pixel response; and the lamps that measure them."""
