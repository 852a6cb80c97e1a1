"""What each command and each rule does: read the stage before, run, write, all through csstsim.io.

A stage refuses an input whose recorded recipe (digests of campaign, camera, layers and exposure) is not its
own, and gives its products that recipe on. Nothing appears under its name before it is complete.
"""

import numpy as np

from csstsim.errors import InputError
from csstsim.in_memory import Timer, blank, digitised, rendered, say_selected, selected, simulate
from csstsim.one_thread import one_thread
from csstsim.pages import explained
from csstsim.release import check_recipe


@one_thread
def select(run, job):
    """Find the objects that reach a job's window."""
    timer = Timer("select")
    table = selected(run, job)
    table.write(
        run.paths.stage(*job.key, "select.parquet"), table.meta | {"recipe": run.recipe(job), "stages": [timer.entry()]}
    )
    say_selected(table, print)


@explained("catalogue")
def check_catalog(run, say):
    """Open what the campaign draws from; try a catalogue of the user's on the first science job (catalog.contract)."""
    from csstsim.catalog.contract import check
    from csstsim.catalog.select import near, region_for

    source = run.open_truth()
    jobs = run.imaging_jobs or run.slitless_jobs
    if run.embedded or not jobs:
        return
    job = jobs[0]
    report = check(source, run.config.catalog.options, region_for(*job.footprint(), run.margin_deg(job)), run.camera)
    say(f"{run.config.catalog.kind}: {report}")
    reach = len(near(report.table, job.wcs, job.observer, job.window)[0])
    say(f"{reach} of them are near what chip {job.chip.id} sees in exposure {job.pointing.obsid}")
    if report.faults:
        raise InputError(
            f"the catalogue has {len(report.faults)} faults, the first: {report.faults[0]}", file=run.file,
            key="catalog.kind", value=run.config.catalog.kind,
        )  # fmt: skip


@one_thread
def render(run, job):
    """Run the layers of the render stage: expected electrons, counted electrons, drawn objects."""
    from csstsim.catalog.table import ObjectTable
    from csstsim.io.frames import save_frame

    timer, objects = Timer("render"), None
    if job.pointing.type == "SCIE":
        path = run.paths.stage(*job.key, "select.parquet")
        objects = ObjectTable.read(path)
        check_recipe(path, objects.meta, run.recipe(job))
    state = rendered(run, job, objects)
    planes = {"image": state.image, "counted": state.counted, "mask": state.mask}
    state.header["stages"] = [*(objects.meta["stages"] if objects is not None else []), timer.entry()]
    drawn = state.truth if state.truth is not None else ObjectTable.complete({})
    drawn.write(run.paths.stage(*job.key, "drawn.parquet"), drawn.meta | {"recipe": run.recipe(job)})
    if state.orders is not None:
        state.orders.write(run.paths.stage(*job.key, "orders.parquet"), {"recipe": run.recipe(job)})
    save_frame(run.paths.stage(*job.key, "render.fits"), planes, _meta(run, job, state))


@one_thread
def readout(run, job):
    """Run the layers of the readout stage: electrons to DN."""
    from csstsim.io.frames import save_frame

    timer = Timer("readout")
    state = run.steps[job.pointing.type].run(_state_before(run, job, "render"), "readout", run.config.seed)
    _save_cosmic(run, job, state)
    state.header.setdefault("stages", []).append(timer.entry())
    save_frame(
        run.paths.stage(*job.key, "readout.fits"), {"image": state.image, "mask": state.mask}, _meta(run, job, state)
    )


def _save_cosmic(run, job, state):
    """Write the electrons of cosmic rays alone (int32, the window's active pixels), if a layer left them to be written.

    They lie beside the Level-0 file; one of another layer list is removed.
    """
    from csstsim.io.frames import save_frame

    path = run.paths.level0_cosmic(job.pointing, job.chip.id)
    path.unlink(missing_ok=True)
    if state.cosmic_rays is None:
        return
    (pixel, electrons), plane = state.cosmic_rays, np.zeros(job.window.shape, np.int32)
    plane.reshape(-1)[pixel] = electrons
    save_frame(path, {"cosmic": plane}, {"recipe": run.recipe(job), "unit": "electron"})
    state.cosmic_rays = None


