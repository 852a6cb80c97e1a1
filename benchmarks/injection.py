"""Injection tested: cost on a whole chip, the difference to a simulation by layer, stars recovered without bias.

    python benchmarks/injection.py            # cost, layers and stars: ten minutes
    python benchmarks/injection.py layers     # one of them, or trend; figure: docs/figures/recovered.png

cost    CPU seconds of 1,000 and 10,000 sources of S/N 5 to 100 in a whole calibrated image and a whole raw frame of
        150 s in r, beyond reading and writing. Limits for the image: 5 and 15.
layers  injection into a raw frame, compared with a readout of the same electrons of light, before the rounding to
        whole DN: rms difference in sigmas, one layer at a time. Limits: 0.1, of the irradiated device's pixels 0.15.
stars   5,000 stars of S/N 15 to 100 in a whole calibrated image: mean flux and place in their errors, and the pulls
        of fluxes by ERR, of a matched filter whose weights do not depend on the noise.
trend   pulls of measured fluxes against S/N, of four times 10,200 such stars, and what makes them (five minutes).
Exit code 1 if a limit is not kept.
"""

import argparse
import time
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from evidence.record import Record

import numpy as np

import csstsim
from csstsim.campaign.job import Job
from csstsim.catalog.astrometry.reduction import icrs
from csstsim.detector.noise import add_poisson
from csstsim.inject.calibrated import Planes, into_calibrated
from csstsim.inject.inject import inject
from csstsim.inject.level0 import difference, into_level0
from csstsim.inject.light import catalogue_of, light_of, table_of
from csstsim.inject.memory import BaseFrame
from csstsim.inject.recovery.bins import number
from csstsim.inject.recovery.recover import recover
from csstsim.io.fits import open_fits, read_pixels
from csstsim.measure.detection.detect import point_window
from csstsim.measure.light.centroid import windowed_positions
from csstsim.measure.light.photometry import HALF, fit_sources, psf_model, render_psf
from csstsim.simulation.state import State
from csstsim.stages.calibrate import calibrate, known_corrections
from csstsim.stages.chip import chip
from csstsim.stages.psf import open_psf

OBSID, CHIP = "10100000001", 9
TOY_SIZE = 500  # px
FOLDER = Path("results/injection")
LIMITS = {1000: 5.0, 10_000: 15.0}  # CPU s
DIFFERENCE = 0.1  # sigma
IRRADIATED = 0.15  # of a pixel; read noise hides which traps were full: docs/injection.md
BIAS, PULLS = 3.0, (0.95, 1.05)
EDGES = 14, 18, 25, 40, 60, 110  # S/N
LAYERS = {
    "brighter_fatter": {}, "detector_defects": {}, "blooming": {}, "CTE_effect": {"density_scale": 0.02},
    "CTE_effect, irradiated": {"density_scale": 1.0}, "nonlinearity": {},
}  # fmt: skip


def simulation(size=None):
    """Return a Simulation of one r exposure with an empty sky; size: of a window [px]."""
    sim = csstsim.Simulation(cache=FOLDER / f"cache_{size or 'chip'}").aim(
        150.1, 2.2, chip=CHIP, size=size, obsid=OBSID
    )
    return sim.replace(catalog=objects(sim, np.array([100.0]), np.array([100.0]), np.array([60.0])))


def objects(sim, x, y, mag, kind=None):
    """Return an astropy Table of objects at pixels of the chip; kind (n,): star or galaxy."""
    from astropy.table import Table

    job = sim._run.job(OBSID, CHIP)
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    kind = np.full(len(x), "star") if kind is None else kind
    size = np.where(kind == "galaxy", 0.3, 0.0)
    return Table({"id": np.arange(1, len(x) + 1), "ra": ra, "dec": dec, "mag_r": mag, "type": kind, "size": size})


def quiet(_):
    """Say nothing."""


