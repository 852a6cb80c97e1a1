"""A campaign from its survey table to a verified delivery on one machine, with processes killed on the way; its cost.

    python benchmarks/release.py [CAMPAIGN] [--chips whole] [--every 240] [--seed 1]    (default: examples/release.yaml)

At random times, --every seconds apart on average, kill -9 ends in turn: a running job; Snakemake with all its jobs;
another job; Snakemake alone, whose jobs then end by themselves and are made again. Each time the command that started
the campaign is repeated (after --unlock if Snakemake was killed). At the end come csstsim verify, report --strict, and
tables. CPU seconds are those of all processes, including the killed ones: this process adopts the orphans and waits for
them (Linux only). Those of killed jobs, and of jobs left over, are told apart:
they are lost but for the chips that the next attempt takes over.
"""

import argparse
import ctypes
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path

from evidence.record import Record, cpu_seconds

import psutil
from projection import project
from support.mini_campaign import POINTINGS, write_campaign
from toy_sky import toy_sky

from csstsim.campaign.opened import OpenCampaign

ROOT = Path(__file__).parents[1]
LOG = ROOT / ".snakemake" / "release.log"
CHIPS = "whole", "stages", "exposure"
KINDS = "a job", "Snakemake and its jobs", "a job", "Snakemake alone"  # in turn
UNLOCK = "--unlock", "--snakefile", os.devnull  # the lock is the folder's: to remove it, no rule need be read
SUBREAPER = 36  # prctl's PR_SET_CHILD_SUBREAPER: orphans become children of this process


def snakemake(*arguments):
    """Start Snakemake, with its output in .snakemake/release.log; return the process."""
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    line = [sys.executable, "-m", "snakemake", "--profile", "profiles/default", *arguments]
    with open(LOG, "a") as log:
        return subprocess.Popen(line, cwd=ROOT, env=environment, stdout=log, stderr=log)


def at_work(process):
    """Return the processes of csstsim's commands that Snakemake started."""
    found = []
    for child in psutil.Process(process.pid).children(recursive=True):
        try:
            words = child.cmdline()
        except psutil.Error:
            continue
        if len(words) > 2 and words[1].endswith("csstsim"):
            found.append(child)
    return found


def kill(kind, process, dice):
    """Kill -9; return (what was killed, as text, CPU s lost by it), or None if there was nothing."""
    jobs = at_work(process)
    if not jobs:
        return None
    victim = dice.choice(jobs)
    words = " ".join(word for word in victim.cmdline()[2:] if not word.endswith(".yaml"))
    if kind == "a job":
        spent = victim.cpu_times()
        victim.kill()
        return words, spent.user + spent.system
    for one in [process] if kind == "Snakemake alone" else [process, *jobs]:
        one.kill()
    process.wait()
    return f"{kind} ({len(jobs)} running: {words}, ...)", orphans()


def orphans():
    """Wait for the adopted processes, which end by themselves or are killed; return their CPU s."""
    spent = 0.0
    while True:
        try:
            *_, used = os.wait4(-1, 0)
        except ChildProcessError:
            return spent
        spent += used.ru_utime + used.ru_stime


def run(campaign, chips, every, dice, kinds=KINDS):
    """Run a campaign to its end through the kills; return the numbers of kills and starts, and the CPU s lost."""
    begun, kills, starts, lost = time.perf_counter(), 0, 0, 0.0
    while True:
        process, starts = snakemake("--config", f"campaign={campaign}", f"chips={chips}"), starts + 1
        due = time.perf_counter() + dice.expovariate(1 / every)
        while process.poll() is None:
            time.sleep(0.5)
            if time.perf_counter() < due:
                continue
            if done := kill(kinds[kills % len(kinds)], process, dice):
                kills, lost = kills + 1, lost + done[1]
                print(f"{time.perf_counter() - begun:7.0f} s: kill -9: {done[0]}", flush=True)
                due += dice.expovariate(1 / every)
        if process.returncode == 0:
            return kills, starts, lost
        if not kills or starts > kills + 1:
            sys.exit("the campaign failed by itself: .snakemake/release.log")
        if process.returncode < 0 and snakemake(*UNLOCK).wait():
            sys.exit("cannot be unlocked: .snakemake/release.log")


def main() -> None:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", default="examples/release.yaml")
    parser.add_argument("--chips", choices=CHIPS, default=CHIPS[0], help="what one process makes (docs/slurm.md)")
    parser.add_argument("--every", type=float, default=240.0, help="mean seconds between kills")
    parser.add_argument("--seed", type=int, default=1)
    with Record(parser) as record:
        release(record, parser)


def release(record: Record, parser: argparse.ArgumentParser) -> None:
    """Run the campaign through the kills, verify it, and project its cost."""
    arguments = record.options
    if record.toy:
        folder = record.results / "release"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        few = toy_sky(folder, 60.15, -40.0, 20)
        arguments.campaign, arguments.every = str(write_campaign(folder, POINTINGS[:1], **few)), 60.0  # one kill
    if not (ROOT / arguments.campaign).is_file():
        parser.error(f"CAMPAIGN: no such file, seen from {ROOT}")
    if not arguments.every > 0:
        parser.error("--every: more than 0 s")
    LOG.parent.mkdir(exist_ok=True)
    if ctypes.CDLL(None, use_errno=True).prctl(SUBREAPER, 1, 0, 0, 0):
        sys.exit("this system has no PR_SET_CHILD_SUBREAPER")
    begun = time.perf_counter()
    dice = random.Random(arguments.seed)
    kinds = KINDS[1:] if record.toy else KINDS
    kills, starts, lost = run(arguments.campaign, arguments.chips, arguments.every, dice, kinds)
    wall = time.perf_counter() - begun
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = spent.ru_utime + spent.ru_stime
    record.value("kills", kills, "kill -9s that the campaign went through")
    record.value("starts", starts, "starts of Snakemake")
    record.value("wall", wall, f"wall time on {os.cpu_count()} cores", unit="s")
    record.value("cpu", cpu, "CPU time of all processes, the killed ones included", unit="CPU-s")
    record.value("lost", lost, "CPU time of what was killed", unit="CPU-s")
    done = OpenCampaign(arguments.campaign)
    csstsim = [str(Path(sys.executable).with_name("csstsim"))]
    for command in (["verify", arguments.campaign, "--manifest"], ["report", arguments.campaign, "--strict"]):
        before = cpu_seconds()
        ended = subprocess.run(csstsim + command, cwd=ROOT, capture_output=True, text=True, check=False)
        lines = (ended.stdout + ended.stderr).splitlines()
        print(lines[-1] if lines else "no output")
        what = f"exit code of `csstsim {command[0]} {command[2]}`"
        record.value(command[0], ended.returncode, what, below=0)
        what = f"`csstsim {command[0]} {command[2]}` of {len(done.jobs)} Level-0 files"
        record.value(f"{command[0]}_cpu", cpu_seconds() - before, what, unit="CPU-s")
    verdict = json.loads(done.paths.report.with_name("verdict.json").read_text())["counts"]
    record.value("gates", verdict["pass"], "gates that pass")
    record.value("gates_few", verdict["not evaluated"], "gates with too few sources to be evaluated")
    record.value("gates_failed", verdict["fail"], "gates that fail", below=0)
    project(done, cpu, lost, record)


if __name__ == "__main__":
    main()
