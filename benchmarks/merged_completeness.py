"""Merged sources of a field in u, g, r, i against the truth: completeness, galaxies' colours, stars and galaxies apart.

    python benchmarks/merged_completeness.py              # half of a chip, two visits a band; ten CPU-minutes
    python benchmarks/merged_completeness.py --keep       # the tables as they are, judged again

Every frame is made and measured, and every brick merged, at each run. The last table compares a catalogue whose
sources are those of single frames with one of all frames together (`measurement.joint`); the other tables are of the
former. Isolated objects are those of `csstsim validate`. True S/N is that of one exposure, in the best band, for a
colour in the worse of its two; the joint S/N is that of all exposures of an object together. Colours are measured less
true, from the merged magnitudes that are meant for colours if the table has them, else Kron. Stars include quasars. A
source is called a star if its `star` is above one half.

Exit code 1 if a goal is missed, 2 if the input cannot be used.
"""

import argparse
import sys
from itertools import pairwise
from pathlib import Path

from evidence.record import Record

import numpy as np
import yaml
from scipy.spatial import cKDTree
from source_extractor import FIELD, csstsim, emptied, run_csstsim
from toy_sky import toy_sky

from csstsim.base.errors import CsstsimError
from csstsim.base.healpix import brick_of
from csstsim.base.sphere import unit_vectors
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.io.truth import read_truth
from csstsim.measure.bricks.merge import DETECTION_COLUMNS, merge_brick
from csstsim.measure.bricks.validation import compare
from csstsim.measure.bricks.validation.measured_frame import DISTINCT, MeasuredFrame, distinct, truth_inside
from csstsim.stages.measure import measured_table

ROOT = Path(__file__).parents[1]
BANDS = "u", "g", "r", "i"
EDGES = 10, 15, 30, 500  # of true S/N
MAGNITUDES = 17, 20, 21, 22, 23, 24, 25, 26  # in r
FAINT = 24, 24.5, 25, 25.5, 26, 26.5, 27  # in r
SAME_PLACE = 0.05  # arcsec
ADDED_GOAL = 95.0  # %
GOALS = {"galaxies": 97.0, "stars": 99.0}  # % found
COLOUR_GOAL = 0.05  # mag
COLOUR_MAGNITUDES = "gaap_mag_{}", "total_mag_{}", "kron_mag_{}"  # the first that there is


def campaign(output, radius, toy=False):
    """Write the campaign of the field; return its file. radius: of the region [arcmin]; toy: of a table of objects."""
    output.mkdir(parents=True, exist_ok=True)
    content = {
        "schema_version": 1, "name": "merged_completeness", "survey_table": str(ROOT / "survey_tables/demo.csv"),
        "output": str(output.resolve()), "seed": 1,
        "select": {
            "types": ["SCIE"], "chips": "imaging", "filters": list(BANDS), "region": FIELD | {"radius": radius},
        },
        "window": "region", "observations": {"SCIE": str(ROOT / "config/observations/science.yaml")},
        "measurement": {"joint": True},
    }  # fmt: skip
    if toy:
        content |= toy_sky(output, **FIELD, radius=radius / 60)
        content["select"]["obsids"] = ["10100000002", "10100000003", "10100000004", "10100000005"]
    path = output / "campaign.yaml"
    path.write_text("# Written by benchmarks/merged_completeness.py\n" + yaml.safe_dump(content, sort_keys=False))
    return path


def make(run):
    """Make and measure all frames, and merge all bricks. Returns the CPU seconds."""
    cpu = 0.0
    for job in run.jobs:
        for command in "chip", "measure":
            cpu += csstsim(command, run, job)
    for pix in run.merge_bricks:
        cpu += run_csstsim("merge", run.file, "--brick", str(pix))
    return cpu


def alone(run):
    """Return {brick: sources that single frames show}."""
    merged = {}
    for pix, jobs in run.merge_bricks.items():
        tables = (measured_table(run, job, DETECTION_COLUMNS) for job in jobs)
        merged[pix], _ = merge_brick(pix, tables, run.camera.bands)
    return merged


def together(run):
    """Return {brick: sources that all frames together show}."""
    return {pix: ObjectTable.read(run.paths.merge(pix)) for pix in run.merge_bricks}


