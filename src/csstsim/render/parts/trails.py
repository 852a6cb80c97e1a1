"""Objects that move during the exposure: a trail is rendered as points along it, a long one as a line (tracks).

A trail of up to LINE_PX is cut into pieces, each a copy of the object with its part of the light at the position of its
own time. All renderers treat them as any object. Times and fractions are the nodes and weights of Gauss and
Legendre, some SPACING px apart. A pixel-integrated PSF has less than 1e-4 of its light above one cycle per pixel, so
this sum cannot be told from a line; the tests compare it with GalSim's. A piece has the light of the time that its
column is exposed. The response of the pixels, in which the shutter is, multiplies it (optics.throughput.response).
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, overload

import numpy as np

from csstsim.catalog.changing.motion import Motion, positions_at
from csstsim.catalog.table import ObjectTable
from csstsim.render.parts.component_pieces import draw_components
from csstsim.render.parts.piece_tables import SHARE, gathered, orders_of
from csstsim.render.parts.tracks import draw_tracks

if TYPE_CHECKING:
    from collections.abc import Callable

    from csstsim.base.types import FloatArray, IntArray
    from csstsim.catalog.changing.motion import Interval
    from csstsim.catalog.light.object_spectra import Spectra
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.render.canvas import Canvas
    from csstsim.render.drawing import Drawing
    from csstsim.render.parts.component_pieces import DrawDispersed

# px; points in addition
SPACING = 0.5
FEWEST = 4
LINE_PX = 256.0  # longer trails, and those with a width, are lines


@overload
def draw_trailed(
    draw: Callable[[Canvas, ObjectTable, Drawing], ObjectTable], canvas: Canvas, objects: ObjectTable, drawing: Drawing
) -> tuple[ObjectTable]: ...


@overload
def draw_trailed(
    draw: DrawDispersed,
    canvas: Canvas,
    objects: ObjectTable,
    drawing: Drawing,
    spectra: Spectra,
    disperser: Disperser,
) -> tuple[ObjectTable, ObjectTable]: ...


def draw_trailed(
    draw: Callable[..., Any],
    canvas: Canvas,
    objects: ObjectTable,
    drawing: Drawing,
    spectra: Spectra | None = None,
    disperser: Disperser | None = None,
) -> tuple[ObjectTable, ...]:
    """Draw objects with a function of render.imaging or render.slitless; return what it returns, as a tuple.

    draw(canvas, objects, drawing), with a disperser draw(canvas, objects, spectra, disperser, drawing). Objects that
    move are rendered along their trails, each with one row in the tables. Without such objects this calls `draw`.
    """

    def drawn(table: ObjectTable, light: Spectra | None) -> tuple[ObjectTable, ...]:
        if disperser is None:
            return (draw(canvas, table, drawing),)
        assert light is not None  # given with a disperser
        return draw_components(draw, canvas, table, light, disperser, drawing)

    if "trail_length" not in objects or not (objects["trail_length"] > 0).any():
        return drawn(objects, spectra)
    length = objects["trail_length"] / drawing.wcs.chip.telescope.pixel_scale
    line = (length > LINE_PX) | ((objects["trail_width"] > 0) & (length > 0))
    rest = np.flatnonzero(~line)
    others = objects.take(rest)
    pieces = cut(others, drawing)
    owner = pieces.owner
    light = pieces.light
    table, *orders = drawn(pieces.table, None if spectra is None else spectra.take(rest[owner]).times(light))
    tables = [(rest, gathered(others, owner, table))]
    if line.any():
        at = np.flatnonzero(line)
        tables.append((at, draw_tracks(canvas, objects.take(at), drawing, spectra and spectra.take(at), disperser)))
    sort = np.argsort(np.concatenate([rows for rows, _ in tables]), kind="stable")
    whole = ObjectTable.concat([part for _, part in tables]).take(sort)
    return (whole, *(orders_of(part, rest[owner], light) for part in orders))


class Pieces(NamedTuple):
    """The m pieces of objects: their table, the row of the object of each (m,), and its light (m,).

    light: that of the object in the exposure is 1.
    """

    table: ObjectTable
    owner: IntArray
    light: FloatArray


def cut(objects: ObjectTable, drawing: Drawing) -> Pieces:
    """Return the Pieces of objects. A row that does not move is one piece. Pieces of a row are together, in time."""
    interval = drawing.interval
    scale = drawing.wcs.chip.telescope.pixel_scale
    length = np.where(objects["trail_length"] > 0, objects["trail_length"] / scale, 0.0)
    count = np.where(length > 0, np.ceil(length / SPACING) + FEWEST, 1).astype(int)
    owner = np.repeat(np.arange(len(objects)), count)
    light = np.ones(len(owner))
    moving = np.flatnonzero(length[owner] > 0)
    pieces = objects.take(owner)
    if not len(moving):
        return Pieces(pieces.with_columns(**{SHARE: light}), owner, light)
    assert interval is not None and drawing.observer is not None  # given for objects that move
    moved = owner[moving]
    rules = [_rule(n) for n in count[np.unique(moved)].tolist()]
    step = np.concatenate([nodes for nodes, _ in rules])
    part = np.concatenate([weights for _, weights in rules])
    start = objects["trail_start"][moved]
    end = objects["trail_end"][moved]
    t = 0.5 * (start + end) + step * (end - start)
    motion = motion_of(objects.take(moved), interval)
    at = positions_at(motion, drawing.wcs, drawing.observer, t)
    light[moving] = (end - start) * part * exposed_more(interval, at.x) / interval.exptime
    columns = {"ra": at.ra, "dec": at.dec, "ra_orig": at.ra_epoch, "dec_orig": at.dec_epoch, "x": at.x, "y": at.y}
    changed = {name: objects[name][owner].astype(float) for name in columns}
    for name, values in columns.items():
        changed[name][moving] = values
    fraction = np.ones(len(owner))
    fraction[moving] = part
    flux = {f"flux{i}": pieces[f"flux{i}"] * light for i in range(4)}
    return Pieces(pieces.with_columns(**changed, **flux, **{SHARE: fraction}), owner, light)


@lru_cache(512)
def _rule(n: int) -> tuple[FloatArray, FloatArray]:
    """Return (nodes from -0.5 to 0.5, weights whose sum is 1) of n points."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return 0.5 * nodes, 0.5 * weights


def motion_of(objects: ObjectTable, interval: Interval) -> Motion:
    """Return the Motion of objects as selected."""
    return Motion(objects.with_columns(ra=objects["ra_orig"], dec=objects["dec_orig"]), interval)


def exposed_more(interval: Interval, x: FloatArray) -> FloatArray:
    """Return (n,) by how much more the light of a time counts at columns x, because the response has less of it."""
    first, last = interval.exposed(x)
    return interval.exptime / (last - first)