def cost(record):
    """Record CPU seconds."""
    sim = simulation(TOY_SIZE if record.toy else None)
    run, job, frame = sim._run, sim._run.job(OBSID, CHIP), sim.chip(OBSID, CHIP)
    held = BaseFrame(FOLDER, frame.header, frame.header, frame.readout, "channels", None, frame.raw)
    planes = Planes(*(np.full(job.window.shape, value, kind) for value, kind in ((0, "f4"), (0.05, "f4"), (0, "u1"))))
    for count in (20, *LIMITS):  # the first loads what is compiled
        rng = np.random.default_rng(count)
        x, y = (start + rng.uniform(20, job.window.nx - 20, count) for start in (job.window.x0, job.window.y0))
        kind = np.where(np.arange(count) % 2, "galaxy", "star")
        mag = np.where(kind == "star", rng.uniform(22.0, 25.6, count), rng.uniform(21.2, 24.7, count))
        table = table_of(objects(sim, x, y, mag, kind))
        start = time.process_time()
        light = light_of(run, job, catalogue_of(run, job, table), 1, quiet)
        drawn = time.process_time()
        response = known_corrections(run, job).response.at(*np.divmod(light.pixel, job.window.nx))
        into_calibrated(planes, light, job.pointing.exptime, background=0.2, limit=7e4, response=response)
        image = time.process_time()
        into_level0(run, job, held, light)
        raw = time.process_time()
        if count in LIMITS:
            snr = np.percentile(light.truth["snr"], [1, 99])
            what = f"{count:,} sources of S/N {snr[0]:.0f} to {snr[1]:.0f}"
            record.value(f"light_{count}", drawn - start, f"{what}: their flux", unit="CPU-s")
            record.value(f"image_{count}", image - start, f"{what}: into the image", unit="CPU-s", below=LIMITS[count])
            record.value(f"raw_{count}", drawn - start + raw - image, f"{what}: into the raw frame", unit="CPU-s")


def layers(record):
    """Record the rms difference by layer."""
    base, rows = simulation(size=300 if record.toy else 1200), []
    off = dict.fromkeys(("brighter_fatter", "detector_defects", "blooming", "CTE_effect", "nonlinearity"))
    cases = {"none": off, "all": {}, "all, irradiated": {"CTE_effect": {"density_scale": 1.0}}}
    for name, param in LAYERS.items():
        keyword = name.split(",")[0]
        cases[f"{name} alone"] = {key: value for key, value in off.items() if key != keyword} | {keyword: param}
    for name, changes in cases.items():
        pixels, light, mean = compared(base.replace(layers=changes), 20 if record.toy else 400)
        key, most = name.replace(",", "").replace(" ", "_"), IRRADIATED if "irradiated" in name else DIFFERENCE
        record.value(f"pixels_{key}", pixels, f"layers {name}: rms difference of a lit pixel in its sigma", below=most)
        record.value(f"light_{key}", light, f"layers {name}: of an object's flux in its sigma", below=DIFFERENCE)
        rows.append([name, f"{pixels:.3f}", f"{light:.3f}", f"{mean:+.3f}"])
    header = ["layers", "lit pixel [its sigma], rms", "flux of an object [its sigma], rms", "mean of lit pixels [e-]"]
    record.table("layers", header, rows)


def compared(sim, count):
    """Return the numbers of `layers`: injection less a readout with the same light, before rounding."""
    run, job = sim._run, sim._run.job(OBSID, CHIP)
    w, rng = job.window, np.random.default_rng(2)
    x, y = rng.uniform(w.x0 + 10, w.x1 - 10, count), rng.uniform(w.y0 + 10, w.y1 - 10, count)
    table = objects(sim, x, y, rng.uniform(18.6, 25.5, count), np.where(np.arange(count) % 2, "galaxy", "star"))
    light = light_of(run, job, catalogue_of(run, job, table_of(table)), 1, quiet)
    if light.electrons.max() > run.camera.detector.full_well / 2:
        raise SystemExit("an object is brighter than half of the full well")
    frame, sky = sim.chip(OBSID, CHIP), sim.light(OBSID, CHIP).image
    held = BaseFrame(FOLDER, frame.header, frame.header, frame.readout, "channels", None, frame.raw)
    wanted = _read_out(run, job, sky, light) - _read_out(run, job, sky)
    detector = run.camera.detector
    off = frame.readout.active(difference(run, job, held, light)[0] - wanted) * detector.gain
    plane = light.plane(w.shape)
    sigma, lit = np.sqrt(sky + plane + detector.read_noise**2), plane > 0
    boxes = [
        np.s_[round(v) - w.y0 - 3 : round(v) - w.y0 + 4, round(u) - w.x0 - 3 : round(u) - w.x0 + 4]
        for u, v in zip(x, y, strict=True)
    ]
    each = [off[box].sum() / np.sqrt((sigma[box] ** 2).sum()) for box in boxes]
    return float(np.std(off[lit] / sigma[lit])), float(np.std(each)), float(off[lit].mean())