def judged(run, merged):
    """Return (truth, sources, row of each isolated true object's source or -1, mask of the real sources) of all bricks.

    merged: {brick: sources}; truth: measured_frame.distinct, with columns visits_B and snr_B (NaN if no frame of band
    B shows the object). Blended objects are not matched, as in validation.trials: a quasar's host would take its
    source.
    """
    columns, infos, every = [f"mag_{band}" for band in run.camera.bands], {}, []
    parts = {pix: [] for pix in run.merge_bricks}
    seen = {band: [] for band in BANDS}
    for job in run.jobs:
        table = measured_table(run, job, ["x"])
        chip = run.camera.detector.channel_ny, run.camera.telescope.pixel_scale
        frame = MeasuredFrame(read_truth(run.paths.level0_truth(job)), table, *chip)
        objects = truth_inside(frame)
        infos.setdefault(frame.band, []).append(frame.info)
        seen[frame.band].append(objects["id"])
        every.append(frame.truth)
        for pix, some in parts.items():
            inside = brick_of(objects["ra_epoch"], objects["dec_epoch"]) == pix
            some.append(ObjectTable({name: objects[name][inside] for name in (*DISTINCT, *columns)}))
    tables = []
    for pix, some in parts.items():
        truth, sources = distinct(some, columns), merged[pix]
        real = np.zeros(len(sources), bool)
        for whole in every:
            real[compare.matched_sources(whole, sources)] = True
        snr = {}
        for band in BANDS:
            visits = sum(np.isin(truth["id"], ids).astype(int) for ids in seen[band])
            snr[f"visits_{band}"] = visits
            snr[f"snr_{band}"] = np.where(visits > 0, compare.true_snr(band, truth, infos[band]), np.nan)
        alone = ~truth["blended"].astype(bool)
        match = np.full(len(truth), -1)
        match[alone] = compare.match(truth.take(alone), sources)
        tables.append((truth.with_columns(**snr), sources, match, real))
    return joined(tables)


def joined(tables):
    """Return the bricks' (truth, sources, match, real) as one."""
    truth, sources = (
        ObjectTable({name: np.concatenate([table[name] for table in some]) for name in some[0]})
        for some in ([each[k] for each in tables] for k in (0, 1))
    )
    first = np.cumsum([0, *(len(each[1]) for each in tables)])
    match = np.concatenate([np.where(each[2] >= 0, each[2] + n, -1) for each, n in zip(tables, first, strict=False)])
    return truth, sources, match, np.concatenate([each[3] for each in tables])


def completeness(truth, match):
    """Return [(what, percent, n, goal or None)] of isolated objects by true S/N, of the best band and joint."""
    snr = np.array([np.nan_to_num(truth[f"snr_{band}"]) for band in BANDS])
    joint = np.sqrt(sum(truth[f"visits_{band}"] * one**2 for band, one in zip(BANDS, snr, strict=True)))
    best = "S/N", snr.max(axis=0), [(EDGES[0], np.inf), *pairwise(EDGES)]
    alone, galaxy = ~truth["blended"].astype(bool), truth["obj_type"] == GALAXY
    rows = []
    for kind, some in (("galaxies", galaxy), ("stars", ~galaxy)):
        for what, values, bins in (best, ("joint S/N of all frames", joint, pairwise(EDGES))):
            for low, high in bins:
                chosen = alone & some & (values > low) & (values <= high)
                n = int(chosen.sum())
                share = 100.0 * float((match[chosen] >= 0).mean()) if n else None
                name = f"> {low}" if np.isinf(high) else f"{low} - {high}"
                rows.append((f"{kind} found, {what} {name}", share, n, GOALS[kind] if np.isinf(high) else None))
    return rows


def colours(truth, sources, match):
    """Return [(what, {median, error, sigma, n}, possible)] of isolated galaxies: colour measured less true [mag].

    possible: the number above the S/N in both bands; n of them have both magnitudes.
    """
    alone = ~truth["blended"].astype(bool) & (truth["obj_type"] == GALAXY)
    form, rows = next(form for form in COLOUR_MAGNITUDES if form.format("r") in sources), []
    for blue, red in pairwise(BANDS):
        snr = np.fmin(*(np.nan_to_num(truth[f"snr_{band}"]) for band in (blue, red)))
        some = np.flatnonzero(alone & (snr > EDGES[0]))
        there = some[match[some] >= 0]
        given, got = (
            table[name.format(blue)][at] - table[name.format(red)][at]
            for table, name, at in ((truth, "mag_{}", there), (sources, form, match[there]))
        )
        off = (got - given).astype(float)
        name = f"{blue} - {red} of galaxies, {form.format('B')}, measured - true"
        rows.append((name, compare.spread(off[np.isfinite(off)]), len(some)))
    return rows


def kinds(truth, sources, match):
    """Return [(bin, share of true stars called stars, n, share of those called stars that are, n)], isolated, in r."""
    some = np.flatnonzero(~truth["blended"].astype(bool) & (match >= 0))
    star, called = truth["obj_type"][some] != GALAXY, np.asarray(sources["star"])[match[some]] > 0.5
    rows = []
    for low, high in pairwise(MAGNITUDES):
        inside = (truth["mag_r"][some] > low) & (truth["mag_r"][some] <= high)
        both, true, told = ((inside & mask).sum() for mask in (star & called, star, called))
        rows.append((f"{low} - {high}", both / max(true, 1), int(true), both / max(told, 1), int(told)))
    return rows


