"""Skewness of convergence from a fit of the bispectrum of matter to N-body simulations, without any halo.

    python benchmarks/bispectrum.py

    B(k1, k2, k3) = 2 F(k1, k2) P(k1) P(k2) + two more,      <kappa^3> = int dchi q^3 / chi^4 int int W W W B

F: Scoccimarro & Couchman 2001 (MNRAS 325, 1312, equations 5 to 10), within 15% of their simulations; P: halofit.
S3 = <kappa^3> / <kappa^2>^2 and sigma of convergence in Gaussian windows at z = 1, 2, 3, in Limber's and Born's
approximation.
"""

import argparse

from evidence.record import Record

import numpy as np

from csstsim.universe.lensing.lens_spectra import Shells
from csstsim.universe.parameters import load_universe

_L = np.geomspace(3.0, 6e4, 56)  # multipoles
_PHI = np.linspace(0, np.pi, 41)[:-1] + np.pi / 80  # between l1 and l2
_NODES, _TOY_NODES = 24, 3  # of distance
_SOURCES, _WINDOWS = (1.0, 2.0, 3.0), (1.0, 2.0, 4.0)  # redshifts; arcmin


def kernel(power, k, z):
    """Return a, b, c (len(k)) of the fit at redshift z."""
    growth = float(power.cosmology.growth(z))
    fine = np.geomspace(1e-3, 1e3, 3000)
    linear = power.linear(fine, z)
    nonlinear_k = np.interp(1.0, fine**3 * linear / (2 * np.pi**2), fine)
    smooth = np.polynomial.polynomial.Polynomial.fit(np.log(fine), np.log(linear), 9)  # no acoustic wiggles in n
    n = smooth.deriv()(np.log(np.clip(k, fine[0], fine[-1])))
    q, sigma8 = k / nonlinear_k, power.numbers["sigma_8"] * growth
    q3 = (4 - 2**n) / (1 + 2 ** (n + 1))
    a = (1 + sigma8**-0.2 * np.sqrt(0.7 * q3) * (q / 4) ** (n + 3.5)) / (1 + (q / 4) ** (n + 3.5))
    b = (1 + 0.4 * (n + 3) * q ** (n + 3)) / (1 + q ** (n + 3.5))
    c = (1 + 4.5 / (1.5 + (n + 3) ** 4) * (2 * q) ** (n + 3)) / (1 + (2 * q) ** (n + 3.5))
    return a, b, c


def bispectrum(power, k1, k2, k3, z):
    """Return B [Mpc^6] of triangles."""
    sides = k1, k2, k3
    p = [power.nonlinear(k, z) for k in sides]
    fits = [kernel(power, k.ravel(), z) for k in sides]
    a, b, c = ([fit[i].reshape(k.shape) for fit, k in zip(fits, sides, strict=True)] for i in range(3))
    total = 0.0
    for i, j, other in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        cosine = (sides[other] ** 2 - sides[i] ** 2 - sides[j] ** 2) / (2 * sides[i] * sides[j])
        ratio = sides[i] / sides[j]
        f = 5 / 7 * a[i] * a[j] + 0.5 * (ratio + 1 / ratio) * cosine * b[i] * b[j] + 2 / 7 * cosine**2 * c[i] * c[j]
        total = total + 2 * f * p[i] * p[j]
    return total


def moments(shells: Shells, z_source: float, windows: np.ndarray, count: int = _NODES) -> np.ndarray:
    """Return <kappa^2> and <kappa^3> (2, windows) in Gaussian windows of sigma [rad]."""
    source = float(shells.cosmology.comoving_distance(z_source))
    nodes, weights = np.polynomial.legendre.leggauss(count)
    chi = 0.5 * source * (1 + nodes)
    l1, l2, cosine = _L[:, None, None], _L[None, :, None], np.cos(_PHI)
    l3 = np.sqrt(l1**2 + l2**2 + 2 * l1 * l2 * cosine)
    cells = np.gradient(np.log(_L)) * _L**2
    measure = cells[:, None, None] * cells[None, :, None] * (2 * np.pi) * (2 * np.pi / len(_PHI)) / (2 * np.pi) ** 4
    total = np.zeros((2, len(windows)))
    filters = [np.exp(-0.5 * (l1**2 + l2**2 + l3**2) * s**2) * measure for s in windows]
    for x, weight in zip(chi, 0.5 * source * weights, strict=True):
        z = float(np.interp(x, *shells.distances))
        q = shells.strength(z) * x * (1 - x / source)
        b = bispectrum(shells.power, *np.broadcast_arrays(l1 / x, l2 / x, l3 / x), z)
        p = shells.power.nonlinear((_L + 0.5) / x, z)
        total[0] += [weight * q**2 / x**2 * (cells * p * np.exp(-((_L * s) ** 2))).sum() / (2 * np.pi) for s in windows]
        total[1] += [weight * q**3 / x**4 * (b * f).sum() for f in filters]
    return total


def main(record: Record) -> None:
    shells = load_universe().matter_field(1, False).shells
    rows = [[f"{window:g}"] for window in _WINDOWS]
    for z in _SOURCES:
        count = _TOY_NODES if record.toy else _NODES
        second, third = moments(shells, z, np.radians(np.array(_WINDOWS) / 60), count)
        skewness = third / second**2
        for row, deviation, s3 in zip(rows, 1e3 * np.sqrt(second), skewness, strict=True):
            row += [f"{deviation:.2f}", f"{s3:.0f}"]
        record.value(f"s3_{z:g}", skewness[0], f"S3 at z = {z:g} in a Gaussian window of {_WINDOWS[0]:g} arcmin")
    names = [f"{what}, z = {z:g}" for z in _SOURCES for what in ("1000 sigma", "S3")]
    record.table("windows", ["window [arcmin]", *names], rows)


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
