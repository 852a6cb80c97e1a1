"""Validate: comparison of a merged brick with the truth of the frames on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim import __version__
from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.process.one_thread import one_thread
from csstsim.base.process.progress import progress
from csstsim.base.release import check_recipe
from csstsim.base.shipped import SHIPPED
from csstsim.io.paths import existing_product
from csstsim.stages.level0 import truth_of
from csstsim.stages.measure import measured_table
from csstsim.stages.merge import jobs_on
from csstsim.stages.parts.catalogue_counts import brick_objects
from csstsim.stages.parts.frame_facts import frame_facts

if TYPE_CHECKING:
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign

LIMITS = SHIPPED / "limits.yaml"
LIMIT_SECONDS = 150.0  # of the limiting magnitudes there and in filters.yaml


@one_thread
def validate(run: OpenCampaign, pix: int) -> None:
    """Compare a merged brick with the truth of the frames on it."""
    from csstsim.base.files.atomic import atomic_path
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.bricks.validation.gates.register import gate_named
    from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame
    from csstsim.measure.bricks.validation.result_file import write_result
    from csstsim.measure.bricks.validation.validate import validate_brick
    from csstsim.measure.bricks.validation.verdict import NAMES, sentence
    from csstsim.measure.bricks.validation.whole_objects import whole_objects
    from csstsim.report.figures import brick_figure
    from csstsim.report.style import band_styles

    camera = run.camera
    objects = brick_objects(run, pix)
    frames = (
        MeasuredFrame(
            whole_objects(truth_of(run, job)),
            measured_table(run, job),
            camera.detector.channel_ny,
            camera.telescope.pixel_scale,
            _depth(run, job),
            frame_facts(run, job, objects),
        )
        for job in progress(jobs_on(run, pix), "frames")
    )
    merged = ObjectTable.read(existing_product(run.paths.merge(pix), f"merge {run.file} --brick {pix}"))
    check_recipe(run.paths.merge(pix), merged.meta, run.brick_recipe(pix))
    result, arrays = validate_brick(pix, merged, frames, camera.bands, run.limits, objects.laws() if objects else None)
    result |= {
        "csstsim": __version__,
        "recipe": run.brick_recipe(pix),
        "camera": run.recipes.validation["camera"],
        "limits": run.limits.model_dump(mode="json"),
    }
    path = run.paths.validate(pix)
    figure = brick_figure(
        result,
        arrays,
        band_styles(camera.filters),
        threshold=gate_named("completeness").threshold_in(run.limits),
        snr_min=run.limits.snr_min,
    )
    with atomic_path(path.with_suffix(".png")) as temporary:
        temporary.write_bytes(figure)
    write_result(path, result)
    for gate in result["gates"]:
        sources = "" if gate["n"] is None else f", {gate['n']} sources"
        allowed = "" if gate["margin"] is None else f", {gate['margin']:.2f} of the maximum allowed with chance"
        print(f"{NAMES[gate['passed']]}: {sentence({'brick': pix, **gate})}{sources}{allowed}")


def _depth(run: OpenCampaign, job: Job) -> tuple[float, float]:
    """Return (low, high): the published 5-sigma magnitudes of the filter, scaled to the exposure time.

    A camera other than the shipped one has only those of its filters.yaml.
    """
    camera = run.camera
    name = job.chip.filter
    computed = read_yaml(LIMITS)["computed"]["values"] if camera.shipped else {}
    stated = camera.filters[name].limiting_mag
    values = np.sort([stated, computed.get(name, stated)]) + 1.25 * np.log10(job.pointing.exptime / LIMIT_SECONDS)
    return values[0], values[1]
