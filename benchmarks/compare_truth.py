"""The code of docs/compare_truth.md, run as it stands there on the first campaign of a new user: what it prints.

    python benchmarks/compare_truth.py

The campaign is that of `csstsim init`: one small field, twice in each of g, r and i. Its chips, measured tables and
merged bricks are made if they do not exist.
"""

import argparse
import contextlib
import re
import shutil
import subprocess
import sys
from pathlib import Path

from evidence import ROOT
from evidence.record import Record

import yaml
from toy_sky import toy_sky

from csstsim.campaign.opened import OpenCampaign

PAGE = ROOT / "docs/compare_truth.md"
EXPOSURE = "10100000004"  # of the page's first example
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def run_csstsim(*words: object) -> None:
    """Run a command of csstsim; what it says goes to stderr."""
    command = [Path(sys.executable).parent / "csstsim", *words]
    subprocess.run([str(word) for word in command], stdout=sys.stderr, check=True)


def campaign(record: Record) -> OpenCampaign:
    """Make the campaign's measured tables and merged bricks; return it."""
    folder = record.results / "compare_truth"
    shutil.rmtree(folder, ignore_errors=True)
    run_csstsim("init", folder)
    file = folder / "campaign.yaml"
    if record.toy:
        content = yaml.safe_load(file.read_text())
        region = content["select"]["region"]
        content |= toy_sky(folder, region["ra"], region["dec"], count=100, radius=region["radius"] / 60)
        content["select"]["obsids"] = [EXPOSURE]
        file.write_text(yaml.safe_dump(content, sort_keys=False))
    run = OpenCampaign(file)
    for job in run.jobs:
        for command in "chip", "measure":
            run_csstsim(command, file, "--obsid", job.obsid, "--chip", job.chip.id)
    for pix in run.merge_bricks:
        run_csstsim("merge", file, "--brick", pix)
    return run


def main() -> None:
    """Run the page's code, and record what each block prints."""
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        run = campaign(record)
        names: dict[str, object] = {}
        printed = 0
        with contextlib.chdir(run.file.parent):
            for block in BLOCK.findall(PAGE.read_text()):
                if "print(" not in block:
                    exec(block, names)
                    continue
                printed += 1
                with record.printed(f"block_{printed}"):
                    exec(block, names)


if __name__ == "__main__":
    main()
