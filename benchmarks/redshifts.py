"""How many redshifts of slitless spectra are right, by a fit of public templates, and what contamination costs.

    python benchmarks/redshift_field.py
    python benchmarks/redshifts.py --templates TEMPLATES

Stacks and scores the spectra of redshift_field.py with `csstsim budget redshift`; redshift_fit.py fits. TEMPLATES is a
folder of texts of two columns, rest wavelength [A] and flux density per angstrom. Meant are the twelve of EAZY,
templates/fsps_full/tweak_fsps_QSF_12_v3_*.dat of github.com/gbrammer/eazy-photoz (Brammer et al. 2008, ApJ 686, 1503),
from FSPS: they share nothing with the spectra from which csstsim's galaxies are made, whose own are fitted, too.
A redshift is good if any other one has a chi2 larger by GOOD. Draws budget_redshift.png and redshift_cost.png.
"""

import argparse
import csv
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from evidence.record import Record

import numpy as np
import redshift_cost
from redshift_field import CHIPS, KEPT, emptied, fields, jobs_of, made, opened, spent
from redshift_fit import REST, STEP, TOY_STEP, fit, own_templates, public_templates

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.measure.spectra.line_fluxes import compared_with_truth
from csstsim.studies.budget.redshift.frame_tables import read_frame_tables
from csstsim.studies.budget.redshift.line_biases import line_biases, mean
from csstsim.studies.budget.redshift.report import budget
from csstsim.studies.budget.redshift.scores import scores

GOOD, STRICTER = 16.0, (25.0, 40.0)
BRIGHT = 21.0  # mag
CLEAN = 0.1  # light of others over one's own
SNR = 2.0, 3.0  # least true ones of subsets of the lines
NEEDED = "complete", "pure"

Fits = dict[int, tuple[float, float]]  # {id: (z, how much larger the chi2 of another one is)}


def answered(fits: Fits, least: float = GOOD) -> dict[int, tuple[float, bool]]:
    """Return {id: (z, good)}, as budget.redshift.scores takes it."""
    return {k: (z, above >= least) for k, (z, above) in fits.items()}


def stacked(runs: list[OpenCampaign], way: str, output: Path, band: str) -> tuple[ObjectTable, ObjectTable]:
    """Stack the spectra of one of redshift_field.WAYS; return the stack and its galaxies."""
    budget(runs, output, way, band=band, log=lambda text: None)
    return ObjectTable.read(output / "stack.parquet"), ObjectTable.read(output / "objects.parquet")


def scored(runs: list[OpenCampaign], output: Path, fits: Fits, band: str) -> dict[str, Any]:
    """Score the fits as a user does, by a CSV file; return the scores."""
    answer = output / "redshifts.csv"
    with open(answer, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["id", "z", "good"])
        writer.writerows([k, f"{z:.5f}", int(good)] for k, (z, good) in sorted(answered(fits).items()))
    return budget(runs, output, "catalogue", answer, band, log=lambda text: None)


def share(one: dict[str, Any], name: str) -> str:
    """Return completeness or purity with its error, as a cell."""
    key = {"complete": "completeness", "pure": "purity"}[name]
    return f"{one[key]:.3f} +- {one[f'{key}_err']:.3f}" if np.isfinite(one[key]) else ""


def scatter(one: dict[str, Any]) -> list[str]:
    """Return scatter and bias of good redshifts, as cells."""
    return [
        format(one[key], form) if np.isfinite(one[key]) else "" for key, form in (("sigma", ".4f"), ("bias", "+.4f"))
    ]


def bounds(one: dict[str, Any], below: str = "below") -> str:
    """Return the words of a class."""
    if not np.isfinite(one["high"]):
        return f"above {one['low']:g}"
    return f"{below} {one['high']:g}" if one["low"] == 0 and below else f"{one['low']:g} to {one['high']:g}"


def class_tables(record: Record, found: dict[str, Any]) -> None:
    """Record completeness, purity, scatter and bias by magnitude, redshift, size and contamination."""
    heads = {
        "magnitude": "i", "redshift": "redshift", "size": "half-light radius [arcsec]",
        "contamination": "light of others / own",
    }  # fmt: skip
    for name, head in heads.items():
        rows = [(bounds(one, ""), one) for one in found[name]]
        if name == "magnitude":
            rows.append(("all", found["all"]))
        cells = [[label, one["objects"], *(share(one, part) for part in NEEDED), *scatter(one)] for label, one in rows]
        record.table(name, [head, "galaxies", *NEEDED, "sigma_NMAD of dz / (1 + z)", "bias"], cells)


