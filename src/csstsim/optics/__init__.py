"""From the sky to the focal plane: background light, PSF, distortion, WCS, gratings, shutter, flat, scattered light.

May import: catalog, universe, instrument, detector, base.
"""
