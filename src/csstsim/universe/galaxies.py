"""Galaxies of the embedded universe: counts, sizes, shapes, redshifts and spectra drawn from simple laws.

Number counts in i fix how many and how bright; everything else is drawn given i. Each quantity has its own random
stream, so a change to one leaves the others as they were. Left out: clustering, merging, spiral arms,
the link between shape, size, bulge and spectrum beyond their common dependence on magnitude and redshift.
"""

import numpy as np

from csstsim.universe.galaxy_sed import COEFFICIENTS

HALF_LIGHT = 1.678347  # half-light radius / scalelength of an exponential disc
ARCMIN2_PER_DEG2 = 3600.0
_STEP = 0.01  # mag, of the cumulative counts


def cumulative_counts(numbers):
    """Return (i, N(<i) [deg-2]) from the brightest tabulated magnitude to the faint limit that gives `density`."""
    knots = np.asarray(numbers["counts"], dtype=float)
    target = numbers["density"] * ARCMIN2_PER_DEG2
    mag = np.arange(knots[0, 0], knots[-1, 0] + 20.0, _STEP)
    log = np.interp(mag, knots[:, 0], np.log10(knots[:, 1]))
    log += numbers["faint_slope"] * np.maximum(mag - knots[-1, 0], 0.0)
    counts = 10**log
    total = np.concatenate([[0.0], np.cumsum(0.5 * (counts[1:] + counts[:-1]) * _STEP)])
    if not total[0] < target < total[-1]:
        raise ValueError(f"galaxies.density {numbers['density']} arcmin-2 is not reached by the counts")
    end = np.searchsorted(total, target)
    limit = np.interp(target, total, mag)
    return np.append(mag[:end], limit), np.append(total[:end], target)


def draw_galaxies(rng, area, numbers):
    """Return the columns of a Poisson number of galaxies on `area` [deg2], except position, scale and magnitudes.

    `rng(name)` gives the generator of one quantity. Besides table columns: `i`, the drawn AB magnitude.
    """
    mag, total = cumulative_counts(numbers)
    count = rng("count").poisson(total[-1] * area)
    i = np.interp(rng("mag").random(count) * total[-1], total, mag)
    e = _ellipticity(rng("shape"), count, numbers["ellipticity"])
    size, bulge = numbers["size_disk"], numbers["bulge"]
    scatter = size["scatter"] * rng("size").standard_normal(count)
    scalelength = np.exp(size["intercept"] + size["slope"] * (i - 23.0) + scatter)
    generator = rng("bulge")
    fraction = np.minimum(np.abs(bulge["scatter"] * generator.standard_normal(count)), 1.0)
    fraction[generator.random(count) < bulge["dominated"]] = 1.0
    columns = {
        "z": _redshift(rng("redshift"), i, numbers["redshift"]),
        "size_disk": HALF_LIGHT * scalelength,
        "size_bulge": scalelength,
        "bulge_frac": fraction,
        "e1": e.real,
        "e2": e.imag,
    }
    mix = _mixture(rng("spectrum"), i, numbers["mixture"])
    columns |= {f"coeff{k}": mix[:, k] for k in range(COEFFICIENTS)}
    return {name: values.astype(np.float32) for name, values in columns.items()} | {"i": i}


def ellipticity_density(e, numbers):
    """Return the unnormalised prior P(|e|), |e| = (a - b)/(a + b)."""
    cut = 1 - np.exp((e - numbers["e_max"]) / numbers["a"])
    return e * cut / ((1 + e) * np.sqrt(e**2 + numbers["e0"] ** 2))


def _ellipticity(generator, count, numbers):
    grid = np.linspace(0, numbers["e_max"], 2001)
    total = np.cumsum(ellipticity_density(grid, numbers))
    modulus = np.interp(generator.random(count) * total[-1], total, grid)
    return modulus * np.exp(2j * np.pi * generator.random(count))


def _redshift(generator, i, numbers):
    """Draw z ~ z^2 exp(-(z / z0)^p) on 0..z_max: (z / z0)^p is a gamma variate."""
    from scipy.special import gammainc, gammaincinv

    power = numbers["power"]
    median = numbers["median_i24"] * np.exp(numbers["slope"] * (i - 24.0))
    z0 = median / gammaincinv(3 / power, 0.5) ** (1 / power)
    top = gammainc(3 / power, (numbers["z_max"] / z0) ** power)
    return z0 * gammaincinv(3 / power, generator.random(len(i)) * top) ** (1 / power)


def _mixture(generator, i, numbers):
    """Return (n, 5) coefficients of the templates; the first four sum to 1."""
    t = np.clip((i - 18.0) / 8.0, 0.0, 1.0)[:, None]
    alpha = (1 - t) * np.asarray(numbers["bright"]) + t * np.asarray(numbers["faint"])
    draw = generator.standard_gamma(alpha)
    mix = draw / draw.sum(axis=1, keepdims=True)
    bright, faint = numbers["quiescent_fraction"]
    quiescent = generator.random(len(i)) < (1 - t[:, 0]) * bright + t[:, 0] * faint
    mix[quiescent] = numbers["quiescent"]
    scatter = np.exp(numbers["line_scatter"] * generator.standard_normal(len(i)))
    return np.column_stack([mix, numbers["line_strength"] * (mix[:, 2] + mix[:, 3]) * scatter])
