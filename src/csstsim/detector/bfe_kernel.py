"""From the areas of pixels that charge changes to the kernel of the brighter-fatter effect.

A charge changes the area of the pixels around it by a[dy, dx] of a pixel per electron (Astier et al. 2019, A&A 629,
A36). Moved charge (detector.brighter_fatter) is, in a flat of mean mu, mu (k * Q) with k the discrete Laplacian of K:

    k = laplacian(K) + skew (second difference along y - along x) = a / 2

K is zero beyond its 5 x 5, so the 9 areas of a quadrant give its 9 values, and what the 5 x 5 areas lack to sum to zero
lies on the ring around them. The potential of a charge is round and only a pixel's own boundaries move the easier the
lower their barriers, so the difference of a[1, 0] and a[0, 1] is the skew and their mean goes into K. Quadrants are
indexed [dy, dx]: rows along the columns of the chip (parallel), columns along its rows (serial). builders/bfe_fit.py
finds the areas from the covariances of flats.
"""

import numpy as np

from csstsim.base.errors import InputError

SIZE = 3  # of the quadrant of K
STABLE = 0.25  # of a pixel: boundaries that move more are no small shift, and the kernel's limiter would act on them


def unfold(quadrant):
    """Return the (2n - 1, 2n - 1) array even in both directions whose quadrant (n, n) is given."""
    half = np.concatenate([quadrant[:0:-1], quadrant])
    return np.concatenate([half[:, :0:-1], half], axis=1)


def fold(array):
    """Return the quadrant (n, n) of a (2n - 1, 2n - 1) array, the mean of its mirror images, dimensionless or not."""
    n = len(array) // 2
    mean = (array + array[::-1] + array[:, ::-1] + array[::-1, ::-1]) / 4
    return mean[n:, n:]


def laplacian(quadrant):
    """Return the quadrant (n + 1, n + 1) of the sum over the four neighbours minus four times an (n, n) one."""
    whole = np.pad(unfold(quadrant), 2)
    edges = whole[:-2, 1:-1] + whole[2:, 1:-1] + whole[1:-1, :-2] + whole[1:-1, 2:]
    return fold(edges - 4 * whole[1:-1, 1:-1])


def kernel(areas):
    """Return (K (3, 3), skew) [per e-] of areas (3, 3) [per e-]. Raises ValueError for another shape or not finite."""
    areas = np.array(areas, float)
    if areas.shape != (SIZE, SIZE) or not np.isfinite(areas).all():
        raise ValueError(f"areas of shape {areas.shape}; need a finite ({SIZE}, {SIZE})")
    skew = (areas[1, 0] - areas[0, 1]) / 4
    areas[1, 0] -= 2 * skew
    areas[0, 1] += 2 * skew
    units = np.eye(SIZE**2).reshape(-1, SIZE, SIZE)
    matrix = np.stack([laplacian(unit)[:SIZE, :SIZE].ravel() for unit in units], axis=1)
    return np.linalg.solve(matrix, areas.ravel() / 2).reshape(SIZE, SIZE), skew


def detector_kernel(detector):
    """Return (K (3, 3), skew) [per e-] of a detector (brighter_fatter.yaml, full_well).

    Raises InputError if it has no areas, or charge at full well could move a boundary by a quarter pixel.
    """
    numbers = detector.brighter_fatter
    try:
        potential, skew = kernel(float(numbers["scale"]) * np.array(numbers["areas"], float))
    except (KeyError, TypeError, ValueError):
        allowed = "areas (3 x 3 numbers) and scale"
        raise InputError("not usable", key="brighter_fatter.yaml", value=numbers or None, allowed=allowed) from None
    shift = detector.full_well * (np.abs(unfold(potential)).sum() + abs(skew))
    if not shift < STABLE:
        message, allowed = "boundaries move too far at full well", f"less than {STABLE} pixels"
        raise InputError(message, key="brighter_fatter.yaml", value=shift, allowed=allowed)
    return potential, skew
