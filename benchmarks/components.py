"""Accuracy and cost of galaxies of any profile, with knots, and of images.

    python benchmarks/components.py                  # the tables of docs/galaxy_shapes.md (fifteen CPU-minutes)
    python benchmarks/components.py --accuracy       # each kind by each method against direct optics
    python benchmarks/standard_scene.py; python benchmarks/components.py --cost
    python benchmarks/components.py --figure docs/figures/galaxy_shapes.png

Accuracy: one galaxy of each kind near a node of the PSF set, drawn by GalSim (reference), stamps and photons, against
direct optics (csstsim.bench.imaging.truth). The response to shear is compared in the same way. Photons have PHOTONS
electrons; their statistical errors follow in brackets. Exit code 1 if a goal is missed.

Cost: select and render of the standard scene as it is, with free indices and knots, and with an image of 101 x 101
pixels in every tenth galaxy; all in turn, the least of three runs of each.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import galsim
import numpy as np
import yaml
from astropy.io import fits

from csstsim.base.counter import object_keys
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.bench.imaging.cases import SHARES, Case, half_of, make_row, place
from csstsim.bench.imaging.measures import errors, moments
from csstsim.bench.imaging.methods import drawing_of, standard
from csstsim.bench.imaging.truth import Truth
from csstsim.bench.setting import make_setting
from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.row_files import with_images
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.render.canvas import Canvas
from csstsim.render.imaging import draw as engine
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.parts.object_parts import part_keys
from csstsim.render.scene import make_scene
from csstsim.stages import psf as psf_stage
from csstsim.stages import render as render_stage
from csstsim.stages import select as select_stage

galsim.errors.raise_fft_size_error = True
FOLDER, SCENE = Path("results/components"), Path("results/standard_scene")
ELECTRONS, PHOTONS, GAMMA, SIGMA = 1e5, 3e7, 0.02, 4.0
GOALS = np.array([1e-3, 1.0, 1.0, 1e-4, 1e-4, 1e-3])  # flux, x, y [mas], e1, e2, size^2
RESPONSE = 1e-3
KNOTS = {"size_disk": 0.5, "bulge_frac": 0.2, "size_bulge": 0.2, "knots": 20}
KINDS = {
    "Sersic n = 1.5": {"size_disk": 0.3, "n_disk": 1.5},
    "Sersic n = 2.5": {"size_disk": 0.3, "n_disk": 2.5},
    "Sersic n = 6.2": {"size_disk": 0.2, "n_disk": 6.2},
    "n = 1.2, bulge n = 3.1": {"size_disk": 0.5, "size_bulge": 0.2, "bulge_frac": 0.4, "n_disk": 1.2, "n_bulge": 3.1},
    "disk, bulge, 20 knots": KNOTS | {"knots_frac": 0.3},
    "20 knots": KNOTS | {"knots_frac": 1.0, "bulge_frac": 0.0},
    "image of n = 1": {"sersic": (1.0, 0.3, 0.03, 201)},
    "image of n = 2.5": {"sersic": (2.5, 0.2, 0.05, 151)},
}


def sersic_image(n, size, scale, side):
    """Return the columns of a galaxy with an image of a Sersic profile, integrated over its pixels by GalSim."""
    image = galsim.ImageD(side, side)
    galsim.Sersic(n, half_light_radius=size).shear(g1=0.25, g2=0.15).drawImage(image, scale=scale)
    path = FOLDER / f"sersic_{n:g}.fits"
    fits.writeto(path, image.array, overwrite=True)
    columns = {"image_file": np.array([str(path.resolve())]), "image_scale": np.array([scale])}
    return with_images(columns, np.array([GALAXY]), "columns")


def case_of(setting, columns, gamma=0.0):
    """Return the Case of a galaxy near a node."""
    rng = stream(5, "components")
    row = make_row(setting, rng, 0, *place(setting, rng, True), SHARES, ELECTRONS, 0.0, 0.4, 0.3)
    columns = sersic_image(*columns["sersic"]) if "sersic" in columns else columns
    columns = {name: np.atleast_1d(value) for name, value in columns.items()} | {"gamma1": np.array([gamma])}
    row = row.with_columns(**columns)
    if "image_file" in columns:
        row = row.with_columns(e1=np.zeros(1), e2=np.zeros(1))
    row = row.with_columns(reach=np.array([140], np.int32), lost=np.array([1e-4]))
    half = half_of(row)
    x, y = (round(float(row[name][0])) for name in "xy")
    window = Window(x - half, x + half + 1, y - half, y + half + 1)
    return Case(row, make_scene(row, setting.wcs, setting.psf, setting.exptime), window, ELECTRONS, True)


def stamps(setting, case):
    canvas = Canvas(np.zeros(case.window.shape), case.window)
    engine.draw_objects(canvas, case.row, drawing_of(setting, case, "noise_free"))
    return canvas.expected


def photons(setting, case):
    canvas, scene = Canvas(None, case.window), case.brighter(PHOTONS).scene
    shoot = canvas.count()
    keys = part_keys(object_keys(np.uint64(3), np.zeros(1, np.int64)), scene)
    shoot_scene(canvas, scene, keys, setting.table)
    return shoot * (ELECTRONS / PHOTONS)


METHODS = {"reference": (standard, np.inf), "stamps": (stamps, np.inf), "photons": (photons, PHOTONS)}


def response(draw, setting, columns, sigma):
    """Return the response of (e1, e2) to gamma1, by halving the difference of two draws."""
    one, other = (moments(draw(case_of(setting, columns, sign * GAMMA)), sigma).value[3:5] for sign in (1, -1))
    return (one - other) / (2 * GAMMA)


def accuracy():
    """Print errors of each kind by each method; return whether all goals are met."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    setting, good = make_setting(FOLDER, "r"), True
    truth = Truth(setting)
    print("| kind | method | flux | x, y [mas] | e1, e2 | size^2 | response to shear |\n|---|---|---|---|---|---|---|")
    for kind, columns in KINDS.items():
        case, sigma = case_of(setting, columns), 6.0
        direct = truth(case)
        wanted = response(truth, setting, columns, sigma)[0]
        for name, (draw, drawn) in METHODS.items():
            found, chance = errors(draw(setting, case) / ELECTRONS, direct, 60.0, ELECTRONS, drawn, sigma=sigma)
            found, chance = found[:6], chance[:6]
            random = np.isfinite(drawn)
            seen = (
                ""
                if random
                else f"{response(lambda c, d=draw: d(setting, c), setting, columns, sigma)[0] / wanted - 1:+.1e}"
            )
            met = (np.abs(found) < GOALS + SIGMA * chance * random).all() and (random or abs(float(seen)) < RESPONSE)
            good &= bool(met)
            cells = [f"{v:+.1e}" + (f" ({c:.0e})" if random else "") for v, c in zip(found, chance, strict=True)]
            flux, x, y, e1, e2, size2 = cells
            print(
                f"| {kind} | {name} | {flux} | {x}, {y} | {e1}, {e2} | {size2} | {seen} |{'' if met else ' MISSED'}",
                flush=True,
            )
    return good


