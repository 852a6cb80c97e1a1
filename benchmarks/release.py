"""A campaign from its survey table to a verified delivery on one machine, with processes killed on the way; its cost.

    python benchmarks/release.py [CAMPAIGN] [--every 240] [--seed 1]        default: examples/release.yaml

At random times, --every seconds apart on average, kill -9 ends in turn: a running job; Snakemake with all its jobs;
another job; Snakemake alone, whose jobs then end by themselves. Each time the command that started the campaign is
repeated (after --unlock if Snakemake was killed). At the end come csstsim verify, report --strict, and tables. CPU
seconds are those of all processes, including the killed ones: this process adopts the orphans (Linux only).
"""

import argparse
import ctypes
import os
import random
import resource
import subprocess
import sys
import time
from pathlib import Path

import psutil

ROOT = Path(__file__).parents[1]
LOG = ROOT / ".snakemake" / "release.log"
KINDS = "a job", "Snakemake and its jobs", "a job", "Snakemake alone"  # in turn
SUBREAPER = 36  # prctl's PR_SET_CHILD_SUBREAPER: orphans become children of this process


def snakemake(campaign, *arguments):
    """Start Snakemake on a campaign, with its output in .snakemake/release.log; return the process."""
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    line = [sys.executable, "-m", "snakemake", "--profile", "profiles/default", *arguments]
    line += ["--config", f"campaign={campaign}"]
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
    """Kill -9; return what was killed, as text, or None if there was nothing."""
    jobs = at_work(process)
    if not jobs:
        return None
    victim = dice.choice(jobs)
    doomed = {"a job": [victim], "Snakemake alone": [process]}.get(kind, [process, *jobs])
    words = " ".join(word for word in victim.cmdline()[2:] if not word.endswith(".yaml"))
    for one in doomed:
        one.kill()
    if kind != "a job":
        psutil.wait_procs(jobs)  # the jobs left over end by themselves
    return words if kind == "a job" else f"{kind} ({len(jobs)} running: {words}, ...)"


def run(campaign, every, dice):
    """Run a campaign to its end through the kills; return [(s since the start, what was killed)], number of starts."""
    begun, kills, starts = time.perf_counter(), [], 0
    while True:
        process, starts = snakemake(campaign), starts + 1
        due = time.perf_counter() + dice.expovariate(1 / every)
        while process.poll() is None:
            time.sleep(0.5)
            if time.perf_counter() < due:
                continue
            if what := kill(KINDS[len(kills) % len(KINDS)], process, dice):
                kills.append((time.perf_counter() - begun, what))
                print(f"{kills[-1][0]:7.0f} s: kill -9: {what}", flush=True)
                due += dice.expovariate(1 / every)
        if process.returncode == 0:
            return kills, starts
        if not kills or starts > len(kills) + 1:
            sys.exit("the campaign failed by itself: .snakemake/release.log")
        if process.returncode < 0 and snakemake(campaign, "--unlock").wait():
            sys.exit("cannot be unlocked: .snakemake/release.log")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", nargs="?", default="examples/release.yaml")
    parser.add_argument("--every", type=float, default=240.0, help="mean seconds between kills")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    if not (ROOT / arguments.campaign).is_file():
        parser.error(f"CAMPAIGN: no such file, seen from {ROOT}")
    if not arguments.every > 0:
        parser.error("--every: more than 0 s")
    LOG.parent.mkdir(exist_ok=True)
    if ctypes.CDLL(None, use_errno=True).prctl(SUBREAPER, 1, 0, 0, 0):
        sys.exit("this system has no PR_SET_CHILD_SUBREAPER")
    begun = time.perf_counter()
    kills, starts = run(arguments.campaign, arguments.every, random.Random(arguments.seed))
    wall = time.perf_counter() - begun
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = spent.ru_utime + spent.ru_stime
    print(f"{len(kills)} kills, {starts} starts; wall {wall:.0f} s, CPU {cpu:.0f} s, {os.cpu_count()} cores")
    csstsim = [str(Path(sys.executable).with_name("csstsim"))]
    for command in (["verify", arguments.campaign, "--manifest"], ["report", arguments.campaign, "--strict"]):
        done = subprocess.run(csstsim + command, cwd=ROOT, capture_output=True, text=True, check=False)
        lines = (done.stdout + done.stderr).splitlines()
        print(f"csstsim {' '.join(command)}: exit code {done.returncode}; {lines[-1] if lines else ''}")
    subprocess.run(
        [sys.executable, "benchmarks/projection.py", arguments.campaign, f"--cpu={cpu}"], cwd=ROOT, check=True
    )


if __name__ == "__main__":
    main()
