"""The kernel of the brighter-fatter effect from the changes of pixel areas by charge.

A charge changes the area of the pixels around it by a[dy, dx] of a pixel per electron (Astier et al. 2019, A&A 629,
A36). In a flat of mean mu, the moved charge (detector.brighter_fatter) is mu (k * Q), k the discrete Laplacian of K:

    k = laplacian(K) + skew (second difference along y - along x) = a / 2

K is zero outside 5 x 5, so the 9 areas of a quadrant determine its 9 values. All areas sum to zero: the ring around the
5 x 5 areas has the remainder. The potential of a charge is assumed to be round; only the boundaries of its own pixel
move more easily where their barriers are lower. So the difference of a[1, 0] and a[0, 1] gives the skew, and their mean
enters K. Quadrants are indexed [dy, dx]: dy along the columns of the chip (parallel), dx along its rows (serial).
builders/bfe_fit.py derives the areas from the covariances of flats.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.types import FloatArray

if TYPE_CHECKING:
    from csstsim.instrument.chip import Detector

SIZE = 3  # of the quadrant of K
SHIFT_MAX = 0.25  # of a pixel: the model assumes small shifts, and the kernel's limiter would act on larger ones


def unfold(quadrant: FloatArray) -> FloatArray:
    """Return the (2n - 1, 2n - 1) array, even in both directions, with the given quadrant (n, n)."""
    half = np.concatenate([quadrant[:0:-1], quadrant])
    return np.concatenate([half[:, :0:-1], half], axis=1)


def fold(array: FloatArray) -> FloatArray:
    """Return the quadrant (n, n) of a (2n - 1, 2n - 1) array averaged with its mirror images [unit of the array]."""
    n = len(array) // 2
    mean = (array + array[::-1] + array[:, ::-1] + array[::-1, ::-1]) / 4
    return mean[n:, n:]


def laplacian(quadrant: FloatArray) -> FloatArray:
    """Return the discrete Laplacian, as a quadrant (n + 1, n + 1), of a quadrant (n, n) [unit of the quadrant]."""
    padded = np.pad(unfold(quadrant), 2)
    neighbours = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    return fold(neighbours - 4 * padded[1:-1, 1:-1])


def kernel(areas: ArrayLike) -> tuple[FloatArray, float]:
    """Return (K (3, 3), skew) [per e-] of areas (3, 3) [per e-]. Raises ValueError unless these are finite (3, 3)."""
    areas = np.array(areas, float)
    if areas.shape != (SIZE, SIZE) or not np.isfinite(areas).all():
        raise ValueError(f"areas of shape {areas.shape}; need a finite ({SIZE}, {SIZE})")
    skew = (areas[1, 0] - areas[0, 1]) / 4
    areas[1, 0] -= 2 * skew
    areas[0, 1] += 2 * skew
    return np.linalg.solve(_laplacians(), areas.ravel() / 2).reshape(SIZE, SIZE), skew


@cache
def _laplacians() -> FloatArray:
    """Return (9, 9): each column is the Laplacian of a quadrant with one 1 in it."""
    units = np.eye(SIZE**2).reshape(-1, SIZE, SIZE)
    return np.stack([laplacian(unit)[:SIZE, :SIZE].ravel() for unit in units], axis=1)


def detector_kernel(detector: Detector) -> tuple[FloatArray, float]:
    """Return (K (3, 3), skew) [per e-] of a detector (brighter_fatter.yaml, full_well).

    Raises InputError if it has no areas, or if charge at full well could move a boundary by a quarter pixel.
    """
    parameters = detector.brighter_fatter
    try:
        potential, skew = kernel(float(parameters["scale"]) * np.array(parameters["areas"], float))
    except (KeyError, TypeError, ValueError):
        allowed = "areas (3 x 3 numbers) and scale"
        raise InputError("not usable", key="brighter_fatter.yaml", value=parameters or None, allowed=allowed) from None
    shift = detector.full_well * (np.abs(unfold(potential)).sum() + abs(skew))
    if not shift < SHIFT_MAX:
        message = "boundaries move too far at full well"
        allowed = f"less than {SHIFT_MAX} pixels"
        raise InputError(message, key="brighter_fatter.yaml", value=shift, allowed=allowed)
    return potential, skew