def scene_with(scene, kind, folder):
    """Return the standard scene's table with other galaxies."""
    rng, galaxy = stream(2, "components", kind), scene["obj_type"] == GALAXY
    count = len(scene)
    if kind == "as it is":
        return scene
    columns = {
        "n_disk": rng.uniform(0.6, 1.6, count).astype(np.float32),
        "n_bulge": rng.uniform(1.0, 5.5, count).astype(np.float32),
        "knots": np.where(galaxy, rng.integers(5, 31, count), 0).astype(np.int32),
        "knots_frac": np.where(galaxy, 0.2 * (1 - scene["bulge_frac"]), 0.0).astype(np.float32),
    }
    if kind.endswith("images"):
        names = [blobs(rng, folder / f"{k}.fits") for k in range(100)]
        every = galaxy & (np.arange(count) % 10 == 0)
        files = np.where(every, np.array(names)[rng.integers(0, 100, count)], "")
        pictured = with_images(
            {"image_file": files, "image_scale": np.where(every, 0.03, 0.0), "image_pa": rng.uniform(0, 360, count)}
            | {name: scene[name] for name in ("size_disk", "size_bulge")},
            scene["obj_type"], "columns",
        )  # fmt: skip
        columns |= pictured | {"knots_frac": np.where(every, 0, columns["knots_frac"]).astype(np.float32)}
        columns["bulge_frac"] = np.where(every, 0, scene["bulge_frac"]).astype(np.float32)
    return scene.with_columns(**columns)


