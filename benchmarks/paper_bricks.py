"""Ten bricks in u, g and r, merged: the colours of paper_figures.py, which the paper takes from ten merged catalogues.

    python benchmarks/paper_bricks.py    # after ten_images.yaml; goes on where it was stopped

A brick is that in which the middle of an image of examples/ten_images.yaml lies: two in each Cycle-9 field. It is a
campaign of its own: one exposure of 150 s in each band, every layer, in windows about the middle of the brick. With the
default radius they need six truth bricks that the ten images do not have. `--radius 5` has three times the area.
"""

import argparse
import time
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

from evidence.record import Record

import healpy
import numpy as np
import yaml
from toy_sky import toy_sky

from csstsim.base.healpix import NSIDE, brick_of
from csstsim.campaign.aiming import aimed_exposures, chips_for, survey_table_text
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.command_line.main import main as command

ROOT = Path(__file__).parents[1]
IMAGES, OUTPUT = ROOT / "examples/ten_images.yaml", ROOT / "results/paper_bricks"
BANDS = "u", "g", "r"
TOY_RADIUS = 0.3
RADIUS = 2.9  # arcmin, of the region; its windows are twice as wide, and lie in the brick at any angle


def middles(run):
    """Return [(ra, dec, Pointing)] of the middle of each image of the campaign."""
    found = []
    for job in run.imaging_jobs:
        pointing, window = job.pointing, job.window
        wcs, _ = run.maps(pointing, job.chip)
        x, y = 0.5 * (window.x0 + window.x1 - 1), 0.5 * (window.y0 + window.y1 - 1)
        found.append((*(float(v) for v in wcs.pixel_to_world(x, y)), pointing))
    return found


def campaign(images, folder, place, pointing, chips, **content):
    """Write the campaign of exposures like `pointing` of a place (ra, dec), one on each chip; return it opened.

    content: more keys of its file. Truth and PSF sets are shared with the campaign `images`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    settings = {"pa": pointing.pa, "times": (pointing.time,), "exptime": pointing.exptime}
    found = aimed_exposures(images.camera, *place, chips, **settings)
    comment = f"{folder.name} in {', '.join(chip.filter for chip in chips)}"
    (folder / "table.csv").write_text(survey_table_text(found, [comment]))
    content = {
        "schema_version": 1, "name": folder.name, "survey_table": "table.csv", "output": "products",
        "seed": images.config.seed,
    } | content  # fmt: skip
    if images.config.share:
        content["share"] = str(Path(images.config.share).resolve())
    if not images.embedded:  # at toy size
        content |= toy_sky(folder, *place, radius=0.01)
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return OpenCampaign(folder / "campaign.yaml")


def campaigns(images=IMAGES, output=OUTPUT, radius=RADIUS):
    """Return {brick: OpenCampaign} of the ten bricks; their files are written."""
    run, found = OpenCampaign(images), {}
    chips = chips_for(run.camera, filters=BANDS)
    for ra, dec, pointing in middles(run):
        pix = int(brick_of(ra, dec))
        place = tuple(float(v) for v in healpy.pix2ang(NSIDE, pix, nest=True, lonlat=True))
        region = dict(zip(("ra", "dec"), place, strict=True)) | {"radius": radius}
        select = {"filters": list(BANDS), "region": region}
        folder = output / f"brick_{pix}_{radius:g}"
        found[pix] = campaign(run, folder, place, pointing, chips, select=select, window="region")
    return found


def csstsim(*words: object) -> float:
    """Run a command of csstsim in this process, which says nothing; return its CPU seconds."""
    start = time.process_time()
    with redirect_stdout(StringIO()):
        command([str(word) for word in words], standalone_mode=False)
    return time.process_time() - start


def _names(job):
    return "--obsid", job.obsid, "--chip", job.chip.id


def make(run, pix):
    """Make what is missing of a brick's campaign. Return its CPU seconds."""
    cpu = 0.0
    for job in run.jobs:
        if not run.paths.measure(*job.key).is_file():
            cpu += sum(csstsim(stage, run.file, *_names(job)) for stage in ("chip", "measure"))
    if not run.paths.merge(pix).is_file():
        cpu += csstsim("merge", run.file, "--brick", pix)
    return cpu


def main() -> None:
    """Make the bricks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, default=IMAGES)
    parser.add_argument("--output", type=Path, default=OUTPUT)
    parser.add_argument("--radius", type=float, default=RADIUS, help="Half the width of the windows, arcmin.")
    with Record(parser) as record:
        given = record.options
        if record.toy:
            given.images, given.radius = toy_images(record.results / "paper_images"), TOY_RADIUS
            given.output = record.results / "paper_bricks"
        cpu, frames, depths = 0.0, 0, []
        for pix, run in campaigns(given.images, given.output, given.radius).items():
            seconds = make(run, pix)
            print(f"brick {pix}: {len(run.jobs)} frames, {seconds:.0f} CPU s", flush=True)
            cpu, frames = cpu + seconds, frames + len(run.jobs)
            of_g = (ObjectTable.read(run.paths.measure(*job.key)) for job in run.jobs if job.chip.filter == "g")
            depths += [table.meta["depth_5sigma"] for table in of_g]
        record.value("frames", frames, "frames of the bricks")
        record.value("depth_g", float(np.median(depths)), "depth of the g frames, 5 sigma, point source", unit="mag")
        record.value("cpu", cpu, "making what was missing", unit="CPU-s")


def toy_images(folder: Path) -> Path:
    """Write a campaign of a small window of one r image, make and measure it; return its file."""
    content = yaml.safe_load(IMAGES.read_text())
    content |= {"survey_table": str(IMAGES.parent / content["survey_table"]), "output": str(folder)}
    content |= {"window": {"x0": 4000, "x1": 4700, "y0": 4000, "y1": 4700}, "share": None, "psf": {"grid": 2}}
    file = folder / "campaign.yaml"
    folder.mkdir(parents=True, exist_ok=True)
    file.write_text(yaml.safe_dump(content))
    run = OpenCampaign(file)
    job = run.imaging_jobs[0]
    middle = (float(corner.mean()) for corner in job.footprint())
    content["select"] = content["select"] | {"obsids": [job.obsid], "chips": [job.chip.id]}
    file.write_text(yaml.safe_dump(content | toy_sky(folder, *middle, count=600, radius=0.01)))
    run = OpenCampaign(file)
    if not run.paths.measure(*job.key).exists():
        for stage in ("chip", "measure"):
            csstsim(stage, run.file, *_names(job))
    return file


if __name__ == "__main__":
    main()
