"""Faults put into a campaign's chain: each must fail its gate, and a campaign without a fault must fail none.

    python benchmarks/faulty_campaigns.py [--seeds 10] [--folder results/faulty_campaigns]

The campaign (tests/support/star_galaxy_field.py) has 1216 x 1216 px, four exposures in r and two in g. A fault
(tests/support/faulty_chain.py) is in one exposure, or in the merge. Its margin is the gate's: the number over the
largest allowed one, which includes chance. Prints the tables of docs/validation_measured.md; exit code 1 if a fault has
a margin below 1.5 or names another exposure, or a campaign without a fault fails a gate.
"""

import argparse
import contextlib
import io
import os
import shutil
import time
from contextlib import nullcontext
from pathlib import Path

from evidence.record import Record

from support.faulty_chain import FAULTS
from support.star_galaxy_field import write_field

from csstsim.campaign.opened import OpenCampaign
from csstsim.measure.bricks.validation.result_file import read_result
from csstsim.measure.bricks.validation.verdict import verdict_of_results
from csstsim.stages import chip as chip_stage
from csstsim.stages import measure as measure_stage
from csstsim.stages import merge as merge_stage
from csstsim.stages import validate as validate_stage

MARGIN = 1.5
GIVEN = {"galaxy_completeness_min": 0.9, "lost_max": 0.02, "twice_max": 0.02}  # own catalogues must give them
ONE_OF_FOUR, ONE_OF_TWO = "10100000002", "10100000005"


def make(run, job, context, stage):
    """Make and measure one exposure; its `stage` runs within the fault's context."""
    if stage in ("all", "chip"):
        with context() if stage == "chip" else nullcontext():
            chip_stage.chip(run, job, log=lambda *_: None)
    with context() if stage == "measure" else nullcontext():
        measure_stage.measure(run, job)


def verdict(run, context=nullcontext):
    """Merge and validate; return the verdict on the gates."""
    results = []
    for pix in run.merge_bricks:
        with context():
            merge_stage.merge(run, pix)
        validate_stage.validate(run, pix)
        results.append(read_result(run.paths.validate(pix)))
    return verdict_of_results(results)


def campaign(folder, seed, psf):
    """Make the campaign of a seed, with existing PSF sets if there are any; return (run, verdict)."""
    run = OpenCampaign(write_field(folder, seed, validation=GIVEN))
    if psf.exists():
        shutil.copytree(psf, run.paths.output / "psf", copy_function=os.link)
    for job in run.jobs:
        make(run, job, nullcontext, "all")
    if not psf.exists():
        shutil.copytree(run.paths.output / "psf", psf)
    return run, verdict(run)


def faulty(run, kept, fault):
    """Return (verdict, exposure) of the campaign whose products are in `kept`, with a fault put into that exposure."""
    output = run.paths.output
    shutil.rmtree(output)
    shutil.copytree(kept, output, copy_function=os.link)  # products are replaced, never changed in place
    obsid = ONE_OF_TWO if "of two" in fault.words else ONE_OF_FOUR
    if fault.stage == "merge":
        return verdict(run, fault.context), None
    make(run, next(job for job in run.jobs if job.obsid == obsid), fault.context, fault.stage)
    return verdict(run), obsid


def row_of(fault, evaluated, obsid):
    """Return (row of the table, whether the gates found the fault)."""
    failing = [gate for gate in evaluated["gates"] if gate["passed"] is False]
    named = [gate for gate in failing if gate["name"] == fault.gate]
    right = bool(named) and all(gate.get("exposure") == obsid for gate in named)
    others = sorted({gate["name"] for gate in failing} - {fault.gate})
    if not named:
        return (fault.words, fault.gate, "-", "-", "passes", ", ".join(others)), False
    gate = max(named, key=lambda gate: gate["margin"])
    row = f"{gate['value']:.4g}", gate["threshold"], f"{gate['margin']:.1f}", "; ".join(others)
    return (fault.words, fault.gate, *row), right and gate["margin"] >= MARGIN


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=10, help="unfaulted campaigns")
    parser.add_argument("--folder", type=Path, default=Path("results/faulty_campaigns"))
    with Record(parser) as record:
        compare(record)


def compare(record: Record) -> None:
    """Make campaigns without and with faults, and record which gates fail."""
    seeds, faults = (1, FAULTS[:1]) if record.toy else (record.options.seeds, FAULTS)
    folder, start = (record.results if record.toy else record.options.folder).resolve(), time.process_time()
    folder = folder / "faulty_campaigns" if record.toy else folder
    shutil.rmtree(folder, ignore_errors=True)
    first, rows, failing, nearest = None, [], 0, []
    for seed in range(1, seeds + 1):
        with contextlib.redirect_stdout(io.StringIO()):
            run, evaluated = campaign(folder / f"seed_{seed}", seed, folder / "psf")
        gates = [gate for gate in evaluated["gates"] if gate["passed"] is not None]
        near = max(gates, key=lambda gate: gate["margin"])
        fail = [f"{gate['name']} {gate['band']}" for gate in gates if not gate["passed"]]
        rows.append(
            [seed, len(gates), ", ".join(fail) or 0, f"{near['name']}, {near['band']}", f"{near['margin']:.2f}"]
        )
        failing += len(fail)
        nearest.append(near["margin"])
        first = first or run
        if run is not first:
            shutil.rmtree(folder / f"seed_{seed}")
    record.table("sound", ["seed", "gates evaluated", "fail", "nearest to failing", "its margin"], rows)
    record.value("sound_failing", failing, f"gates that fail in {seeds} campaigns without a fault", below=0)
    record.value("sound_gates", rows[0][1], "gates evaluated in a campaign without a fault")
    record.value("sound_nearest", max(nearest), "margin of the gate nearest to failing, without a fault")
    record.value("sound_nearest_min", min(nearest), "the same in the campaign where it is smallest")
    kept = folder / "kept"
    shutil.copytree(first.paths.output, kept, copy_function=os.link)
    rows, unseen = [], []
    for fault in faults:
        with contextlib.redirect_stdout(io.StringIO()):
            row, seen = row_of(fault, *faulty(first, kept, fault))
        rows.append(row)
        unseen += [] if seen else [fault.words]
    record.table("faults", ["fault", "gate that fails", "value", "threshold", "margin", "others that fail"], rows)
    what = f"of {len(faults)} faults, not seen by their gate with a margin of {MARGIN}"
    record.value("unseen", len(unseen), what + (f" ({', '.join(unseen)})" if unseen else ""), below=0)
    record.value("cpu", time.process_time() - start, "all campaigns", unit="CPU-s")


if __name__ == "__main__":
    main()
