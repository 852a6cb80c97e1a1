"""One frame of those in which the sources of a brick are found and measured together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.measure.detection.peaks import WIDTH_FACTOR, smoothing, smoothing_sigma
from csstsim.measure.detection.residual import Residual
from csstsim.measure.light.photometry import PsfModel

AB_MICROJANSKY = 23.9  # AB magnitude of 1 microjansky


@dataclass(frozen=True)
class JointFrame:
    """What is left of a frame, its PSF and its place on the sky.

    `to_pixel(ra, dec)`: positions [px of the frame] of directions [deg, ICRS at the epoch]; `pixel`: arcsec; `mjd`: the
    middle of the exposure (UTC).
    """

    obsid: str
    chip: int
    band: str
    residual: Residual
    psf: PsfModel
    to_pixel: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
    zeropoint: float
    pixel: float
    mjd: float

    @cached_property
    def weight(self) -> FloatArray:
        """The Gaussian with which the frame is smoothed for detection."""
        return smoothing(self.psf.kernel())

    @cached_property
    def width(self) -> float:
        """Sigma [px] of the Gaussian that suits the PSF best."""
        return smoothing_sigma(self.psf.kernel()) / WIDTH_FACTOR

    @property
    def to_microjansky(self) -> float:
        """Microjansky of one electron."""
        return 10.0 ** (0.4 * (AB_MICROJANSKY - self.zeropoint))

    @cached_property
    def error(self) -> float:
        """The error of a faint point's flux, microjansky."""
        return float(np.median(self.residual.noise) * np.median(self.psf.n_eff) ** 0.5) * self.to_microjansky
