"""Cost of photons: nanoseconds per electron and microseconds per object, against GalSim's photon shooting.

    python benchmarks/photons.py [--repeats 7]

Cases: single kinds of objects, objects of few electrons, and the standard scene's stars and galaxies
(standard_scene.csv, 155 e- at magnitude 26; sizes fall by 10^0.13 per magnitude) at its density. PSF nodes are as far
apart as on a 30 x 30 grid, so that tables enter and leave the cache as on a chip. Times are CPU times of one thread,
the least of the repeats, because other programs may disturb the rest. Also printed is the cost of the tables, and of
GalSim with its PSF object reused (one PSF object per object would cost 0.27 s more each).

For comparison, a prototype without counter-based random numbers took 12 ns per photon for stars, 19 ns for galaxies in
bulk and 39 ns for galaxies below 1000 electrons on a similar machine.
"""

import argparse
import csv
import tempfile
import time
from functools import partial
from pathlib import Path

import galsim
import numpy as np

from csstsim.base.counter import object_keys
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.optics.psf.psf_file import PsfSet, write_psf
from csstsim.optics.psf.psf_set import make_psf
from csstsim.optics.scatter.scattered_light import scattered_light
from csstsim.profiles.sersic import sersic_b
from csstsim.render.canvas import Canvas
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.psf_table import make_table, read_tables, write_tables
from csstsim.render.scene import Scene

GRID, CHIP_GRID, CHIP_PX, CHIP = 6, 30, 9216, 9
SIDE = CHIP_PX * (GRID - 1) // (CHIP_GRID - 1)
WINDOW = Window(0, SIDE, 0, SIDE)
ELECTRONS_26 = 155.0  # of magnitude 26 in 150 s
SCALE = 0.074
BRIGHT = 1e5  # electrons above which stars are not drawn as photons


def dense_psf(folder):
    """Return a PsfSet of the r band whose nodes are as close as those of a 30 x 30 grid."""
    camera = load_camera(SHIPPED / "instrument")
    filter = camera.filters["r"]
    coarse = Path(folder) / "coarse.h5"
    make_psf(
        coarse, camera.chips[CHIP], filter, camera.telescope, camera.psf, GRID, camera_digest=camera.digest,
        scattered=scattered_light(camera, filter),
    )  # fmt: skip
    psf = PsfSet(coarse)
    names = ("cell_um", "cell_arcsec", "oversampling", "chip", "filter", "grid", "camera_digest")
    images = ((psf.node(k), psf.tilt[k]) for k in range(GRID**2))
    write_psf(
        Path(folder) / "dense.h5", psf.nodes_xy * (GRID - 1) / (CHIP_GRID - 1), psf.wavelength, images,
        cells=psf.image.shape[-1], about={k: psf.attributes[k] for k in names}, provenance={},
    )  # fmt: skip
    return PsfSet(Path(folder) / "dense.h5")


def scene(psf, electrons, rng, index=(0.0, 4.0), size=0.3, bulge=0.0):
    """Return a Scene of objects anywhere on the window: of `electrons` (n,), Sersic indices 0 for points."""
    n = len(electrons)
    x, y = rng.uniform(0, SIDE, (2, n))
    sersic = np.zeros((n, 2, 3))
    for c in range(2):
        if index[c]:
            sersic[:, c, 0], sersic[:, c, 1], sersic[:, c, 2] = index[c], sersic_b(index[c]), size
    bulge = np.broadcast_to(bulge, n)
    node, weight, outside = psf.weights(x, y)
    matrix = np.tile(np.array([[1.1, 0.2], [0.2, 0.95]]) / SCALE, (n, 1, 1))
    return Scene(
        np.arange(n), x, y, np.repeat(electrons[:, None] / 4, 4, axis=1), np.stack([1 - bulge, bulge], axis=1), sersic,
        matrix, node, weight, outside,
    )  # fmt: skip


