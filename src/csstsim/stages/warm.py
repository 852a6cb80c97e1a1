"""Compile what simulating and measuring a campaign needs, for this machine and once: `csstsim doctor --warm`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

from csstsim.base.process.progress import progress
from csstsim.base.process.shipped_kernels import leave_out_shipped
from csstsim.base.shipped import ROOT
from csstsim.campaign.opened import OpenCampaign

if TYPE_CHECKING:
    from csstsim.campaign.job import Job

EXPOSURES = {"10100000004": 9, "10100000015": 29}  # r and GV
RADIUS = 0.3  # arcmin of the demo's region
GRID = 2
POSITIONS = 300_000  # of few, the distortion is found without compiled code


def warm() -> None:
    """Run each stage on an imaging and a slitless chip of a tiny part of the demo, in a temporary folder.

    Code that comes with csstsim is compiled, too: for this machine it is a few per cent faster.
    """
    leave_out_shipped()
    with tempfile.TemporaryDirectory(prefix="csstsim_") as folder:
        run = OpenCampaign(_campaign(Path(folder)))
        for step in progress(list(_steps(run)), "compiling"):
            with redirect_stdout(StringIO()):
                step()


def _campaign(folder: Path) -> Path:
    """Write the campaign into a folder, and return its file."""
    source = ROOT / "config" / "campaign.yaml"
    config = yaml.safe_load(source.read_text())
    config["survey_table"] = str((source.parent / config["survey_table"]).resolve())
    config |= {"name": "warm", "output": str(folder / "results"), "psf": {"grid": GRID}}
    region = config["select"]["region"] | {"radius": RADIUS}
    config["select"] |= {"obsids": list(EXPOSURES), "chips": list(EXPOSURES.values()), "region": region}
    file = folder / "campaign.yaml"
    file.write_text(yaml.safe_dump(config))
    return file


def _find_positions(job: Job) -> None:
    """Find the sky positions of many pixels, and the pixels of these."""
    x, y = np.zeros((2, POSITIONS))
    job.wcs.world_to_pixel(*job.wcs.pixel_to_world(x, y))


def _steps(run: OpenCampaign) -> Iterator[Callable[[], object]]:
    """Yield the stages in their order."""
    from csstsim.stages.chip import chip
    from csstsim.stages.extract import extract
    from csstsim.stages.measure import measure
    from csstsim.stages.merge import merge
    from csstsim.stages.psf import psf
    from csstsim.stages.truth import truth
    from csstsim.stages.validate import validate

    yield partial(_find_positions, run.jobs[0])
    for pix in sorted({pix for job in run.jobs for pix in run.truth_bricks(job)}):
        yield partial(truth, run, pix)
    for job in run.jobs:
        yield partial(psf, run, job.chip.id)
        yield partial(chip, run, job)
        yield partial(measure if job.chip.kind == "imaging" else extract, run, job)
    for pix in run.merge_bricks:
        yield partial(merge, run, pix)
        yield partial(validate, run, pix)
