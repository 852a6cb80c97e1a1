"""Catalogues of one full-depth chip by several codes, judged by the truth: completeness, false sources, accuracy, cost.

    apt-get install source-extractor psfex; pip install photutils scikit-image
    python benchmarks/catalogue_codes.py                       # all codes; makes the chip of config/full_chip.yaml
    python benchmarks/catalogue_codes.py --codes csstsim sep   # these again, the others as stored
    python benchmarks/catalogue_codes.py --score TABLE.parquet # a measured table of csstsim alone, in seconds

The Level-0 file is made if there is none, and calibrated once. Every code gets that calibrated image, except csstsim,
whose `measure` calibrates by itself: the same steps, timed apart. The codes run as shipped, those called "deep" with a
kernel as wide as the PSF and the threshold of `measure.detect`. A code without its program or library is left out.
Tables and scores are stored in --output. catalogue_scores.py explains the scores; the number in brackets behind a
completeness is the share [%] found by chance, for which it is corrected.
"""

import argparse
import importlib.util
import json
import shutil
import sys
import tempfile
import warnings
from pathlib import Path

import astromatic
from catalogue_scores import Judge, own_catalogue, scores
from measure_chip import measure
from source_extractor import csstsim, encircled, our_psf

from csstsim.base.errors import CsstsimError
from csstsim.base.files.atomic import atomic_path
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.io.truth import read_truth

ROOT = Path(__file__).parents[1]
OURS, PSFEX = "csstsim", "sex+psfex"
SEX, DEEP = "source-extractor", "source-extractor-deep"
CODES = OURS, SEX, DEEP, "sep", "sep-deep", "photutils", PSFEX
CALIBRATION = "calibrate", "charge moved back"  # parts of `csstsim measure`, as measure_chip.py names them
RUNS = 2  # of csstsim, the cheaper counts: the first may compile


def why_not(code):
    """Return why a code cannot run here, None if it can."""
    programs = {SEX: [SEX], DEEP: [SEX], PSFEX: astromatic.PROGRAMS}.get(code, ())
    modules = {"sep": ["sep"], "sep-deep": ["sep"], "photutils": ["photutils", "skimage"]}.get(code, ())
    absent = [name for name in programs if shutil.which(name) is None]
    absent += [name for name in modules if importlib.util.find_spec(name) is None]
    return f"{', '.join(absent)} not installed" if absent else None


def run_code(code, run, job, folder):
    """Run a code on a job's calibrated image; return (its catalogue, {"cpu", "calibration", "memory"}).

    Seconds of CPU, GB. cpu excludes the calibration.
    """
    calibrated, exptime = run.paths.calibrated(*job.key), job.pointing.exptime
    if code == OURS:
        total, parts, memory = min(
            (measure(run.file, job.obsid, job.chip.id) for _ in range(RUNS)), key=lambda one: one[0]
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
    flux = [a if some else b for a, b, some in zip(fitted, table["flux_kron"], point, strict=True)]
    return (
        ObjectTable({"x": table["x"], "y": table["y"], "flux": flux, "snr": table["snr"]}),
        sum(extracted.cpu.values()), extracted.memory,
    )  # fmt: skip


def judge_of(run, job, info):
    """Return the Judge of a job's frame. info: of a measured table."""
    truth = read_truth(run.paths.level0_truth(job))
    return Judge(truth, info, run.camera.detector.channel_ny, run.camera.telescope.pixel_scale)


def compare(run, job, codes, folder):
    """Run the codes and store {code: scores} in `folder`; return all that are stored, in the order of CODES."""
    if not run.paths.level0_truth(job).is_file():
        csstsim("chip", run, job)
    if not run.paths.calibrated(*job.key).is_file() or OURS in codes:
        csstsim("calibrate", run, job)
    for code in sorted(codes, key=CODES.index):
        if reason := why_not(code):
            print(f"{code}: left out, {reason}", file=sys.stderr)
            continue
        table, cost = run_code(code, run, job, folder)
        table.write(folder / f"{code}.parquet")
        info = ObjectTable.read(run.paths.measure(*job.key), ["x"]).meta
        text = json.dumps({"cost": cost, "scores": scores(judge_of(run, job, info), table)}, indent=1)
        with atomic_path(folder / f"{code}.json") as temporary:
            temporary.write_text(text)
        print(f"{code}: {len(table)} rows, {cost['cpu']:.1f} CPU s", file=sys.stderr)
    return stored(folder)


def stored(folder):
    """Return {code: {"cost", "scores"}} of the codes stored in a folder, in the order of CODES."""
    files = {code: folder / f"{code}.json" for code in CODES}
    return {code: json.loads(file.read_text()) for code, file in files.items() if file.is_file()}


def show(columns):
    """Print the table. columns: {title: {"cost" (optional), "scores"}}."""
    print(f"| | {' | '.join(columns)} |\n|---|{'---|' * len(columns)}")
    costs = {name: each.get("cost", {}) for name, each in columns.items()}
    calibration = next((cost["calibration"] for cost in costs.values() if "calibration" in cost), None)
    if any(costs.values()):
        for row, key, more in (
            ("CPU s", "cpu", 0.0),
            ("CPU s with calibration", "cpu", calibration),
            ("GB", "memory", 0),
        ):
            cells = [f"{cost[key] + more:.1f}" if cost and more is not None else "-" for cost in costs.values()]
            print(f"| {row} | {' | '.join(cells)} |")
    for row in dict.fromkeys(row for each in columns.values() for row in each["scores"]):
        cells = [each["scores"].get(row, {"text": "-"})["text"] for each in columns.values()]
        print(f"| {row} | {' | '.join(cells)} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--campaign", type=Path, default=ROOT / "config/full_chip.yaml")
    parser.add_argument("--output", type=Path, default=ROOT / "results/catalogue_codes", help="Tables and scores.")
    parser.add_argument("--codes", nargs="+", choices=CODES, default=CODES)
    parser.add_argument("--score", nargs="+", type=Path, metavar="TABLE", help="Score these measured tables only.")
    given = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    try:
        run = OpenCampaign(given.campaign, copied=bool(given.score))
        job = run.jobs[0]
        if given.score:
            return show(stored(given.output) | scored(run, job, given.score))
        given.output.mkdir(parents=True, exist_ok=True)
        show(compare(run, job, given.codes, given.output))
    except CsstsimError as error:
        print(error, file=sys.stderr)
        sys.exit(2)


def scored(run, job, paths):
    """Return {file: {"scores"}} of measured tables of a job's frame."""
    columns = {}
    for path in paths:
        table = ObjectTable.read(path)
        columns[path.stem] = {"scores": scores(judge_of(run, job, table.meta), own_catalogue(table))}
    return columns


if __name__ == "__main__":
    main()
