"""CPU seconds per Level-0 file outside the stages' own work: interpreter, imports, files between stages, Snakemake.

    python benchmarks/overhead.py [--exposures 2]

Eight whole full-depth chips, one of them spectroscopic, of each of two exposures (examples/release.yaml); truth bricks
and PSF sets are made before. Then one Snakemake makes the Level-0 files alone on this machine: four jobs per file
(`--config chips=stages`), one (`whole`), one for an exposure's eight (`exposure`). The total is that of Snakemake and
its children. The own work is what the stages report in the last case, where seven of eight files find everything
imported and compiled. On a cluster each job of several files starts Snakemake twice more on its node; the table adds
that in its own column.
"""

import argparse
import os
import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path

from evidence.record import Record

import projection
import yaml
from toy_sky import toy_sky

from csstsim.campaign.config import load_campaign
from csstsim.campaign.opened import OpenCampaign

ROOT = Path(__file__).parents[1]
CHIPS = [6, 7, 8, 9, 10, 11, 12, 14]  # y, i, g, r, GI, z, NUV, u
FOLDER = ROOT / "results" / "overhead"
STARTS = 2  # of Snakemake on the node, for each Slurm job: one for the job, and one for its rules
FILES = {"stages": 8, "whole": 8, "exposure": 30}  # Level-0 files in a Slurm job
LIMIT = 0.15
TOY = {"x0": 5000, "x1": 5300, "y0": 4500, "y1": 4800}


def run(*arguments):
    """Run Snakemake; return the CPU s of it and all its children."""
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "snakemake", "--profile", "profiles/default", *map(str, arguments)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(done.stdout[-2000:] + done.stderr[-2000:])
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def own_work(logs):
    """Return the CPU s that the stages report in the logs of csstsim chip."""
    found = (re.findall(r"^\w+: [\d.]+ s, ([\d.]+) CPU-s$", path.read_text(), re.MULTILINE) for path in logs.iterdir())
    return sum(float(cpu) for times in found for cpu in times)


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--exposures", type=int, default=2, choices=(1, 2))
    with Record(parser) as record:
        measure(record)


def measure(record: Record) -> None:
    """Make the files in each way, and record the cost."""
    content = load_campaign(ROOT / "examples/release.yaml").model_dump(mode="json") | {"output": str(FOLDER)}
    content["select"]["obsids"] = content["select"]["obsids"][: 1 if record.toy else record.options.exposures]
    content["select"]["chips"] = chips = CHIPS[:1] if record.toy else CHIPS
    if record.toy:
        output = FOLDER / "toy"
        content |= {"window": TOY, "output": str(output)} | toy_sky(output.parent, 30.0, -48.0)
    FOLDER.mkdir(parents=True, exist_ok=True)
    file = FOLDER / "campaign.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    campaign = OpenCampaign(file)
    paths, jobs = campaign.paths, campaign.jobs
    files = [paths.level0(job) for job in jobs]
    bricks = {pix for job in jobs for pix in campaign.truth_bricks(job)} if campaign.embedded else ()
    run(*map(paths.truth, bricks), *map(paths.psf, chips), "--config", f"campaign={file}")
    spent = {}
    for mode in ("exposure", *FILES):  # the first run compiles
        shutil.rmtree(paths.output / "level0", ignore_errors=True)
        shutil.rmtree(paths.output / "logs", ignore_errors=True)
        spent[mode] = run(*files, "--config", f"campaign={file}", f"chips={mode}") / len(files)
        if mode == "stages":
            projection.record_jobs(projection.spent(paths.output), record)
    own = own_work(paths.output / "logs/exposure") / len(files)
    start = run(*files, "--config", f"campaign={file}", "chips=exposure", "--dry-run", "--forceall")
    record.value("own", own, f"own work of the stages, each of {len(files)} files", unit="CPU-s")
    record.value("start", start, "a start of Snakemake", unit="CPU-s")
    rows = []
    for mode, count in FILES.items():
        slurm = spent[mode] + STARTS * start / count
        share = 1 - own / slurm
        here, there = spent[mode] - own, slurm - own
        record.value(f"slurm_{mode}", there, f"overhead with Slurm, chips={mode}", unit="CPU-s a file")
        record.value(
            f"fraction_{mode}",
            share,
            f"fraction of all that is overhead, chips={mode}",
            below=LIMIT if mode == "exposure" else None,
        )
        rows.append([mode, f"{spent[mode]:.1f}", f"{here:.1f}", f"{there:.1f}", count, f"{100 * share:.0f}%"])
    header = ["chips", "CPU-s a file", "overhead", "with Slurm", "files a Slurm job", "fraction"]
    record.table("files", header, rows)


if __name__ == "__main__":
    main()
