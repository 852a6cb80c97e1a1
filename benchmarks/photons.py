"""Cost of photons: nanoseconds per electron and microseconds per object, against GalSim's photon shooting.

    python benchmarks/photons.py [--repeats 7]

Cases: single kinds of objects, objects of few electrons, and the standard scene's stars and galaxies
(standard_scene.csv, 155 e- at magnitude 26; sizes fall by 10^0.13 per magnitude) at its density. PSF nodes are as far
apart as on a 30 x 30 grid, so that tables enter and leave the cache as on a chip. Times are CPU times of one thread,
the least of the repeats, because other programs may disturb the rest. Also recorded are the cost of the tables, and of
GalSim with its PSF object reused.
"""

import argparse
import csv
import tempfile
import time
from functools import partial
from pathlib import Path

from evidence.record import Record

import galsim
import numpy as np

from csstsim.base.counter import object_keys
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.profiles.sersic import sersic_b
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.optics.psf.psf_file import PsfSet, write_psf
from csstsim.optics.psf.psf_set import PsfSampling, make_psf
from csstsim.optics.scatter.scattered_light import scattered_light
from csstsim.render.canvas import Canvas
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.psf_table import PsfTable, make_table, read_tables, write_tables
from csstsim.render.scene import Scene

GRID, CHIP_GRID, CHIP_PX, CHIP = 6, 30, 9216, 9
SIDE = CHIP_PX * (GRID - 1) // (CHIP_GRID - 1)
WINDOW = Window(0, SIDE, 0, SIDE)
ELECTRONS_26 = 155.0  # of magnitude 26 in 150 s
SCALE = 0.074
BRIGHT = 1e5  # electrons above which stars are not drawn as photons
TOY_GRID, TOY_REPEATS = 2, 1
ONES = {
    "star_ns": "stars of 3e4 e-", "n1_ns": "galaxies of n = 1, 3e4 e-", "n4_ns": "galaxies of n = 4, 3e4 e-",
    "galsim_star_ns": "GalSim, stars of 3e4 e-", "galsim_n1_ns": "GalSim, galaxies of n = 1, 3e4 e-",
    "galsim_n4_ns": "GalSim, galaxies of n = 4, 3e4 e-",
}  # fmt: skip
HEADER = "objects", "number", "electrons", "ns / electron", "us / object"