def report(truth, sources, match, real, record):
    """Record the tables, and the figures that have a goal."""
    lines = []
    for name, share, n, goal in completeness(truth, match):
        if goal is not None and share is not None:
            record.value(f"found_{name.split()[0]}", share, f"{name}, of {n}", unit="%", above=goal)
        told = "" if goal is None or share is None else f"{goal:g}: {'met' if share >= goal else 'MISSED'}"
        lines.append([name, "-" if share is None else f"{share:.1f}", n, told])
    twice, n = compare.duplicates(truth, sources, match)
    record.value("real", 100 * real.mean(), f"of {len(real)} merged sources, with a true object", unit="%")
    lines.append(["merged sources with a true object", f"{100 * real.mean():.1f}", len(real), ""])
    lines.append(["counted twice", "-" if twice is None else f"{100 * twice:.2f}", n, ""])
    record.table("completeness", ["", "%", "of", "goal"], lines)
    lines = []
    for name, seen, possible in colours(truth, sources, match):
        if seen["n"] < 2:
            lines.append([name, "-", "-", f"{seen['n']} of {possible}", ""])
            continue
        told = "met" if abs(seen["median"]) <= COLOUR_GOAL else "MISSED"
        key = "_".join(name.split(" of ")[0].split(" - "))
        record.value(
            f"colour_{key}", seen["median"], f"{name}: median", unit="mag", error=seen["error"],
            goal=abs(seen["median"]) <= COLOUR_GOAL,
        )  # fmt: skip
        median = "{median:+.3f} ± {error:.3f}".format(**seen)
        lines.append([name, median, f"{seen['sigma']:.3f}", f"{seen['n']} of {possible}", f"{COLOUR_GOAL:g}: {told}"])
    record.table("colours", ["colour [mag]", "median", "scatter", "n of possible", "goal"], lines)
    lines = [
        [name, f"{100 * share:.1f}", true, f"{100 * pure:.1f}", told]
        for name, share, true, pure, told in kinds(truth, sources, match)
    ]
    record.table("kinds", ["r [mag]", "stars called stars [%]", "of", "called stars that are [%]", "of"], lines)


def report_joint(one, both, record):
    """Record what all frames together add. one, both: (truth, sources, match, real) of `alone` and `together`."""
    truth, single, first, _ = one
    _, sources, second, real = both
    alone = ~truth["blended"].astype(bool)
    lines = []
    for low, high in pairwise(FAINT):
        chosen = alone & (truth["mag_r"] > low) & (truth["mag_r"] <= high)
        shares = [float((match[chosen] >= 0).mean()) if chosen.any() else np.nan for match in (first, second)]
        for name, share in zip(("single", "joint"), shares, strict=True):
            what = f"found, r {low:g} to {high:g}, {'single frames' if name == 'single' else 'all frames together'}"
            error = (share * (1 - share) / max(chosen.sum(), 1)) ** 0.5
            record.value(f"{name}_{low:g}", 100 * share, what, unit="%", error=100 * error)
        lines.append([f"{low:g} - {high:g}", *(f"{100 * share:.1f}" for share in shares), int(chosen.sum())])
    record.table("joint", ["r [mag]", "single frames [%]", "all together [%]", "objects"], lines)
    known = cKDTree(unit_vectors(single["ra"], single["dec"]))
    distance, _ = known.query(unit_vectors(sources["ra"], sources["dec"]))
    added = np.degrees(distance) * 3600.0 > SAME_PLACE
    record.value("added", int(added.sum()), "sources added")
    if added.any():
        pure = 100 * float(real[added].mean())
        record.value("added_real", pure, "of them with a true object", unit="%", above=ADDED_GOAL)
    record.value("added_new", int((sources["n_detections"] == 0).sum()), "of them without a detection in any frame")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=ROOT / "results/merged_completeness")
    parser.add_argument(
        "--radius", type=float, default=3.9, help="Of the field, arcmin; its windows are twice as wide."
    )
    parser.add_argument("--keep", action="store_true", help="Compare the merged bricks that there are.")
    with Record(parser) as record:
        evaluate(record)


def evaluate(record: Record) -> None:
    """Make the field, and compare it with the truth."""
    given = record.options
    try:
        output, radius = (record.results / "merged_completeness", 0.3) if record.toy else (given.output, given.radius)
        if not given.keep:
            emptied(output)
        run = OpenCampaign(campaign(output, radius, toy=record.toy))
        if not given.keep:
            record.value("cpu", make(run), "making, measuring and merging all frames", unit="CPU-s")
        one, both = (judged(run, merged) for merged in (alone(run), together(run)))
        report(*one, record)
        report_joint(one, both, record)
    except CsstsimError as error:
        print(error, file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
