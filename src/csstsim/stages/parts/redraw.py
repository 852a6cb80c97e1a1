"""The light of a chip made from that of a variant's base, if only some objects differ: theirs is taken off or added.

Objects that are drawn as photons are counted in whole electrons, with random numbers of their own, and each photon is
lost or kept by itself. Whole numbers add up to the same sum in any order. So the light has the bits of a full run.
Light of stamps, wings, ghosts and of objects below the floor is added to floats object by object. The last bit of such
a sum depends on its order, that of wings and of objects below the floor on all others of the chip. If such light
differs, None is returned, and the chip is drawn in full.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.plural import number_of
from csstsim.base.release import check_recipe
from csstsim.catalog.flags import SATURATED
from csstsim.io.paths import RENDER_PRODUCTS
from csstsim.render.drawn_table import ADDED
from csstsim.simulation.state import State
from csstsim.stages.parts.stage_frames import state_before
from csstsim.stages.psf import open_psf

if TYPE_CHECKING:
    from collections.abc import Callable

    from csstsim.base.types import IntArray
    from csstsim.campaign.job import Job
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.catalog.table import ObjectTable

PHOTONS = "photons"  # render.policy
SOURCES = "scie_obs", "sky_background", "prnu_effect"  # layers after which the planes of objects can be told apart
ROW = "catalog_row"  # differs with the table's rows, and decides nothing


def may_redraw(run: OpenCampaign, job: Job) -> bool:
    """Whether a variant's job differs from one of its base in nothing but objects, if in anything."""
    if run.base is None or job.chip.kind != "imaging" or run.config.fidelity in ("noise_free", "reference"):
        return False
    try:
        theirs = run.base.job(*job.key)
    except InputError:  # not one of its jobs
        return False
    if theirs.digest != job.digest:
        return False
    steps = run.steps[job.pointing.type]
    own = {step.name for step in steps.stage("render")} - set(SOURCES)
    kind = job.pointing.type, job.chip
    return not own and run.recipes.but_objects(*kind) == run.base.recipes.but_objects(*kind)


def redrawn(run: OpenCampaign, job: Job, objects: ObjectTable, say: Callable[[str], object] = print) -> State | None:
    """Return the State of a variant's job after the render stage, or None if it must be drawn in full.

    objects: as stages.select.selected gives them. The header's `objects_electrons`, a sum of floats, may differ from a
    full run's in its last bit. Raises InputError for light of the base that is of another campaign.
    """
    from csstsim.catalog.table import ObjectTable

    base = run.base
    files = [base.paths.stage(*job.key, name) for name in RENDER_PRODUCTS[:2]] if base and may_redraw(run, job) else []
    if base is None or not files or not all(path.is_file() for path in files):
        return None
    theirs = base.job(*job.key)
    drawn = ObjectTable.read(files[1])
    check_recipe(files[1], drawn.meta, base.recipe(theirs, "render"))
    rows = _same_rows(objects, drawn)
    if rows is None:
        return None
    new = np.flatnonzero(rows < 0)
    gone = np.setdiff1d(np.arange(len(drawn)), rows)
    added = _shot(run, job, objects.take(new))
    taken = _shot(run, job, _as_selected(drawn.take(gone), objects))
    if added is None or taken is None:
        return None
    state = state_before(base, theirs, "render")
    counted = np.zeros(state.image.shape, np.int32) if state.counted is None else state.counted
    truth = _joined(drawn, rows, added.truth, new, objects)
    if not (truth["method"] == PHOTONS).any():
        return None  # a full run has no plane of counted electrons
    difference = [0 if one.counted is None else one.counted for one in (added, taken)]
    state.counted = counted + difference[0] - difference[1]
    state.truth, state.header = truth, dict(state.header) | {"truth_hash": objects.meta["truth_hash"]}
    state.header["objects_electrons"] += float(state.counted.sum(dtype=np.int64) - counted.sum(dtype=np.int64))
    say(f"the base's light, with {number_of(len(new), 'object')} added and {len(gone)} taken off")
    return state


def _same_rows(objects: ObjectTable, drawn: ObjectTable) -> IntArray | None:
    """Return (n,) rows of equal objects in the base's table, -1 for others; None if the tables cannot be compared."""
    names = [name for name in objects.names if name not in (ROW, "flags")]
    if set(names) != set(drawn.names) - {ROW, "flags", *ADDED} or "image_file" in names:
        return None  # a column of one table alone may be a profile's
    ids = objects["id"]
    old = drawn["id"]
    if len(np.unique(ids)) < len(ids) or len(np.unique(old)) < len(old):
        return None  # random numbers of equal ids depend on their order
    order = np.argsort(old)
    at = order[np.minimum(np.searchsorted(old, ids, sorter=order), len(old) - 1)] if len(old) else None
    if at is None:
        return np.full(len(ids), -1)
    same = old[at] == ids
    for name in names:
        ours = objects[name]
        other = drawn[name][at]
        same &= (ours == other) | ((ours != ours) & (other != other))
    return np.where(same, at, -1)


def _as_selected(drawn: ObjectTable, objects: ObjectTable) -> ObjectTable:
    """Return rows of the base's drawn table with the columns of a table of selected objects."""
    return type(drawn)({name: drawn[name] for name in objects.names if name in drawn.names}, objects.meta)


def _shot(run: OpenCampaign, job: Job, objects: ObjectTable) -> State | None:
    """Return the State of some objects drawn alone, or None if not all of their light is photons."""
    state = State.blank(replace(job.exposure, mask=False), objects)
    if not len(objects):
        state.truth = None
        return state
    from csstsim.render.psf_table import read_tables

    state.psf = open_psf(run, job.chip)
    state.tables = read_tables(run.paths.psf_tables(job.chip.id), state.psf)
    step = run.steps[job.pointing.type].step("scie_obs")
    assert step is not None  # it draws objects
    state = step.module.apply(state, step.param, run.streams(job).layer(step.name))
    return None if state.image.any() else state


def _joined(
    drawn: ObjectTable, rows: IntArray, added: ObjectTable | None, new: IntArray, objects: ObjectTable
) -> ObjectTable:
    """Return the drawn table of all objects, in their order, before saturation is flagged."""
    columns = {}
    for name in drawn.names:
        first = drawn[name][np.maximum(rows, 0)].copy() if len(drawn) else np.zeros(len(rows), drawn[name].dtype)
        if len(new):
            assert added is not None  # they were drawn
            first = first.astype(np.result_type(first.dtype, added[name].dtype)) if first.dtype.kind in "US" else first
            first[new] = added[name]
        columns[name] = objects[name] if name == ROW else first
    columns["flags"] = columns["flags"] & ~np.array(SATURATED, columns["flags"].dtype)
    return type(drawn)(columns, objects.meta)
