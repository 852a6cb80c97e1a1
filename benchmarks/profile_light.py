"""Total magnitudes of isolated galaxies of one profile, n = 1 or n = 4, through the whole chain.

    python benchmarks/profile_light.py

An r chip has galaxies of half-light radii about SIZE, within a factor SPREAD, on a grid with a pitch of PITCH px. They
are drawn, read out through every layer, calibrated and measured. Printed by the truth's S/N: median of `flux_total`
less the true magnitude, its error and the scatter.

The second table is GalSim's: noise-free images of a profile, and the best fit of the other profile with free size and
light. Its chi2 says how well one exposure tells the two apart. The light is how wrong the magnitude is if it cannot.
"""

import argparse
from itertools import pairwise
from pathlib import Path

from evidence.record import Record

import galsim
import numpy as np
import yaml
from astropy.table import Table
from chip_stages import ROOT, measured
from toy_sky import TOY_PSF

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.open import TABLE_KIND
from csstsim.catalog.table import ObjectTable
from csstsim.io.truth import read_truth
from csstsim.measure import source_columns
from csstsim.measure.bricks.match import one_to_one

PITCH, SPREAD, SIZE = 100, 1.6, 0.25  # px; of a log-normal; arcsec
MAGNITUDES = 20.5, 25.2
SNR = 8, 13, 20, 35, 60, 120
SPOILT = source_columns.TRUNCATED | source_columns.SATURATED | source_columns.SHARP | source_columns.BAD_PIXELS
SCALE, FWHM, SIDE, NOISE = 0.074, 0.16, 257, 7.5  # arcsec; px; electron a pixel
galsim.errors.raise_fft_size_error = True


def campaign(folder: Path, toy: bool) -> Path:
    """Write the galaxies' table and the campaign of one r chip, or of a window of it; return the campaign's file."""
    folder.mkdir(parents=True, exist_ok=True)
    content = yaml.safe_load((ROOT / "config/full_chip.yaml").read_text())
    content |= {"name": "profile_light", "output": str(folder / "output")}
    content["survey_table"] = str(ROOT / "survey_tables/demo.csv")
    content["catalog"] = {"kind": TABLE_KIND, "options": {"file": str(folder / "galaxies.fits")}}
    run = OpenCampaign(ROOT / "config/full_chip.yaml")
    exposure = run.jobs[0].exposure
    rng, half = np.random.default_rng(26), PITCH / 2
    line = np.arange(half, exposure.window.nx - half, PITCH)
    x, y = (place.ravel() + rng.uniform(-0.5, 0.5, line.size**2) for place in np.meshgrid(line, line))
    ra, dec = exposure.wcs.pixel_to_world(x, y)
    bulge = rng.random(x.size) < 0.5
    angle, e = rng.uniform(0, 2 * np.pi, x.size), np.minimum(np.abs(rng.normal(0.0, 0.25, x.size)), 0.6)
    size = SIZE * np.exp(np.log(SPREAD) * rng.normal(size=x.size))
    Table({
        "ra": ra, "dec": dec, "mag_r": rng.uniform(*MAGNITUDES, x.size), "size": size, "type": ["galaxy"] * x.size,
        "bulge_frac": bulge.astype(float), "e1": e * np.cos(angle), "e2": e * np.sin(angle),
    }).write(folder / "galaxies.fits", overwrite=True)  # fmt: skip
    if toy:
        content |= {"window": {"x0": 4000, "x1": 4800, "y0": 4000, "y1": 4800}, "psf": TOY_PSF}
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    return file


def of_the_chain(record):
    """Record the errors of measured total magnitudes."""
    from csstsim.command_line.main import main as csstsim

    file = campaign(record.results / "profile_light", record.toy)
    run = OpenCampaign(file)
    job = run.jobs[0]
    measured(file, job.obsid, job.chip.id)
    csstsim(["measure", str(file), "--obsid", job.obsid, "--chip", str(job.chip.id)], standalone_mode=False)
    truth, found = read_truth(run.paths.level0_truth(job)), ObjectTable.read(run.paths.measure(*job.key))
    reach = np.full(len(truth), 4.0)
    row = one_to_one(np.column_stack([truth["x"], truth["y"]]), np.column_stack([found["x"], found["y"]]), reach)
    judged = (row >= 0) & ((found["flags"][row] & SPOILT) == 0)
    off = -2.5 * np.log10(np.maximum(found["flux_total"][row] / truth["electrons"], 0.01))
    lines = []
    for n, some in (1, truth["bulge_frac"] < 0.5), (4, truth["bulge_frac"] > 0.5):
        for low, high in pairwise(SNR):
            inside = some & (truth["snr"] >= low) & (truth["snr"] < high)
            values = off[inside & judged]
            if not len(values):
                continue
            middle = np.median(values)
            scatter = 1.4826 * np.median(np.abs(values - middle))
            error = 1.25 * scatter / len(values) ** 0.5
            found_fraction = 100 * (inside & (row >= 0)).sum() / max(inside.sum(), 1)
            what = f"galaxies of n = {n}, S/N {low} to {high}: median total less true magnitude"
            record.value(f"n{n}_{low}_{high}", middle, what, unit="mag", error=error)
            cells = f"{found_fraction:.1f}", f"{middle:+.3f} ± {error:.3f}", f"{scatter:.3f}"
            lines.append([n, f"{low} to {high}", len(values), *cells])
    record.table("chain", ["n", "S/N", "galaxies", "found [%]", "total - true [mag]", "scatter"], lines)


def image(n, size):
    """Return the noise-free image of a galaxy of light 1 behind a Gaussian PSF; size: half-light radius, arcsec."""
    galaxy = galsim.Sersic(n, half_light_radius=size, gsparams=galsim.GSParams(maximum_fft_size=16384)).shear(g1=0.2)
    seen = galsim.Convolve(galaxy, galsim.Gaussian(fwhm=FWHM))
    return seen.drawImage(nx=SIDE, ny=SIDE, scale=SCALE, dtype=float).array


def told_apart(record):
    """Record how well the best fit of the other profile fits."""
    lines = []
    for n, other, size in (1, 4, 0.25), (1, 4, 0.4), (4, 1, 0.15), (4, 1, 0.25), (4, 1, 0.4):
        true = image(n, size)
        fits = []
        for factor in np.geomspace(0.2, 3.0, 4 if record.toy else 24):
            model = image(other, factor * size)
            light = (model * true).sum() / (model**2).sum()
            fits.append((((true - light * model) ** 2).sum(), light))
        misfit, light = min(fits)
        for snr in 10, 20, 40:
            chi2 = misfit * snr**2 / (true**2).sum()
            lines.append([n, f'{size}"', snr, f"{chi2:.1f}", f"{-2.5 * np.log10(light):+.2f}"])
            if (n, size, snr) == (4, 0.25, 10):
                what = "the best fit of n = 1 to n = 4, half-light radius 0.25 arcsec, S/N 10"
                record.value("other_chi2", chi2, f"{what}: chi2")
                record.value("other_light", -2.5 * np.log10(light), f"{what}: its flux less the true one", unit="mag")
    header = ["true n", "half-light radius", "S/N", "chi2 of the other n's best fit", "its flux - true [mag]"]
    record.table("told_apart", header, lines)


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        of_the_chain(record)
        told_apart(record)
