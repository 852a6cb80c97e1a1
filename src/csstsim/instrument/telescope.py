"""The telescope: collecting area, plate scale, parity and shutter (paper, section 2). Jitter lives with the PSF."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Telescope:
    """Numbers of config/instrument/telescope.yaml. The off-axis design has no obscuration: the area is the disc."""

    diameter_m: float
    focal_length_m: float
    pixel_scale: float  # arcsec / pixel
    parity: int  # +1: the CD matrix has a positive determinant; -1: mosaic y is mirrored on the sky
    shutter_time: float  # s, a leaf's opening or closing
    shutter_span_mm: float  # between the bearings of the two leaves

    @property
    def area_m2(self):
        """Collecting area [m2]."""
        return math.pi * self.diameter_m**2 / 4
