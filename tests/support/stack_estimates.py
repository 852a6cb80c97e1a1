"""Estimators, in numpy alone, of a chip's channels from stacks of calibration frames, and their errors.

Frames are in DN above the bias level; the estimators do not use how they were made. All errors are one sigma.
"""

import numpy as np
from scipy import ndimage
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.stats import norm

RAY = 5.0  # sigma: a pixel beyond it was struck by a cosmic ray ...
GROW = np.ones((5, 5), bool)  # ... and so may its neighbours be, below the noise


def struck(frames, noise, still):
    """Return (n, ny, nx) bool: pixels of frames (n, ny, nx) that rays charged, RAY above the stack's median, grown.

    noise: of a pixel, scalar or (ny, nx), in the frames' unit. still: (ny, nx) bool, pixels not to be searched (hot).
    """
    middle = np.median(frames, axis=0)
    return np.stack([ndimage.binary_dilation((frame - middle > RAY * noise) & ~still, GROW) for frame in frames])


def struck_of_pair(first, second, still):
    """Return (ny, nx) bool: pixels that a ray charged in one of two flats of the same light, grown."""
    away = first - second
    away -= np.median(away[~still])
    noise = np.sqrt(np.mean(away[~still & (np.abs(away) < 10 * 1.4826 * np.median(np.abs(away[~still])))] ** 2))
    return ndimage.binary_dilation((np.abs(away) > RAY * noise) & ~still, GROW)


def linearity(times, means, errors, shape):
    """Return (q, c), covariance (2, 2) of mean signals s = s0 + x + q x^2 + c x^3, x = rate times: four parameters.

    times, means, errors: (n,). shape: <x^2> / <x>^2 over the pixels, above 1 where the light is not even; its cube is
    the third moment's but for the skewness.
    """
    times, means = np.asarray(times, float), np.asarray(means, float)
    powers = np.stack([np.ones_like(times), times, shape * times**2, shape**3 * times**3], axis=1)
    weight = powers / np.asarray(errors)[:, None]
    covariance = np.linalg.inv(weight.T @ weight)
    _, rate, square, cube = covariance @ (weight.T @ (means / errors))
    by = np.array([[-2 * square / rate**3, 1 / rate**2, 0], [-3 * cube / rate**4, 0, 1 / rate**3]])
    return (square / rate**2, cube / rate**3), by @ covariance[1:, 1:] @ by.T


def straightened(signal, q, c):
    """Return the linear signal (float64) of x + q x^2 + c x^3, by Newton's steps."""
    x = np.array(signal, float)
    for _ in range(3):
        x -= (x * (1 + x * (q + c * x)) - signal) / (1 + x * (2 * q + 3 * c * x))
    return x


def photon_transfer(means, variances, numbers):
    """Return (gains (m,), area), covariance (m + 1, m + 1) of flats at n levels in m channels.

    means, variances (n, m): of linear signals, in DN; variances of one frame without those of readout and rounding.
    numbers (n, m): differences of pixels behind each variance. In electrons the variance is mu (1 + area mu / 2)^2:
    shot noise, and what brighter pixels lose to their neighbours. `area` [1/e-] is the chip's; the squares of
    what the neighbours gain, a twentieth of the last term, are left out (1e-4 of the variance at 60,000 e-).
    """
    errors = variances * np.sqrt(2 / numbers)

    def off(theta):
        electrons = means * theta[:-1]
        model = electrons * (1 + 1e-6 * theta[-1] * electrons / 2) ** 2 / theta[:-1] ** 2
        return ((variances - model) / errors).ravel()

    found = least_squares(off, [*(means[0] / variances[0]), 0.0], x_scale="jac")
    unit = np.array([1.0] * means.shape[1] + [1e-6])
    return found.x * unit, np.linalg.inv(found.jac.T @ found.jac) * np.outer(unit, unit)


