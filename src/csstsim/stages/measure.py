"""Measure: the sources of a Level-0 file detected and measured."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.plural import number_of
from csstsim.base.process.one_thread import one_thread
from csstsim.base.release import check_recipe
from csstsim.io.paths import existing_product
from csstsim.stages.calibrate import calibrated_frame
from csstsim.stages.parts.shared import copied
from csstsim.stages.psf import open_psf

if TYPE_CHECKING:
    from collections.abc import Iterable

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.detection.residual import Residual


@one_thread
def measure(run: OpenCampaign, job: Job) -> None:
    """Detect and measure the sources of a Level-0 file."""
    from csstsim.measure.catalogue import FrameFacts, measure_frame

    if copied(run.base_files(job, "measure")):
        return
    recipe = {"recipe": run.recipe(job, "measure")}

    def save(left: Residual) -> None:
        from csstsim.stages.parts.residual_file import save_residual

        save_residual(run.paths.residual(*job.key), left, recipe)

    file, calibrated = calibrated_frame(run, job)
    table = measure_frame(
        calibrated,
        open_psf(run, job.chip),
        job.wcs,
        file.observer,
        FrameFacts.of(job),
        keep=save if run.config.measurement.joint else None,
    )
    table.write(run.paths.measure(*job.key), table.meta | recipe)
    print(f"{number_of(len(table), 'source')}, 5 sigma at {table.meta['depth_5sigma']:.2f} AB")


def measured_table(run: OpenCampaign, job: Job, columns: Iterable[str] | None = None) -> ObjectTable:
    """Return the table of a job's measured sources; `columns` of it, or all. Raises InputError."""
    from csstsim.catalog.table import ObjectTable

    path = existing_product(run.paths.measure(*job.key), f"measure {run.file} {job.options}")
    table = ObjectTable.read(path, columns)
    check_recipe(path, table.meta, run.recipe(job, "measure"))
    return table
