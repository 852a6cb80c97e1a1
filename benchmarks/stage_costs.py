"""CPU and memory of each stage on one full-size r-band chip, printed as a table (for config/costs.yaml).

    python benchmarks/stage_costs.py [--mag-limit 21]

Each stage is its own process, start-up included, as in the workflow. Objects are cut at a bright limit to keep
it short; the cost of one object is printed beside, from the truth table's CPU milliseconds.
"""

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml

from csstsim.campaign.opened import OpenCampaign
from csstsim.io.truth import read_truth

ROOT = Path(__file__).parents[1]
OBSID, CHIP = "10100000004", 9


def cost(*arguments):
    """Run `csstsim ...` and return its (CPU s, largest memory MB)."""
    process = subprocess.Popen([str(Path(sys.executable).parent / "csstsim"), *map(str, arguments)], cwd=ROOT)
    _, status, used = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"csstsim {arguments[0]} failed")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mag-limit", type=float, default=21.0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        campaign = yaml.safe_load((ROOT / "config" / "campaign.yaml").read_text())
        campaign |= {"output": scratch, "window": None, "catalog": {"mag_limit": options.mag_limit}, "psf": {"grid": 2}}
        del campaign["select"]["region"]
        file = Path(scratch) / "campaign.yaml"
        file.write_text(yaml.safe_dump(campaign))
        run = OpenCampaign(file)
        job = run.job(OBSID, CHIP)
        bricks = run.truth_bricks(job)
        print("| stage | CPU s | memory MB |\n|---|---|---|")
        costs = [cost("truth", file, "--brick", pix) for pix in bricks]
        print(f"| truth, a brick | {np.mean([c for c, _ in costs]):.1f} | {max(m for _, m in costs):.0f} |", flush=True)
        print("| psf, 16 images | {:.1f} | {:.0f} |".format(*cost("psf", file, "--chip", CHIP)), flush=True)
        for stage in ("select", "render", "readout", "level0", "measure"):
            used = cost(stage, file, "--obsid", OBSID, "--chip", CHIP)
            print("| {} | {:.1f} | {:.0f} |".format(stage, *used), flush=True)
        ms = read_truth(run.paths.level0_truth(job.pointing, CHIP))["ms"]
        print(f"\n{len(ms)} objects: median {np.median(ms):.0f} ms, mean {ms.mean():.0f} ms of CPU each")


if __name__ == "__main__":
    main()
