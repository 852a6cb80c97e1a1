"""The telescope: collecting area, plate scale, parity and shutter (paper, section 2). Jitter lives with the PSF."""

import math
from dataclasses import dataclass
from typing import Literal

from csstsim.base.model import Data, NotNegative, Positive


@dataclass(frozen=True)
class Telescope(Data):
    """Numbers of config/instrument/telescope.yaml. The off-axis design has no obscuration: the area is the disc."""

    diameter_m: Positive
    focal_length_m: Positive
    pixel_scale: Positive  # arcsec / pixel
    parity: Literal[1, -1]  # +1: the CD matrix has a positive determinant; -1: mosaic y is mirrored on the sky
    shutter_time: NotNegative  # s, a leaf's opening or closing
    shutter_span_mm: Positive  # between the bearings of the two leaves

    @property
    def area_m2(self):
        """Collecting area [m2]."""
        return math.pi * self.diameter_m**2 / 4
