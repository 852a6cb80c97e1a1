"""Electrons per second from spectra: the integral cell by cell against the sum over the paper's 0.5 A grid.

    python benchmarks/sed_integration.py [--galaxies 76000]

Prints, for the four sub-bands of each filter, the CPU seconds of a whole chip of galaxies, those of the direct sum
(measured on 400 of them and scaled) and the largest relative difference. Galaxies count for the latter if they have
more than 1e-5 of the median light, and more than 1e-3 of their own passes the intergalactic medium. Then prints the
cost of seven bands of one brick's galaxies, one by one and from tables in redshift, as bricks are made.
"""

import argparse
import time

import numpy as np

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.light.photometry import subband_weights
from csstsim.instrument.camera import load_camera
from csstsim.universe.galaxies.band_rates import BandRates
from csstsim.universe.parameters import load_universe

DIRECT = 400
BRICK = 105_000


def galaxies(seds, count):
    rng = stream(1, "benchmark", "galaxies")
    mix = seds.coefficients(
        rng.dirichlet(np.full(5, 0.4), count), rng.exponential(0.6, count), rng.lognormal(0, 0.5, count)
    )
    return rng.uniform(0, 4, count), mix, rng.normal(0.1, 0.003, count)


def timed(function, *arguments):
    start = time.process_time()
    result = function(*arguments)
    return result, time.process_time() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--galaxies", type=int, default=76_000)
    count = parser.parse_args().galaxies
    seds, camera = load_universe(SHIPPED / "universe").galaxy_seds, load_camera(SHIPPED / "instrument")
    z, mix, av = galaxies(seds, count)
    few = z[:DIRECT], mix[:DIRECT], av[:DIRECT]
    seds.rates(*(part[:1] for part in few), subband_weights(camera.filters["NUV"], camera.telescope))  # compiled
    print(f"| filter | {count} galaxies, cells: CPU s | sum over the grid: CPU s | largest difference |")
    print("|---|---|---|---|")
    for band, filter_ in camera.bands.items():
        weights = subband_weights(filter_, camera.telescope)
        rates, fast = timed(seds.rates, z, mix, av, weights)
        sums, slow = timed(lambda w=weights: seds.spectra(few[0], few[1], np.ones(DIRECT), few[2]) @ w.T)
        clear = seds.spectra(few[0], few[1], np.ones(DIRECT), few[2], igm=False) @ weights.T
        seen = sums > np.maximum(1e-3 * clear, 1e-5 * np.median(sums, axis=0))
        error = np.abs(rates[:DIRECT][seen] / sums[seen] - 1).max()
        print(f"| {band} | {fast:.2f} | {slow * count / DIRECT:.0f} | {error:.1e} |", flush=True)
    weights = np.stack([subband_weights(f, camera.telescope).sum(axis=0) for f in camera.bands.values()])
    z, mix, av = galaxies(seds, BRICK)
    BandRates(seds, weights).rates(z[:1], mix[:1], av[:1])  # compiled
    one_by_one, slow = timed(seds.rates, z, mix, av, weights)
    tables = BandRates(seds, weights)
    first, further = (timed(tables.rates, z, mix, av) for _ in range(2))
    seen = one_by_one > 1e-6 * one_by_one.max(axis=1, keepdims=True)
    error = np.abs(first[0][seen] / one_by_one[seen] - 1)
    print(
        f"\n{BRICK} galaxies of a brick, seven bands: one by one {slow:.2f} CPU s; from tables {first[1]:.2f} for the"
    )
    print(
        f"first brick of a process, {further[1]:.2f} for the next; largest difference {error.max():.1e}, 99% below",
        end=" ",
    )
    print(f"{np.percentile(error, 99):.0e}")


if __name__ == "__main__":
    main()
