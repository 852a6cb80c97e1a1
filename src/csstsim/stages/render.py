"""Render: objects and sky, as expected and as counted electrons."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.digest import digest
from csstsim.base.process.one_thread import one_thread
from csstsim.base.release import check_recipe
from csstsim.simulation.state import State
from csstsim.stages.parts.rerendered import rerendered
from csstsim.stages.parts.stage_frames import Timer, frame_meta
from csstsim.stages.psf import open_psf

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.base.types import IntArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.light.object_spectra import Spectra
    from csstsim.catalog.table import ObjectTable
    from csstsim.simulation.exposure import Exposure


@one_thread
def render(run: OpenCampaign, job: Job) -> None:
    """Run the layers of the render stage: expected electrons, counted electrons, table of rendered objects."""
    from csstsim.catalog.table import ObjectTable
    from csstsim.io.frames import save_frame

    timer = Timer("render")
    objects = None
    if job.pointing.type == "SCIE":
        path = run.paths.stage(*job.key, "select.parquet")
        objects = ObjectTable.read(path)
        check_recipe(path, objects.meta, run.recipe(job, "select"))
    state = rerendered(run, job, objects) if objects is not None else None
    if state is None:
        state = rendered(run, job.exposure, objects, run.streams(job))
    else:
        _finished(run, job.exposure, state)
    planes = {"image": state.image, "counted": state.counted, "mask": _marked(state.mask)}
    state.header["stages"] = [*(objects.meta["stages"] if objects is not None else []), timer.entry()]
    rendered_objects = state.truth if state.truth is not None else ObjectTable.complete({}, run.camera.bands)
    recipe = {"recipe": run.recipe(job, "render")}
    rendered_objects.write(run.paths.stage(*job.key, "drawn.parquet"), rendered_objects.meta | recipe)
    if state.orders is not None:
        state.orders.write(run.paths.stage(*job.key, "orders.parquet"), recipe)
    path = run.paths.stage(*job.key, "render.fits")
    save_frame(path, planes, frame_meta(run, job, state), sparse=("counted",))


def _marked(mask: IntArray | None) -> IntArray | None:
    """Return a truth mask if any of its bits is set, else None: the rendered file must not depend on the detector."""
    return mask if mask is not None and mask.any() else None


def rendered(run: OpenCampaign, exposure: Exposure, objects: ObjectTable | None, rng: Streams) -> State:
    """Return the State of an Exposure after the render stage.

    objects: of stages.select.selected; None except for science exposures. rng: the job's rng.Streams.
    """
    state = State.blank(exposure, objects)
    chip = exposure.chip
    if exposure.pointing.type == "SCIE":
        assert objects is not None  # from stages.select.selected
        state.psf = open_psf(run, chip)
        if exposure.fidelity != "reference":
            from csstsim.render.psf_table import read_tables

            state.tables = read_tables(run.paths.psf_tables(chip.id), state.psf)
        state.header["truth_hash"] = objects.meta["truth_hash"]
        state.header["psf_hash"] = digest(state.psf.attributes)
        state.spectra = object_spectra(run, exposure, objects)
    state = run.steps[exposure.pointing.type].run(state, "render", rng)
    return _finished(run, exposure, state)


def _finished(run: OpenCampaign, exposure: Exposure, state: State) -> State:
    """Return the State with the flags of saturated objects and the total electrons of its light."""
    if state.truth is not None and exposure.chip.kind == "imaging":
        from csstsim.render.imaging.saturated import flag_saturated

        full_well = run.camera.detector.full_well
        state.truth = flag_saturated(state.truth, state.image, state.counted, exposure.window, full_well)
    state.header["light_electrons"] = state.electrons()
    state.forget()
    return state


def object_spectra(run: OpenCampaign, exposure: Exposure | Job, objects: ObjectTable) -> Spectra | None:
    """Return the catalog.light.object_spectra.Spectra of a slitless chip's objects, None for an imaging chip's."""
    if exposure.chip.kind != "slitless":
        return None
    from csstsim.catalog.light.object_spectra import catalog_spectra, embedded_spectra

    if run.embedded:
        return embedded_spectra(objects, run.universe, run.config.catalog.components == "full")
    from csstsim.catalog.open import open_catalog

    return catalog_spectra(objects, open_catalog(run.catalog, run.region(exposure), run.paths.truth, {}))