def standard(psf, rng):
    """Return (galaxies, stars) of the standard scene that fall on the window."""
    with open(Path(__file__).with_name("standard_scene.csv"), newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    magnitudes = {}
    for kind in ("galaxies", "stars"):
        counts = rng.poisson([row[kind] * (SIDE / CHIP_PX) ** 2 for row in rows])
        magnitudes[kind] = np.repeat([row["mag_r"] for row in rows], counts) + rng.uniform(0, 0.5, counts.sum())
    galaxies, stars = (ELECTRONS_26 * 10 ** (0.4 * (26 - magnitudes[kind])) for kind in ("galaxies", "stars"))
    size = 10 ** (-0.13 * (magnitudes["galaxies"] - 22) - 0.35 + 0.2 * rng.normal(size=len(galaxies)))
    return (
        scene(psf, galaxies, rng, (1.0, 4.0), size, rng.beta(1, 3, len(galaxies))),
        scene(psf, stars[stars < BRIGHT], rng),
    )


def cpu(function, repeats):
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        result = function()
        best = min(best, time.process_time() - start)
    return best, result


def report(label, objects, table, repeats, **losses):
    canvas, keys = Canvas(None, WINDOW, **losses), object_keys(np.uint64(1), objects.ids)
    canvas.count()
    seconds, (on, outside_box, _) = cpu(lambda: shoot_scene(canvas, objects, keys, table), repeats)
    drawn = on.sum() + outside_box.sum()
    print(
        f"{label:44s} {len(objects):7d} {drawn:10.3g} {1e9 * seconds / drawn:9.1f} {1e6 * seconds / len(objects):9.2f}"
    )


def report_galsim(psf, electrons, repeats):
    """Print the marginal cost of a photon by GalSim's photon shooting, with one PSF object for all."""
    image = psf.at(SIDE / 2, SIDE / 2).mean(axis=0)
    point = galsim.InterpolatedImage(galsim.ImageD(image), scale=1 / psf.oversampling, x_interpolant="quintic")
    disk, bulge = galsim.Exponential(half_light_radius=4.0), galsim.DeVaucouleurs(half_light_radius=4.0)
    rng = galsim.BaseDeviate(1)
    for label, profile in (
        ("star", point), ("n = 1", galsim.Convolve(disk, point)), ("n = 4", galsim.Convolve(bulge, point)),
    ):  # fmt: skip
        stamp = galsim.ImageD(100, 100)
        how = {"scale": 1.0, "method": "phot", "n_photons": electrons, "rng": rng, "poisson_flux": False}
        draw = partial(profile.drawImage, stamp, **how)
        draw()
        seconds, _ = cpu(draw, repeats)
        print(f"GalSim {label:37s} {1:7d} {electrons:10.3g} {1e9 * seconds / electrons:9.1f} {1e6 * seconds:9.1f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    rng = np.random.default_rng(5)
    with tempfile.TemporaryDirectory() as folder:
        psf = dense_psf(folder)
        make_table(psf, [0])  # compiles
        path = Path(folder) / "tables.h5"
        seconds, _ = cpu(lambda: write_tables(path, psf), 1)
        images = 4 * GRID**2
        print(
            f"tables: {1e3 * seconds / images:.2f} ms an image, file {path.stat().st_size / images * 3.6e-6:.2f} GB for"
        )
        opening, table = cpu(lambda: read_tables(path, psf), 5)
        making, _ = cpu(lambda: table.node_coefficients(3), 5)
        print(f"30 x 30 nodes; opened in {1e3 * opening:.1f} ms; coefficients of a node in {1e3 * making:.1f} ms;")
        print(f"light of the middle, the rest: {table.share.mean(axis=(0, 1))}, negative: {table.negative.max():.1e}\n")
        canvas = Canvas(None, WINDOW)
        canvas.count()
        shoot_scene(canvas, scene(psf, np.full(3, 9.0), rng), np.arange(3, dtype=np.uint64), table)
        print(f"{'objects':44s} {'number':>7s} {'electrons':>10s} {'ns / e-':>9s} {'us / obj':>9s}")
        half = np.full(WINDOW.shape, 0.5, np.float32)
        for label, keywords, losses in (
            ("stars", {}, {}),
            ("stars, half lost", {}, {"response": half}),
            ("galaxies n = 1", {"index": (1.0, 4.0)}, {}),
            ("galaxies n = 4", {"index": (1.0, 4.0), "bulge": 1.0}, {}),
            ("galaxies n = 2.5", {"index": (2.5, 4.0)}, {}),
        ):
            report(f"{label} of 3e4 e-", scene(psf, np.full(100, 3e4), rng, **keywords), table, repeats, **losses)
        for electrons in (1, 10, 30, 100, 300, 1000):
            objects = scene(psf, np.full(3000, float(electrons)), rng, (1.0, 4.0), bulge=0.3)
            report(f"galaxies n = 1, 4 of {electrons} e-", objects, table, repeats)
        galaxies, stars = standard(psf, rng)
        total = galaxies.electrons.sum(axis=1)
        report("standard scene, galaxies", galaxies, table, repeats)
        report("standard scene, galaxies below 100 e-", galaxies.take(total < 100), table, repeats)
        report(
            "standard scene, galaxies 100 to 1000 e-", galaxies.take((total >= 100) & (total < 1000)), table, repeats
        )
        report("standard scene, galaxies above 1000 e-", galaxies.take(total >= 1000), table, repeats)
        report(f"standard scene, stars below {BRIGHT:.0g} e-", stars, table, repeats)
        report_galsim(psf, 30_000, repeats)


if __name__ == "__main__":
    main()
