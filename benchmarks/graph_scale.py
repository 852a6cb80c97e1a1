"""Snakemake's own cost for a campaign of many exposures: to plan its jobs, and to run through them.

    python benchmarks/graph_scale.py [--exposures 1 10 226 1221] [--chips stages whole exposure]    (an hour)

Campaigns have the first 1, 10, ... Cycle-9 exposures (226: W1; 1221: all five fields in one) with all 30 chips. After a
dry run comes a run in which every job is only marked as done (--touch on files that do not exist), so that Snakemake's
scheduling remains. `stages`, `whole`, `exposure`: four jobs per Level-0 file, one, or one for an exposure's 30; above
MOST_SMALL exposures the last alone. Prints wall and CPU seconds, the largest resident memory, jobs per second including
planning, and CPU seconds per file; and the CPU seconds of `csstsim status` for the largest campaign.
"""

import argparse
import csv
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from evidence.record import Record

import yaml
from start_of_stages import MAIN, cpu_seconds

ROOT = Path(__file__).parents[1]
CHIPS, MODES = 30, ("stages", "whole", "exposure")
MOST_SMALL = 300


def campaign(folder, exposures):
    """Write a campaign of the first `exposures` of W1 to W5 to a folder; return its file."""
    rows = []
    for number in range(1, 6):
        with open(ROOT / f"survey_tables/w{number}.csv") as file:
            rows += csv.DictReader(line for line in file if not line.startswith("#"))
    if exposures > len(rows):
        sys.exit(f"--exposures {exposures}: the five fields have {len(rows)}")
    with open(folder / "table.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows[:exposures])
    path, select = folder / "campaign.yaml", {"types": ["SCIE"], "chips": "all"}
    content = {
        "schema_version": 1,
        "name": "scale",
        "survey_table": str(folder / "table.csv"),
        "output": str(folder / "out"),
    }
    path.write_text(yaml.safe_dump(content | {"seed": 1, "select": select}))
    return path


def snakemake(file, chips, *arguments):
    """Return (wall s, CPU s, largest resident MB, output) of one Snakemake with all its children."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with tempfile.TemporaryFile("w+") as log:
        start = time.perf_counter()
        line = [sys.executable, "-m", "snakemake", *arguments, "--config", f"campaign={file}", f"chips={chips}"]
        process = subprocess.Popen(line, cwd=ROOT, env=os.environ | {"PATH": path}, stdout=log, stderr=log)
        _, status, used = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        log.seek(0)
        text = log.read()
    if status:
        sys.exit(text[-2000:])
    return wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, text


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--exposures", type=int, nargs="+", default=[1, 10, 226, 1221])
    parser.add_argument("--chips", nargs="+", choices=MODES, default=MODES)
    with Record(parser) as record:
        scale(record)


def scale(record: Record) -> None:
    """Record the cost by exposures and by what a job is."""
    arguments, rows = record.options, []
    for exposures in [1] if record.toy else arguments.exposures:
        few = record.toy or exposures > MOST_SMALL
        for chips in [chips for chips in arguments.chips if chips == MODES[-1] or not few]:
            with tempfile.TemporaryDirectory() as folder:
                file = campaign(Path(folder), exposures)
                *plan, text = snakemake(file, chips, "--dry-run", "--quiet", "rules")
                jobs = int(re.search(r"^total +(\d+)$", text, re.MULTILINE)[1])
                wall, cpu, memory, _ = snakemake(file, chips, "--touch", "--cores", "8")
            figures = [f"{value:.0f}" for value in (*plan, wall, cpu, memory)]
            key = f"{exposures}_{chips}"
            record.value(f"plan_{key}", plan[1], f"plan of {exposures} exposures, chips={chips}", unit="CPU-s")
            record.value(f"lead_{key}", cpu, f"leading through {exposures} exposures, chips={chips}", unit="CPU-s")
            rate, each = jobs / wall, cpu / (exposures * CHIPS)
            rows.append([exposures, chips, f"{jobs:,}", *figures, f"{rate:.0f}", f"{each:.2f}"])
    columns = ["wall s", "CPU-s", "MB"]
    header = ["exposures", "chips", "jobs", *(f"{what}: {name}" for what in ("plan", "lead") for name in columns)]
    record.table("scale", [*header, "jobs/s", "CPU-s a file"], rows)
    with tempfile.TemporaryDirectory() as folder:
        cpu, _ = cpu_seconds("-c", MAIN, "status", campaign(Path(folder), exposures))
    record.value("status", cpu, f"`csstsim status` of {exposures * CHIPS:,} chips of which none is made", unit="CPU-s")


if __name__ == "__main__":
    main()
