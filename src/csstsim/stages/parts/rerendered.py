"""The light of a chip computed from that of a variant's base, if only objects differ: they are subtracted or added.

Objects rendered as photons are counted in whole electrons, with separate random numbers, and each photon is lost or
counted independently. A sum of whole numbers does not depend on their order, so the light has the bits of a full run.
Light of stamps, wings, ghosts and objects below the floor is added as floats, object by object. The last bit of such a
sum depends on the order; that of wings and of objects below the floor depends on all other objects of the chip. If such
light differs, None is returned, and the chip is rendered in full.
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

PHOTONS = "photons"  # render.imaging.methods.photons
SOURCES = "scie_obs", "sky_background", "prnu_effect"  # layers that leave the objects' light in separate planes
ROW = "catalog_row"  # differs with the table's rows, without effect on the light


def may_rerender(run: OpenCampaign, job: Job) -> bool:
    """Whether a variant's job may differ from that of its base in objects only."""
    if run.base is None or job.chip.kind != "imaging" or run.config.fidelity in ("noise_free", "reference"):
        return False
    try:
        base_job = run.base.job(*job.key)
    except InputError:  # not one of its jobs
        return False
    if base_job.digest != job.digest:
        return False
    steps = run.steps[job.pointing.type]
    added_layers = {step.name for step in steps.stage("render")} - set(SOURCES)
    kind = job.pointing.type, job.chip
    return not added_layers and run.recipes.without_objects(*kind) == run.base.recipes.without_objects(*kind)


def rerendered(run: OpenCampaign, job: Job, objects: ObjectTable, log: Callable[[str], object] = print) -> State | None:
    """Return the State of a variant's job after the render stage, or None if it must be rendered in full.

    objects: of stages.select.selected. The header's `objects_electrons`, a sum of floats, may differ from that of a
    full run in its last bit. Raises InputError if the light of the base belongs to another campaign.
    """
    from csstsim.catalog.table import ObjectTable

    base = run.base
    if base is None or not may_rerender(run, job):
        return None
    files = [base.paths.stage(*job.key, name) for name in RENDER_PRODUCTS[:2]]
    if not all(path.is_file() for path in files):
        return None
    base_job = base.job(*job.key)
    base_table = ObjectTable.read(files[1])
    check_recipe(files[1], base_table.meta, base.recipe(base_job, "render"))
    rows = _same_rows(objects, base_table)
    if rows is None:
        return None
    new = np.flatnonzero(rows < 0)
    removed = np.setdiff1d(np.arange(len(base_table)), rows)
    added = _photons_of(run, job, objects.take(new))
    subtracted = _photons_of(run, job, _as_selected(base_table.take(removed), objects))
    if added is None or subtracted is None:
        return None
    state = state_before(base, base_job, "render")
    counted = np.zeros(state.image.shape, np.int32) if state.counted is None else state.counted
    truth = _merged_table(base_table, rows, added.truth, new, objects)
    if not (truth["method"] == PHOTONS).any():
        return None  # a full run has no plane of counted electrons
    difference = [0 if one.counted is None else one.counted for one in (added, subtracted)]
    state.counted = counted + difference[0] - difference[1]
    state.truth, state.header = truth, dict(state.header) | {"truth_hash": objects.meta["truth_hash"]}
    state.header["objects_electrons"] += float(state.counted.sum(dtype=np.int64) - counted.sum(dtype=np.int64))
    log(f"light of the base, with {number_of(len(new), 'object')} added and {len(removed)} subtracted")
    return state


def _same_rows(objects: ObjectTable, base_table: ObjectTable) -> IntArray | None:
    """Return (n,): row of the equal object in the base's table, -1 without one; None: the tables are not comparable."""
    names = [name for name in objects.names if name not in (ROW, "flags")]
    if set(names) != set(base_table.names) - {ROW, "flags", *ADDED} or "image_file" in names:
        return None  # a column of one table alone may be a profile's
    ids = objects["id"]
    base_ids = base_table["id"]
    if len(np.unique(ids)) < len(ids) or len(np.unique(base_ids)) < len(base_ids):
        return None  # random numbers of equal ids depend on their order
    order = np.argsort(base_ids)
    if not len(base_ids):
        return np.full(len(ids), -1)
    base_row = order[np.minimum(np.searchsorted(base_ids, ids, sorter=order), len(base_ids) - 1)]
    same = base_ids[base_row] == ids
    for name in names:
        column = objects[name]
        base_column = base_table[name][base_row]
        same &= (column == base_column) | ((column != column) & (base_column != base_column))
    return np.where(same, base_row, -1)


def _as_selected(base_table: ObjectTable, objects: ObjectTable) -> ObjectTable:
    """Return rows of the base's table of rendered objects with the columns of a table of selected objects."""
    columns = {name: base_table[name] for name in objects.names if name in base_table.names}
    return type(base_table)(columns, objects.meta)


def _photons_of(run: OpenCampaign, job: Job, objects: ObjectTable) -> State | None:
    """Return the State of objects rendered alone, or None if not all of their light is photons."""
    state = State.blank(replace(job.exposure, mask=False), objects)
    if not len(objects):
        state.truth = None
        return state
    from csstsim.render.psf_table import read_tables

    state.psf = open_psf(run, job.chip)
    state.tables = read_tables(run.paths.psf_tables(job.chip.id), state.psf)
    step = run.steps[job.pointing.type].step("scie_obs")
    assert step is not None  # it renders objects
    state = step.module.apply(state, step.param, run.streams(job).layer(step.name))
    return None if state.image.any() else state


def _merged_table(
    base_table: ObjectTable, rows: IntArray, added: ObjectTable | None, new: IntArray, objects: ObjectTable
) -> ObjectTable:
    """Return the table of all rendered objects, in the order of `objects`, before saturation is flagged."""
    columns = {}
    for name in base_table.names:
        old = base_table[name]
        column = old[np.maximum(rows, 0)].copy() if len(base_table) else np.zeros(len(rows), old.dtype)
        if len(new):
            assert added is not None  # they were rendered
            if column.dtype.kind in "US":
                column = column.astype(np.result_type(column.dtype, added[name].dtype))
            column[new] = added[name]
        columns[name] = objects[name] if name == ROW else column
    columns["flags"] = columns["flags"] & ~np.array(SATURATED, columns["flags"].dtype)
    return type(base_table)(columns, objects.meta)
