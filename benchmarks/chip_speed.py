"""Cost of a full r-band chip of the standard scene, from catalogue to electron image; also by the paper's method.

    python benchmarks/standard_scene.py            # first: the catalogue
    python benchmarks/chip_speed.py [--counts 1000 10000 76638 300000 1000000] [--sample 60]

For each number of objects (drawn from the scene's, at random positions on the chip; 76,638 is the scene itself) it
prints the CPU seconds of selection (reading, photometry, astrometry, distortion) and of the render stage (PSF tables,
policy, objects, sky), and the largest private memory. Times are the least of three runs (one from 200,000 objects on)
after one that compiles. Then the paper's method (GalSim, a PSF object for each object and sub-band;
csstsim.bench.imaging.peers) runs on a sample spread over the objects' brightness, and is extrapolated to all. The
brightest 0.2%, which the paper would draw in stamps of up to 27,756 px, are left out of both its sample and its sum.
"""

import argparse
import time
from pathlib import Path

import galsim
import numpy as np
import yaml
from private_memory import PrivateMemory

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.bench.imaging import peers
from csstsim.bench.imaging.cases import Case
from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import at_j2000, icrs
from csstsim.catalog.table import STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.render.scene import make_scene
from csstsim.stages import psf as psf_stage
from csstsim.stages import render as render_stage
from csstsim.stages import select as select_stage

galsim.errors.raise_fft_size_error = True
FOLDER = Path("results/standard_scene")
BRIGHTEST = 0.002
MANY = 200_000  # objects from which one run is enough
HALF_MAX = 200  # px: half the side of the paper's stamps in the sample


def campaign(count, scene, template):
    """Write a campaign of `count` objects of the scene; return it opened."""
    file = FOLDER / f"objects_{count}.parquet"
    if not file.exists():
        resampled(count, scene, template).write(file, {"product": "standard scene, resampled"})
    content = load_campaign(SHIPPED / "standard_scene.yaml").model_dump(mode="json")
    content["catalog"]["options"]["file"] = str(file)
    path = FOLDER / f"scene_{count}.yaml"
    path.write_text(yaml.safe_dump(content))
    return OpenCampaign(path)


def resampled(count, scene, job):
    if count == len(scene):
        return scene
    rng, window = stream(1, "chip speed", count), job.window
    table = scene.take(rng.choice(len(scene), count, replace=count > len(scene)))
    x, y = rng.uniform(window.x0, window.x1 - 1, count), rng.uniform(window.y0, window.y1 - 1, count)
    motion = {
        name: np.where(table["obj_type"] == STAR, table[name], 0.0) for name in ("pmra", "pmdec", "parallax", "rv")
    }
    ra, dec = at_j2000(*icrs(*job.wcs.pixel_to_world(x, y), job.observer), job.observer, **motion)
    return table.with_columns(ra=ra, dec=dec, id=np.arange(count))


def measured(run, runs):
    """Return (CPU s of select, of render, GB, State): the least of all runs but the first."""
    best, job = (np.inf, np.inf), run.jobs[0]
    for i in range(runs):
        state = None  # frees the memory of the previous run
        with PrivateMemory() as memory:
            start = time.process_time()
            objects = select_stage.selected(run, job.exposure)
            middle = time.process_time()
            state = render_stage.rendered(run, job.exposure, objects, run.streams(job))
            spent = middle - start, time.process_time() - middle
        if i:
            best = min(best, spent, key=sum)
    return *best, memory.largest, state


def paper_seconds(state, psf, exptime, sample):
    """Return (mean CPU s per object, its standard error, number of objects it represents)."""
    truth = state.truth
    order = np.argsort(truth["electrons"])
    order = order[truth["electrons"][order] > 0]
    order = order[: int(len(order) * (1 - BRIGHTEST))]
    seconds = []
    setting = type("Setting", (), {"psf": psf})
    for i in order[np.linspace(0, len(order) - 1, sample).astype(int)]:
        row = truth.take([i])
        x, y, half = round(row["x"][0]), round(row["y"][0]), min(int(row["reach"][0]), HALF_MAX)
        window = Window(x - half, x + half + 1, y - half, y + half + 1)
        case = Case(row, make_scene(row, state.wcs, psf, exptime), window, float(row["electrons"][0]), False)
        draw = peers.paper(setting, case)
        start = time.process_time()
        draw(1)
        seconds.append(time.process_time() - start)
    return np.mean(seconds), np.std(seconds) / np.sqrt(len(seconds)), len(order)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--counts", type=int, nargs="+", default=[1000, 10_000, 76_638, 300_000, 1_000_000])
    parser.add_argument("--sample", type=int, default=60, help="objects drawn by the paper's method")
    options = parser.parse_args()
    template = OpenCampaign(SHIPPED / "standard_scene.yaml")
    job, scene = template.jobs[0], ObjectTable.read(FOLDER / "objects.parquet")
    number = job.chip.id
    for path, make in (
        (template.paths.psf(number), lambda: psf_stage.psf(template, number)),
        (template.paths.psf_tables(number), lambda: psf_stage.psf_tables(template, job.chip)),
    ):
        if not path.exists():
            make()
    print("| objects | select, CPU s | render, CPU s | both | GB private |\n|---|---|---|---|---|")
    both = []
    for count in options.counts:
        select, render, memory, state = measured(campaign(count, scene, job), 4 if count < MANY else 2)
        both.append(select + render)
        print(f"| {count} | {select:.2f} | {render:.2f} | {both[-1]:.2f} | {memory:.2f} |", flush=True)
        if count == len(scene):
            mean, error, stands = paper_seconds(state, psf_stage.open_psf(template, job.chip), 150.0, options.sample)
            light = state.truth
            for method in np.unique(light["method"]):
                mine = light["method"] == method
                print(f"  {method}: {mine.sum()} objects, {light['ms'][mine].sum() / 1000:.2f} CPU-s")
            print(
                f"  the paper's method: {mean:.3f} +- {error:.3f} CPU-s per object, "
                f"{mean * stands:.0f} +- {error * stands:.0f} for {stands} of them, "
                f"{mean * stands / both[-1]:.0f} times csstsim's whole chip"
            )
        del state  # frees its memory before the next row
    slopes = np.diff(np.log(both)) / np.diff(np.log(options.counts))
    print("exponent of cost against number of objects, from one row to the next:", np.round(slopes, 2))


if __name__ == "__main__":
    main()
