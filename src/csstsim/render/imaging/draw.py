"""Draw the objects of an imaging chip by the methods that render.policy chooses, and return their truth table.

Photons go to the plane `counted`, whole electrons with their Poisson noise. All other light goes to the plane of
expected electrons, whose Poisson noise is added once, in `poisson_and_dark`.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.counter import object_keys
from csstsim.catalog.flags import SKIPPED_FAINT
from csstsim.render import policy
from csstsim.render.drawn_table import DrawnTable
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.imaging.unresolved import add_unresolved
from csstsim.render.parts.object_parts import part_keys
from csstsim.render.scene import make_scene
from csstsim.render.settings import load_numbers

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray, IntArray
    from csstsim.catalog.table import ObjectTable
    from csstsim.instrument.chip import Window
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.render.canvas import Canvas
    from csstsim.render.drawing import Drawing
    from csstsim.render.scene import Scene


def draw_objects(canvas: Canvas, objects: ObjectTable, drawing: Drawing) -> ObjectTable:
    """Draw the objects of an imaging chip on a Canvas; return the table with what was rendered (render.drawn_table).

    objects: ObjectTable from catalog.selection.select; drawing: render.drawing.Drawing.
    """
    out = DrawnTable(objects, np.sum([objects[f"flux{i}"] for i in range(4)], axis=0) * drawing.exptime)
    rows = out.rows
    wing = drawing.wing
    scattered = drawing.scattered
    scene = make_scene(objects.take(rows), drawing.wcs, drawing.psf, drawing.exptime)
    out.flag_optics(scene.outside[: len(rows)], wing)
    assert scene.reach is not None  # select gives it
    scene = scene if wing is not None else scene.sized(scene.reach)
    choice = policy.choose(scene, drawing, canvas.maximum)
    assert drawing.key is not None
    keys = part_keys(object_keys_of(drawing.key, scene.ids[: len(rows)]), scene)
    of_row = rows if scene.parent is None else rows[scene.parent]
    electrons = scene.electrons.sum(axis=1)
    out.note_choice(of_row, choice, electrons)
    for kind in (policy.UNRESOLVED, policy.STAMP, policy.PHOTONS):
        mine = np.flatnonzero(choice.method == kind)
        if not mine.size:
            continue
        start = time.process_time()
        some = scene.take(mine)
        at = of_row[mine]
        if kind == policy.UNRESOLVED:
            light = some if wing is not None else _boxed(some, drawing.psf)
            out.note(at, *add_unresolved(canvas, light))
            out.flags[at] |= SKIPPED_FAINT
        elif kind == policy.STAMP:
            result = draw_scene(canvas, some, drawing.mixer, scattered, drawing.wcs.chip)
            out.note(at, result.drawn, result.box)
            np.add.at(out.ms, at, result.ms)
            np.bitwise_or.at(out.flags, at, result.flags)
            assert some.reach is not None and some.wing is not None
            out.note_sides(at, some.reach, some.wing)
        else:
            assert drawing.tables is not None
            canvas.count()
            shot = shoot_scene(canvas, some, keys[mine], drawing.tables, wing)
            out.note(at, shot.on_window, shot.box)
        if kind != policy.STAMP:
            work = policy.costs(some, some.electrons.sum(axis=1), load_numbers().cost).photons
            np.add.at(out.ms, at, 1000 * (time.process_time() - start) * work / work.sum())
    out.name_methods(of_row, policy.METHODS[choice.method], electrons)
    main = scene if scene.parent is None else scene.take(np.arange(len(rows)))
    out.miss(rows[(out.drawn[rows] == 0) & _misses(canvas.window, main, objects["wing"][rows])])
    return out.table()


def _misses(window: Window, scene: Scene, wing: FloatArray) -> BoolArray:
    """Whether the stamp and wing of each object miss the window; an object may have no electrons there by chance."""
    assert scene.reach is not None
    reach = np.maximum(scene.reach, wing) + 0.5
    return _beyond(scene.x, reach, window.x0, window.x1) | _beyond(scene.y, reach, window.y0, window.y1)


def _beyond(position: FloatArray, reach: FloatArray, first: int, last: int) -> BoolArray:
    """Whether positions and their reach (n,) lie beyond the pixels first..last (half-open) of an axis."""
    return (position + reach < first - 0.5) | (position - reach > last - 0.5)


def _boxed(scene: Scene, psf: PsfSet) -> Scene:
    """Return the Scene with only the light that falls within the PSF's box."""
    inside = np.einsum("nk,nkb->nb", scene.weight, np.where(scene.weight[..., None] > 0, psf.flux[scene.node], 0.0))
    return replace(scene, electrons=scene.electrons * inside)


def object_keys_of(base: np.uint64, ids: IntArray) -> IntArray:
    """Return a key for each object, from its id and, for repeated ids, the position among the objects of that id."""
    order = np.argsort(ids, kind="stable")
    first = np.r_[True, np.diff(ids[order]) != 0]
    rank = np.arange(len(ids))
    again = np.empty(len(ids), np.int64)
    again[order] = rank - np.maximum.accumulate(np.where(first, rank, 0))
    keys = object_keys(base, ids)
    for i in np.flatnonzero(again):
        keys[i] = object_keys(~keys[i], again[i : i + 1])[0]  # ~: the first object uses the words of the key itself
    return keys
