"""Catalogues of one full-depth chip by several codes against the truth: completeness, false sources, accuracy, cost.

    apt-get install source-extractor psfex; pip install photutils scikit-image
    python benchmarks/catalogue_codes.py                         # all codes, table and chart
    python benchmarks/catalogue_codes.py --codes csstsim sep     # these again, the others as stored
    python benchmarks/catalogue_codes.py --score TABLE.parquet   # a measured table of csstsim alone, in seconds

The chip is that of config/full_chip.yaml. It is made, unless only some codes run again, and calibrated once. Every code
gets that calibrated image, except csstsim, whose `measure` calibrates by itself: the same steps, timed apart. The codes
run as shipped, those called "deep" with a kernel as wide as the PSF and a S/N of 3.75 as the threshold. A code
without its program or library is left out. Tables and scores are stored in --output. catalogue_scores.py explains the
scores; the number in brackets behind a completeness is the percentage found by chance, for which it is corrected.
"""

import argparse
import importlib.util
import json
import shutil
import sys
import tempfile
import warnings
from pathlib import Path

from evidence.record import Record

import astromatic
import numpy as np
from catalogue_chart import draw
from catalogue_scores import Judge, false_detections, own_catalogue, scores, well_inside
from chip_stages import campaign as chip_campaign
from measure_chip import measure
from scipy.spatial import cKDTree
from source_extractor import csstsim, encircled, our_psf

from csstsim.base.errors import CsstsimError, InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.campaign.job import Job
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.io.paths import existing_product
from csstsim.io.truth import read_truth
from csstsim.measure.bricks.validation.trials import MATCH_PX
from csstsim.measure.source_columns import SHARP
from csstsim.stages.measure import measured_table

ROOT = Path(__file__).parents[1]
OURS, PSFEX = "csstsim", "sex+psfex"
SEX, DEEP = "source-extractor", "source-extractor-deep"
CODES = OURS, SEX, DEEP, "sep", "sep-deep", "photutils", PSFEX
CALIBRATION = "calibrate", "charge moved back"  # parts of `csstsim measure`, as measure_chip.py names them
SCORES = "scores.json"
CITED = {  # rows of the scores, without the number of objects, and their names in the record
    "points, S/N > 5": "points", "galaxies, S/N > 5": "galaxies", "galaxies, S/N 12 - 30": "galaxies_12_30",
    "galaxies, S/N > 12, 40 to 200 px from bright stars": "galaxies_near_stars", "detections": "detections",
    "false, claimed S/N > 5": "false", "stars: magnitude bias": "stars_bias",
    "galaxies: magnitude bias": "galaxies_bias",
    "stars: position error [mas]": "stars_position", "galaxies: position error [mas]": "galaxies_position",
}  # fmt: skip
RUNS = 2  # of csstsim, the cheaper counts: the first may compile


def why_not(code):
    """Return why a code cannot run here, None if it can."""
    programs = {SEX: [SEX], DEEP: [SEX], PSFEX: astromatic.PROGRAMS}.get(code, ())
    modules = {"sep": ["sep"], "sep-deep": ["sep"], "photutils": ["photutils", "skimage"]}.get(code, ())
    absent = [name for name in programs if shutil.which(name) is None]
    absent += [name for name in modules if importlib.util.find_spec(name) is None]
    return f"{', '.join(absent)} not installed" if absent else None


