"""Builder of the standard scene: the chip on which speed and accuracy are measured.

    python benchmarks/standard_scene.py                # writes results/standard_scene/objects.parquet
    csstsim chip config/standard_scene.yaml --obsid ... --chip 9      # draws it (obsid: in that file)
    python benchmarks/standard_scene.py --chip 29 1 3  # the same sky on other chips: results/standard_scene/chip_29 ...
    python benchmarks/standard_scene.py --histogram > benchmarks/standard_scene.csv    # makes the counts

The scene has 71,479 galaxies and 5,159 stars (the paper's r-band chip); standard_scene.csv fixes their numbers per half
magnitude in r. The objects of each bin are drawn from those of nine truth bricks with that brightness (repeatedly if
there are too few, from the next bin if there are none), and spread uniformly over the chip of the campaign's exposure.
Stars keep their motions: their J2000 positions are such that they lie on the chip at the epoch. Around a spectroscopic
chip the same density of objects continues as far as its gratings reach.
"""

import argparse
import csv
from pathlib import Path

from evidence.record import Record

import numpy as np
import yaml

from csstsim.base.files.atomic import atomic_path
from csstsim.base.process.progress import progress
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.sections import Lensing
from csstsim.catalog.astrometry.reduction import at_j2000, icrs
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.catalog.truth_bricks import make_brick
from csstsim.optics.geometry.pointing_for import pointing_for
from csstsim.universe.parameters import load_universe

CAMPAIGN = SHIPPED / "standard_scene.yaml"
RESULTS = CAMPAIGN.parents[1] / "results"
COUNTS = Path(__file__).with_suffix(".csv")
TOTAL = {"galaxies": 71_479, "stars": 5_159}
KIND = {"galaxies": GALAXY, "stars": STAR}
SEED, BRICK = 1, 561928  # the exposure's brick; its neighbours are added for enough bright stars
STEP = 0.5  # mag
COARSE, FAINT = 4, 15  # steps to a row of the recorded table; its last row
# At toy size: one brick, a corner of the chip, few PSF nodes
TOY = {"window": {"x0": 0, "x1": 600, "y0": 0, "y1": 600}, "psf": {"grid": 3}}


def source(camera, toy=False):
    """Return the objects from which those of a scene are drawn."""
    import healpy

    around = [] if toy else healpy.get_all_neighbours(256, BRICK, nest=True)
    universe, lensing = load_universe(SHIPPED / "universe"), Lensing(field="none") if toy else Lensing()
    bricks = progress([BRICK, *around], "truth bricks")
    return ObjectTable.concat(make_brick(SEED, int(pix), universe, camera, lensing, "none") for pix in bricks)


def bins(table):
    return np.floor(table["mag_r"] / STEP).astype(int)


def histogram(table):
    """Return [(bin, galaxies, stars)]: the bricks' histogram scaled to the totals, rounded to keep the sums."""
    columns = {}
    for name, total in TOTAL.items():
        chosen = table.take(table["obj_type"] == KIND[name])
        found, counts = np.unique(bins(chosen), return_counts=True)
        edges = np.round(np.concatenate([[0.0], np.cumsum(counts)]) * total / counts.sum()).astype(int)
        columns[name] = dict(zip(found.tolist(), np.diff(edges).tolist(), strict=True))
    rows = range(min(map(min, columns.values())), max(map(max, columns.values())) + 1)
    return [(k, columns["galaxies"].get(k, 0), columns["stars"].get(k, 0)) for k in rows]


def read_counts():
    with open(COUNTS, newline="") as file:
        return [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]


def draw(table, counts):
    """Return rows of `table` with these counts of each kind and brightness; an empty bin takes the next's, scaled."""
    rng, rows, dimmed = stream(SEED, "standard scene", "rows"), [], []
    for name, kind in KIND.items():
        place = {k: np.flatnonzero((table["obj_type"] == kind) & (bins(table) == k)) for k in np.unique(bins(table))}
        place = {k: there for k, there in place.items() if len(there)}
        for row in counts:
            wanted, k = int(row[name]), int(row["mag_r"] / STEP)
            if wanted:
                nearest = min(place, key=lambda other: abs(other - k))
                rows.append(np.resize(rng.permutation(place[nearest]), wanted))
                dimmed.append(np.full(wanted, (k - nearest) * STEP))
    out, dimmed = table.take(np.concatenate(rows)), np.concatenate(dimmed).astype(np.float32)
    magnitudes = {name: out[name] + dimmed for name in out if name.startswith("mag_")}
    return out.with_columns(sed_scale=out["sed_scale"] * np.float32(10) ** (-0.4 * dimmed), **magnitudes)


def put(table, job, bounds):
    """Return the table spread over `bounds` (x0, x1, y0, y1) of the job's chip, with new ids."""
    rng, count = stream(SEED, "standard scene", "places"), len(table)
    x, y = rng.uniform(*bounds[:2], count), rng.uniform(*bounds[2:], count)
    star = table["obj_type"] == STAR
    motion = {name: np.where(star, table[name], 0.0) for name in ("pmra", "pmdec", "parallax", "rv")}
    ra, dec = at_j2000(*icrs(*job.wcs.pixel_to_world(x, y), job.observer), job.observer, **motion)
    return table.with_columns(ra=ra, dec=dec, id=np.arange(1, count + 1))


