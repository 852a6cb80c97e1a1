"""Ten bricks in u, g and r, merged: the colours of paper_figures.py, which the paper takes from ten merged catalogues.

    python benchmarks/paper_bricks.py    # after ten_images.yaml; goes on where it was stopped

A brick is that in which the middle of an image of examples/ten_images.yaml lies: two in each Cycle-9 field. It is a
campaign of its own: one exposure of 150 s in each band, every layer, in windows about the middle of the brick. With the
default radius they need six truth bricks that the ten images do not have. `--radius 5` has three times the area.
"""

import argparse
from pathlib import Path

import healpy
import yaml
from source_extractor import csstsim, run_csstsim

from csstsim.base.healpix import NSIDE, brick_of
from csstsim.campaign.aiming import aimed, chips_for, table_of
from csstsim.campaign.opened import OpenCampaign

ROOT = Path(__file__).parents[1]
IMAGES, OUTPUT = ROOT / "examples/ten_images.yaml", ROOT / "results/paper_bricks"
BANDS = "u", "g", "r"
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
    found = aimed(images.camera, *place, chips, pa=pointing.pa, times=(pointing.time,), exptime=pointing.exptime)
    (folder / "table.csv").write_text(table_of(found, [f"{folder.name} in {', '.join(chip.filter for chip in chips)}"]))
    content = {
        "schema_version": 1, "name": folder.name, "survey_table": "table.csv", "output": "products",
        "seed": images.config.seed, "share": str(Path(images.config.share).resolve()),
    } | content  # fmt: skip
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


def make(run, pix):
    """Make what is missing of a brick's campaign. Return its CPU seconds."""
    cpu = 0.0
    for job in run.jobs:
        if not run.paths.measure(*job.key).is_file():
            cpu += csstsim("chip", run, job) + csstsim("measure", run, job)
    if not run.paths.merge(pix).is_file():
        cpu += run_csstsim("merge", run.file, "--brick", str(pix))
    return cpu


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=Path, default=IMAGES)
    parser.add_argument("--output", type=Path, default=OUTPUT)
    parser.add_argument("--radius", type=float, default=RADIUS, help="Half the width of the windows, arcmin.")
    given = parser.parse_args()
    for pix, run in campaigns(given.images, given.output, given.radius).items():
        print(f"brick {pix}: {len(run.jobs)} frames, {make(run, pix):.0f} CPU s", flush=True)


if __name__ == "__main__":
    main()
