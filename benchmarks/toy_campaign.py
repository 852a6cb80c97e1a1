"""A campaign of tiny chips, for benchmarks at toy size that read the files of a finished campaign."""

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

from support.mini_campaign import write_campaign

from csstsim.campaign.opened import OpenCampaign
from csstsim.command_line.main import main as csstsim


def made_frames(folder: Path, **changes: Any) -> tuple[Path, OpenCampaign]:
    """Write a campaign of tiny chips into a folder, and make the Level-0 files that are not there; return both.

    changes: keys of the campaign (tests/support/mini_campaign.py).
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = write_campaign(folder, **changes)
    run = OpenCampaign(file)
    for job in run.jobs:
        if not run.paths.level0(job).exists():
            with redirect_stdout(StringIO()):
                csstsim(["chip", str(file), "--obsid", job.obsid, "--chip", str(job.chip.id)], standalone_mode=False)
    return file, run