def _read_out(run, job, sky, light=None):
    """Return the DN, before rounding, of one readout of expected electrons and a Light, with the simulator's noise."""
    state, streams = State.blank(job.exposure), run.streams(job)
    state.image = sky.copy()
    for step in run.steps["SCIE"].stage("readout"):
        rng = streams.layer(step.name)
        if step.name != "poisson_and_dark":
            state = step.module.apply(state, step.param, rng)
            continue
        dark = state.chip.detector.dark * job.exposure.exptime
        add_poisson(state.image, rng.exposure_key("shot"), dark=dark, counted=state.take_counted())
        if light is not None:
            state.image.reshape(-1)[light.pixel] += light.electrons
    return state.image


def stars(record):
    """Record bias and pulls of 5,000 stars."""
    field = Field(3, 100, TOY_SIZE) if record.toy else Field(71, 128)
    found, _ = field.recovered(1)
    record.value("stars", int(found.clean.sum()), f"of {len(found.clean)} stars recovered cleanly")
    print(f"true S/N {found.snr.min():.0f} to {found.snr.max():.0f}")
    print(f"flux, all  {told(number(found.pull))}, of which")
    print(f"           {found.colour.mean():+.4f} by the star's colour, {found.noise.mean():+.4f} by noise")
    one = number(found.pull)
    record.value("flux", one.mean, "mean pull of fluxes", error=one.mean_error)
    for key, values in (("rest", found.rest), ("x", found.place_x), ("y", found.place_y)):
        one, what = number(values), {"rest": "fluxes without colour and noise"}.get(key, f"positions in {key}")
        within = abs(one.mean) < BIAS * one.mean_error
        record.value(key, one.mean, f"mean pull of {what}", error=one.mean_error, goal=within)
    one = number(err_pulls(field, found.frame))
    within = abs(one.mean) < BIAS * one.mean_error
    record.value("by_err", one.mean, "mean pull of a matched filter by ERR", error=one.mean_error, goal=within)
    record.value("by_err_scatter", one.scatter, "scatter of these pulls", above=PULLS[0], below=PULLS[1])


def trend(record):
    """Record the pulls of measured fluxes against S/N, of four times 10,200 stars, and what makes them."""
    field, rows = Field(3, 100, TOY_SIZE) if record.toy else Field(101, 90), []
    runs = [field.recovered(realisation)[0] for realisation in range(1, 2 if record.toy else 5)]
    snr, pull, colour, noise, rest = (
        np.concatenate([getattr(run, name) for run in runs]) for name in ("snr", "pull", "colour", "noise", "rest")
    )
    for low, high in (*pairwise(EDGES), (EDGES[0], EDGES[-1])):
        some = (snr >= low) & (snr < high)
        if some.sum() < 2:
            continue
        one, left = number(pull[some]), number(rest[some])
        cells = f"{one.mean:+.3f} ± {one.mean_error:.3f}", f"{colour[some].mean():+.3f}", f"{noise[some].mean():+.3f}"
        rows.append([f"{low} to {high}", one.n, *cells, f"{left.mean:+.3f} ± {left.mean_error:.3f}"])
        what, within = f"S/N {low} to {high}: mean pull that is left", abs(left.mean) < BIAS * left.mean_error
        record.value(f"left_{low}_{high}", left.mean, what, error=left.mean_error, goal=within)
    record.table("trend", ["S/N", "stars", "mean pull", "of colour", "of noise", "left"], rows)


@dataclass(frozen=True)
class Found:
    """Clean recovered stars: true S/N, pulls of flux and place, and the parts of the flux's pull that are foreseen.

    colour: by a spectrum that is not that of the PSF model, whose sub-bands have equal weights; noise: of the place
    and of the error itself (`foreseen`); rest: without both. clean: of all stars; frame: the injected image.
    """

    snr: np.ndarray
    pull: np.ndarray
    colour: np.ndarray
    noise: np.ndarray
    rest: np.ndarray
    place_x: np.ndarray
    place_y: np.ndarray
    clean: np.ndarray
    frame: Path


