"""Draw the objects of a spectroscopic chip: as render.imaging.draw, with the light dispersed by the gratings.

The method (render.policy) is chosen from the first order's electrons over the pixels that a spectrum covers. Objects
are rendered in chunks, because all spectra together would not fit in memory. Truth has one table of objects, as on
imaging chips, and one of orders.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.counter import word
from csstsim.base.process.progress import progress
from csstsim.catalog.flags import BAD_VALUE
from csstsim.catalog.table import ObjectTable
from csstsim.render.drawn_table import DrawnTable
from csstsim.render.imaging.draw import object_keys_of
from csstsim.render.method import NOT_RENDERED, SpectraBatch, SpectraMethod, Targets, names_of
from csstsim.render.parts.object_parts import part_keys
from csstsim.render.policy import choose_dispersed
from csstsim.render.scene import make_scene
from csstsim.render.slitless.register import METHODS
from csstsim.render.slitless.traces import Traces

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from csstsim.base.types import BoolArray, FloatArray, IntArray
    from csstsim.instrument.chip import Window
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.render.canvas import Canvas
    from csstsim.render.drawing import Drawing
    from csstsim.render.method import Method
    from csstsim.render.policy import Choice
    from csstsim.render.scene import Scene

FAINTEST = 1.0  # electron: an order with fewer, and none drawn, has no row in the table of orders
_LANES = 8  # sums side by side, which the compiler puts into one register
_STRIP = 64  # px: objects are rendered strip by strip, so that their pixels stay in cache


def draw_dispersed(
    canvas: Canvas,
    objects: ObjectTable,
    spectra: Callable[[IntArray, FloatArray], FloatArray],
    disperser: Disperser,
    drawing: Drawing,
) -> tuple[ObjectTable, ObjectTable]:
    """Draw the objects of a spectroscopic chip on a Canvas; return (table with what was rendered, table of orders).

    Arguments as in render.imaging.draw.draw_objects; spectra: catalog.light.object_spectra.Spectra of `objects`;
    disperser: optics.gratings.dispersion.Disperser. Column `electrons` is the sum of all orders, `method` is photons or
    slabs. The table of orders (columns: io.orders) has a row for each object, piece and order whose light may reach
    the window.
    """
    job = DispersedJob(objects, disperser, drawing)
    scene = job.scene
    visits = job.visits
    result = job.result
    choice = choose_dispersed(Targets(scene, drawing, canvas.maximum, disperser), METHODS)
    assert drawing.key is not None and choice.allowed is not None
    keys = part_keys(object_keys_of(drawing.key, scene.ids[: job.count]), scene)
    visit_keys = _visit_keys(keys, visits)
    for chunk in progress(_chunks(scene, choice, disperser), "spectra"):
        at, chunk_visits = _visits_of(chunk.rows, visits, len(scene))
        densities = _photon_densities(job, choice, chunk, spectra)
        result.nominal(at, chunk_visits, densities, chunk.disperser.rates)
        start = time.process_time()
        traces = Traces(densities, chunk_visits, chunk.disperser)
        batch = SpectraBatch(scene.take(chunk.rows), drawing, traces, visit_keys[at], choice.allowed[chunk.rows])
        rendered = chunk.method.draw(canvas, batch)
        result.drawn[at] = rendered.electrons
        result.box[at] = rendered.box
        np.bitwise_or.at(job.out.flags, job.rows[visits[at, 0]], rendered.flags)
        ms = rendered.ms
        result.ms[at] = 1000 * (time.process_time() - start) / max(len(at), 1) if ms is None else ms
    return tables_of(job, choice, canvas.window, METHODS)


class _Chunk(NamedTuple):
    """Objects rendered together: their method, a Disperser with sufficiently fine bins, and their rows (n,)."""

    method: SpectraMethod
    disperser: Disperser
    rows: IntArray


def _chunks(scene: Scene, choice: Choice, disperser: Disperser) -> Iterator[_Chunk]:
    """Yield the chunks of a Scene's objects, sorted by strip."""
    if len(scene) == 0:
        return
    assert choice.coarse is not None
    order = np.lexsort((scene.x, np.floor(scene.y / _STRIP), scene.node[:, 0]))
    for method in METHODS:
        for coarse, size in ((False, method.chunk), (True, method.chunk_coarse)):
            mine = order[(choice.method[order] == method.code) & (choice.coarse[order] == coarse)]
            for start in range(0, len(mine), size):
                yield _Chunk(method, disperser.coarse if coarse else disperser, mine[start : start + size])


