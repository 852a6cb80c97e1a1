"""Accuracy and cost of galaxies of any profile, with knots, and of images.

    python benchmarks/standard_scene.py; python benchmarks/components.py       # fifteen CPU-minutes

Accuracy: one galaxy of each kind near a node of the PSF set, drawn by GalSim (reference), stamps and photons, against
direct optics (csstsim.studies.bench.imaging.truth). The response to shear is compared in the same way. Photons have
PHOTONS electrons; their statistical errors follow in brackets.

Cost: select and render of the standard scene as it is, with free indices and knots, and with an image of 101 x 101
pixels in every tenth galaxy; all in turn, the least of three runs of each.
"""

import argparse
import tempfile
import time
from functools import partial
from pathlib import Path

from evidence.record import Record

import galsim
import numpy as np
import yaml
from astropy.io import fits
from bench_setting import setting_of
from components_figure import draw_figure
from standard_scene import campaign_of

from csstsim.base.counter import object_keys
from csstsim.base.rng import stream
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
from csstsim.studies.bench.imaging.cases import Case, Shape, half_of, make_row, position
from csstsim.studies.bench.imaging.measures import errors, moments
from csstsim.studies.bench.imaging.methods import drawing_of, standard
from csstsim.studies.bench.imaging.truth import Truth
from csstsim.studies.bench.setting import Setting

galsim.errors.raise_fft_size_error = True
ELECTRONS, PHOTONS, GAMMA, SIGMA = 1e5, 3e7, 0.02, 4.0
GOALS = np.array([1e-3, 1.0, 1.0, 1e-4, 1e-4, 1e-3])  # flux, x, y [mas], e1, e2, size^2
RESPONSE = 1e-3
LIMITS = {"free n and knots": 1.3, "free n, knots, images": 2.0}  # cost over that of the scene as it is
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
REACH, TOY_REACH, TOY_PHOTONS = 140, 30, 1e5  # px, px, electrons
TOY_KINDS = {
    "Sersic n = 2.5": KINDS["Sersic n = 2.5"], "4 knots": KNOTS | {"knots": 4, "knots_frac": 0.3},
    "image of n = 1": {"sersic": (1.0, 0.2, 0.05, 31)},
}  # fmt: skip


def sersic_image(folder, n, size, scale, side):
    """Return the columns of a galaxy with an image of a Sersic profile, integrated over its pixels by GalSim."""
    folder.mkdir(exist_ok=True)
    image = galsim.ImageD(side, side)
    galsim.Sersic(n, half_light_radius=size).shear(g1=0.25, g2=0.15).drawImage(image, scale=scale)
    path = folder / f"sersic_{n:g}.fits"
    fits.writeto(path, image.array, overwrite=True)
    columns = {"image_file": np.array([str(path.resolve())]), "image_scale": np.array([scale])}
    return with_images(columns, np.array([GALAXY]), "columns")


def case_of(setting, columns, gamma=0.0, reach=REACH):
    """Return the Case of a galaxy near a node."""
    rng = stream(5, "components")
    row = make_row(setting, rng, 0, position(setting, rng, True), Shape(ELECTRONS, 0.0, 0.4, 0.3))
    if "sersic" in columns:
        columns = sersic_image(Path(setting.psf.path).parent / "images", *columns["sersic"])
    columns = {name: np.atleast_1d(value) for name, value in columns.items()} | {"gamma1": np.array([gamma])}
    row = row.with_columns(**columns)
    if "image_file" in columns:
        row = row.with_columns(e1=np.zeros(1), e2=np.zeros(1))
    row = row.with_columns(reach=np.array([reach], np.int32), lost=np.array([1e-4]))
    half = half_of(row)
    x, y = (round(float(row[name][0])) for name in "xy")
    window = Window(x - half, x + half + 1, y - half, y + half + 1)
    return Case(row, make_scene(row, setting.wcs, setting.psf, setting.exptime), window, ELECTRONS, True)


def stamps(setting, case):
    canvas = Canvas(np.zeros(case.window.shape), case.window)
    engine.draw_objects(canvas, case.row, drawing_of(setting, case, "noise_free"))
    return canvas.expected


def photons(setting, case, count=PHOTONS):
    canvas, scene = Canvas(None, case.window), case.brighter(count).scene
    shoot = canvas.count()
    keys = part_keys(object_keys(np.uint64(3), np.zeros(1, np.int64)), scene)
    shoot_scene(canvas, scene, keys, setting.table)
    return shoot * (ELECTRONS / count)


