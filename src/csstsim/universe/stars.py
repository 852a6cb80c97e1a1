"""Stars of the embedded universe: counts by galactic latitude, temperatures, populations and motions.

The counts are cumulative anchors in V, scaled with latitude (the brick's centre); V is read as the AB magnitude in a
5000-5900 A box. Temperatures follow two peaks, turn-off and M dwarfs; distance comes from the main sequence (or the red
clump), metallicity and velocity from the population. Left out: the structure of the Galaxy beyond latitude (bulge,
arms, longitude), binaries, clusters, white dwarfs, extinction (av = 0).
"""

import numpy as np

_POLE = np.radians([192.85948, 27.12825])  # north galactic pole, ICRS (ESA 1997, Hipparcos vol. 1, 1.5.3)
KM_S_PER_MAS_YR_KPC = 4.740470464  # one astronomical unit a year in km / s
_STEP = 0.01  # mag


def sin_latitude(ra, dec):
    """Return sin(b) of ICRS positions [deg]."""
    ra, dec = np.radians(ra), np.radians(dec)
    return np.sin(_POLE[1]) * np.sin(dec) + np.cos(_POLE[1]) * np.cos(dec) * np.cos(ra - _POLE[0])


def cumulative_counts(numbers, sin_b):
    """Return (V, stars brighter than V and fainter than the bright limit [deg-2])."""
    knots = np.asarray(numbers["counts"], dtype=float)
    bright, faint = numbers["limits"]
    mag = np.append(np.arange(bright, faint, _STEP), faint)
    total = 10 ** _extrapolate(mag, knots[:, 0], np.log10(knots[:, 1]))
    cosec, factor = np.asarray(numbers["latitude"], dtype=float).T
    factor = np.exp(np.interp(1 / max(abs(sin_b), 1e-9), cosec, np.log(factor)))
    return mag, factor * (total - total[0])


def draw_stars(rng, area, sin_b, numbers):
    """Return the columns of a Poisson number of stars on `area` [deg2], except position, scale and magnitudes.

    `rng(name)` gives the generator of one quantity. Besides table columns: `v`, the drawn magnitude.
    """
    mag, total = cumulative_counts(numbers, sin_b)
    count = rng("count").poisson(total[-1] * area)
    v = np.interp(rng("mag").random(count) * total[-1], total, mag)
    population = _population(rng("population"), v, numbers["populations"])
    teff, giant = _temperature(rng("temperature"), v, numbers["temperature"])
    absolute, logg = _luminosity(teff, giant, numbers)
    kpc = 10 ** (0.2 * (v - absolute + 5.0)) / 1000.0
    feh = np.asarray(numbers["populations"]["feh"])[population]
    motion = _velocity(rng("velocity"), population, numbers["populations"])
    columns = {
        "teff": teff,
        "logg": logg,
        "feh": feh[:, 0] + feh[:, 1] * rng("feh").standard_normal(count),
        "pmra": motion[0] / (KM_S_PER_MAS_YR_KPC * kpc),
        "pmdec": motion[1] / (KM_S_PER_MAS_YR_KPC * kpc),
        "rv": motion[2],
        "parallax": 1.0 / kpc,
    }
    return {name: values.astype(np.float32) for name, values in columns.items()} | {"v": v}


def _extrapolate(x, knots, values):
    """Linear interpolation, continued beyond both ends with the last slope."""
    inside = np.interp(x, knots, values)
    slopes = np.diff(values) / np.diff(knots)
    return inside + slopes[0] * np.minimum(x - knots[0], 0) + slopes[-1] * np.maximum(x - knots[-1], 0)


def _population(generator, v, numbers):
    shares = np.array([np.interp(v, numbers["v"], row) for row in numbers["share"]])
    edges = np.cumsum(shares / shares.sum(axis=0), axis=0)[:-1]
    return (generator.random(len(v)) > edges).sum(axis=0)


def _temperature(generator, v, numbers):
    """Return (Teff [K], is a giant)."""
    cool, giant, median_warm, median_cool = (
        np.interp(v, numbers["v"], numbers[name]) for name in ("m_share", "giant_share", "warm", "m_dwarf")
    )
    u, w, noise = generator.random(len(v)), generator.random(len(v)), generator.standard_normal(len(v))
    warm = median_warm * np.exp(numbers["warm_scatter"] * noise)
    teff = np.where(u < cool, median_cool * np.exp(numbers["m_scatter"] * noise), warm)
    return np.clip(teff, *numbers["limits"]), (u >= cool) & (w < giant)


def _luminosity(teff, giant, numbers):
    """Return (absolute V [mag], logg); giants' Teff is set to the clump's in place."""
    clump_teff, clump_v, clump_logg = numbers["giant"]
    teff[giant] = clump_teff
    knots, absolute, logg = np.asarray(numbers["main_sequence"], dtype=float).T
    x = np.log(teff)
    return (
        np.where(giant, clump_v, np.interp(x, np.log(knots), absolute)),
        np.where(giant, clump_logg, np.interp(x, np.log(knots), logg)),
    )


def _velocity(generator, population, numbers):
    spread = np.hypot(numbers["velocity"], np.asarray(numbers["drift"]) / np.sqrt(3))[population]
    return generator.standard_normal((3, len(population))) * spread
