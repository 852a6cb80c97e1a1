"""From the sky to the focal plane: PSF, distortion, WCS, gratings, shutter, flat field, scattered light."""