def dense_psf(folder, grid=GRID):
    """Return a PsfSet of the r band, of grid x grid nodes as close as those of a 30 x 30 grid."""
    camera = load_camera(SHIPPED / "instrument")
    filter = camera.filters["r"]
    coarse = Path(folder) / "coarse.h5"
    make_psf(
        coarse, camera.chips[CHIP], filter, camera.psf, PsfSampling(grid), camera_digest=camera.digest,
        scattered=scattered_light(camera, filter),
    )  # fmt: skip
    psf = PsfSet(coarse)
    names = ("cell_um", "cell_arcsec", "oversampling", "chip", "filter", "grid", "camera_digest")
    images = ((psf.node(k), psf.tilt[k]) for k in range(grid**2))
    write_psf(
        Path(folder) / "dense.h5", psf.nodes_xy * (grid - 1) / (CHIP_GRID - 1), psf.wavelength, images,
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


def cost(objects: Scene, table: PsfTable, repeats: int, **losses: np.ndarray) -> tuple[int, float, float, float]:
    """Return (number, electrons drawn, ns per electron, us per object)."""
    canvas, keys = Canvas(None, WINDOW, **losses), object_keys(np.uint64(1), objects.ids)
    canvas.count()
    seconds, (on, outside_box, _) = cpu(lambda: shoot_scene(canvas, objects, keys, table), repeats)
    drawn = on.sum() + outside_box.sum()
    return len(objects), drawn, 1e9 * seconds / drawn, 1e6 * seconds / len(objects)


def galsim_costs(psf: PsfSet, electrons: int, repeats: int) -> dict[str, tuple[int, float, float, float]]:
    """Return the marginal cost of a photon by GalSim's photon shooting, with one PSF object for all; as `cost`."""
    image = psf.at(SIDE / 2, SIDE / 2).mean(axis=0)
    point = galsim.InterpolatedImage(galsim.ImageD(image), scale=1 / psf.oversampling, x_interpolant="quintic")
    disk, bulge = galsim.Exponential(half_light_radius=4.0), galsim.DeVaucouleurs(half_light_radius=4.0)
    rng = galsim.BaseDeviate(1)
    found = {}
    for label, profile in (
        ("stars of", point), ("galaxies of n = 1,", galsim.Convolve(disk, point)),
        ("galaxies of n = 4,", galsim.Convolve(bulge, point)),
    ):  # fmt: skip
        stamp = galsim.ImageD(100, 100)
        how = {"scale": 1.0, "method": "phot", "n_photons": electrons, "rng": rng, "poisson_flux": False}
        draw = partial(profile.drawImage, stamp, **how)
        draw()
        seconds, _ = cpu(draw, repeats)
        found[f"GalSim, {label} 3e4 e-"] = 1, electrons, 1e9 * seconds / electrons, 1e6 * seconds
    return found


def report_tables(record: Record, psf: PsfSet, path: Path, grid: int) -> PsfTable:
    """Record what the tables of photons cost; return them."""
    make_table(psf, [0])  # compiles
    seconds, _ = cpu(lambda: write_tables(path, psf), 1)
    images = 4 * grid**2
    opening, table = cpu(lambda: read_tables(path, psf), 5)
    making, _ = cpu(lambda: table.node_coefficients(3), 5)
    whole = path.stat().st_size / images * 4 * CHIP_GRID**2 / 1e9
    record.value("table_ms", 1e3 * seconds / images, "making tables, an image of the PSF set", unit="CPU-ms")
    record.value("table_gb", whole, f"file of tables of {CHIP_GRID} x {CHIP_GRID} nodes", unit="GB")
    record.value("open_ms", 1e3 * opening, "opening the tables", unit="CPU-ms")
    record.value("node_ms", 1e3 * making, "coefficients of a node, from the tables", unit="CPU-ms")
    record.value("negative", table.negative.max(), "largest fraction of flux below zero that is clipped")
    return table


def costs(psf: PsfSet, table: PsfTable, repeats: int) -> dict[str, tuple[int, float, float, float]]:
    """Return the costs of all cases by their names."""
    rng = np.random.default_rng(5)
    canvas, found = Canvas(None, WINDOW), {}
    canvas.count()
    shoot_scene(canvas, scene(psf, np.full(3, 9.0), rng), np.arange(3, dtype=np.uint64), table)  # compiles
    half = np.full(WINDOW.shape, 0.5, np.float32)
    for label, keywords, losses in (
        ("stars of", {}, {}),
        ("stars, half lost, of", {}, {"response": half}),
        ("galaxies of n = 1,", {"index": (1.0, 4.0)}, {}),
        ("galaxies of n = 4,", {"index": (1.0, 4.0), "bulge": 1.0}, {}),
        ("galaxies of n = 2.5,", {"index": (2.5, 4.0)}, {}),
    ):
        found[f"{label} 3e4 e-"] = cost(scene(psf, np.full(100, 3e4), rng, **keywords), table, repeats, **losses)
    for electrons in (1, 10, 30, 100, 300, 1000):
        objects = scene(psf, np.full(3000, float(electrons)), rng, (1.0, 4.0), bulge=0.3)
        found[f"galaxies of {electrons} e-"] = cost(objects, table, repeats)
    galaxies, stars = standard(psf, rng)
    total = galaxies.electrons.sum(axis=1)
    parts = {
        "all galaxies": galaxies, "galaxies below 100 e-": galaxies.take(total < 100),
        "galaxies of 100 to 1000 e-": galaxies.take((total >= 100) & (total < 1000)),
        "galaxies above 1000 e-": galaxies.take(total >= 1000), "stars below 1e5 e-": stars,
    }  # fmt: skip
    return found | {f"standard scene: {name}": cost(objects, table, repeats) for name, objects in parts.items()}


def main(record: Record) -> None:
    """Record all costs."""
    repeats, grid = (TOY_REPEATS, TOY_GRID) if record.toy else (record.options.repeats, GRID)
    with tempfile.TemporaryDirectory() as folder:
        psf = dense_psf(folder, grid)
        table = report_tables(record, psf, Path(folder) / "tables.h5", grid)
        found = costs(psf, table, repeats) | galsim_costs(psf, 30_000, repeats)
    rows = [
        [name, f"{number:,}", f"{drawn:,.0f}", f"{ns:,.0f}", f"{us:,.{1 if us < 100 else 0}f}"]
        for name, (number, drawn, ns, us) in found.items()
    ]
    record.table("costs", HEADER, rows)
    for key, name in ONES.items():
        end = name.removeprefix("GalSim, ")
        by = ", by GalSim" if end != name else ""
        record.value(key, found[name][2], f"an electron of {end}{by}", unit="CPU-ns")
    faint = found["standard scene: galaxies below 100 e-"]
    record.value("faint_us", faint[3], "a galaxy below 100 e- of the standard scene", unit="CPU-us")
    share = faint[0] / found["standard scene: all galaxies"][0]
    record.value("faint_fraction", share, "fraction of the standard scene's galaxies below 100 e-")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    with Record(parser) as record:
        main(record)
