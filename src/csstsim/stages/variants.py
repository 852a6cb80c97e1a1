"""Variants: the page that compares a campaign's variants: their verdicts and the differences of their measurements."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import progress
from csstsim.base.release import check_recipe
from csstsim.io.paths import existing_product
from csstsim.stages.level0 import truth_of
from csstsim.stages.measure import measured_table

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign


@one_thread
def variants(run: OpenCampaign, log: Callable[[Any], object] = print) -> None:
    """Write report/variants.html of a base whose campaigns are finished. Raises InputError if a product is missing."""
    from csstsim.base.stages import flatten
    from csstsim.report.variants_page import Study, write_variants

    if not run.variants:
        raise InputError("the campaign has no variants", file=run.file, key="variants")
    runs = (run, *run.variants)
    verdicts = {one.variant or "base": _verdict(one) for one in runs}
    base = _Measured(run)
    studies = [
        Study(one.variant, flatten(run.config.variants[one.variant]), *base.compared(one))
        for one in progress(run.variants, "variants")
        if one.variant is not None  # for the types: all have a name
    ]
    page = run.paths.variants_page
    write_variants(page, run.title, verdicts, studies)
    for study in studies:
        log(f"{study.name}: {len(study.objects)} objects and spectra in both")
    log(page)


def _verdict(run: OpenCampaign) -> dict[str, Any]:
    path = existing_product(run.paths.report.with_name("verdict.json"), f"report {run.file}")
    try:
        return json.loads(path.read_text())
    except ValueError:
        raise InputError("is damaged; write the report again", file=path) from None


class _Measured:
    """The measurements of a base, one frame at a time, for comparison with its variants."""

    def __init__(self, run: OpenCampaign) -> None:
        self._run = run

    def compared(self, other: OpenCampaign) -> tuple[list[dict[str, Any]], dict[str, dict[str, int]]]:
        """Return ([differences of objects and spectra], {"base" or "variant": counts}) of frames that both have."""
        from csstsim.measure.bricks.validation.twins import differences, spectral_differences

        theirs = {job.key: job for job in other.science_jobs}
        objects: list[dict[str, Any]] = []
        counts: dict[str, dict[str, int]] = {"base": {}, "variant": {}}
        for job in self._run.science_jobs:
            twin = theirs.get(job.key)
            if twin is None:
                continue
            if self._run.has_orders(job) and other.has_orders(twin):
                pair = (_spectra(one, frame) for one, frame in ((self._run, job), (other, twin)))
                objects += spectral_differences(*pair).values()
            elif job.chip.kind == twin.chip.kind == "imaging":
                (first, n_first), (second, n_second) = _seen(self._run, job), _seen(other, twin)
                objects += differences(first, second).values()
                for name, found in (("base", n_first), ("variant", n_second)):
                    counts[name] = {key: counts[name].get(key, 0) + value for key, value in found.items()}
        return objects, counts


def _seen(run: OpenCampaign, job: Job) -> tuple[dict[int, dict[str, Any]], dict[str, int]]:
    from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame, truth_inside
    from csstsim.measure.bricks.validation.twins import measured_objects

    truth = truth_of(run, job)
    measured = measured_table(run, job)
    frame = MeasuredFrame(truth, measured, run.camera.detector.channel_ny, run.camera.telescope.pixel_scale)
    return measured_objects(frame, truth_inside(frame))


def _spectra(run: OpenCampaign, job: Job) -> dict[int, dict[tuple[int, int], tuple[float, float]]]:
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.bricks.validation.twins import summed_spectra

    path = existing_product(run.paths.spectra(*job.key), f"extract {run.file} {job.options}")
    table = ObjectTable.read(path)
    check_recipe(path, table.meta, run.recipe(job, "measure"))
    return summed_spectra(table)