def run_code(code, run, job, folder, runs=RUNS):
    """Run a code on a job's calibrated image; return (its catalogue, {"cpu", "calibration", "memory"}).

    Seconds of CPU, GB. cpu excludes the calibration.
    """
    calibrated, exptime = run.paths.calibrated(*job.key), job.pointing.exptime
    if code == OURS:
        total, parts, memory = min(
            (measure(run.file, job.obsid, job.chip.id) for _ in range(runs)), key=lambda one: one[0]
        )
        calibration = sum(parts[name] for name in CALIBRATION)
        table = own_catalogue(ObjectTable.read(run.paths.measure(*job.key)))
        return table, {"cpu": total - calibration, "calibration": calibration, "memory": memory}
    with tempfile.TemporaryDirectory(dir=folder) as place:
        place = Path(place)
        if code in (SEX, DEEP):
            table, cpu, memory = astromatic.plain(calibrated, place, exptime, deep=code == DEEP)
        elif code == PSFEX:
            table, cpu, memory = with_psf(run, job, astromatic.extract(calibrated, place, exptime))
        else:
            path = place / "table.parquet"
            script = ROOT / "benchmarks/catalogue_peers.py"
            cpu, memory, failed = astromatic.cost([sys.executable, str(script), code, str(calibrated), str(path)])
            if failed:
                raise RuntimeError(f"{code} failed")
            table = ObjectTable.read(path)
    return table, {"cpu": cpu, "memory": memory}


def with_psf(run, job, extracted):
    """Return (catalogue, CPU seconds, GB) of source-extractor and psfex.

    The flux is that of the fit where the source looks like a point (AUTO no brighter than it by a third), else AUTO.
    psfex's model ends 10 px from a star: its flux is brought to all light as in source_extractor.py.
    """
    table, psf = extracted.table, our_psf(run, job)
    light = encircled(extracted.psf, 0.5 * astromatic.APERTURE) / encircled(psf, 0.5 * astromatic.APERTURE)
    fitted = table["flux_psf"] * light
    point = (fitted > 0) & (table["flux_kron"] < 4 / 3 * fitted)
    columns = {name: table[name] for name in ("x", "y", "snr")}
    columns["flux"] = np.where(point, fitted, table["flux_kron"])
    return ObjectTable(columns), sum(extracted.cpu.values()), extracted.memory


def judge_of(run, job, info):
    """Return the Judge of a job's frame. info: of a measured table. Raises InputError without the truth."""
    truth = read_truth(existing_product(run.paths.level0_truth(job), f"chip {run.file} {job.options}"))
    return Judge(truth, info, run.camera.detector.channel_ny, run.camera.telescope.pixel_scale)


def compare(run, job, codes, folder, runs=RUNS):
    """Run the codes; store their tables, and the scores and costs of all tables there, in `folder`."""
    if set(codes) == set(CODES) or not run.paths.level0_truth(job).is_file():
        csstsim("chip", run, job)
    if not run.paths.calibrated(*job.key).is_file() or OURS in codes:
        csstsim("calibrate", run, job)
    folder.mkdir(parents=True, exist_ok=True)
    for code in sorted(codes, key=CODES.index):
        if why_not(code):
            continue
        table, cost = run_code(code, run, job, folder, runs)
        table.write(folder / f"{code}.parquet", {"cost": cost})
        print(f"{code}: {len(table)} rows, {cost['cpu']:.1f} CPU s", file=sys.stderr)
    judge = judge_of(run, job, measured_table(run, job, ["x"]).meta)
    files = {code: folder / f"{code}.parquet" for code in CODES}
    tables = {code: ObjectTable.read(file) for code, file in files.items() if file.is_file()}
    columns = {code: table.meta | {"scores": scores(judge, table)} for code, table in tables.items()}
    with atomic_path(folder / SCORES) as temporary:
        temporary.write_text(json.dumps(columns, indent=1))


def stored(folder):
    """Return {code: {"cost", "scores"}} that `compare` has stored in a folder; empty if there are none."""
    return json.loads((folder / SCORES).read_text()) if (folder / SCORES).is_file() else {}


def scored(run, job, paths):
    """Return {file: {"scores"}} of measured tables of a job's frame."""
    columns = {}
    for path in paths:
        table = ObjectTable.read(path)
        if missing := [name for name in ("x", "y", "flux_total", "snr", "flags") if name not in table]:
            raise InputError("not a measured table: it lacks a column", file=path, key=missing[0])
        columns[path.stem] = {"scores": scores(judge_of(run, job, table.meta), own_catalogue(table))}
    return columns