class Field:
    """Stars on a grid in a calibrated image of an empty sky, `side` times `side`, `step` px apart.

    size: of a window [px]; None: the whole chip.
    """

    def __init__(self, side, step, size=None):
        sim = simulation(size)
        self.run, self.job = sim._run, sim._run.job(OBSID, CHIP)
        if not self.run.paths.level0(self.job).exists():
            chip(self.run, self.job, quiet)
        calibrate(self.run, self.job)
        rng = np.random.default_rng(5)
        lines = np.meshgrid(*[np.arange(side)] * 2)
        x, y = (v.ravel() * float(step) + 70 + rng.uniform(-8, 8, side**2) for v in lines)
        window = self.job.window
        self.table = objects(sim, x + window.x0, y + window.y0, rng.uniform(21.5, 24.8, side**2))
        exact = Job(self.job.obsid, replace(self.job.exposure, fidelity="noise_free"))
        light = light_of(self.run, exact, catalogue_of(self.run, exact, table_of(self.table)), 1, quiet)
        self.truth, self.response = light.truth, known_corrections(self.run, self.job).response
        share = self.response.at(*np.divmod(light.pixel, window.nx))
        self.expected = np.zeros(window.shape, np.float32)  # electrons
        self.expected.reshape(-1)[light.pixel] = light.nominal / share

    def recovered(self, realisation):
        """Return (Found, recovered table) of the stars with noise of a realisation."""
        image, folder = self.run.paths.calibrated(*self.job.key), FOLDER / f"stars_{time.time_ns()}"
        (new,) = inject([image], self.table, folder, print, campaign=self.run, realisation=realisation)
        found = recover(new, image, quiet, campaign=self.run)
        order = np.argsort(self.truth["obj_ID" if "obj_ID" in self.truth else "id"])
        x, y, snr = (np.asarray(self.truth[name], float)[order][found["id"] - 1] for name in ("x", "y", "snr"))
        clean = found["clean"]
        with open_fits(new) as file:
            background = float(np.median(read_pixels(file["ERR"], new)[::8, ::8])) * self.job.pointing.exptime
        zeropoint = self.job.exposure.filter.zeropoint(self.run.camera.telescope)
        flux = self.job.pointing.exptime * 10 ** (0.4 * (zeropoint - found["mag"]))
        error = flux / (found["snr"] - found["flux_pull"])
        without_noise, noise = self.foreseen(x, y, flux, background)
        colour, pull = (without_noise - flux) / error, found["flux_pull"]
        parts = snr, pull, colour, noise, pull - colour - noise, found["x_pull"], found["y_pull"]
        return Found(*(part[clean] for part in parts), clean, new), found

    def foreseen(self, x, y, flux, background):
        """Return (flux that measure's fit finds without noise, mean pull that noise makes), (n,) each.

        The fit F = sum(p d) / sum(p^2) stands at a windowed place. Its offsets u = sum(a n) follow from the noise n of
        the pixels, a = w dx / (F sum(w (1 - dx^2 / s^2) p)) (measure.light.centroid). To second order, with p_u the
        slope of the PSF and V the variance of a pixel,
            mean of F / F - 1 = sum over x, y of [sum(a p_u V) / F - sum(p_u^2) sum(a^2 V) / 2] / sum(p^2).
        The error follows the flux that was found: a pull of -(d ln error / d ln F) error / F.
        background [e-]: noise of a pixel without stars.
        """
        window = self.job.window
        x, y = x - window.x0, y - window.y0
        model = psf_model(open_psf(self.run, self.job.chip), (window.x0, window.y0), window.shape)
        sigma = point_window(model.kernel())
        found = windowed_positions(self.expected, x, y, np.full(len(x), sigma))
        cell, plane = model.cell(x, y), np.ones(window.shape, np.float32)
        unusable = np.zeros(window.shape, np.uint8)
        fit = fit_sources(self.expected, plane, unusable, found.x, found.y, np.ones(len(x)), model.at(x, y))
        share = self.response.at(*(np.rint(v).astype(int) for v in (y, x)))
        noise = [
            _noise(model, cell[k], x[k] - round(x[k]), y[k] - round(y[k]), flux[k], background**2, share[k], sigma)
            for k in range(len(x))
        ]
        return fit.flux, np.array(noise)


