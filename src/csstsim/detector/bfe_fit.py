"""From the covariances of flats to the kernel of the brighter-fatter effect, and back.

A charge changes the area of the pixels around it by a[dy, dx] of a pixel per electron (Astier et al. 2019, A&A 629,
A36). Moved charge (detector.brighter_fatter) is, in a flat of mean mu, mu (k * Q) with k the discrete Laplacian of K:

    k = laplacian(K) + skew (second difference along y - along x) = a / 2
    C = mu delta + 2 k mu^2 + (k correlated with k) mu^3        for Poisson flats, exact but for terms of order 1 / mu

K is zero beyond its 5 x 5, so the 9 areas of a quadrant give its 9 values, and what the 5 x 5 areas lack to sum to zero
lies on the ring around them. The potential of a charge is round and only a pixel's own boundaries move the easier the
lower their barriers, so the difference of a[1, 0] and a[0, 1] is the skew and their mean goes into K. Real flats have
2/3 (a * a) for the last term, ours 1/4: the areas fitted are those that serve the kernel, different by some per cent of
themselves at 50,000 e-. Quadrants are indexed [dy, dx]: rows along the columns of the chip (parallel), columns along
its rows (serial).
"""

import numpy as np

SIZE = 3  # of the quadrant of K


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


def all_areas(areas):
    """Return the (4, 4) areas [per e-] of the kernel of (3, 3) ones: the same, and the ring that makes the sum 0."""
    potential, skew = kernel(areas)
    every = 2 * laplacian(potential)
    every[1, 0] += 2 * skew
    every[0, 1] -= 2 * skew
    return every


def predict(areas, mean):
    """Return the covariances (7, 7) [e-^2] of a flat of `mean` electrons by lag, [0, 0] the variance; zero beyond."""
    k = unfold(all_areas(areas) / 2)
    lags = range(len(k))
    cov = mean**3 * np.array([[np.sum(k[dy:, dx:] * k[: len(k) - dy, : len(k) - dx]) for dx in lags] for dy in lags])
    cov[: SIZE + 1, : SIZE + 1] += 2 * mean**2 * k[SIZE:, SIZE:]
    cov[0, 0] += mean
    return cov


def measure(first, second, reach=SIZE):
    """Return (mean [e-], covariances (reach, reach) [e-^2], standard errors) of two equal flats (ny, nx) [e-].

    The covariance is half that of the difference, from which all fixed patterns fall out; lags (dy, dx) and (dy, -dx)
    are averaged. Raises ValueError if the two differ in shape or are smaller than twice the reach.
    """
    if first.shape != second.shape or min(first.shape) < 2 * reach:
        raise ValueError(f"flats of shapes {first.shape} and {second.shape}; need equal ones of {2 * reach} or more")
    difference = first.astype(float) - second
    difference -= difference.mean()
    ny, nx = difference.shape
    cov, pairs = np.empty((reach, reach)), np.empty((reach, reach))
    for dy in range(reach):
        for dx in range(reach):
            right = np.mean(difference[: ny - dy, : nx - dx] * difference[dy:, dx:])
            left = np.mean(difference[: ny - dy, dx:] * difference[dy:, : nx - dx])
            cov[dy, dx] = (right + left) / 4
            pairs[dy, dx] = (ny - dy) * (nx - dx) * (2 if dy and dx else 1)
    errors = cov[0, 0] / np.sqrt(pairs)
    errors[0, 0] *= np.sqrt(2)
    return (first.mean(dtype=float) + second.mean(dtype=float)) / 2, cov, errors


def fit(means, covariances, errors):
    """Return (areas (3, 3) [per e-], errors) of flats of `means` (n,) [e-], covariances (n, 3, 3) [e-^2] with errors.

    Least squares lag by lag on mu^2, the cubic term taken from the areas of the round before.
    """
    means, cov, weight = np.asarray(means), np.asarray(covariances), 1 / np.asarray(errors) ** 2
    square = (means**2)[:, None, None]
    norm = (weight * square**2).sum(0)
    areas = np.zeros((SIZE, SIZE))
    for _ in range(20):
        rest = np.array([predict(areas, mean)[:SIZE, :SIZE] for mean in means]) - areas * square
        areas = (weight * square * (cov - rest)).sum(0) / norm
    return areas, 1 / np.sqrt(norm)
