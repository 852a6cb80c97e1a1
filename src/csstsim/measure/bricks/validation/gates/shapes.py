"""Shapes of stars and galaxies."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.measure.bricks.validation.compare import SNR_MAX, spread
from csstsim.measure.bricks.validation.gates.record import SIGMAS_OF_MANY, AtMost, Measured

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.bricks.validation.gates.data import FrameData

SNR_SHAPE = 20.0  # galaxies' shapes are tested above this
SHAPE_MAX = 1.5  # of a measured shape; longer ones are noise


def _of_stars(data: FrameData, column: str) -> list[Measured]:
    values = data.table[column][data.sharp]
    off = spread(values[np.isfinite(values)])
    return [Measured(off["median"], off["n"], off["error"] or 0.0)]


def _of_galaxies(data: FrameData) -> list[Measured]:
    slope, sigma, n = shape_slope(data.table)
    return [Measured(None if slope is None else float(abs(slope - 1)), n, sigma)]


class ShapeSlope(NamedTuple):
    """A complex slope (None if not known), its error on an axis, and the number of galaxies."""

    slope: complex | None
    sigma: float
    n: int


def shape_slope(table: ObjectTable) -> ShapeSlope:
    """Return the complex slope of galaxies' measured shapes against the true ones; table: of trials.

    It is 1 if they agree. A rotation by an angle a gives a factor exp(2 i a); a wrong sign of one component gives a
    slope near zero.
    """
    bright = (table["galaxy"] > 0) & (table["snr"] > SNR_SHAPE) & (table["snr"] < SNR_MAX)
    true, measured = (table[f"{name}1"][bright] + 1j * table[f"{name}2"][bright] for name in ("true_g", "g"))
    good = np.isfinite(true) & np.isfinite(measured) & (np.abs(measured) < SHAPE_MAX)
    true = true[good]
    measured = measured[good]
    n = int(good.sum())
    weight = float(np.sum(np.abs(true) ** 2))
    if n < 2 or weight == 0:
        return ShapeSlope(None, 0.0, n)
    slope = np.sum(measured * np.conj(true)) / weight
    scatter = np.sum(np.abs(measured - slope * true) ** 2) / (2 * (n - 1))
    return ShapeSlope(slope, float(np.sqrt(scatter / weight)), n)


GATES = (
    *(
        AtMost(
            name,
            scope="frame",
            threshold=threshold,
            tests=f"{statistic} of stars, minus that of the PSF model at their position, median at S/N > 50",
            measure=partial(_of_stars, column=column),
            sigmas=SIGMAS_OF_MANY,
        )
        for name, threshold, statistic, column in (
            ("star size over PSF model, less 1", "psf_size_max", "relative size", "psf_size"),
            ("star e1 less PSF model", "psf_e_max", "distortion e1", "psf_e1"),
            ("star e2 less PSF model", "psf_e_max", "distortion e2", "psf_e2"),
        )
    ),
    AtMost(
        "shape response minus 1",
        scope="frame",
        threshold="shape_max",
        tests="complex slope of measured on true sheared shapes at S/N > 20, minus 1: finds a rotation or a wrong sign",
        measure=_of_galaxies,
        sigmas=SIGMAS_OF_MANY,
    ),
)