def response(draw, make, sigma):
    """Return the response of (e1, e2) to gamma1, by halving the difference of two draws; make(gamma1) -> Case."""
    one, other = (moments(draw(make(sign * GAMMA)), sigma).value[3:5] for sign in (1, -1))
    return (one - other) / (2 * GAMMA)


def accuracy(record: Record, setting: Setting) -> None:
    """Record errors of each kind by each method, and the largest over their goals."""
    truth, count = Truth(setting), TOY_PHOTONS if record.toy else PHOTONS
    methods = {"reference": (standard, np.inf), "stamps": (stamps, np.inf)}
    methods["photons"] = partial(photons, count=count), count
    rows, worst, sigma = [], {}, 6.0
    for kind, columns in (TOY_KINDS if record.toy else KINDS).items():
        make = partial(case_of, setting, columns, reach=TOY_REACH if record.toy else REACH)
        case = make()
        direct = truth(case)
        wanted = response(truth, make, sigma)[0]
        for name, (draw, drawn) in methods.items():
            found, chance = errors(draw(setting, case) / ELECTRONS, direct, 60.0, ELECTRONS, drawn, sigma=sigma)
            found, chance = found[:6], chance[:6]
            random, seen = np.isfinite(drawn), ""
            over = np.abs(found) / (GOALS + SIGMA * chance * random)
            if not random:
                off = response(lambda c, d=draw: d(setting, c), make, sigma)[0] / wanted - 1
                seen, over = f"{off:+.1e}", [*over, abs(off) / RESPONSE]
            worst.setdefault(name, []).append(max(over))
            cells = [f"{v:+.1e}" + (f" ({c:.0e})" if random else "") for v, c in zip(found, chance, strict=True)]
            flux, x, y, e1, e2, size2 = cells
            rows.append([kind, name, flux, f"{x}, {y}", f"{e1}, {e2}", size2, seen])
    record.table("accuracy", ["kind", "method", "flux", "x, y [mas]", "e1, e2", "size^2", "response to shear"], rows)
    for name, over in worst.items():
        allowed = f" and {SIGMA:g} errors of chance" if name == "photons" else ""
        record.value(name, max(over), f"{name}: largest error, in units of its goal{allowed}", below=1)


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


def cost(record: Record, runs: int) -> None:
    """Record the CPU seconds of select and render of each kind of scene."""
    file = campaign_of(record)
    template = OpenCampaign(file)
    scene = ObjectTable.read(Path(file).parent / template.config.catalog.options["file"])
    number, where = template.jobs[0].chip.id, record.results / "components"
    for path, make in (
        (template.paths.psf(number), lambda: psf_stage.psf(template, number)),
        (template.paths.psf_tables(number), lambda: psf_stage.psf_tables(template, template.jobs[0].chip)),
    ):
        if not path.exists():
            make()
    (where / "images").mkdir(parents=True, exist_ok=True)
    kinds = {}
    for kind in ("as it is", *LIMITS):
        table = where / f"{kind.replace(' ', '_').replace(',', '')}.parquet"
        scene_with(scene, kind, where / "images").write(table, {"product": kind})
        content = load_campaign(file).model_dump(mode="json")
        content["catalog"]["options"]["file"] = str(table.resolve())
        path = table.with_suffix(".yaml")
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
    best = {kind: min(times[1:], key=sum) for kind, times in spent.items()}
    ratio = {kind: sum(times) / sum(best["as it is"]) for kind, times in best.items()}
    rows = [[kind, f"{select:.1f}", f"{render:.1f}", f"{ratio[kind]:.2f}"] for kind, (select, render) in best.items()]
    record.table("cost", ["scene", "select, CPU s", "render, CPU s", "over the scene as it is"], rows)
    for key, (kind, limit) in zip(("knots_cost", "images_cost"), LIMITS.items(), strict=True):
        record.value(key, ratio[kind], f"cost of the standard scene, {kind}, over that as it is", below=limit)


def main(record: Record) -> None:
    """Record accuracy and cost, and draw the page's picture."""
    setting = setting_of(record, "r")
    accuracy(record, setting)
    cost(record, 1 if record.toy else record.options.runs)
    with tempfile.TemporaryDirectory() as folder:
        draw_figure(record.figure("galaxy_shapes.png"), setting, Path(folder))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=3, help="runs of each scene after the first")
    with Record(parser) as record:
        main(record)