def deficit(area, electrons):
    """Return what the brighter-fatter effect leaves of the variance of white patterns in a flat of so many e-."""
    return (1 + area * electrons / 2) ** 2


def smooth(image, good, order=3, side=16):
    """Return the polynomial surface (ny, nx) of an image, fitted to means of blocks of its good pixels."""
    ny, nx = image.shape
    y, x = (np.linspace(-1, 1, n) for n in image.shape)
    blocks = [np.array_split(np.arange(n), max(n // side, order + 1)) for n in (ny, nx)]
    starts = [np.array([part[0] for part in parts]) for parts in blocks]

    def sums(values):
        return np.add.reduceat(np.add.reduceat(values, starts[0], axis=0), starts[1], axis=1)

    count = sums(good.astype(float))
    level = sums(np.where(good, image, 0.0)) / np.maximum(count, 1)
    at = [np.array([axis[part].mean() for part in parts]) for axis, parts in zip((y, x), blocks, strict=True)]
    terms = [(i, j) for i in range(order + 1) for j in range(order + 1 - i)]
    matrix = np.stack([np.outer(at[0] ** i, at[1] ** j).ravel() for i, j in terms], axis=1)
    weight = np.sqrt(count.ravel())
    solved, *_ = np.linalg.lstsq(matrix * weight[:, None], level.ravel() * weight, rcond=None)
    return sum(k * np.outer(y**i, x**j) for k, (i, j) in zip(solved, terms, strict=True))


def pattern_rms(first, second, good):
    """Return (rms, error) of the pattern that two independent flats, divided by their smooth parts, have in common."""
    one, two = (np.where(good, flat / smooth(flat, good) - 1, 0.0)[good] for flat in (first, second))
    shared = np.mean(one * two)
    error = np.sqrt((one.var() * two.var() + shared**2) / one.size)
    return np.sqrt(shared), error / (2 * np.sqrt(shared))


def trail(level, spread, density, timescale, well, n_rows, rows):
    """Return (rows,) electrons in the parallel overscan of a column behind a flat.

    level, spread: mean and standard deviation of the flat's pixels [e-]. density, timescale (k,) as in cti.yaml; well:
    (beta, full_well, notch). A trap is full when the last packet has gone by if that reached its level, or an earlier
    one did and it has not let go since: traps above the mean are full, too, in proportion to the packets that reach
    them. Traps that the few electrons of the overscan reach, 1 in 200, are taken to let go, too.
    """
    beta, full_well, notch = well
    out = np.zeros(rows)
    for rho, tau in zip(density, timescale, strict=True):
        stay = np.exp(-1 / tau)

        def full(u, stay=stay):
            reached = norm.sf(notch + full_well * u ** (1 / beta), level, spread)
            return reached / (1 - (1 - reached) * stay) if reached > 0 else 0.0

        edge = ((level - notch) / full_well) ** beta
        filled = n_rows * rho * quad(full, 0, 1, points=(edge,), limit=400)[0]
        out += filled * (1 - stay) * stay ** np.arange(rows)
    return out


def smoothed(level, density, timescale, well, n_rows):
    """Return the share of a flat's shot noise that traps take away; arguments as of `trail`.

    A packet x above a trap's level, z sigma over the mean, loses an electron to it if it is empty, one below gets one
    if it is full and lets go. With f the chance to be full, which no packet to come knows of, the covariance of x and
    its change is -sigma phi(z) [1 - f exp(-1 / tau)]; twice that, of all traps.
    """
    beta, full_well, notch = well
    z = np.linspace(-8, 8, 1601)
    reached = norm.sf(z)
    slope = beta * ((level - notch) / full_well) ** beta / (level - notch)  # of the share of a pixel with charge
    stay = np.exp(-1 / np.array(timescale))[:, None]
    full = reached / (1 - (1 - reached) * stay)
    return 2 * n_rows * slope * np.sum(density * np.trapezoid(norm.pdf(z) * (1 - full * stay), z, axis=1))
