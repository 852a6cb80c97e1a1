"""Fluxes and magnitudes of stars."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.measure.bricks.validation.compare import spread
from csstsim.measure.bricks.validation.gates.data import clipped_mean
from csstsim.measure.bricks.validation.gates.record import SIGMAS_OF_MANY, AtMost, Between, Measured

if TYPE_CHECKING:
    from csstsim.measure.bricks.validation.gates.data import FrameData

FLOOR_MAG = 0.005  # added to a star's stated error: a few must not dominate a mean


def _pulls(data: FrameData) -> list[Measured]:
    pulls = data.table["pull"][data.bright]
    width = spread(pulls[np.isfinite(pulls)])
    return [Measured(width["sigma"], width["n"])]


def _zero_point(data: FrameData) -> list[Measured]:
    off = clipped_mean(data.table["mag_off"][data.bright], data.table["mag_err"][data.bright], FLOOR_MAG)
    return [Measured(off.mean, off.n, off.sigma)]


def _magnitudes(band: Mapping[str, Any]) -> list[Measured]:
    return [Measured(band["star"]["median"], band["star"]["n"])]


GATES = (
    Between(
        "width of stars' pulls",
        scope="frame",
        threshold="pull_width",
        tests="flux residual divided by its stated error, S/N 20 to 500, stars whose neighbours contribute less than "
        "0.3 sigma of flux",
        measure=_pulls,
        sigmas=SIGMAS_OF_MANY,
    ),
    AtMost(
        "zero point of an exposure [mag]",
        scope="frame",
        threshold="zeropoint_max",
        unit="mag",
        tests="PSF magnitude minus true magnitude, mean of stars at S/N 20 to 500",
        measure=_zero_point,
        sigmas=SIGMAS_OF_MANY,
    ),
    AtMost(
        "magnitude bias of stars",
        scope="band",
        threshold="mag_bias_max",
        unit="mag",
        tests="merged PSF magnitude minus true magnitude, median at S/N > 20",
        measure=_magnitudes,
    ),
)
