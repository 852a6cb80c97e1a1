"""Draw the objects of an imaging chip by the methods that render.policy chooses, and return their truth table.

Photons go to the plane `counted`, whole electrons with their Poisson noise. All other light goes to the plane of
expected electrons, whose Poisson noise is added once, in `poisson_and_dark`.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.counter import object_keys
from csstsim.render.drawn_table import DrawnTable
from csstsim.render.imaging.register import METHODS
from csstsim.render.method import Batch, Targets, names_of
from csstsim.render.parts.object_parts import part_keys
from csstsim.render.policy import choose
from csstsim.render.scene import make_scene

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray, IntArray
    from csstsim.catalog.table import ObjectTable
    from csstsim.instrument.chip import Window
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
    scene = make_scene(objects.take(rows), drawing.wcs, drawing.psf, drawing.exptime)
    out.flag_optics(scene.outside[: len(rows)], wing)
    assert scene.reach is not None  # select gives it
    scene = scene if wing is not None else scene.sized(scene.reach)
    choice = choose(Targets(scene, drawing, canvas.maximum), METHODS)
    assert drawing.key is not None
    keys = part_keys(object_keys_of(drawing.key, scene.ids[: len(rows)]), scene)
    of_row = rows if scene.parent is None else rows[scene.parent]
    electrons = scene.electrons.sum(axis=1)
    out.note_choice(of_row, choice, electrons)
    for method in METHODS:
        mine = np.flatnonzero(choice.method == method.code)
        if not mine.size:
            continue
        start = time.process_time()
        targets = Targets(scene.take(mine), drawing)
        rendered = method.draw(canvas, Batch(targets.scene, drawing, keys[mine]))
        at = of_row[mine]
        out.note(at, rendered.electrons, rendered.box)
        np.bitwise_or.at(out.flags, at, rendered.flags)
        if method.stamps:
            out.note_sides(at, targets.reach, targets.wing)
        ms = rendered.ms
        if ms is None:
            cost = method.cost(targets)
            ms = 1000 * (time.process_time() - start) * cost / cost.sum()
        np.add.at(out.ms, at, ms)
    out.name_methods(of_row, names_of(choice.method, METHODS), electrons)
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
