"""Compile what simulating and measuring a campaign needs, once for an installation: `csstsim doctor --warm`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from functools import partial
from io import StringIO
from pathlib import Path

import yaml

from csstsim.base.process.progress import progress
from csstsim.base.shipped import ROOT
from csstsim.campaign.opened import OpenCampaign

EXPOSURES = {"10100000004": 9, "10100000015": 29}  # r and GV
RADIUS = 0.3  # arcmin of the demo's region
GRID = 2


def warm() -> None:
    """Run each stage on an imaging and a slitless chip of a tiny part of the demo, in a temporary folder."""
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


def _steps(run: OpenCampaign) -> Iterator[Callable[[], object]]:
    """Yield the stages in their order."""
    from csstsim.stages.chip import chip
    from csstsim.stages.extract import extract
    from csstsim.stages.measure import measure
    from csstsim.stages.merge import merge
    from csstsim.stages.psf import psf
    from csstsim.stages.truth import truth
    from csstsim.stages.validate import validate

    for pix in sorted({pix for job in run.jobs for pix in run.truth_bricks(job)}):
        yield partial(truth, run, pix)
    for job in run.jobs:
        yield partial(psf, run, job.chip.id)
        yield partial(chip, run, job)
        yield partial(measure if job.chip.kind == "imaging" else extract, run, job)
    for pix in run.merge_bricks:
        yield partial(merge, run, pix)
        yield partial(validate, run, pix)
