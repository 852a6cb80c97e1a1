"""Electrons per second from spectra: the integral cell by cell against the sum over the paper's 0.5 A grid.

    python benchmarks/sed_integration.py [--galaxies 76000]

Recorded are, for the four sub-bands of each filter, the CPU seconds of a whole chip of galaxies, those of the direct
sum (measured on 400 of them and scaled) and the largest relative difference. Galaxies count for the latter if they have
more than 1e-5 of the median light, and more than 1e-3 of their own passes the intergalactic medium. Then follows the
cost of seven bands of one brick's galaxies, one by one and from tables in redshift, as bricks are made.
"""

import argparse
import time

from evidence.record import Record

import numpy as np

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.light.photometry import subband_weights
from csstsim.instrument.camera import load_camera
from csstsim.universe.galaxies.band_rates import BandRates
from csstsim.universe.parameters import load_universe

DIRECT, TOY_DIRECT = 400, 20
BRICK, TOY_BRICK = 105_000, 20_000
TOY_GALAXIES, TOY_BANDS = 1000, 2
SEEN, CLEAR, BRICK_SEEN = (
    1e-5,
    1e-3,
    1e-6,
)  # of the median light, of the light without absorption, of the brightest band


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


def main(record: Record) -> None:
    """Record costs and differences of each filter, and of a brick."""
    toy = record.toy
    count, direct, brick = (TOY_GALAXIES, TOY_DIRECT, TOY_BRICK) if toy else (record.options.galaxies, DIRECT, BRICK)
    seds, camera = load_universe(SHIPPED / "universe").galaxy_seds, load_camera(SHIPPED / "instrument")
    z, mix, av = galaxies(seds, count)
    few = z[:direct], mix[:direct], av[:direct]
    seds.rates(*(part[:1] for part in few), subband_weights(camera.filters["NUV"], camera.telescope))  # compiled
    rows, found = [], []
    for band, filter_ in list(camera.bands.items())[: TOY_BANDS if toy else None]:
        weights = subband_weights(filter_, camera.telescope)
        rates, fast = timed(seds.rates, z, mix, av, weights)
        sums, slow = timed(lambda w=weights: seds.spectra(few[0], few[1], np.ones(direct), few[2]) @ w.T)
        clear = seds.spectra(few[0], few[1], np.ones(direct), few[2], igm=False) @ weights.T
        seen = sums > np.maximum(CLEAR * clear, SEEN * np.median(sums, axis=0))
        error = np.abs(rates[:direct][seen] / sums[seen] - 1).max()
        found.append((fast, slow * count / direct, error))
        rows.append([band, f"{fast:.2f}", f"{found[-1][1]:.0f}", f"{error:.0e}"])
        print(*rows[-1], flush=True)
    head = ["filter", f"{count:,} galaxies, cells: CPU s", "sum over the grid: CPU s", "largest difference"]
    record.table("filters", head, rows)
    fast, slow, error = np.array(found).T
    for key, values, what in (("cells", fast, "cell by cell"), ("sums", slow, "by the sum over the grid")):
        record.value(f"{key}_minimum", values.min(), f"{count:,} galaxies {what}: minimum over filters", unit="CPU-s")
        record.value(f"{key}_maximum", values.max(), f"{count:,} galaxies {what}: maximum over filters", unit="CPU-s")
    record.value("difference", error.max(), "largest relative difference of the two, any filter")
    weights = np.stack([subband_weights(f, camera.telescope).sum(axis=0) for f in camera.bands.values()])
    z, mix, av = galaxies(seds, brick)
    BandRates(seds, weights).rates(z[:1], mix[:1], av[:1])  # compiled
    one_by_one, slow = timed(seds.rates, z, mix, av, weights)
    tables = BandRates(seds, weights)
    first, further = (timed(tables.rates, z, mix, av) for _ in range(2))
    seen = one_by_one > BRICK_SEEN * one_by_one.max(axis=1, keepdims=True)
    error = np.abs(first[0][seen] / one_by_one[seen] - 1)
    what = f"{brick:,} galaxies of a brick, seven bands"
    record.value("brick_slow", slow, f"{what}: one by one", unit="CPU-s")
    record.value("brick_first", first[1], f"{what}: from tables, the first brick of a process", unit="CPU-s")
    record.value("brick_next", further[1], f"{what}: from tables, the next brick", unit="CPU-s")
    record.value("brick_difference", error.max(), f"{what}: largest difference of tables")
    record.value("brick_difference_99", np.percentile(error, 99), f"{what}: 99% of differences are below")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--galaxies", type=int, default=76_000)
    with Record(parser) as record:
        main(record)
