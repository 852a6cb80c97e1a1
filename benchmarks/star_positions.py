"""Bright stars all over a full-size chip: are their measured positions those of the truth?

    python benchmarks/star_positions.py [--stars 1000] [--chip 9] [--figure docs/figures/star_positions.png]

Stars of S/N above 500 at random positions on one chip are drawn with every layer of the shipped science exposure
(distortion, flat field, shutter, noise, readout), measured and matched with the truth table. Prints mean and scatter of
measured minus true positions, and slopes of the residuals over the chip with their errors. Takes some minutes.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import yaml
from astropy.table import Table

from csstsim.base.rng import stream
from csstsim.base.units import ab_photon_density
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.catalog.base import CatalogBase
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.io.truth import read_truth
from csstsim.stages import chip as chip_stage
from csstsim.stages import measure as measure_stage

ROOT = Path(__file__).parents[1]
OBSID = "10101000001"
ELECTRONS = 2.7e5  # S/N 519 against all noise; in one pixel at most 68,000, below the digitiser's limit
APART = 100.0  # px, between stars


class Stars(CatalogBase):
    """Stars of one AB magnitude in every band: options ra, dec, mag."""

    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        places = zip(self.options["ra"], self.options["dec"], strict=True)
        self.objs = [MockObject(id=i + 1, type="star", ra=ra, dec=dec) for i, (ra, dec) in enumerate(places)]

    def load_sed(self, obj):
        return Table({"WAVELENGTH": GRID, "FLUX": ab_photon_density(GRID, self.options["mag"])})

    def load_norm_filt(self, obj):
        return None


def scattered(count, chip, margin=40.0):
    """Return x, y of `count` positions on the chip, at least APART from one another."""
    rng, kept = stream(1, "benchmark", "star positions"), np.zeros((0, 2))
    size = np.array([chip.detector.nx, chip.detector.ny])
    while len(kept) < count:
        place = rng.uniform(margin, size - margin)
        if not len(kept) or np.hypot(*(kept - place).T).min() > APART:
            kept = np.vstack([kept, place])
    return kept.T


def measured(scratch, count, number):
    """Return x, y [px] of the truth and measured minus true [mas], for stars that are not saturated."""
    base = {
        "schema_version": 1, "name": "star_positions", "seed": 1, "output": str(scratch),
        "survey_table": str(ROOT / "survey_tables" / "w1.csv"),
        "select": {"types": ["SCIE"], "obsids": [OBSID], "chips": [number]},
    }  # fmt: skip
    file = Path(scratch) / "campaign.yaml"
    file.write_text(yaml.safe_dump(base))
    empty = OpenCampaign(file)
    job, filter_ = empty.job(OBSID, number), empty.camera.filters[empty.camera.chips[number].filter]
    ra, dec = icrs(*job.wcs.pixel_to_world(*scattered(count, job.chip)), job.observer)
    mag = filter_.zeropoint(empty.camera.telescope) - 2.5 * np.log10(ELECTRONS / job.pointing.exptime)
    options = {"ra": ra.tolist(), "dec": dec.tolist(), "mag": float(mag)}
    file.write_text(yaml.safe_dump(base | {"catalog": {"kind": "star_positions:Stars", "options": options}}))
    run = OpenCampaign(file)
    job = run.job(OBSID, number)
    chip_stage.chip(run, job)
    measure_stage.measure(run, job)
    truth = read_truth(run.paths.level0_truth(job))
    found = ObjectTable.read(run.paths.measure(*job.key))
    x, y = truth["x"], truth["y"]
    nearest = np.array([np.argmin(np.hypot(found["x"] - a, found["y"] - b)) for a, b in zip(x, y, strict=True)])
    found = found.take(nearest)
    off = np.stack([found["x"] - x, found["y"] - y]) * run.camera.telescope.pixel_scale * 1000
    good = np.hypot(*off) < 74  # mas, a pixel
    flux = truth["electrons"][good]
    print(
        f"{good.sum()} of {count} stars found, S/N {np.median(flux / np.sqrt(flux + 16 * found.meta['rms'] ** 2)):.0f}"
    )
    return x[good], y[good], off[:, good]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stars", type=int, default=1000)
    parser.add_argument("--chip", type=int, default=9)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        x, y, off = measured(scratch, options.stars, options.chip)
    u, v = x / 4608 - 1, y / 4616 - 1
    for axis, residual in zip("xy", off, strict=True):
        basis = np.stack([np.ones_like(u), u, v], axis=1)
        fit, *_ = np.linalg.lstsq(basis, residual, rcond=None)
        error = residual.std() * np.sqrt(np.diag(np.linalg.inv(basis.T @ basis)))
        slopes = ", ".join(f"{f:+.3f} +- {e:.3f}" for f, e in zip(fit[1:], error[1:], strict=True))
        mean, scatter, rms = residual.mean(), residual.std() / np.sqrt(len(u)), np.sqrt(np.mean(residual**2))
        print(
            f"{axis}: mean {mean:+.3f} +- {scatter:.3f} mas, rms {rms:.3f} mas; slope over half the chip: {slopes} mas"
        )
    if options.figure:
        draw(options.figure, x, y, off)


def draw(path, x, y, off):
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(9, 5), sharey=True, layout="constrained")
    for row, (name, residual) in zip(axes, zip("xy", off, strict=True), strict=True):
        for axis, (place, against) in zip(row, ((x, "x"), (y, "y")), strict=True):
            axis.plot(place, residual, ".", ms=2, alpha=0.6)
            axis.axhline(0, color="k", lw=0.5)
            axis.set(xlabel=f"{against} [px]", ylabel=f"{name}: out - in [mas]")
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main()
