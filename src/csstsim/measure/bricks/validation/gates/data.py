"""What the gates of an exposure and of a brick are evaluated from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.arrays.robust_sigma import sigma_of_deviations
from csstsim.base.types import BoolArray, FloatArray
from csstsim.measure.bricks.validation.compare import SNR_SHARP
from csstsim.measure.bricks.validation.facts import header_off, pixels_off
from csstsim.measure.bricks.validation.trials import bright_stars

if TYPE_CHECKING:
    from csstsim.campaign.thresholds import ValidateConfig
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.bricks.validation.facts import Deviation
    from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame

CLIP = 4.0  # sigma; values further off are left out of means


@dataclass(frozen=True)
class FrameData:
    """One exposure of one chip: its frame, the trials of its objects on the brick, the campaign's thresholds."""

    frame: MeasuredFrame
    table: ObjectTable
    brick: int
    thresholds: ValidateConfig

    @property
    def where(self) -> dict[str, Any]:
        """The names of exposure and chip in a gate's result."""
        return {"exposure": self.frame.info.get("obsid"), "chip": self.frame.info.get("chip")}

    @cached_property
    def bright(self) -> BoolArray:
        """Mask of the stars whose fluxes are tested."""
        return bright_stars(self.table)

    @cached_property
    def sharp(self) -> BoolArray:
        """Mask of the stars whose positions and shapes are tested."""
        return self.bright & (self.table["snr"] > SNR_SHARP)

    @cached_property
    def pixels(self) -> dict[str, list[Deviation]]:
        """Deviations of the pixels (facts.pixels_off); empty if nothing is known of them."""
        frame = self.frame
        return pixels_off(frame.info.get("channels", ()), frame.facts, frame.truth, frame.pixel) if frame.facts else {}

    @cached_property
    def header(self) -> dict[str, list[Deviation]]:
        """Deviations of the header (facts.header_off); empty if nothing is known of it."""
        return header_off(self.frame.facts) if self.frame.facts else {}


class BrickData(NamedTuple):
    """Statistics of a brick's merged catalogue.

    laws: {kind: (number in the brick's truth, number expected)}; radial: spread of bright stars' position residuals
    [mas]; purity: fraction of n sources that match a true object; lost, duplicates: (fraction, n) of compare.lost, by
    kind, and of compare.duplicates.
    """

    laws: Mapping[str, tuple[float, float]]
    radial: Mapping[str, Any]
    purity: float | None
    sources: int
    lost: Mapping[str, tuple[float | None, int]]
    duplicates: tuple[float | None, int]


class ClippedMean(NamedTuple):
    """A mean, its standard error, and the number of values in it; (None, 0, 0) of no values."""

    mean: float | None
    sigma: float
    n: int


def clipped_mean(values: FloatArray, errors: FloatArray, floor: float) -> ClippedMean:
    """Return the mean of values (n,) with their errors; each value's sigma is its error and `floor` in quadrature.

    Values further than CLIP sigma from the median are left out; sigma is scaled up if the values scatter by more. The
    mean's error is the larger of the stated one and that from the scatter.
    """
    good = np.isfinite(values) & np.isfinite(errors)
    values = values[good]
    sigma = np.hypot(errors[good], floor)
    if len(values) == 0:
        return ClippedMean(None, 0.0, 0)
    pull = (values - np.median(values)) / sigma
    near = np.abs(pull) < CLIP * max(1.0, sigma_of_deviations(np.abs(pull)))
    values = values[near]
    weight = sigma[near] ** -2.0
    mean = float(np.average(values, weights=weight))
    stated = weight.sum() ** -0.5
    scatter = np.sqrt(np.sum(weight**2 * (values - mean) ** 2)) / weight.sum()
    return ClippedMean(mean, float(max(stated, scatter)), len(values))
