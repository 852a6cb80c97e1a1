"""A job in memory, stage by stage: nothing is read or written but the truth bricks and PSF sets that jobs share."""

import time

import numpy as np

from csstsim.config import digest
from csstsim.one_thread import one_thread
from csstsim.prepare import missing_bricks, missing_psf, open_psf, psf_box
from csstsim.state import State


class Timer:
    """Wall and CPU seconds of a stage, for the provenance of its product."""

    def __init__(self, stage):
        self.stage, self.wall, self.cpu = stage, time.perf_counter(), time.process_time()

    def entry(self):
        """Return [stage, wall s, CPU s] since it began."""
        return [self.stage, time.perf_counter() - self.wall, time.process_time() - self.cpu]


@one_thread
def simulate(run, job, say=print):
    """Run one job in memory, its missing truth bricks and PSF set made first.

    Returns its State at the end (image: DN, uint16, the window's readout frame) and its provenance, from which
    io.level0 makes the header.
    """
    state, timer = light(run, job, say), Timer("readout")
    state = run.steps[job.pointing.type].run(state, "readout", run.config.seed)
    state.header["stages"].append(timer.entry())
    return digitised(run, job, state, Timer("level0"))


@one_thread
def light(run, job, say=print):
    """Return the State of a job after the render stage: expected and counted electrons of objects and sky, truth.

    Missing truth bricks and a missing PSF set are made first.
    """
    from csstsim.catalog.table import ObjectTable

    header, objects = {"stages": []}, None
    if job.pointing.type == "SCIE":
        missing_bricks(run, job, say)
        timer = Timer("select")
        objects = selected(run, job)
        header["stages"].append(timer.entry())
        say_selected(objects, say)
        missing_psf(run, job, say)  # after the catalogue of the user's, which may not open
    timer = Timer("render")
    state = rendered(run, job, objects)
    state.header |= header
    if run.has_stage(job.pointing, "render"):
        header["stages"].append(timer.entry())
    if state.truth is None:
        state.truth = ObjectTable.complete({})
    return state


def selected(run, job):
    """Return the ObjectTable of what reaches a job's window (catalog.select)."""
    from csstsim.catalog.open import open_catalog
    from csstsim.catalog.select import Noise, region_for, select_objects
    from csstsim.optics.beyond import beyond_box

    config, camera, exptime = run.config.catalog, run.camera, job.pointing.exptime
    filter_, detector = camera.filters[job.chip.filter], camera.detector
    key = run.universe_key() if run.embedded else {}
    catalog = open_catalog(config, region_for(*job.footprint(), run.margin_deg(job)), run.paths.truth, key)
    noise = Noise(filter_.sky, detector.dark, detector.read_noise)
    return select_objects(
        catalog, job.wcs, job.observer, job.window, filter_, camera.telescope, exptime, noise, config.mag_limit,
        rotated=config.shapes == "rotated90", beyond=beyond_box(camera, filter_), box=psf_box(run, job.chip),
        disperser=run.disperser(job),
    )  # fmt: skip


def say_selected(table, say):
    """Say how many objects reach the window, and how many of them will not be drawn, and why."""
    from csstsim.catalog.flags import BAD_VALUE, STRONG_LENSING
    from csstsim.catalog.usable import why_not_drawn

    say(f"{len(table)} objects reach the window; left out: {table.meta['dropped']}")
    for reason, count in why_not_drawn(table, table["flags"] & (BAD_VALUE | STRONG_LENSING)).items():
        say(f"{count} not drawn: {reason}")


def object_spectra(run, job, objects):
    """Return the catalog.spectra.Spectra of a slitless chip's objects, None for an imaging chip's."""
    if job.chip.kind != "slitless":
        return None
    from csstsim.catalog.spectra import catalog_spectra, embedded_spectra

    if run.embedded:
        return embedded_spectra(objects, run.universe)
    from csstsim.catalog.open import open_catalog
    from csstsim.catalog.select import region_for

    region = region_for(*job.footprint(), run.margin_deg(job))
    return catalog_spectra(objects, open_catalog(run.config.catalog, region, run.paths.truth, {}))


def blank(run, job, objects=None):
    """Return the State of a job that no layer has touched: no light, and all that layers look up."""
    camera = run.camera
    mask = np.zeros(job.window.shape, np.uint8) if run.steps[job.pointing.type].mask else None
    return State(
        chip=job.chip, filter=camera.filters[job.chip.filter], telescope=camera.telescope, pointing=job.pointing,
        catalog=objects, window=job.window, wcs=job.wcs, image=np.zeros(job.window.shape, np.float32), mask=mask,
        sky=camera.sky, leds=camera.leds, prnu=run.steps[job.pointing.type].losses["prnu"],
        gratings=camera.gratings[job.chip.id] if job.chip.kind == "slitless" and job.pointing.type == "SCIE" else None,
    )  # fmt: skip


def rendered(run, job, objects):
    """Return the State after the render stage. objects: as `selected` gives them; None but for science exposures."""
    state = blank(run, job, objects)
    if job.pointing.type == "SCIE":
        state.psf, state.fidelity = open_psf(run, job.chip), run.config.fidelity
        if state.fidelity != "reference":
            from csstsim.render.psf_table import read_tables

            state.tables = read_tables(run.paths.psf_tables(job.chip.id), state.psf)
        state.header["truth_hash"] = objects.meta["truth_hash"]
        state.header["psf_hash"] = digest(state.psf.attributes)
        state.spectra = object_spectra(run, job, objects)
    state = run.steps[job.pointing.type].run(state, "render", run.config.seed)
    state.header["light_electrons"] = state.electrons()
    state.forget()
    return state


def digitised(run, job, state, timer):
    """Return the State after the level0 stage and its provenance (io.keywords.header_values)."""
    from csstsim.optics import shutter

    steps = run.steps[job.pointing.type]
    state = steps.run(state, "level0", run.config.seed)
    if steps.losses["shutter"]:
        state.header |= shutter.moments(job.pointing, state.telescope)
    state.header.setdefault("stages", []).append(timer.entry())
    provenance = {
        "recipe": run.recipe(job),
        "seed": run.config.seed,
        "campaign_name": run.config.name,
        **run.config.astrometry.model_dump(),
        "layers": steps.describe(),
        "truth_hash": state.header.pop("truth_hash", "none"),
        "psf_hash": state.header.pop("psf_hash", "none"),
        "stages": state.header.pop("stages"),
        "timing": state.header.pop("timing", []),
    }
    return state, provenance
