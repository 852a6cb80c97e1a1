"""What light loses on its way: flat field, shutter, pixel response; and the lamps that measure it."""
