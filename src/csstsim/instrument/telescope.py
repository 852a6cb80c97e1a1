"""The telescope: collecting area, plate scale, parity and shutter (paper, section 2). Jitter is in psf.yaml."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from csstsim.base.model import Data, Number, Positive, between


@dataclass(frozen=True)
class Telescope(Data):
    """Parameters of telescope.yaml. The off-axis design has no obscuration, so the area is that of the full disc."""

    diameter_m: Annotated[Number, between(0.1, 100)]
    focal_length_m: Annotated[Number, between(0.1, 1000)]
    pixel_scale: Annotated[Number, between(0.001, 10)]  # arcsec / pixel
    parity: Literal[1, -1]  # +1: the CD matrix has a positive determinant; -1: mosaic y is mirrored on the sky
    shutter_time: Annotated[Number, between(0, 100)]  # s, that a leaf takes to open or close
    shutter_span_mm: Positive  # between the bearings of the two leaves
    sun_angle_min: Annotated[Number, between(0, 180)] = 0.0  # deg, boresight to the Sun: below it there is a warning

    @property
    def area_m2(self) -> float:
        """Collecting area [m2]."""
        return math.pi * self.diameter_m**2 / 4
