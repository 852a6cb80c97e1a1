"""Runs the workflow on a small campaign and reads its products' contents, for tests that compare two runs."""

import atexit
import os
import re
import shutil
import subprocess
import sys
from contextlib import ExitStack
from functools import cache
from pathlib import Path

import fitsio

from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.studies.compare.varying import varies
from support.mini_campaign import POINTINGS, write_campaign
from support.warm import programs

ROOT = Path(__file__).resolve().parents[2]


@cache
def _forked():
    """Return the folder of programs that are forked from a process with all libraries."""
    running = ExitStack()
    atexit.register(running.close)
    return running.enter_context(programs())


def command(campaign, *arguments):
    """The snakemake command line and environment for a campaign, run from the repository's root.

    On Slurm a job's processes start on its node, all others are forked.
    """
    cluster = str(ROOT / "profiles" / "slurm") in arguments
    folder = Path(sys.executable).parent if cluster else _forked()
    environment = os.environ | {"PATH": os.pathsep.join([str(folder), os.environ["PATH"]])}
    line = [
        str(folder / "snakemake"), "--snakefile", str(ROOT / "Snakefile"),
        "--directory", str(campaign.parent),
        "--config", f"campaign={campaign}", *arguments,
    ]  # fmt: skip
    return line, environment


def snakemake(campaign, *arguments, fails=False):
    """Return what Snakemake says; it must succeed, or fail."""
    line, environment = command(campaign, *arguments)
    done = subprocess.run(line, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert (done.returncode != 0) == fails, done.stdout + done.stderr
    return done.stdout + done.stderr


def dry_run(campaign, *arguments):
    """Return (exit code, what it says) of a dry run."""
    line, environment = command(campaign, *arguments, "--dry-run")
    done = subprocess.run(
        line, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    return done.returncode, done.stdout


def planned(campaign, *arguments):
    """Return the rules that Snakemake would run."""
    code, said = dry_run(campaign, *arguments)
    assert code == 0, said
    return set(re.findall(r"^(\w+) +\d+$", said, re.MULTILINE)) - {"all", "total"}


def make(folder, pointings=POINTINGS, **changes):
    folder.mkdir()
    return write_campaign(folder, pointings, select={"chips": [9, 29]}, **changes)  # r, and a grating


def with_prepared(campaign, other):
    """Give a campaign the truth bricks and PSF sets of another, which are the same."""
    for kind in ("truth", "psf"):
        shutil.copytree(other.parent / "out" / kind, campaign.parent / "out" / kind)
    return campaign


def level0_targets(campaign):
    run = OpenCampaign(campaign)
    return [str(run.paths.level0(job)) for job in run.jobs]


def content(campaign):
    """Every Level-0 pixel, header card that must not vary and column of the truth of orders, by file name."""
    found = {}
    for path in sorted((campaign.parent / "out" / "level0").rglob("*.fits")):
        with fitsio.FITS(path) as file:
            cards = [
                (record["name"], record["value"], record["comment"])
                for hdu in file
                for record in hdu.read_header().records()
                if not varies(str(record["name"]))
            ]
            found[path.name] = (cards, file["IMAGE"].read().tobytes())
        orders = path.with_suffix(".orders.parquet")
        if orders.exists():
            table = ObjectTable.read(orders)
            found[orders.name] = {n: table[n].astype(str).tolist() for n in table.names}  # NaN is not itself
    return found


def measured(campaign):
    """The bytes of every measurement, spectra table and merged brick."""
    folder = campaign.parent / "out"
    found = [path for kind in ("measure", "spectra", "merge") for path in (folder / kind).rglob("*.parquet")]
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}