@one_thread
def level0(run, job):
    """Run the layers of the level0 stage and write the Level-0 file with its truth beside it."""
    from csstsim.catalog.table import ObjectTable

    timer = Timer("level0")
    state = _state_before(run, job, "readout")
    if run.has_stage(job.pointing, "render"):
        path = run.paths.stage(*job.key, "drawn.parquet")
        state.truth = ObjectTable.read(path)
        check_recipe(path, state.truth.meta, run.recipe(job))
    if run.has_orders(job):
        path = run.paths.stage(*job.key, "orders.parquet")
        state.orders = ObjectTable.read(path)
        check_recipe(path, state.orders.meta, run.recipe(job))
    _write(run, job, *digitised(run, job, state, timer))


def _write(run, job, state, provenance):
    """Write the Level-0 file with its truth, and that of orders, beside it."""
    from csstsim.catalog.table import ObjectTable
    from csstsim.io.level0 import write_level0
    from csstsim.io.orders import write_orders
    from csstsim.io.truth import electron_budget, write_truth

    path = run.paths.level0(job.pointing, job.chip.id)
    truth_path = run.paths.level0_truth(job.pointing, job.chip.id)
    drawn = state.truth if state.truth is not None else ObjectTable.complete({})
    about = {"recipe": run.recipe(job), "level0": path.name, "full_well": run.camera.detector.full_well}
    if run.steps[job.pointing.type].shipped:  # a layer of the user's own may bring charge that nothing counts
        about["electrons"] = electron_budget(state.header, job.window.nx * job.window.ny)
    write_truth(truth_path, drawn, job, about)
    if state.orders is not None:
        orders = {"recipe": run.recipe(job), "level0": path.name}
        write_orders(run.paths.level0_orders(job.pointing, job.chip.id), state.orders, orders)
    write_level0(path, state, run.camera.keywords, provenance)


@one_thread
def chip(run, job, say=print):
    """Run one job in memory, its missing truth bricks and PSF set made first, and write its Level-0 file and truth.

    Returns the State at the end.
    """
    state, provenance = simulate(run, job, say)
    timer = Timer("writing")
    _save_cosmic(run, job, state)
    _write(run, job, state, provenance)
    state.header["timing"] = provenance["timing"]
    for name, wall, cpu in [*provenance["stages"], timer.entry()]:
        say(f"{name}: {wall:.1f} s, {cpu:.1f} CPU-s")
    say(f"{run.paths.level0(job.pointing, job.chip.id)} and its truth table")
    return state


def _state_before(run, job, stage):
    """Return the state the given stage left on disk, or a blank one if this exposure has no such stage."""
    from csstsim.io.frames import load_frame

    state = blank(run, job)
    if run.has_stage(job.pointing, stage):
        path = run.paths.stage(*job.key, f"{stage}.fits")
        planes, meta = load_frame(path, {"stage": stage})
        check_recipe(path, meta, run.recipe(job))
        if "image" not in planes or not {"unit", "header"} <= meta.keys():
            raise InputError("damaged: a frame has the plane image, and unit and header in its record", file=path)
        state.image, state.counted, state.mask = planes["image"], planes.get("counted"), planes.get("mask", state.mask)
        state.unit, state.header = meta["unit"], meta["header"]
    return state


def _meta(run, job, state):
    stage = state.header["stages"][-1][0]
    frame = {"recipe": run.recipe(job), "stage": stage, "unit": state.unit, "header": state.header}
    return frame | {"exposure": _exposure(run, job)}


def _exposure(run, job):
    """Return what a frame is of, by the names that the Level-0 header will have, so that it can be shown alone."""
    pointing, window = job.pointing, job.window
    return job.wcs.header() | {
        "OBSID": pointing.obsid, "FILETYPE": pointing.type, "DETECTOR": f"{job.chip.id:02d}", "FILTER": job.chip.filter,
        "EXPTIME": pointing.exptime, "RA_OBJ": pointing.ra, "DEC_OBJ": pointing.dec, "POS_ANG0": pointing.pa,
        "POSKIND": "APPARENT", "FLDDIST": job.wcs.distortion is not None, "CAMHASH": run.camera.digest,
        "READX0": window.x0 + 1, "READX1": window.x1, "READY0": window.y0 + 1, "READY1": window.y1,
    }  # fmt: skip
