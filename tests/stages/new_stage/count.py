"""Count: the number of sources that were measured on each chip of an exposure."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from csstsim.base.files.atomic import atomic_path
from csstsim.stages.measure import measured_table

if TYPE_CHECKING:
    from csstsim.campaign.opened import OpenCampaign


def count(run: OpenCampaign, obsid: str) -> None:
    """Write {chip: number of sources} of an exposure's imaging chips, as JSON."""
    jobs = [job for job in run.science_exposures[obsid] if job.chip.kind == "imaging"]
    sources = {job.chip.id: len(measured_table(run, job)) for job in jobs}
    with atomic_path(run.paths.of("count", obsid)) as temporary:
        temporary.write_text(json.dumps(sources) + "\n")
