"""CPU seconds a Level-0 file spent outside the stages' own work: interpreter, imports, files between stages, Snakemake.

    python benchmarks/overhead.py [--exposures 3]

Whole full-depth r images of examples/ten_images.yaml, truth bricks and PSF sets made before; then the files alone, with
four rules a chip (`--config chips=stages`) and with a process a chip (`chips=whole`), by one Snakemake on this machine.
All is what that Snakemake and its children took; own work is what the stages say, the writing of the Level-0 file in
it. A Slurm job of eight chips starts Snakemake twice more on its node: that is printed beside.
"""

import argparse
import os
import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import yaml

from csstsim.campaign import OpenCampaign

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "results" / "overhead"
GROUP, STARTS = 8, 2  # profiles/slurm: chips a job; Snakemakes a job
LIMIT = 0.15


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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--exposures", type=int, default=3, help="two r images each")
    content = yaml.safe_load((ROOT / "examples/ten_images.yaml").read_text()) | {"output": str(FOLDER)}
    content["select"]["obsids"] = content["select"]["obsids"][: parser.parse_args().exposures]
    FOLDER.mkdir(parents=True, exist_ok=True)
    file = FOLDER / "campaign.yaml"
    file.write_text(yaml.safe_dump(content, sort_keys=False))
    campaign = OpenCampaign(file)
    paths, jobs = campaign.paths, campaign.jobs
    files = [paths.level0(job.pointing, job.chip.id) for job in jobs]
    bricks = {pix for job in jobs for pix in campaign.truth_bricks(job)}
    prepared = [*map(paths.truth, bricks), *(FOLDER / f"psf/chip_{job.chip.id:02d}.h5" for job in jobs)]
    run(*prepared, "--config", f"campaign={file}", "chips=whole")
    spent = {}
    for mode in ("whole", "stages", "whole"):  # the first compiles what is not yet compiled
        shutil.rmtree(FOLDER / "level0", ignore_errors=True)
        spent[mode] = run(*files, "--config", f"campaign={file}", f"chips={mode}") / len(files)
    logs = [path.read_text() for path in (FOLDER / "logs/chip").iterdir()]
    own = sum(float(cpu) for log in logs for cpu in re.findall(r"^\w+: [\d.]+ s, ([\d.]+) CPU-s$", log, re.MULTILINE))
    own /= len(files)
    start = (
        run(*files, "--config", f"campaign={file}", "chips=whole", "--dry-run", "--forcerun", "chip") / GROUP * STARTS
    )
    print(f"{len(files)} files, own work {own:.1f} CPU s each")
    print("| | CPU s a file | beside the own work | share |\n|---|---|---|---|")
    rows = {
        "four rules a chip": spent["stages"], "one process a chip": spent["whole"],
        f"the same, {GROUP} chips a Slurm job": spent["whole"] + start,
    }  # fmt: skip
    for name, cpu in rows.items():
        print(f"| {name} | {cpu:.1f} | {cpu - own:.1f} | {100 * (cpu - own) / cpu:.0f}% |")
    share = 1 - own / max(list(rows.values())[1:])
    print(f"{'within' if share <= LIMIT else 'ABOVE'} {100 * LIMIT:.0f}%")


if __name__ == "__main__":
    main()