def on_chip(number: int, folder: Path = RESULTS, toy: bool = False) -> Path:
    """Write the campaign of the scene on another chip, with the exposure's time and roll; return its file.

    At toy size it has a corner of the chip.
    """
    run = OpenCampaign(CAMPAIGN)
    job, chip = run.jobs[0], run.camera.chips[number]
    pointing, centre = job.pointing, job.wcs.pixel_to_world(*(np.array(job.window.shape[::-1]) / 2))
    there = pointing_for(pointing, chip, centre, (chip.detector.nx / 2, chip.detector.ny / 2))
    folder = folder / "standard_scene" / f"chip_{number:02d}"
    folder.mkdir(parents=True, exist_ok=True)
    row = [job.obsid, "SCIE", f"{there.ra:.6f}", f"{there.dec:.6f}", pointing.pa, pointing.time, pointing.exptime]
    (folder / "survey.csv").write_text(f"obsid,type,ra,dec,pa,time,exptime\n{','.join(map(str, row))}\n")
    content = load_campaign(CAMPAIGN).model_dump(mode="json") | (TOY if toy else {}) | {
        "name": folder.name, "survey_table": str(folder / "survey.csv"), "output": str(folder)
    }  # fmt: skip
    content["select"]["chips"] = [number]
    content["catalog"]["options"] = {"file": str(folder / "objects.parquet")}
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    return file


def campaign_of(record: Record, catalogue: bool = True) -> Path:
    """Return the campaign of the scene on its r chip; at toy size on a corner of it, and its catalogue is made."""
    if not record.toy:
        return CAMPAIGN
    folder = record.results / "standard_scene"
    content = load_campaign(CAMPAIGN).model_dump(mode="json") | TOY | {"output": str(folder)}
    content["catalog"]["options"] = {"file": str(folder / "objects.parquet")}
    file = folder / "campaign.yaml"
    with atomic_path(file) as part:  # several commands may do so at once
        part.write_text(yaml.safe_dump(content, sort_keys=False))
    if catalogue and not (folder / "objects.parquet").exists():
        write_scene(source(OpenCampaign(file).camera, toy=True), file)
    return file


def write_scene(table, campaign, output=None):
    """Write the catalogue of a campaign's one job; return it.

    It has rows of `table`, at positions whose light reaches the job's chip or window.
    """
    run = OpenCampaign(campaign)
    job, output = run.jobs[0], output or Path(campaign).parent / run.config.catalog.options["file"]
    output = output.resolve()
    whole = np.array([-0.5, job.chip.detector.nx - 0.5, -0.5, job.chip.detector.ny - 0.5])
    window = np.array([job.window.x0, job.window.x1, job.window.y0, job.window.y1]) - 0.5
    bounds = np.array(run.disperser(job).gratings.bounds) if job.chip.kind == "slitless" else window
    more = np.prod(np.diff(bounds)[::2]) / np.prod(np.diff(whole)[::2])
    counts = [row | {name: round(more * row[name]) for name in TOTAL} for row in read_counts()]
    scene = put(draw(table, counts), job, bounds)
    output.parent.mkdir(parents=True, exist_ok=True)
    ObjectTable(scene).write(output, {"product": "standard scene", "seed": SEED, "brick": BRICK})
    print(f"{output}: {len(scene)} objects; {campaign}, exposure {job.obsid}, chip {job.chip.id}")
    return scene


def describe(record: Record, scene: ObjectTable, chip: int, several: bool) -> None:
    """Record what a scene holds; several: there are scenes of other chips, too."""
    end = f"_{chip}" if several else ""
    for name, kind in KIND.items():
        record.value(f"{name}{end}", int((scene["obj_type"] == kind).sum()), f"{name} of the scene of chip {chip}")
    lit = scene.take(np.isfinite(scene["mag_r"]))
    row = np.minimum(bins(lit) // COARSE, FAINT)
    rows = []
    for k in range(row.min(), FAINT + 1):
        edge = f"{k * COARSE * STEP:g}"
        counts = [int(((row == k) & (lit["obj_type"] == kind)).sum()) for kind in KIND.values()]
        rows.append([f"{edge} and fainter" if k == FAINT else f"{edge} to {(k + 1) * COARSE * STEP:g}", *counts])
    record.table(f"counts{end}", ["r", *TOTAL], [[edge, *(f"{n:,}" for n in counts)] for edge, *counts in rows])


def main(record: Record) -> None:
    """Write the scenes that are asked for."""
    options = record.options
    first = campaign_of(record, catalogue=False)
    campaigns = (
        [first] if options.chip is None else [on_chip(number, record.results, record.toy) for number in options.chip]
    )
    table = source(OpenCampaign(first).camera, record.toy)
    if options.histogram:
        print("mag_r,galaxies,stars", *(f"{k * STEP},{g},{s}" for k, g, s in histogram(table)), sep="\n")
        return
    for number, campaign in zip(options.chip or [OpenCampaign(first).jobs[0].chip.id], campaigns, strict=True):
        describe(record, write_scene(table, campaign, options.output), number, options.chip is not None)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--histogram", action="store_true", help="print the counts per bin of r, as CSV")
    parser.add_argument("--output", type=Path, help="file [default: the campaign's catalogue]")
    parser.add_argument("--chip", type=int, nargs="+", help="other chips than that of config/standard_scene.yaml")
    with Record(parser) as record:
        main(record)
