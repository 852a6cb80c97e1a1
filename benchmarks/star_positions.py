"""Bright stars all over a full-size chip: are their measured positions those of the truth?

    python benchmarks/star_positions.py [--stars 1000] [--chip 9]

Stars of S/N above 500 at random positions on one chip are drawn with every layer of the shipped science exposure
(distortion, flat field, shutter, noise, readout), measured and matched with the truth table. Records mean and scatter
of measured minus true positions, and slopes of the residuals over the chip with their errors.
"""

import argparse
import tempfile
from pathlib import Path

from evidence import ROOT
from evidence.record import Record

import matplotlib
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

matplotlib.use("agg")
from matplotlib import pyplot as plt

OBSID = "10101000001"
ELECTRONS = 2.7e5  # S/N 519 against all noise; in one pixel at most 68,000, below the digitiser's limit
APART = 100.0  # px, between stars
COUNT, TOY_COUNT = 1000, 20
TOY_WINDOW = {"x0": 4000, "x1": 5000, "y0": 4100, "y1": 5100}


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


def scattered(count, window, margin=40.0):
    """Return x, y of `count` positions in the window, at least APART from one another."""
    rng, kept = stream(1, "benchmark", "star positions"), np.zeros((0, 2))
    corner, size = np.array([window.x0, window.y0]), np.array([window.nx, window.ny])
    while len(kept) < count:
        place = corner + rng.uniform(margin, size - margin)
        if not len(kept) or np.hypot(*(kept - place).T).min() > APART:
            kept = np.vstack([kept, place])
    return kept.T


def measured(scratch: str, count: int, number: int, record: Record) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x, y [px] of the truth and measured minus true [mas], for stars that are not saturated."""
    base = {
        "schema_version": 1, "name": "star_positions", "seed": 1, "output": scratch,
        "survey_table": str(ROOT / "survey_tables" / "w1.csv"),
        "select": {"types": ["SCIE"], "obsids": [OBSID], "chips": [number]},
    }  # fmt: skip
    if record.toy:
        base |= {"window": TOY_WINDOW, "psf": {"grid": 2}}
    file = Path(scratch) / "campaign.yaml"
    file.write_text(yaml.safe_dump(base))
    empty = OpenCampaign(file)
    job, filter_ = empty.job(OBSID, number), empty.camera.filters[empty.camera.chips[number].filter]
    ra, dec = icrs(*job.wcs.pixel_to_world(*scattered(count, job.window)), job.observer)
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
    record.value("found", int(good.sum()), f"stars found of {count}, within a pixel of their true positions")
    noise = np.sqrt(flux + 16 * found.meta["rms"] ** 2)
    record.value("signal_to_noise", np.median(flux / noise), "median S/N of these stars")
    return x[good], y[good], off[:, good]


def report(x: np.ndarray, y: np.ndarray, off: np.ndarray, record: Record) -> None:
    """Record mean, rms and slopes of the residuals."""
    u, v = x / 4608 - 1, y / 4616 - 1
    basis = np.stack([np.ones_like(u), u, v], axis=1)
    for axis, residual in zip("xy", off, strict=True):
        fit, *_ = np.linalg.lstsq(basis, residual, rcond=None)
        error = residual.std() * np.sqrt(np.diag(np.linalg.inv(basis.T @ basis)))
        what, mean = f"{axis}, measured minus true", residual.mean()
        scatter = residual.std() / np.sqrt(len(u))
        good = abs(mean) < max(0.05, 4 * scatter)
        record.value(f"mean_{axis}", mean, f"{what}: mean", unit="mas", error=scatter, goal=bool(good))
        rms = np.sqrt(np.mean(residual**2))
        record.value(f"rms_{axis}", rms, f"{what}: rms", unit="mas", error=rms / np.sqrt(2 * len(u)))
        for along, slope, uncertain in zip("xy", fit[1:], error[1:], strict=True):
            text = f"{what}: slope along {along} over half the chip"
            within = bool(abs(slope) < 4 * uncertain)
            record.value(f"slope_{axis}_{along}", slope, text, unit="mas", error=uncertain, goal=within)


def draw(path: Path, x: np.ndarray, y: np.ndarray, off: np.ndarray) -> None:
    """Draw the residuals against the positions."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 5), sharey=True, layout="constrained")
    for row, (name, residual) in zip(axes, zip("xy", off, strict=True), strict=True):
        for axis, (place, against) in zip(row, ((x, "x"), (y, "y")), strict=True):
            axis.plot(place, residual, ".", ms=2, alpha=0.6)
            axis.axhline(0, color="k", lw=0.5)
            axis.set(xlabel=f"{against} [px]", ylabel=f"{name}: out - in [mas]")
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stars", type=int, default=COUNT)
    parser.add_argument("--chip", type=int, default=9)
    with Record(parser) as record, tempfile.TemporaryDirectory() as scratch:
        count = TOY_COUNT if record.toy else record.options.stars
        residuals = measured(scratch, count, record.options.chip, record)
        report(*residuals, record)
        draw(record.figure("star_positions.png"), *residuals)
