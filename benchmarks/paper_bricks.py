"""Ten bricks in u, g and r, merged: the colours of paper_figures.py, which the paper takes from ten merged catalogues.

    python benchmarks/paper_bricks.py        # after ten_images.yaml; twenty CPU-minutes, goes on where it was stopped

A brick is that in which the middle of an image of examples/ten_images.yaml lies: two in each Cycle-9 field. It is a
campaign of its own: one exposure of 150 s in each band, every layer, 10' wide about the middle of the brick (whose side
is 13.7'), with the truth bricks of the ten images.
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
RADIUS = 5.0  # arcmin, of the region; its windows are twice as wide


def bricks(run):
    """Return {brick: Pointing of an exposure} of the middle of each image of the campaign."""
    found = {}
    for job in run.imaging_jobs:
        pointing, window = run.pointings[job.obsid], job.window
        wcs, _ = run.maps(pointing, job.chip)
        middle = wcs.pixel_to_world(0.5 * (window.x0 + window.x1 - 1), 0.5 * (window.y0 + window.y1 - 1))
        found[int(brick_of(*middle))] = pointing
    return found


def campaign(images, pix, pointing, output):
    """Write the campaign of a brick, observed as `pointing` but aimed at its middle; return its file."""
    ra, dec = (float(v) for v in healpy.pix2ang(NSIDE, pix, nest=True, lonlat=True))
    folder = output / str(pix)
    folder.mkdir(parents=True, exist_ok=True)
    chips = chips_for(images.camera, filters=BANDS)
    found = aimed(images.camera, ra, dec, chips, pa=pointing.pa, times=(pointing.time,), exptime=pointing.exptime)
    (folder / "table.csv").write_text(table_of(found, [f"brick {pix} in {', '.join(BANDS)}"]))
    content = {
        "schema_version": 1, "name": f"brick_{pix}", "survey_table": "table.csv", "output": "products",
        "seed": images.config.seed, "share": str(Path(images.config.share).resolve()),
        "select": {"filters": list(BANDS), "region": {"ra": ra, "dec": dec, "radius": RADIUS}}, "window": "region",
    }  # fmt: skip
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    return folder / "campaign.yaml"


def campaigns(images=IMAGES, output=OUTPUT):
    """Return {brick: OpenCampaign} of the ten bricks; their files are written."""
    run = OpenCampaign(images)
    return {pix: OpenCampaign(campaign(run, pix, pointing, output)) for pix, pointing in bricks(run).items()}


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
    given = parser.parse_args()
    for pix, run in campaigns(given.images, given.output).items():
        print(f"brick {pix}: {len(run.jobs)} frames, {make(run, pix):.0f} CPU s", flush=True)


if __name__ == "__main__":
    main()
