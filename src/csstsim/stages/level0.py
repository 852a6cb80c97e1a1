"""Level0: digitises the DN, and writes the Level-0 file and its truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.process.one_thread import one_thread
from csstsim.base.release import check_recipe, check_release
from csstsim.io.paths import existing_product
from csstsim.stages.parts.shared import copied
from csstsim.stages.parts.stage_frames import Timer, state_before

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable
    from csstsim.io.level0 import Level0
    from csstsim.simulation.state import State

MADE_WITH = {
    "campaign": "another seed, catalogue or PSF",
    "camera": "another camera",
    "layers": "other layers",
    "exposure": "another row of the survey table",
}


@one_thread
def level0(run: OpenCampaign, job: Job) -> None:
    """Run the layers of the level0 stage and write the Level-0 file and its truth."""
    from csstsim.catalog.table import ObjectTable

    if copied(run.base_files(job, "level0")):
        return
    timer = Timer("level0")
    state = state_before(run, job, "readout")
    if run.has_stage(job.pointing, "render"):
        path = run.paths.stage(*job.key, "drawn.parquet")
        state.truth = ObjectTable.read(path)
        check_recipe(path, state.truth.meta, run.recipe(job, "render"))
    if run.has_orders(job):
        path = run.paths.stage(*job.key, "orders.parquet")
        state.orders = ObjectTable.read(path)
        check_recipe(path, state.orders.meta, run.recipe(job, "render"))
    write_products(run, job, *digitised(run, job, state, timer))


def digitised(run: OpenCampaign, job: Job, state: State, timer: Timer) -> tuple[State, dict[str, Any]]:
    """Return the State after the level0 stage and its provenance (io.keywords.header_values)."""
    from csstsim.detector.adc import clipping_fault, full_fault
    from csstsim.optics.sky.bodies import angles_at_ends
    from csstsim.optics.throughput import shutter

    steps = run.steps[job.pointing.type]
    state = steps.run(state, "level0", run.streams(job))
    if steps.losses.shutter:
        state.header |= shutter.moments(job.pointing.mjd, job.pointing.exptime, state.telescope)
    state.header |= angles_at_ends(job.pointing)
    low, high = (state.header.get(name, 0) for name in ("clipped_low", "clipped_high"))
    for fault in (clipping_fault(low, state.image.size), full_fault(high, state.image.size)):
        if fault:
            print(f"warning: {fault}")
    state.header.setdefault("stages", []).append(timer.entry())
    provenance = {
        "obsid": job.obsid,
        "filename": run.paths.level0(job).stem,
        "recipe": run.recipe(job),
        "seed": run.config.seed,
        "campaign_name": run.config.name,
        **run.config.astrometry.model_dump(),
        "layers": steps.describe(),
        "truth_hash": state.header.pop("truth_hash", "none"),
        "psf_hash": state.header.pop("psf_hash", "none"),
        "camera": run.camera.files.changes | job.chip.maps.record,
        "stages": state.header.pop("stages"),
        "timing": state.header.pop("timing", []),
    }
    return state, provenance


def write_products(run: OpenCampaign, job: Job, state: State, provenance: Mapping[str, Any]) -> None:
    """Write the Level-0 file, its truth table, and the truth table of orders if there is one."""
    from csstsim.catalog.table import ObjectTable
    from csstsim.io.cat import write_cat
    from csstsim.io.level0_writing import write_level0
    from csstsim.io.orders import write_orders
    from csstsim.io.truth import electron_budget, truth_table

    path = run.paths.level0(job)
    rendered = state.truth if state.truth is not None else ObjectTable.complete({}, run.camera.bands)
    about: dict[str, Any] = {"recipe": run.recipe(job), "level0": path.name, "full_well": run.camera.detector.full_well}
    if run.steps[job.pointing.type].shipped:  # a user's layer may add charge that is not accounted for
        about["electrons"] = electron_budget(state.header, job.window.nx * job.window.ny)
    table = truth_table(rendered, job.chip)
    table.write(run.paths.level0_truth(job), about)
    if "cat" in run.config.truth:
        for text in {run.paths.level0_cat(job), run.paths.level0_catalogue(job)}:
            write_cat(text, table)
    if state.orders is not None:
        orders: dict[str, Any] = {"recipe": run.recipe(job), "level0": path.name}
        write_orders(run.paths.level0_orders(job), state.orders, orders)
    write_level0(path, state, run.camera.keywords, provenance)


def truth_of(run: OpenCampaign, job: Job) -> ObjectTable:
    """Return the truth table of a job's Level-0 file (io.truth.read_truth). Raises InputError."""
    from csstsim.io.truth import read_truth

    path = existing_product(run.paths.level0_truth(job), f"chip {run.file} {job.options}")
    table = read_truth(path)
    check_recipe(path, table.meta, run.recipe(job))
    return table


def own_level0(run: OpenCampaign, job: Job) -> Level0:
    """Return the io.level0.Level0 of a job. Raises InputError for a file of another campaign or release."""
    from csstsim.io.keywords import RECIPE
    from csstsim.io.level0 import read_level0

    path = run.paths.level0(job)
    recipe = run.recipe(job)
    existing_product(path, f"chip {run.file} {job.options}")
    file = read_level0(path, verify=True)
    check_release(path, file.header0.get("SIMVER"))
    for name, keyword in RECIPE.items():
        if file.header0.get(keyword) != recipe[name]:
            raise InputError(
                f"made with {MADE_WITH[name]} than now: undo the change, or make the file again",
                file=path,
                key=keyword,
                value=file.header0.get(keyword),
                allowed=recipe[name],
            )
    return file
