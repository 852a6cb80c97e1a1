"""Count: the number of sources that were measured on a frame."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from csstsim.base.files.atomic import atomic_path
from csstsim.stages.measure import measured_table

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign


def count(run: OpenCampaign, job: Job) -> None:
    """Write the number of sources measured on a frame."""
    sources = len(measured_table(run, job))
    with atomic_path(run.paths.of("count", job)) as temporary:
        temporary.write_text(json.dumps({"sources": sources}) + "\n")