def one_score(record: Record, key: str, one: dict[str, Any], what: str) -> None:
    """Record completeness and purity of a set of galaxies."""
    for name, full in (("complete", "completeness"), ("pure", "purity")):
        record.value(f"{name}_{key}", one[full], f"{what}: {name}", error=one[f"{full}_err"])


def template_table(record: Record, fits: dict[str, Fits], objects: ObjectTable) -> None:
    """Record what each set of templates gives, for all galaxies and for bright ones, and what stricter rules do."""
    bright, rows = objects.take(objects["magnitude"] < BRIGHT), []
    for name, one in fits.items():
        parts = [scores(answered(one), some)["all"] for some in (objects, bright)]
        rows.append([name, *(share(part, word) for part in parts for word in NEEDED)])
    heads = [*NEEDED, f"i < {BRIGHT:g}: complete", "pure"]
    record.table("templates", ["templates", *heads], rows)
    first = next(iter(fits.values()))
    for least in STRICTER:
        one_score(record, f"{least:.0f}", scores(answered(first, least), objects)["all"], f"chi2 larger by {least:g}")


def contamination_table(
    record: Record, subtracted: Fits, kept: Fits, objects: ObjectTable
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Record completeness and purity of the same galaxies with neighbours subtracted and kept; return both scores.

    objects: of the spectra with all light kept, whose contamination is the true one.
    """
    same = objects.take(np.isin(objects["id"], list(subtracted)))
    found = [scores(answered(fits), same) for fits in (subtracted, kept)]
    rows = []
    pairs = [*zip(*(one["contamination"] for one in found), strict=True), tuple(one["all"] for one in found)]
    for one, other in pairs:
        label = bounds(one) if "low" in one else "all"
        rows.append([label, one["objects"], *(share(both, word) for word in NEEDED for both in (one, other))])
    heads = ["complete, subtracted", "kept", "pure, subtracted", "kept"]
    record.table("kept", ["light of others / own", "galaxies", *heads], rows)
    return found[0], found[1]


def line_table(record: Record, runs: list[OpenCampaign], classes: list[dict[str, Any]]) -> None:
    """Record flux and place of emission lines over the true ones, by contamination, and of those with little of it."""
    rows = []
    for one in classes:
        flux, shift = f"{one['ratio']:.3f} +- {one['ratio_err']:.3f}", f"{one['shift']:+.2f} +- {one['shift_err']:.2f}"
        rows.append([bounds(one), one["lines"], flux, shift])
    record.table("lines", ["light of others / own, at the line", "lines", "flux over true", "shift [px]"], rows)
    frames = read_frame_tables(runs, "catalogue", lambda text: None)
    every = line_biases([frame.spectra for frame in frames], [frame.lines for frame in frames])
    clean = [one for one in every if abs(one["contamination"]) < CLEAN]
    subsets = {"clean": clean, "all": every}
    subsets |= {f"snr_{least:.0f}": [one for one in clean if one["ratio_err"] * least <= 1] for least in SNR}
    for name, some in subsets.items():
        ratio, error, shift, off = columns(some, "ratio", "ratio_err", "shift", "shift_err")
        what = {"clean": f"lines with contamination below {CLEAN:g}", "all": "all lines"}.get(
            name, f"lines with contamination below {CLEAN:g}, of true S/N {name[4:]} or more"
        )
        middle, spread = mean(ratio, error)
        record.value(f"lines_{name}", len(some), f"{what}: number")
        record.value(f"flux_{name}", middle, f"{what}: flux over the true one", error=spread)
        middle, spread = mean(shift, off)
        record.value(f"shift_{name}", middle, f"{what}: shift", unit="px", error=spread)
        width = np.std((ratio - 1) / error) if some else np.nan
        record.value(f"pull_{name}", width, f"{what}: width of the pulls of fluxes")


def pull_table(record: Record, folders: list[Path], runs: list[OpenCampaign]) -> None:
    """Record how all fluxes of isolated lines compare with the true ones, by grating, and how many limits hold."""
    rows, blind = [], 0
    for band, chip in CHIPS.items():
        parts = []
        for folder, run in zip(folders, runs, strict=True):
            for job in (job for job in jobs_of(run) if job.chip.id == chip):
                path = folder / "catalogue" / run.paths.lines(*job.key).name
                parts.append(ObjectTable.read(path))
        lines = ObjectTable.concat(parts)
        one = compared_with_truth(lines)
        pulls = ["" if one[key] is None else f"{one[key]:.2f}" for key in ("pull_mean", "pull_width")]
        limits = f"{one['limits_held']:,} of {one['limits']:,}"
        rows.append([band, len(parts), f"{one['isolated']:,}", *pulls, limits])
        blind += int((lines["line"] == "").sum())
    header = ["grating", "frames of 300 s", "isolated lines", "mean pull", "width of pulls", "limits that hold"]
    record.table("pulls", header, rows)
    record.value("blind", blind, "lines found without a redshift")


def columns(rows: Sequence[dict[str, Any]], *names: str) -> list[np.ndarray]:
    """Return the columns of rows."""
    return [np.array([row[name] for row in rows], float) for name in names]


def toy_templates(folder: Path) -> Path:
    """Write csstsim's own templates as texts; return their folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, row in enumerate(own_templates()):
        np.savetxt(folder / f"{k}.dat", np.stack([REST, row], axis=1))
    return folder


def main(record: Record) -> None:
    """Fit and score."""
    toy, output = record.toy, record.results / "redshifts"
    band, step = ("r", TOY_STEP) if toy else ("i", STEP)
    templates = record.options.templates
    if toy:
        emptied(output / "fields", record)
        folders = fields(output / "fields", toy)
        runs, templates = [made(folder, toy) for folder in folders], toy_templates(output / "templates")
    else:
        folders = fields(record.results / "redshift_field", toy)
        runs = [opened(folder, toy) for folder in folders]
    begin = time.process_time()
    stack, objects = stacked(runs, "catalogue", output, band)
    fits = {"EAZY's": fit(stack, objects, public_templates(templates), step)}
    fit_cpu = time.process_time() - begin
    found = scored(runs, output, fits["EAZY's"], band)
    shutil.copy(output / "redshift.png", record.figure("budget_redshift.png"))
    record.value("galaxies", len(objects), "galaxies")
    one_score(record, "all", found["all"], "all galaxies")
    bright = scores(answered(fits["EAZY's"]), objects.take(objects["magnitude"] < BRIGHT))["all"]
    one_score(record, "bright", bright, f"galaxies to i = {BRIGHT:g}")
    for key, one in (("all", found["all"]), ("bright", bright)):
        record.value(f"sigma_{key}", one["sigma"], f"{key} galaxies: sigma_NMAD of dz / (1 + z)")
    class_tables(record, found)
    last = found["redshift"][-1]
    record.value("far_good", last["good"], f"galaxies beyond z = {last['low']:g}: good redshifts")
    record.value("far_right", round(last["good"] * last["purity"]), "of them right")
    fits["csstsim's"] = fit(stack, objects, own_templates(), step)
    template_table(record, fits, objects)
    line_table(record, runs, found["lines"])
    pull_table(record, folders, runs)
    stack, objects = stacked(runs[:KEPT], "kept", output / "kept", band)
    kept = fit(stack, objects, public_templates(templates), step)
    record.value("kept_galaxies", len(objects), "galaxies of the positions where other objects' flux is also kept")
    two = contamination_table(record, fits["EAZY's"], kept, objects)
    parts = {"frames": spent(folders, "frame")[0], "extract": spent(folders, "catalogue")[0]}
    galaxy = (len(folders) * sum(parts.values()) + fit_cpu) / found["all"]["objects"]
    record.value("fit_cpu", fit_cpu / len(folders), "stack and fit of a position", unit="CPU-s")
    record.value("galaxy_cpu", galaxy, "a galaxy, from the sky to its redshift", unit="CPU-s")
    record.value("all_cpu", galaxy * found["all"]["objects"] / 60, "all galaxies", unit="CPU-min")
    wanted = found["all"]["objects"] * (found["all"]["completeness_err"] / 1e-3) ** 2
    record.value("wanted", wanted, "galaxies for an error of 0.001 in completeness")
    record.value("wanted_hours", wanted * galaxy / 3600, "the same", unit="CPU-h")
    labels = "neighbours subtracted", "subtracted, two positions", "kept, two positions"
    results = dict(zip(labels, (found, *two), strict=True))
    redshift_cost.draw(record.figure("redshift_cost.png"), results, galaxy, band)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--templates", type=Path, metavar="TEMPLATES", help="folder of texts")
    with Record(parser) as record:
        main(record)