def _noise(model, cell, dx, dy, flux, background, share, sigma):
    """Return the mean pull that noise makes (Field.foreseen) of a star at dx, dy [px] from the middle of a pixel."""

    def psf(u, v):
        out = np.empty((2 * HALF + 1,) * 2)
        render_psf(model.coefficients[cell], model.per_pixel, u, v, out)
        return out

    p, e = psf(dx, dy), 0.02
    variance, square = background + flux * p / share, (p**2).sum()
    v, u = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1] - np.array([dy, dx])[:, None, None]
    w, bias = np.exp(-0.5 * (u**2 + v**2) / sigma**2), 0.0
    for offset, slope in ((u, psf(dx + e, dy) - psf(dx - e, dy)), (v, psf(dx, dy + e) - psf(dx, dy - e))):
        slope = slope / (2 * e)
        a = w * offset / (flux * (w * (1 - offset**2 / sigma**2) * p).sum())
        bias += ((a * slope * variance).sum() / flux - 0.5 * (slope**2).sum() * (a**2 * variance).sum()) / square
    noise = (p**2 * variance).sum()
    error = np.sqrt(noise) / square
    return bias * flux / error - 0.5 * flux / share * (p**3).sum() / noise * error / flux


def told(one):
    """Return a bins.Number of pulls in words."""
    mean = f"mean pull {one.mean:+.4f} +- {one.mean_error:.4f}"
    return f"{one.n} stars, {mean}, scatter {one.scatter:.4f}, {one.outliers} outliers"


def err_pulls(field, frame):
    """Return the pulls (n,) of fluxes of a matched filter, whose templates are the expected light, by ERR."""
    job = field.job
    with open_fits(frame) as file:
        sci, err, dq = (read_pixels(file[name], frame) for name in ("SCI", "ERR", "DQ"))
    pulls, half = [], 8
    for x, y in zip(field.truth["x"], field.truth["y"], strict=True):
        row, column = round(y) - job.window.y0, round(x) - job.window.x0
        cut = np.s_[row - half : row + half + 1, column - half : column + half + 1]
        if dq[cut].any():
            continue
        t, d, s = (plane[cut].astype(float) for plane in (field.expected, sci, err))
        t /= job.pointing.exptime
        w = t - t.mean()  # the local background drops out
        pulls.append(((w * d).sum() - (w * t).sum()) / np.sqrt((w**2 * s**2).sum()))
    return np.array(pulls)


def figure(record):
    """Inject 1,500 stars and galaxies into a window of the mock sky; draw docs/figures/recovered.png."""
    from csstsim.inject.placement import free_pixels, random_positions

    sim = csstsim.Simulation(cache=FOLDER / "sky").aim(
        150.1, 2.2, chip=CHIP, size=300 if record.toy else 2500, obsid=OBSID
    )
    if record.toy:
        few = objects(sim, *np.random.default_rng(1).uniform(4500, 4800, (2, 30)), np.full(30, 21.0))
        sim = sim.replace(catalog=few)
    run, job = sim._run, sim._run.job(OBSID, CHIP)
    if not run.paths.level0(job).exists():
        chip(run, job, quiet)
    calibrate(run, job)
    image, folder = run.paths.calibrated(*job.key), FOLDER / f"figure_{time.time_ns()}"
    with open_fits(image) as file:
        free = free_pixels(read_pixels(file["SCI"], image), read_pixels(file["DQ"], image) > 0, reach=0, sigma=50.0)
    count, rng = 20 if record.toy else 1500, np.random.default_rng(8)
    x, y = random_positions(free, count, 8, min_separation=15.0)
    kind = np.where(np.arange(count) % 3, "galaxy", "star")
    table = objects(sim, x + job.window.x0, y + job.window.y0, rng.uniform(20.5, 26.5, count), kind)
    e, angle = np.where(kind == "galaxy", rng.uniform(0, 0.5, count), 0.0), rng.uniform(0, 2 * np.pi, count)
    table["size"] = np.where(kind == "galaxy", rng.choice([0.15, 0.25, 0.4, 0.6, 1.0], count), 0.0)
    table["e1"], table["e2"] = e * np.cos(angle), e * np.sin(angle)
    (new,) = inject([image], table, folder, print, campaign=run)
    recover(new, image, print, campaign=run)
    record.figure("recovered.png").write_bytes(new.with_suffix(".recovered.png").read_bytes())


if __name__ == "__main__":
    PARTS = {"cost": cost, "layers": layers, "stars": stars, "trend": trend, "figure": figure}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="default: cost, layers and stars")
    with Record(parser) as record:
        if record.toy:
            FOLDER = record.results / "injection"
        for part in record.options.parts or ("cost", "layers", "stars"):
            PARTS[part](record)
