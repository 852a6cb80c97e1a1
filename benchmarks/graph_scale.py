"""Time and memory of building the workflow's graph (snakemake --dry-run), printed as a table.

python benchmarks/graph_scale.py [campaign ...]        default: config/campaign.yaml config/c9_w1.yaml
"""

import argparse
import os
import re
import resource
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]


def dry_run(campaign):
    """Return (jobs, wall s, CPU s, largest memory MB so far of any child) of one dry run."""
    line = [
        sys.executable,
        "-m",
        "snakemake",
        "--dry-run",
        "--forceall",
        "--quiet",
        "rules",
        "--config",
        f"campaign={campaign}",
    ]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(line, cwd=ROOT, env=os.environ | {"PATH": path}, capture_output=True, text=True, check=False)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(done.stdout[-2000:] + done.stderr[-2000:])
    total = re.findall(r"^total +(\d+)$", done.stdout + done.stderr, re.MULTILINE)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return int(total[0]) if total else 0, wall, cpu, after.ru_maxrss / 1024


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    print("| campaign | jobs | wall s | CPU s | memory MB |\n|---|---|---|---|---|")
    for name in sys.argv[1:] or ("config/campaign.yaml", "config/c9_w1.yaml"):
        jobs, wall, cpu, memory = dry_run(name)
        print(f"| {name} | {jobs} | {wall:.1f} | {cpu:.1f} | {memory:.0f} |", flush=True)
