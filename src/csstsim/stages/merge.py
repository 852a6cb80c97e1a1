"""Merge: the measurements on a brick, one row for each source."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from csstsim import __version__
from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import progress
from csstsim.io.paths import existing_product
from csstsim.stages.measure import measured_table
from csstsim.stages.psf import open_psf

if TYPE_CHECKING:
    from collections.abc import Iterator

    from csstsim.base.types import FloatArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.bricks.joint_frame import JointFrame


@one_thread
def merge(run: OpenCampaign, pix: int) -> None:
    """Merge the measurements of a brick: one row per source."""
    from csstsim.measure.bricks.merge import merge_brick, write_merged

    jobs = jobs_on(run, pix)
    profiles: Counter[str] = Counter()
    sources, detections = merge_brick(
        pix,
        _tables(run, jobs, profiles),
        run.camera.bands,
        joint=[_joint_frame(run, job) for job in jobs] if run.config.measurement.joint else (),
    )
    metadata = {
        "product": "merged brick",
        "csstsim": __version__,
        "campaign": run.config.name,
        "brick": pix,
        "recipe": run.brick_recipe(pix),
        "frames": len(jobs),
        "profiles": dict(profiles),
    }
    write_merged(run.paths.merge(pix), sources, detections, metadata)
    print(f"{number_of(len(sources), 'source')} from {number_of(len(detections), 'detection')}")


def _tables(run: OpenCampaign, jobs: list[Job], profiles: Counter[str]) -> Iterator[ObjectTable]:
    """Yield the measured tables of jobs; count their families of profiles (measure.light.family)."""
    from csstsim.measure.bricks.merge import DETECTION_COLUMNS

    for job in progress(jobs, "frames"):
        table = measured_table(run, job, DETECTION_COLUMNS)
        profiles[table.meta.get("profiles", "not known")] += 1  # an older version does not say
        yield _timed(table, job)


def _timed(table: ObjectTable, job: Job) -> ObjectTable:
    """Return a job's measured table with the columns bricks.merge.TIMES."""
    import numpy as np

    interval = job.exposure.interval
    count = len(table)
    return table.with_columns(mjd=np.full(count, interval.middle), exptime=np.full(count, interval.exptime))


def _joint_frame(run: OpenCampaign, job: Job) -> JointFrame:
    """Return what is left of a measured frame."""
    import numpy as np

    from csstsim.catalog.astrometry.reduction import apparent
    from csstsim.measure.bricks.joint_frame import JointFrame
    from csstsim.measure.light.photometry import psf_model
    from csstsim.stages.parts.residual_file import open_residual

    path = existing_product(run.paths.residual(*job.key), f"measure {run.file} {job.options}")
    exposure = job.exposure
    window = job.window

    def to_pixel(ra: FloatArray, dec: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y = job.wcs.world_to_pixel(*apparent(ra, dec, job.observer))
        return x - window.x0, y - window.y0

    return JointFrame(
        job.obsid,
        job.chip.id,
        job.chip.filter.lower(),
        open_residual(path, {"recipe": run.recipe(job, "measure")}),
        psf_model(open_psf(run, job.chip), (window.x0, window.y0), window.shape),
        to_pixel,
        exposure.filter.zeropoint(exposure.telescope) + 2.5 * np.log10(exposure.exptime),
        exposure.telescope.pixel_scale,
        exposure.interval.middle,
    )


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
