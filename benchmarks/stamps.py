"""Stamps: CPU time and error against GalSim's, the time of a chip of faint galaxies, and of a bright star's wing.

    python benchmarks/stamps.py [--count 4000]

One run, one core. Recorded for each case:
* stamps (render.imaging.stamps), with warm tables, for an object alone (its own mixture is transformed) and in company
  (the nodes' transforms are reused; small sizes only);
* GalSim with the PSF object reused (a lower bound: one position, one colour) and rebuilt for each object
  (render.imaging.reference, the paper's method with the sub-bands summed);
* differences of stamps from render.imaging.reference: flux, centroid, weighted size^2 and ellipticity (Gaussian of
  3 px), worst pixel over the peak.
Then `count` galaxies with the sizes and reaches of faint ones are drawn over a chip with 10 x 10 nodes, as on a
noise-free chip, and the wings of bright stars.
"""

import argparse
import tempfile
import time
from pathlib import Path

from evidence.record import Record

import galsim
import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.catalog.selection.reach import POINT_MIN, galaxy_radius
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Chip, Window
from csstsim.instrument.pointing import Pointing
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.psf.psf_file import PsfSet, pixel_response
from csstsim.optics.psf.psf_set import PsfSampling, make_psf
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered, scattered_light
from csstsim.render.canvas import Canvas
from csstsim.render.drawing import Drawing
from csstsim.render.imaging.reference import GSPARAMS, PSF_MAXK, draw_objects
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.psf_mixture import Mixer
from csstsim.render.scene import make_scene
from csstsim.studies.bench.imaging.measures import moments

CHIP, EXPTIME, RATE = 9, 150.0, 1000.0
GRID, SECONDS = 10, 0.3  # nodes along a side; CPU seconds that a median of times fills
TOY_GRID, TOY_SECONDS, TOY_CASES, TOY_COUNT = 2, 0.02, 5, 300
HEADER = (
    "object", "half of the stamp", "stamps alone, ms", "in company", "GalSim, PSF reused", "PSF rebuilt", "flux",
    "centroid, mas", "size^2", "e", "worst pixel",
)  # fmt: skip
CENTRE = 4600.3, 4500.4  # px
CASES = {  # name: (half of the stamp, columns)
    "star": (16, {}),
    "star, wider": (32, {}),
    'disk 0.3"': (40, {"size_disk": 0.3}),
    'bulge 0.3"': (60, {"size_bulge": 0.3, "bulge_frac": 1.0}),
    'both 0.3", e = 0.4': (60, {"size_disk": 0.3, "size_bulge": 0.2, "bulge_frac": 0.3, "e1": 0.3, "e2": 0.26}),
    'both 1"': (100, {"size_disk": 1.0, "size_bulge": 0.5, "bulge_frac": 0.3, "e1": 0.2}),
    'disk 1", e = 0.9': (200, {"size_disk": 1.0, "e2": 0.9}),
    'both 3"': (500, {"size_disk": 3.0, "size_bulge": 1.5, "bulge_frac": 0.3, "e1": 0.2}),
}


_COMPANY = 20
INDICES = np.arange(1.23, 3.7, 0.41)  # of Sersic profiles that nothing else draws


def table_of(wcs, x, y, reach, columns, rate=RATE):
    """Return an ObjectTable in the form of catalog.selection.select's."""
    x, y = np.broadcast_arrays(np.atleast_1d(np.asarray(x, float)), np.atleast_1d(np.asarray(y, float)))
    ra, dec = wcs.pixel_to_world(x, y)
    n = len(x)
    fill = {name: np.broadcast_to(np.asarray(value, float), n).copy() for name, value in columns.items()}
    kind = GALAXY if columns else STAR
    return ObjectTable.complete(fill | {f"flux{i}": np.full(n, rate / 4) for i in range(4)} | {
        "id": np.arange(n), "obj_type": np.full(n, kind), "ra": ra, "dec": dec, "ra_orig": ra, "dec_orig": dec,
        "x": x.copy(), "y": y.copy(), "reach": np.broadcast_to(reach, n).copy(), "lost": np.full(n, 1e-3),
        "wing": np.zeros(n),
    }, ())  # fmt: skip


def cpu(call, least=SECONDS):
    """Return the CPU seconds of a call: the median of as many calls as fill `least` seconds."""
    call()
    times = []
    while sum(times) < least and len(times) < 50:
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return float(np.median(times))


