"""Area changes of pixels by charge (config/instrument/brighter_fatter.yaml) from the covariances of flats, and back.

With areas a = 2 k of the kernel of csstsim.detector.bfe_kernel, the covariances of flats of mean mu are

    C = mu delta + 2 k mu^2 + (k correlated with k) mu^3        for Poisson flats, exact but for terms of order 1 / mu

Real flats have 2/3 (a * a) in the last term, the kernel's 1/4. So the fitted areas are those that suit the kernel; at
50,000 e- they differ by some per cent from the real ones.
"""

import numpy as np

from csstsim.detector.bfe_kernel import SIZE, kernel, laplacian, unfold


def all_areas(areas):
    """Return the (4, 4) areas [per e-] of the kernel of (3, 3) areas: the same, and a ring that makes their sum 0."""
    potential, skew = kernel(areas)
    every = 2 * laplacian(potential)
    every[1, 0] += 2 * skew
    every[0, 1] -= 2 * skew
    return every


def predict(areas, mean):
    """Return the covariances (7, 7) [e-^2] by lag of a flat of `mean` electrons; [0, 0] is the variance."""
    k = unfold(all_areas(areas) / 2)
    lags = range(len(k))
    cov = mean**3 * np.array([[np.sum(k[dy:, dx:] * k[: len(k) - dy, : len(k) - dx]) for dx in lags] for dy in lags])
    cov[: SIZE + 1, : SIZE + 1] += 2 * mean**2 * k[SIZE:, SIZE:]
    cov[0, 0] += mean
    return cov


def measure(first, second, reach=SIZE):
    """Return (mean [e-], covariances (reach, reach) [e-^2], standard errors) of two equal flats (ny, nx) [e-].

    The covariance is half that of the difference, in which all fixed patterns cancel; lags (dy, dx) and (dy, -dx) are
    averaged. Raises ValueError if the two differ in shape or are smaller than twice the reach.
    """
    if first.shape != second.shape or min(first.shape) < 2 * reach:
        raise ValueError(f"flats of shapes {first.shape} and {second.shape}; need equal ones of at least {2 * reach}")
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

    Least squares in mu^2, lag by lag; the cubic term is that of the previous iteration's areas.
    """
    means, cov, weight = np.asarray(means), np.asarray(covariances), 1 / np.asarray(errors) ** 2
    square = (means**2)[:, None, None]
    norm = (weight * square**2).sum(0)
    areas = np.zeros((SIZE, SIZE))
    for _ in range(20):
        rest = np.array([predict(areas, mean)[:SIZE, :SIZE] for mean in means]) - areas * square
        areas = (weight * square * (cov - rest)).sum(0) / norm
    return areas, 1 / np.sqrt(norm)