def blobs(rng, path):
    """Write an image of 101 x 101 pixels of a disk with twenty knots; return its name."""
    axis = np.arange(101) - 50.0
    r2 = axis**2 + axis[:, None] ** 2
    image = np.exp(-np.sqrt(r2) / 8)
    for x, y in rng.normal(0, 12, (20, 2)):
        image += 0.5 * np.exp(-0.5 * ((axis - x) ** 2 + (axis[:, None] - y) ** 2) / 1.5**2)
    fits.writeto(path, image.astype(np.float32), overwrite=True)
    return str(path.resolve())


def cost(runs=3):
    """Print the CPU seconds of select and render of each kind of scene; return whether the goals are met."""
    template, scene = OpenCampaign(SHIPPED / "standard_scene.yaml"), ObjectTable.read(SCENE / "objects.parquet")
    number = template.jobs[0].chip.id
    for path, make in (
        (template.paths.psf(number), lambda: psf_stage.psf(template, number)),
        (template.paths.psf_tables(number), lambda: psf_stage.psf_tables(template, template.jobs[0].chip)),
    ):
        if not path.exists():
            make()
    folder = SCENE / "images"
    folder.mkdir(parents=True, exist_ok=True)
    kinds = {}
    for kind in ("as it is", "free n and knots", "free n, knots, images"):
        file = SCENE / f"{kind.replace(' ', '_').replace(',', '')}.parquet"
        scene_with(scene, kind, folder).write(file, {"product": kind})
        content = load_campaign(SHIPPED / "standard_scene.yaml").model_dump(mode="json")
        content["catalog"]["options"]["file"] = str(file.resolve())
        content["output"] = str(SCENE.resolve())
        path = file.with_suffix(".yaml")
        path.write_text(yaml.safe_dump(content))
        kinds[kind] = OpenCampaign(path)
    spent = {kind: [] for kind in kinds}
    for _ in range(runs + 1):
        for kind, run in kinds.items():
            start = time.process_time()
            objects = select_stage.selected(run, run.jobs[0].exposure)
            middle = time.process_time()
            state = render_stage.rendered(run, run.jobs[0].exposure, objects, run.streams(run.jobs[0]))
            spent[kind].append((middle - start, time.process_time() - middle))
            del objects, state
    print("| scene | select, CPU s | render, CPU s | over the scene as it is |\n|---|---|---|---|")
    best = {kind: min(times[1:], key=sum) for kind, times in spent.items()}
    for kind, (select, render) in best.items():
        ratio = (select + render) / sum(best["as it is"])
        print(f"| {kind} | {select:.1f} | {render:.1f} | {ratio:.2f} |", flush=True)
    plain, knots, images = (sum(best[kind]) for kind in kinds)
    return knots <= 1.3 * plain and images <= 2.0 * plain


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--accuracy", action="store_true", help="accuracy alone")
    parser.add_argument("--cost", action="store_true", help="cost alone")
    parser.add_argument("--runs", type=int, default=3, help="runs of each scene after the first")
    parser.add_argument("--figure", type=Path, help="draw the page's picture instead")
    options = parser.parse_args()
    if options.figure:
        from components_figure import draw_figure

        with tempfile.TemporaryDirectory() as folder:
            draw_figure(options.figure, Path(folder))
        return 0
    every, good = not (options.accuracy or options.cost), True
    if options.accuracy or every:
        good &= accuracy()
    if options.cost or every:
        good &= cost(options.runs)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