def reused(psf, table, half):
    """Return a call that draws with one PSF object, made beforehand."""
    step = 1 / psf.oversampling
    response = pixel_response(psf.at(*CENTRE).mean(axis=0), psf.oversampling)
    params = galsim.GSParams(**GSPARAMS)
    point = galsim.InterpolatedImage(
        galsim.ImageD(response), scale=step, normalization="sb", x_interpolant="quintic", gsparams=params,
        _force_maxk=PSF_MAXK, _force_stepk=2 * np.pi / (response.shape[0] * step),
    )  # fmt: skip
    parts = [(galsim.Exponential, "size_disk", 1 - table["bulge_frac"][0])]
    parts.append((galsim.DeVaucouleurs, "size_bulge", table["bulge_frac"][0]))
    loose = galsim.GSParams(**(GSPARAMS | {"maximum_fft_size": 8192}), folding_threshold=5e-3)
    image = galsim.ImageD(2 * half + 1, 2 * half + 1)

    def draw():
        profile = point
        if table["obj_type"][0] == GALAXY:
            galaxy = galsim.Add(
                [
                    k(half_light_radius=float(table[s][0]) / 0.074, flux=float(f), gsparams=loose)
                    for k, s, f in parts
                    if f
                ]
            )
            galaxy = galaxy.shear(g1=float(table["e1"][0]), g2=float(table["e2"][0]))
            profile = galsim.Convolve(galaxy, point, gsparams=loose, propagate_gsparams=False)
        profile.drawImage(image, scale=1.0, method="no_pixel")

    return draw


def report_cases(record: Record, psf: PsfSet, wcs: ChipWCS) -> None:
    """Record the cost of each case, and how far stamps are from the reference."""
    mixer, rows, differences = Mixer(psf), [], {}
    for name, (half, columns) in list(CASES.items())[: TOY_CASES if record.toy else None]:
        table = table_of(wcs, *CENTRE, half, columns)
        scene = make_scene(table, wcs, psf, EXPTIME)
        x, y = (round(c) for c in CENTRE)
        window = Window(x - half, x + half + 1, y - half, y + half + 1)
        exact, drawing = Canvas(np.zeros(window.shape), window), Drawing(wcs, psf, EXPTIME)
        other = Canvas(np.zeros(window.shape, np.float32), window)
        draw_objects(other, table, drawing)
        theirs, scene = other.expected.astype(float), scene.sized(half)
        draw_scene(exact, scene, mixer)
        ours = exact.expected
        wanted = moments(theirs).value
        off = moments(ours).value - wanted
        off[[0, 5]] /= wanted[[0, 5]]
        many = scene.take(np.zeros(_COMPANY, int))
        alone, company = (min(np.median(draw_scene(other, s, mixer).ms) for _ in range(5)) for s in (scene, many))
        least = TOY_SECONDS if record.toy else SECONDS
        galsim_reused = 1e3 * cpu(reused(psf, table, half), least)
        rebuilt = 1e3 * cpu(lambda o=other, t=table, d=drawing: draw_objects(o, t, d), least)
        worst = np.abs(ours - theirs).max() / theirs.max()
        found = abs(off[0]), 74 * np.abs(off[1:3]).max(), abs(off[5]), np.abs(off[3:5]).max(), worst
        differences[name] = found
        costs = [f"{ms:.{2 if ms < 10 else 0}f}" for ms in (alone, company, galsim_reused, rebuilt)]
        rows.append([name, half, *costs, *(f"{v:.0e}".replace("e-0", "e-") for v in found)])
    record.table("cases", HEADER, rows)
    stars = [found for name, found in differences.items() if name.startswith("star")]
    galaxies = [found for name, found in differences.items() if not name.startswith("star")]
    for kind, some in (("star", stars), ("galaxy", galaxies)):
        for key, what, unit, value in zip(
            ("flux", "centroid", "size2", "e", "pixel"),
            ("flux", "centroid", "size^2", "ellipticity", "worst pixel over the peak"), ("", "mas", "", "", ""),
            np.max(some, axis=0), strict=True,
        ):  # fmt: skip
            record.value(
                f"{kind}_{key}",
                value,
                f"largest difference from the reference, {kind} stamps: {what}",
                unit=unit,
            )


def report_index(record: Record, psf: PsfSet, wcs: ChipWCS) -> None:
    """Record what the first stamp of a Sersic index costs more than the next."""
    mixer, more = Mixer(psf), []
    x, y = (round(c) for c in CENTRE)
    canvas = Canvas(np.zeros((81, 81)), Window(x - 40, x + 41, y - 40, y + 41))
    for index in INDICES:
        table = table_of(wcs, *CENTRE, 40, {"size_disk": 0.3, "n_disk": index})
        scene, times = make_scene(table, wcs, psf, EXPTIME).sized(40), []
        for _ in range(2):
            start = time.process_time()
            draw_scene(canvas, scene, mixer)
            times.append(1e3 * (time.process_time() - start))
        more.append(times[0] - times[1])
    record.value("index_ms", np.median(more), "the first stamp of a Sersic index over the next", unit="CPU-ms")


