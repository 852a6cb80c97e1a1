"""Faults put into a campaign's chain: each must fail its gate, and a campaign without a fault must fail none.

    PYTHONPATH=tests:builders python benchmarks/faulty_campaigns.py [--seeds 10] [--folder results/faulty_campaigns]

The campaign (tests/star_galaxy_field.py) has 1216 x 1216 px, four exposures in r and two in g. A fault
(tests/faulty_chain.py) is in one exposure, or in the merge. Its margin is the gate's: the number over the largest
allowed one, which includes chance. Prints the tables of docs/validation.md; exit code 1 if a fault has a margin below
1.5 or names another exposure, or a campaign without a fault fails a gate.
"""

import argparse
import contextlib
import io
import os
import shutil
import sys
import time
from contextlib import nullcontext
from pathlib import Path

from faulty_chain import FAULTS
from star_galaxy_field import write_field

from csstsim.bricks.validation.result_file import read_result
from csstsim.bricks.validation.verdict import judge
from csstsim.campaign.opened import OpenCampaign
from csstsim.stages import chip as chip_stage
from csstsim.stages import measure as measure_stage
from csstsim.stages import merge as merge_stage
from csstsim.stages import validate as validate_stage

MARGIN = 1.5
ONE_OF_FOUR, ONE_OF_TWO = "10100000002", "10100000005"


def make(run, job, context, stage):
    """Make and measure one exposure; its `stage` runs within the fault's context."""
    if stage in ("all", "chip"):
        with context() if stage == "chip" else nullcontext():
            chip_stage.chip(run, job, say=lambda *_: None)
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
    return judge(results)


def campaign(folder, seed, psf):
    """Make the campaign of a seed, with existing PSF sets if there are any; return (run, verdict)."""
    run = OpenCampaign(write_field(folder, seed))
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


def row_of(fault, judged, obsid):
    """Return (row of the table, whether the gates found the fault)."""
    failing = [gate for gate in judged["gates"] if gate["passed"] is False]
    named = [gate for gate in failing if gate["name"] == fault.gate]
    right = bool(named) and all(gate.get("exposure") == obsid for gate in named)
    others = sorted({gate["name"] for gate in failing} - {fault.gate})
    if not named:
        return (fault.words, fault.gate, "-", "-", "passes", ", ".join(others)), False
    gate = max(named, key=lambda gate: gate["margin"])
    row = f"{gate['value']:.4g}", gate["threshold"], f"{gate['margin']:.1f}", "; ".join(others)
    return (fault.words, fault.gate, *row), right and gate["margin"] >= MARGIN


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=10, help="unfaulted campaigns")
    parser.add_argument("--folder", type=Path, default=Path("results/faulty_campaigns"))
    options = parser.parse_args()
    folder, good, start = options.folder.resolve(), True, time.process_time()
    shutil.rmtree(folder, ignore_errors=True)
    print("| seed | gates judged | fail | nearest to failing | its margin |\n|---|---|---|---|---|", flush=True)
    first = None
    for seed in range(1, options.seeds + 1):
        with contextlib.redirect_stdout(io.StringIO()):
            run, judged = campaign(folder / f"seed_{seed}", seed, folder / "psf")
        gates = [gate for gate in judged["gates"] if gate["passed"] is not None]
        near = max(gates, key=lambda gate: gate["margin"])
        fail = [f"{gate['name']} {gate['band']}" for gate in gates if not gate["passed"]]
        nearest = f"{near['name']}, {near['band']} | {near['margin']:.2f}"
        print(f"| {seed} | {len(gates)} | {', '.join(fail) or 0} | {nearest} |", flush=True)
        good &= not fail
        first = first or run
        if run is not first:
            shutil.rmtree(folder / f"seed_{seed}")
    kept = folder / "kept"
    shutil.copytree(first.paths.output, kept, copy_function=os.link)
    print(
        "\n| fault | gate | value | threshold | margin | other gates that fail |\n|---|---|---|---|---|---|", flush=True
    )
    for fault in FAULTS:
        with contextlib.redirect_stdout(io.StringIO()):
            row, seen = row_of(fault, *faulty(first, kept, fault))
        print("| " + " | ".join(map(str, row)) + " |" + ("" if seen else " NOT SEEN"), flush=True)
        good &= seen
    print(f"\n{time.process_time() - start:.0f} CPU-s; {'all as expected' if good else 'NOT AS EXPECTED'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
