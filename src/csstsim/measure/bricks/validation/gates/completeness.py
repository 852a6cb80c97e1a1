"""Objects that an exposure finds and flags."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import BoolArray
from csstsim.measure.bricks.validation.compare import SNR_MAX
from csstsim.measure.bricks.validation.gates.record import SIGMAS, AtLeast, Measured
from csstsim.measure.bricks.validation.trials import detectable_points

if TYPE_CHECKING:
    from csstsim.measure.bricks.validation.gates.data import FrameData


def _points(data: FrameData) -> list[Measured]:
    return _found(data, detectable_points(data.table, data.thresholds.snr_min))


def _galaxies(data: FrameData) -> list[Measured]:
    snr = data.table["snr"]
    return _found(data, data.table["galaxy"].astype(bool) & (snr > data.thresholds.galaxy_snr_min) & (snr < SNR_MAX))


def _found(data: FrameData, objects: BoolArray) -> list[Measured]:
    """Measure the fraction found of the objects of a mask."""
    return [_fraction(data.table["found"][objects] > 0)]


def _saturated(data: FrameData) -> list[Measured]:
    full = (data.table["full"] > 0) & (data.table["found"] > 0)
    return [_fraction(data.table["sound"][full] == 0)]


def _fraction(mask: BoolArray) -> Measured:
    return Measured(float(np.mean(mask)) if len(mask) else None, len(mask))


def _pairs(band: Mapping[str, Any]) -> list[Measured]:
    n = band["pairs"]["n"]
    return [Measured(band["pairs"]["found"] / n if n else None, n)]


GATES = (
    AtLeast(
        "completeness",
        scope="frame",
        threshold="completeness_min",
        tests="isolated point sources found, of true S/N above `snr_min` and below 500",
        measure=_points,
        sigmas=SIGMAS,
    ),
    AtLeast(
        "completeness of galaxies",
        scope="frame",
        threshold="galaxy_completeness_min",
        tests="isolated galaxies found, of true S/N above `galaxy_snr_min` and below 500",
        measure=_galaxies,
        sigmas=SIGMAS,
    ),
    AtLeast(
        "saturated stars with the flag",
        scope="frame",
        threshold="saturated_min",
        tests="stars flagged as saturated, of those whose brightest pixel must hold twice the full well",
        measure=_saturated,
        sigmas=SIGMAS,
    ),
    AtLeast(
        "completeness of the fainter of close pairs",
        scope="band",
        threshold="pair_completeness_min",
        tests="fraction of the fainter objects with a detection of their own, in pairs within 12 px, both of true S/N "
        "above 8 in an exposure",
        measure=_pairs,
        sigmas=SIGMAS,
    ),
)
