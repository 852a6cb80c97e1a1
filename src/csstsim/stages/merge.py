"""Merge: the measurements on a brick, one row for each source."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim import __version__
from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import progress
from csstsim.stages.measure import measured_table

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable


@one_thread
def merge(run: OpenCampaign, pix: int) -> None:
    """Merge the measurements of a brick: one row per source."""
    from csstsim.measure.bricks.merge import DETECTION_COLUMNS, merge_brick, write_merged

    jobs = jobs_on(run, pix)
    sources, detections = merge_brick(
        pix,
        (_timed(measured_table(run, job, DETECTION_COLUMNS), job) for job in progress(jobs, "frames")),
        run.camera.bands,
    )
    metadata = {
        "product": "merged brick",
        "csstsim": __version__,
        "campaign": run.config.name,
        "brick": pix,
        "recipe": run.brick_recipe(pix),
        "frames": len(jobs),
    }
    write_merged(run.paths.merge(pix), sources, detections, metadata)
    print(f"{number_of(len(sources), 'source')} from {number_of(len(detections), 'detection')}")


def _timed(table: ObjectTable, job: Job) -> ObjectTable:
    """Return a job's measured table with the columns bricks.merge.TIMES."""
    import numpy as np

    interval = job.exposure.interval
    count = len(table)
    return table.with_columns(mjd=np.full(count, interval.middle), exptime=np.full(count, interval.exptime))


def jobs_on(run: OpenCampaign, pix: int) -> list[Job]:
    """Return the jobs that were measured on a brick. Raises InputError if there are none."""
    if pix not in run.merge_bricks:
        raise InputError(
            "not touched by a measured frame of this campaign",
            file=run.file,
            key="brick",
            value=pix,
            allowed=", ".join(map(str, run.merge_bricks)) or "none",
        )
    return run.merge_bricks[pix]
