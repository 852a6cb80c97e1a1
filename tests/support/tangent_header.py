"""A small image's celestial header."""

import numpy as np
from astropy.io import fits


def tangent_header(ra=60.0, dec=-40.0, pa=20.0, crpix=(20.5, 15.5), scale=0.074 / 3600):
    """A TAN header; `pa`: degrees by which north lies off +y."""
    cos, sin = scale * np.cos(np.radians(pa)), scale * np.sin(np.radians(pa))
    cards = {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": ra, "CRVAL2": dec, "CUNIT1": "deg", "CUNIT2": "deg"}
    cards |= {"CRPIX1": crpix[0], "CRPIX2": crpix[1], "CD1_1": -cos, "CD1_2": sin, "CD2_1": sin, "CD2_2": cos}
    return fits.Header(cards | {"LONPOLE": 180.0, "BUNIT": "e-/s"})
