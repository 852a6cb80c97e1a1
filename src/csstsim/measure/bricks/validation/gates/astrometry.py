"""Positions of stars."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.measure.bricks.validation.gates.data import clipped_mean
from csstsim.measure.bricks.validation.gates.record import MIN_SOURCES, SIGMAS_OF_MANY, AtMost, Measured

if TYPE_CHECKING:
    from csstsim.measure.bricks.validation.gates.data import BrickData, FrameData

# added to a star's stated error: a few must not dominate a mean
FLOOR_MAS = 1.0
FLOOR_PX = 0.01


def _sky_position(data: FrameData) -> list[Measured]:
    return _mean_offset(data, ("east_mas", "north_mas"), data.table["place_err"][data.sharp], FLOOR_MAS)


def _header_position(data: FrameData) -> list[Measured]:
    error = data.table["place_err"][data.sharp] / (1000 * data.frame.pixel)
    return _mean_offset(data, ("header_east", "header_north"), error, FLOOR_PX)


def _mean_offset(data: FrameData, axes: tuple[str, str], error: FloatArray, floor: float) -> list[Measured]:
    """Measure the length of the mean offset along two axes; error: of a star on an axis, in the axes' unit."""
    x, y = (clipped_mean(data.table[axis][data.sharp], error, floor) for axis in axes)
    length = None if x.mean is None or y.mean is None else float(np.hypot(x.mean, y.mean))
    return [Measured(length, x.n, max(x.sigma, y.sigma))]


def _bias(band: Mapping[str, Any]) -> list[Measured]:
    """Measure the bias of the worst bin of S/N, less what is allowed for chance."""
    bins = [part[name] for part in band["transfer"] for name in ("deferred_mas", "across_mas")]
    biases = [
        max(abs(part["median"]) - SIGMAS_OF_MANY * part["error"], 0.0) for part in bins if part["n"] >= MIN_SOURCES
    ]
    return [Measured(max(biases, default=None), band["point_sources"])]


def _residual(data: BrickData) -> list[Measured]:
    return [Measured(data.radial["median"], data.radial["n"])]


GATES = (
    AtMost(
        "astrometric offset of an exposure [mas]",
        scope="frame",
        threshold="place_max",
        unit="mas",
        tests="ICRS position minus true position at the epoch, mean of stars at S/N > 50",
        measure=_sky_position,
        sigmas=SIGMAS_OF_MANY,
    ),
    AtMost(
        "position by the header's WCS [px]",
        scope="frame",
        threshold="wcs_max",
        unit="px",
        tests="position of the same stars' pixels by the WCS of the Level-0 header, minus their true apparent "
        "position; where the header is linear, the camera's distortion is subtracted first",
        measure=_header_position,
        sigmas=SIGMAS_OF_MANY,
    ),
    AtMost(
        "position bias, worst bin of S/N > 5 [mas]",
        scope="band",
        threshold="position_bias_max",
        unit="mas",
        tests="median residual along and across columns in each bin of S/N above 5, single exposures, minus four sigma",
        measure=_bias,
    ),
    AtMost(
        "position residual at S/N > 50 [mas]",
        scope="brick",
        threshold="astrometry_max",
        unit="mas",
        tests="merged ICRS position minus true position at the epoch, median",
        measure=_residual,
    ),
)