def _visits_of(chunk: IntArray, visits: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Return (indices of a chunk's visits, the visits with objects numbered within the chunk); count: all objects."""
    number = np.full(count, -1)
    number[chunk] = np.arange(len(chunk))
    at = np.flatnonzero(number[visits[:, 0]] >= 0)
    return at, np.column_stack([number[visits[at, 0]], visits[at, 1:]])


def _photon_densities(
    job: DispersedJob, choice: Choice, chunk: _Chunk, spectra: Callable[[IntArray, FloatArray], FloatArray]
) -> FloatArray:
    """Return a chunk's (n, bins) spectra times the exposure time; bad ones are set to zero, flagged and not rendered.

    Bad: negative, not finite, or of more electrons than the method can render, although the fluxes at selection were
    smaller.
    """
    densities = spectra(job.rows[chunk.rows], chunk.disperser.edges)
    if job.scene.fraction_of_parent is not None:
        densities = densities * job.scene.fraction_of_parent[chunk.rows, None]
    rates = chunk.disperser.rates.sum(axis=1).max(axis=0)
    bad = chunk.rows[_bad(densities, job.exptime, rates, chunk.method.electrons_max)]
    job.out.flags[job.rows[bad]] |= BAD_VALUE
    choice.method[bad] = NOT_RENDERED
    return densities


@numba.njit(cache=True)
def _bad(light: FloatArray, exptime: float, rates: FloatArray, maximum: float) -> BoolArray:
    """Multiply spectra (n, bins) by the exposure time in place and set bad ones to zero; return (n,) bool: bad."""
    bad = np.zeros(len(light), np.bool_)
    bins = light.shape[1]
    lanes = np.empty(_LANES)
    smallest = np.empty(_LANES)
    for i in range(len(light)):
        spectrum = light[i]
        lanes[:] = 0.0
        smallest[:] = 0.0
        for b in range(bins):
            spectrum[b] *= exptime
        for b in range(0, bins - _LANES + 1, _LANES):
            for k in range(_LANES):
                lanes[k] += spectrum[b + k] * rates[b + k]
                smallest[k] = min(smallest[k], spectrum[b + k])
        for b in range(bins - bins % _LANES, bins):
            lanes[0] += spectrum[b] * rates[b]
            smallest[0] = min(smallest[0], spectrum[b])
        bad[i] = not lanes.sum() <= maximum or smallest.min() < 0  # a sum with NaN is not below anything
        if bad[i]:
            spectrum[:] = 0.0
    return bad


class DispersedJob:
    """The objects of a chip with gratings that are to be rendered, and what was rendered of them.

    scene: their Scene; rows: of the table, for each row of the Scene; visits: of the Scene's rows to the pieces of the
    grating; count: of objects, before parts; out: DrawnTable; result: of the visits.
    """

    def __init__(self, objects: ObjectTable, disperser: Disperser, drawing: Drawing) -> None:
        self.disperser = disperser
        self.exptime = drawing.exptime
        self.out = DrawnTable(objects, np.sum([objects[f"flux{i}"] for i in range(4)], axis=0) * drawing.exptime)
        self.rows = self.out.rows
        wing = drawing.wing
        count = len(self.rows)
        scene = make_scene(objects.take(self.rows), drawing.wcs, drawing.psf, drawing.exptime)
        self.out.flag_optics(scene.outside[:count], wing)
        if scene.parent is not None:
            self.rows = self.rows[scene.parent]
        self.count = count
        assert scene.reach is not None and scene.wing is not None  # select gives them
        wide = scene.wing * np.float64(wing is not None)
        self.scene = replace(scene, wing=wide)
        self.visits = disperser.visits(scene.x, scene.y, np.maximum(scene.reach, wide))
        self.result = _Result(self.visits, disperser)


class _Result:
    """Electrons, drawn electrons, box and time of each visit, by order."""

    def __init__(self, visits: IntArray, disperser: Disperser) -> None:
        shape = len(visits), len(disperser.orders)
        self.electrons = np.zeros(shape)
        self.drawn = np.zeros(shape)
        self.box = np.zeros((*shape, 4), np.int64)
        self.ms = np.zeros(len(visits))

    def nominal(self, at: IntArray, visits: IntArray, light: FloatArray, rates: FloatArray) -> None:
        """Record the electrons of visits from the (n, bins) light of their objects and a Disperser's rates."""
        for piece in range(2):
            mine = visits[:, 1] == piece
            self.electrons[at[mine]] = _sums(light, visits[mine, 0], rates[piece])


@numba.njit(cache=True)
def _visit_keys(keys: IntArray, visits: IntArray) -> IntArray:
    """Return a key for each visit; an object that visits both pieces has two keys."""
    out = np.empty(len(visits), np.uint64)
    for v in range(len(visits)):
        out[v] = word(keys[visits[v, 0]], np.uint64(visits[v, 1]))
    return out


@numba.njit(cache=True)
def _sums(light: FloatArray, rows: IntArray, rates: FloatArray) -> FloatArray:
    """Return (len(rows), orders): electrons of each order. Four spectra at a time, so that no sum waits for itself."""
    count = len(rows)
    sums = np.empty(4)
    out = np.zeros((count, len(rates)))
    for first in range(0, count, len(sums)):
        group = rows[np.minimum(np.arange(first, first + len(sums)), count - 1)]
        a = light[group[0]]
        b = light[group[1]]
        c = light[group[2]]
        d = light[group[3]]
        for o in range(len(rates)):
            rate = rates[o]
            one = two = three = four = 0.0
            for i in range(len(rate)):
                one += a[i] * rate[i]
                two += b[i] * rate[i]
                three += c[i] * rate[i]
                four += d[i] * rate[i]
            sums[0] = one
            sums[1] = two
            sums[2] = three
            sums[3] = four
            for k in range(min(len(sums), count - first)):
                out[first + k, o] = sums[k]
    return out


def tables_of(
    job: DispersedJob, choice: Choice, window: Window, methods: Sequence[Method]
) -> tuple[ObjectTable, ObjectTable]:
    """Return (table of objects, table of their orders); methods: those that were chosen from."""
    out = job.out
    rows = job.rows
    scene = job.scene
    visits = job.visits
    result = job.result
    count = len(out.drawn)
    at = rows[visits[:, 0]]
    np.add.at(out.drawn, at, result.drawn.sum(axis=1))
    # Each of two visits has all the light of an object at the line between the pieces, so take the larger
    of_piece = np.zeros((2, count))
    np.add.at(of_piece, (visits[:, 1], at), result.electrons.sum(axis=1))
    out.electrons = of_piece.max(axis=0)
    np.add.at(out.ms, at, result.ms)
    electrons = scene.electrons.sum(axis=1)
    out.note_choice(rows, choice, electrons)
    out.name_methods(rows, names_of(choice.method, methods), electrons)
    assert scene.reach is not None and scene.wing is not None
    on_stamps = [method for method in methods if method.stamps]
    stamped = np.isin(choice.method, [method.code for method in on_stamps])
    out.note_sides(rows[stamped], scene.reach[stamped], scene.wing[stamped])
    lit = result.box[..., 1] > 0
    low = np.full((count, 2), np.iinfo(np.int32).max)
    high = np.zeros((count, 2), np.int64)
    v, o = np.nonzero(lit)
    box = result.box[v, o]
    np.minimum.at(low, at[v], box[:, ::2])
    np.maximum.at(high, at[v], box[:, 1::2])
    low[high[:, 0] == 0] = 0
    out.box[:, ::2] = low
    out.box[:, 1::2] = high
    out.miss((out.drawn == 0) & np.isin(out.method, [method.name for method in on_stamps]))
    if scene.parent is not None:
        job.visits, job.result = _of_objects(job)
        at = rows[job.visits[:, 0]]
    return out.table(), _orders(job, at, window)


def _of_objects(job: DispersedJob) -> tuple[IntArray, _Result]:
    """Return (visits, _Result) of the objects, each with what was rendered of its parts: one row to an order."""
    visits = job.visits
    result = job.result
    scene = job.scene
    assert scene.parent is not None
    mine = np.flatnonzero(visits[:, 0] < job.count)
    number = np.full((job.count, 2), -1)  # of the visit of an object to a piece
    number[visits[mine, 0], visits[mine, 1]] = np.arange(len(mine))
    to = number[scene.parent[visits[:, 0]], visits[:, 1]]
    assigned = to >= 0  # a tile may visit a piece that the middle of its image does not
    merged = _Result(visits[mine], job.disperser)
    for total, part in ((merged.electrons, result.electrons), (merged.drawn, result.drawn), (merged.ms, result.ms)):
        np.add.at(total, to[assigned], part[assigned])
    low = np.full((*merged.drawn.shape, 2), np.iinfo(np.int32).max)
    high = np.zeros((*merged.drawn.shape, 2), np.int64)
    box = np.where(result.box[..., 1:2] > 0, result.box, [np.iinfo(np.int32).max, 0, np.iinfo(np.int32).max, 0])
    np.minimum.at(low, to[assigned], box[assigned][..., ::2])
    np.maximum.at(high, to[assigned], box[assigned][..., 1::2])
    low[high[..., 0] == 0] = 0
    merged.box[..., ::2] = low
    merged.box[..., 1::2] = high
    return visits[mine], merged


def _orders(job: DispersedJob, at: IntArray, window: Window) -> ObjectTable:
    """Return the table of orders, one row per visit and order; at: (v,) rows of the objects table."""
    objects = job.out.objects
    scene = job.scene
    visits = job.visits
    result = job.result
    disperser = job.disperser
    assert scene.reach is not None
    cut = disperser.cut(visits, scene.x, scene.y, scene.reach)
    columns = []
    for piece, (grating, _) in enumerate(disperser.gratings.pieces):
        for o, number in enumerate(disperser.orders):
            if number not in grating.orders:
                continue
            order = grating.orders[number]
            mine = np.flatnonzero(
                (visits[:, 1] == piece) & ((result.drawn[:, o] > 0) | (result.electrons[:, o] >= FAINTEST))
            )
            x = scene.x[visits[mine, 0]]
            y = scene.y[visits[mine, 0]]
            lines = order.lines(x, y).T
            p, q, r, s = lines
            low, high = _range(lines, x, y, window, order.range)
            reaching = np.flatnonzero((low < high) | (result.drawn[mine, o] > 0))
            mine = mine[reaching]
            box = result.box[mine, o]
            columns.append(
                {
                    "id": objects["id"][at[mine]],
                    "row": at[mine].astype(np.int32),
                    "order": np.full(len(mine), number, np.int8),
                    "grating": np.full(len(mine), grating.name),
                    "cut": cut[mine],
                    "x": x[reaching],
                    "y": y[reaching],
                    "p": p[reaching],
                    "q": q[reaching],
                    "r": r[reaching],
                    "s": s[reaching],
                    **order.coefficients_at(x[reaching], y[reaching]),
                    "electrons": result.electrons[mine, o],
                    "drawn": result.drawn[mine, o],
                    **{name: box[:, k].astype(np.int32) for k, name in enumerate(("x0", "x1", "y0", "y1"))},
                    "wave_min": low[reaching].astype(np.float32),
                    "wave_max": high[reaching].astype(np.float32),
                }
            )
    table = {name: np.concatenate([part[name] for part in columns]) for name in columns[0]}
    sort = np.lexsort((table["order"], table["row"]))
    return ObjectTable({name: values[sort] for name, values in table.items()})


def _range(
    lines: FloatArray, x: FloatArray, y: FloatArray, window: Window, limits: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return the (first, last) wavelengths, within `limits`, whose light reaches the window; NaN: none."""
    p, q, r, s = lines
    low = np.full(len(x), limits[0])
    high = np.full(len(x), limits[1])
    for at, offset, slope, first, last in ((x, p, q, window.x0, window.x1), (y, r, s, window.y0, window.y1)):
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort([(edge - 0.5 - at - offset) / slope for edge in (first, last)], axis=0)
        flat = slope == 0
        inside = (at + offset >= first - 0.5) & (at + offset < last - 0.5)
        low = np.maximum(low, np.where(flat, np.where(inside, -np.inf, np.inf), ends[0]))
        high = np.minimum(high, np.where(flat, np.inf, ends[1]))
    none = ~(low <= high)
    return np.where(none, np.nan, low), np.where(none, np.nan, high)