def report_chip(record: Record, psf: PsfSet, wcs: ChipWCS, chip: Chip, count: int) -> None:
    """Record the time of many faint galaxies: 0.1 to 1 arcsec, with bulges; reaches are those of selection.select."""
    rng = np.random.default_rng(1)
    size, angle, e = 0.25 * np.exp(0.45 * rng.normal(size=count)), rng.uniform(0, 7, count), rng.uniform(0, 0.6, count)
    columns = {
        "size_disk": size, "size_bulge": 0.6 * size, "bulge_frac": rng.beta(1, 3, count) * (rng.random(count) > 0.3),
        "e1": e * np.cos(angle), "e2": e * np.sin(angle),
    }  # fmt: skip
    table = table_of(wcs, *rng.uniform(0, 9200, (2, count)), 1, columns, rate=2.0)
    radius, _ = galaxy_radius(table, np.full(count, 2.0 * EXPTIME), 60.0, wcs.chip.telescope.pixel_scale)
    reach = np.ceil(POINT_MIN + radius).astype(int)
    scene, window = make_scene(table, wcs, psf, EXPTIME).sized(reach), chip.full_window
    canvas = Canvas(np.zeros(window.shape, np.float32), window)
    draw_scene(canvas, scene.take(np.arange(50)), psf)
    start = time.process_time()
    drawn = draw_scene(canvas, scene, psf)
    each = 1e3 * (time.process_time() - start) / count
    record.value("faint_reach", np.median(reach), "median reach of the faint galaxies of a chip", unit="px")
    record.value("faint_ms", each, f"a faint galaxy of a chip, mean of {count:,}, nodes included", unit="CPU-ms")
    record.value("faint_median_ms", np.median(drawn.ms), "the same, the median", unit="CPU-ms")
    points = table_of(wcs, *rng.uniform(0, 9200, (2, count)), POINT_MIN, {}, rate=2.0)
    scene = make_scene(points, wcs, psf, EXPTIME).sized(POINT_MIN)
    start = time.process_time()
    draw_scene(canvas, scene, psf)
    each = 1e3 * (time.process_time() - start) / count
    record.value("point_ms", each, f"a star of reach {POINT_MIN:g} px, mean of {count:,}", unit="CPU-ms")


def report_wing(record: Record, psf: PsfSet, wcs: ChipWCS, chip: Chip) -> None:
    """Record the cost of a bright star's wing."""
    scattered, window, mixer = Scattered(read_scattered(psf).wing), chip.full_window, Mixer(psf)
    canvas = Canvas(np.zeros(window.shape, np.float32) + 1, window, np.ones(window.shape, np.float32))
    for reach in (200.0, 1000.0) if record.toy else (200.0, 1000.0, 5000.0):
        table = table_of(wcs, *CENTRE, 32, {}, rate=1e7)
        scene = make_scene(table, wcs, psf, EXPTIME).sized(32, reach)
        seconds = cpu(
            lambda s=scene: draw_scene(canvas, s, mixer, scattered, chip), least=TOY_SECONDS if record.toy else 1
        )
        record.value(f"wing_{reach:.0f}", seconds, f"a star with a wing of {reach:.0f} px", unit="CPU-s")


def main(record: Record) -> None:
    """Make a PSF set, and record all with it."""
    camera = load_camera(SHIPPED / "instrument")
    chip, filter_ = camera.chips[CHIP], camera.filters["r"]
    wcs = ChipWCS(chip, Pointing("SCIE", 60.0, -40.0, 0.0, "2027-06-26T20:35:58", EXPTIME, None, None))
    grid, count = (TOY_GRID, TOY_COUNT) if record.toy else (GRID, record.options.count)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "psf.h5"
        make_psf(
            path, chip, filter_, camera.psf, PsfSampling(grid), camera_digest=camera.digest,
            scattered=scattered_light(camera, filter_),
        )  # fmt: skip
        psf = PsfSet(path)
        report_cases(record, psf, wcs)
        report_index(record, psf, wcs)
        report_chip(record, psf, wcs, chip, count)
        report_wing(record, psf, wcs, chip)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=int, default=4000, help="faint galaxies")
    with Record(parser) as record:
        main(record)