def show(columns, record):
    """Record the table, and what is cited. columns: {title: {"cost" (optional), "scores"}}."""
    lines = []
    costs = [each.get("cost") for each in columns.values()]
    calibration = next((cost["calibration"] for cost in costs if cost and "calibration" in cost), np.nan)
    rows = {"CPU s": ("cpu", 0.0), "CPU s with calibration": ("cpu", calibration), "GB": ("memory", 0.0)}
    for row, (key, more) in rows.items():
        cells = [f"{cost[key] + more:.1f}" if cost else "-" for cost in costs]
        lines.append([row, *cells])
    for row in dict.fromkeys(row for each in columns.values() for row in each["scores"]):
        cells = [each["scores"].get(row, {"text": "-"})["text"] for each in columns.values()]
        lines.append([row, *cells])
    record.table("scores", ["", *columns], lines)
    for code, column in columns.items():
        key = "".join(c if c.isalnum() else "_" for c in code)
        if "cost" in column:
            record.value(f"{key}_cpu", column["cost"]["cpu"], f"{code}, of the calibrated image", unit="CPU-s")
        for row, score in column["scores"].items():
            if name := CITED.get(row.partition(" (")[0]):
                known = score["value"] is not None and np.isfinite(score["value"])
                if known or record.toy:
                    record.value(f"{key}_{name}", score["value"] if known else np.nan, f"{code}: {row}")
    if np.isfinite(calibration):
        record.value("calibration_cpu", calibration, "the calibration", unit="CPU-s")


def sharp_among_false(run: OpenCampaign, job: Job, folder: Path, record: Record) -> None:
    """Record the fraction of source-extractor's false detections that csstsim's table calls sharp, as cosmic rays."""
    if not (folder / f"{SEX}.parquet").is_file():
        return
    table, ours = ObjectTable.read(folder / f"{SEX}.parquet"), measured_table(run, job, ["x", "y", "flags"])
    judge = judge_of(run, job, ours.meta)
    table = well_inside(judge, table)
    false, _ = false_detections(judge, table)
    table, ours = table.take(false & (table["snr"] > 5)), ours.take((ours["flags"] & SHARP) > 0)
    places = [np.column_stack([some["x"], some["y"]]) for some in (ours, table)]
    near = cKDTree(places[0]).query(places[1])[0] < MATCH_PX if len(ours) else np.zeros(len(table), bool)
    what = f"of {len(table)} false detections of {SEX}, claimed S/N > 5: those with the flag SHARP in csstsim's table"
    record.value("sharp_among_false", near.mean() if len(near) else np.nan, what)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaign", type=Path, default=ROOT / "config/full_chip.yaml")
    parser.add_argument("--output", type=Path, default=ROOT / "results/catalogue_codes", help="Tables and scores.")
    parser.add_argument("--codes", nargs="*", choices=CODES, default=CODES, help="None: only the scores and the chart.")
    parser.add_argument("--score", nargs="+", type=Path, metavar="TABLE", help="Score these measured tables only.")
    with Record(parser) as record:
        given = record.options
        if record.toy:
            given.campaign, given.output = chip_campaign(toy=True), record.results / "catalogue_codes"
        for code in given.codes:
            if reason := why_not(code):
                record.skip(code, reason)
        try:
            evaluate(record)
        except CsstsimError as error:
            print(error, file=sys.stderr)
            sys.exit(2)


def evaluate(record: Record) -> None:
    """Run the codes, or score tables, and record the scores."""
    given = record.options
    warnings.simplefilter("ignore", RuntimeWarning)
    run = OpenCampaign(given.campaign, copied=bool(given.score))
    job = next(job for job in run.jobs if job.chip.filter == "r")
    if given.score:
        show(stored(given.output) | scored(run, job, given.score), record)
        return
    compare(run, job, given.codes, given.output, 1 if record.toy else RUNS)
    columns = stored(given.output)
    objects = len(read_truth(run.paths.level0_truth(job)))
    record.value("objects", objects, "true objects of the chip")
    if (given.output / f"{OURS}.parquet").is_file():
        sharp_among_false(run, job, given.output, record)
    show(columns, record)
    draw(record.figure("catalogue_codes.png"), columns)


if __name__ == "__main__":
    main()
