"""Cost of a full r-band chip of the standard scene, from catalogue to electron image; also by the paper's method.

    python benchmarks/standard_scene.py            # first: the catalogue
    python benchmarks/chip_speed.py [--counts 1000 10000 76638 300000 1000000] [--sample 60]

For each number of objects (drawn from the scene's, at random positions on the chip; 76,638 is the scene itself) it
records the CPU seconds of selection (reading, photometry, astrometry, distortion) and of the render stage (PSF tables,
policy, objects, sky), and the largest private memory. Times are the least of three runs (one from 200,000 objects on)
after one that compiles. For the scene itself it records which method drew how many objects, and how many have a
predicted error above a tenth of their noise. Then the paper's method (GalSim, a PSF object for each object and
sub-band; csstsim.studies.bench.imaging.peers) runs on a sample spread over the objects' brightness, and is extrapolated
to all. The brightest 0.2%, which the paper would draw in stamps of up to 27,756 px, are in neither its sample nor its
sum.
"""

import argparse
import time
from pathlib import Path

from evidence.record import Record

import galsim
import numpy as np
import yaml
from private_memory import PrivateMemory
from standard_scene import campaign_of

from csstsim.base.rng import stream
from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import at_j2000, icrs
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.render.scene import make_scene
from csstsim.stages import psf as psf_stage
from csstsim.stages import render as render_stage
from csstsim.stages import select as select_stage
from csstsim.studies.bench.imaging import peers
from csstsim.studies.bench.imaging.cases import Case

galsim.errors.raise_fft_size_error = True
ALLOWED = 0.1  # of its noise: the error that `standard` allows an object
TOY_COUNTS, TOY_SAMPLE = (100, 0), 4  # 0: the scene itself
BRIGHTEST = 0.002
MANY = 200_000  # objects from which one run is enough
HALF_MAX = 200  # px: half the side of the paper's stamps in the sample


def campaign(count: int, scene: ObjectTable, template: Path) -> OpenCampaign:
    """Write a campaign of `count` objects of the scene, whose own is `template`; return it opened."""
    run = OpenCampaign(template)
    folder = (template.parent / run.config.catalog.options["file"]).resolve().parent
    file = folder / f"objects_{count}.parquet"
    resampled(count, scene, run.jobs[0]).write(file, {"product": "standard scene, resampled"})
    content = load_campaign(template).model_dump(mode="json")
    content["catalog"]["options"]["file"] = str(file)
    path = folder / f"scene_{count}.yaml"
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


def describe(record: Record, truth: ObjectTable) -> None:
    """Record the scene's methods and predicted errors."""
    for method in ("photons", "stamp"):
        mine = truth["method"] == method
        record.value(f"{method}_objects", int(mine.sum()), f"objects of the scene rendered by {method}")
        record.value(f"{method}_cpu", truth["ms"][mine].sum() / 1e3, f"drawing the scene's {method}", unit="CPU-s")
    above = truth["error"] > ALLOWED
    record.value(
        "above", int(above.sum()), f"objects of the scene with a predicted error above {ALLOWED} of their noise"
    )
    record.value("above_fraction", above.mean(), "their fraction of all objects")
    for kind, name in ((STAR, "stars"), (GALAXY, "galaxies")):
        mine = above & (truth["obj_type"] == kind)
        record.value(f"above_{name}", int(mine.sum()), f"{name} among them")
    record.value("above_snr", truth["snr"][above].min() if above.any() else np.nan, "smallest S/N of these objects")
    record.value("above_maximum", truth["error"].max(), "largest predicted error of an object", unit="of its noise")
    share = (truth["error"] / truth["snr"])[above].max() if above.any() else np.nan
    record.value("above_share", share, "largest predicted error of these objects over their S/N")


def main(record: Record) -> None:
    """Record the cost of each number of objects, what the scene's are, and the cost by the paper's method."""
    options, file = record.options, campaign_of(record)
    template = OpenCampaign(file)
    job, scene = template.jobs[0], ObjectTable.read(file.parent / template.config.catalog.options["file"])
    number = job.chip.id
    for path, make in (
        (template.paths.psf(number), lambda: psf_stage.psf(template, number)),
        (template.paths.psf_tables(number), lambda: psf_stage.psf_tables(template, job.chip)),
    ):
        if not path.exists():
            make()
    both, rows = [], []
    counts = [count or len(scene) for count in (TOY_COUNTS if record.toy else options.counts)]
    for count in counts:
        run = campaign(count, scene, file)
        select, render, memory, state = measured(run, 4 if count < MANY and not record.toy else 2)
        both.append(select + render)
        rows.append([f"{count:,}", f"{select:.1f}", f"{render:.1f}", f"{both[-1]:.1f}", f"{memory:.1f}"])
        print(*rows[-1], flush=True)
        if count == len(scene):
            record.value("select", select, "selection of the standard scene", unit="CPU-s")
            record.value("render", render, "render stage of the standard scene", unit="CPU-s")
            record.value("both", both[-1], "both", unit="CPU-s")
            record.value("memory", memory, "largest private memory of both", unit="GB")
            describe(record, state.truth)
            sample = TOY_SAMPLE if record.toy else options.sample
            mean, error, stands = paper_seconds(state, psf_stage.open_psf(template, job.chip), 150.0, sample)
            record.value("paper_object", mean, "an object by the paper's method", unit="CPU-s", error=error)
            record.value(
                "paper", mean * stands, f"all but the brightest {BRIGHTEST:.1%} of objects by the paper's method",
                unit="CPU-s", error=error * stands,
            )  # fmt: skip
            record.value(
                "paper_ratio", mean * stands / both[-1], "the paper's method over csstsim's whole chip",
                error=error * stands / both[-1],
            )  # fmt: skip
        del state  # frees its memory before the next row
    record.table("counts", ["objects", "select, CPU s", "render, CPU s", "both", "private memory, GB"], rows)
    slopes = np.diff(np.log(both)) / np.diff(np.log(counts))
    record.value(
        "slopes", ", ".join(f"{slope:.2f}" for slope in slopes),
        "power of the number of objects with which the cost grows, from row to row",
    )  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--counts", type=int, nargs="+", default=[1000, 10_000, 76_638, 300_000, 1_000_000])
    parser.add_argument("--sample", type=int, default=60, help="objects rendered by the paper's method")
    with Record(parser) as record:
        main(record)
