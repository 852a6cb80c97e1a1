"""Completeness, bias and scatter of recovered objects in bins, with errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.arrays.robust_sigma import SIGMA_PER_MAD
from csstsim.measure.bricks.validation.density import EDGES as DENSITIES

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray
    from csstsim.catalog.table import ObjectTable

POINT_SIZE = 1e-6  # arcsec: smaller objects are points
SIZES = (0.0, POINT_SIZE, 0.1, 0.2, 0.3, 0.5, 0.8, 1.3, 2.0, np.inf)  # arcsec
MAG_STEP = 0.5
OBJECTS_MIN = 5  # for a bias and a scatter
CLIP = 5.0  # robust sigmas
AGAINST = {"mag": "true magnitude [AB]", "size": "half-light radius [arcsec]", "density": "density [arcmin-2]"}
QUANTITIES = {
    "d_mag": "magnitude",
    "d_x": "position x [px]",
    "d_y": "position y [px]",
    "d_g1": "shape g1",
    "d_g2": "shape g2",
    "flux_pull": "pull of flux",
    "x_pull": "pull of x",
    "y_pull": "pull of y",
}


@dataclass(frozen=True)
class Number:
    """Mean and scatter of n values without outliers, and their errors."""

    n: int
    mean: float
    mean_error: float
    scatter: float
    scatter_error: float
    outliers: int


def number(values: FloatArray) -> Number:
    """Return the Number of values, NaN left out; mean and scatter are NaN with fewer than OBJECTS_MIN values.

    Values farther than CLIP robust sigmas from the median are outliers.
    """
    values = np.asarray(values, float)
    values = values[np.isfinite(values)]
    if len(values) < OBJECTS_MIN:
        return Number(len(values), np.nan, np.nan, np.nan, np.nan, 0)
    deviation = np.abs(values - np.median(values))
    # Not sigma_of_deviations: the order of the products decides which values are kept
    inliers = values[deviation <= max(CLIP * SIGMA_PER_MAD * np.median(deviation), np.finfo(float).tiny)]
    scatter = inliers.std(ddof=1) if len(inliers) > 1 else 0.0
    return Number(
        len(inliers),
        float(inliers.mean()),
        float(scatter / np.sqrt(len(inliers))),
        float(scatter),
        float(scatter / np.sqrt(2 * max(len(inliers) - 1, 1))),
        len(values) - len(inliers),
    )


class Fraction(NamedTuple):
    """A fraction and its lower and upper 68% bound."""

    value: float
    low: float
    high: float


def fraction(found: int, total: int) -> Fraction:
    """Return the Fraction `found` of `total`, after Wilson (1927); NaN of none."""
    if not total:
        return Fraction(np.nan, np.nan, np.nan)
    p = found / total
    z2 = 1.0
    middle = p + z2 / (2 * total)
    half = np.sqrt(p * (1 - p) / total + z2 / (4 * total**2))
    low = (middle - half) / (1 + z2 / total)
    high = (middle + half) / (1 + z2 / total)
    return Fraction(p, min(low, p), min(max(high, p), 1.0))


@dataclass(frozen=True)
class Bin:
    """Objects whose `against` lies in low <= value < high."""

    low: float
    high: float
    centre: float  # mean of the objects
    objects: int
    found: int
    numbers: dict[str, Number]  # {name of QUANTITIES: Number}, of clean sources

    @property
    def completeness(self) -> Fraction:
        """The fraction of the objects that were found."""
        return fraction(self.found, self.objects)


def binned(table: ObjectTable, against: str) -> list[Bin]:
    """Return the Bins with objects of a recovered table against `mag`, `size` or `density`."""
    values = np.asarray(table[against], float)
    if not len(values):
        return []
    edges: tuple[float, ...] | FloatArray | None = {"size": SIZES, "density": DENSITIES}.get(against)
    if edges is None:
        lowest = np.floor(np.nanmin(values) / MAG_STEP)
        edges = MAG_STEP * np.arange(lowest, np.floor(np.nanmax(values) / MAG_STEP) + 2)
    index = np.digitize(values, edges) - 1
    return [
        of_rows(table, index == k, edges[k], edges[k + 1], values) for k in range(len(edges) - 1) if (index == k).any()
    ]


def of_rows(table: ObjectTable, rows: BoolArray, low: float, high: float, values: FloatArray) -> Bin:
    """Return the Bin of a mask of rows."""
    clean = rows & table["clean"]
    numbers = {name: number(table[name][clean]) for name in QUANTITIES}
    return Bin(low, high, float(values[rows].mean()), int(rows.sum()), int(table["found"][rows].sum()), numbers)
