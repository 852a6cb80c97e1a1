"""Objects that move during the exposure: a trail is drawn as points along it, a long one as a line (tracks).

A trail of up to LINE_PX is cut into pieces, each a copy of the object with its part of the light at the place of its
own time. All renderers draw them as they draw any object. Times and shares are the nodes and weights of Gauss and
Legendre, some SPACING px apart. A pixel-integrated PSF has less than 1e-4 of its light above one cycle per pixel, so
this sum cannot be told from a line; the tests compare it with GalSim's. A piece has the light of the time that its
column is exposed. The response of the pixels, in which the shutter is, multiplies it (optics.throughput.response).
"""

from functools import lru_cache

import numpy as np

from csstsim.catalog.changing.motion import Motion, seen_at
from csstsim.catalog.table import ObjectTable
from csstsim.render.drawn_table import NONE
from csstsim.render.parts.tracks import draw_tracks

SPACING, FEWEST = 0.5, 4  # px; points in addition
LINE_PX = 256.0  # longer trails, and those with a width, are lines
SHARE = "trail_share"  # column of the pieces: their share of the object's light


def draw_trailed(draw, canvas, objects, drawing, spectra=None, disperser=None):
    """Draw objects with a function of render.imaging or render.slitless; return what it returns, as a tuple.

    draw(canvas, objects, drawing), with a disperser draw(canvas, objects, spectra, disperser, drawing). Objects that
    move are drawn along their trails, each with one row in the tables. Without such objects this is a call of `draw`.
    """

    def drawn(some, light):
        found = draw(canvas, some, drawing) if disperser is None else draw(canvas, some, light, disperser, drawing)
        return found if isinstance(found, tuple) else (found,)

    if "trail_length" not in objects or not (objects["trail_length"] > 0).any():
        return drawn(objects, spectra)
    length = objects["trail_length"] / drawing.wcs.chip.telescope.pixel_scale
    line = (length > LINE_PX) | ((objects["trail_width"] > 0) & (length > 0))
    rest = np.flatnonzero(~line)
    some = objects.take(rest)
    pieces, owner, light = cut(some, drawing)
    table, *orders = drawn(pieces, None if spectra is None else spectra.take(rest[owner]).times(light))
    tables = [(rest, gathered(some, owner, table))]
    if line.any():
        at = np.flatnonzero(line)
        tables.append((at, draw_tracks(canvas, objects.take(at), drawing, spectra and spectra.take(at), disperser)))
    place = np.argsort(np.concatenate([rows for rows, _ in tables]), kind="stable")
    whole = ObjectTable.concat([part for _, part in tables]).take(place)
    return (whole, *(orders_of(part, rest[owner], light) for part in orders))


def cut(objects, drawing):
    """Return (pieces, owner (m,), light (m,)): the pieces as an ObjectTable, the rows they are of, and their light.

    light: that of the exposure is 1. A row that does not move is one piece. Pieces of a row are together, in time.
    """
    interval, scale = drawing.interval, drawing.wcs.chip.telescope.pixel_scale
    length = np.where(objects["trail_length"] > 0, objects["trail_length"] / scale, 0.0)
    count = np.where(length > 0, np.ceil(length / SPACING) + FEWEST, 1).astype(int)
    owner = np.repeat(np.arange(len(objects)), count)
    light = np.ones(len(owner))
    moving = np.flatnonzero(length[owner] > 0)
    pieces = objects.take(owner)
    if not len(moving):
        return pieces.with_columns(**{SHARE: light}), owner, light
    mine = owner[moving]
    rules = [_rule(n) for n in count[np.unique(mine)].tolist()]
    step, part = (np.concatenate(values) for values in zip(*rules, strict=True))
    start, end = (objects[name][mine] for name in ("trail_start", "trail_end"))
    t = 0.5 * (start + end) + step * (end - start)
    motion = motion_of(objects.take(mine), interval)
    ra, dec, ra_epoch, dec_epoch, x, y = seen_at(motion, drawing.wcs, drawing.observer, t)
    light[moving] = (end - start) * part * exposed_more(interval, x) / interval.exptime
    columns = {"ra": ra, "dec": dec, "ra_orig": ra_epoch, "dec_orig": dec_epoch, "x": x, "y": y}
    changed = {name: objects[name][owner].astype(float) for name in columns}
    for name, values in columns.items():
        changed[name][moving] = values
    share = np.ones(len(owner))
    share[moving] = part
    flux = {f"flux{i}": pieces[f"flux{i}"] * light for i in range(4)}
    return pieces.with_columns(**changed, **flux, **{SHARE: share}), owner, light


@lru_cache(512)
def _rule(n):
    """Return (places from -0.5 to 0.5, weights whose sum is 1) of n points."""
    nodes, weights = np.polynomial.legendre.leggauss(n)
    return 0.5 * nodes, 0.5 * weights


def motion_of(objects, interval):
    """Return the Motion of objects as selected."""
    return Motion(objects.with_columns(ra=objects["ra_orig"], dec=objects["dec_orig"]), interval)


def exposed_more(interval, x):
    """Return (n,) by how much more the light of a time counts at columns x, because the response has less of it."""
    first, last = interval.exposed(x)
    return interval.exptime / (last - first)


def gathered(objects, owner, drawn):
    """Return the table of `objects` with what was drawn of their pieces (render.drawn_table), a row for each object."""
    count = len(objects)
    ends = np.r_[np.flatnonzero(np.r_[True, owner[1:] != owner[:-1]]), len(owner)] if count else np.zeros(1, int)
    starts = ends[:-1]
    lit = drawn["method"] != NONE
    chosen = starts.copy()  # the first piece that was drawn
    rows = np.flatnonzero(lit)
    chosen[owner[rows[::-1]]] = rows[::-1]
    box = {}
    there = drawn["x1"] > drawn["x0"]
    for low, high in (("x0", "x1"), ("y0", "y1")):
        least, most = np.full(count, np.iinfo(np.int32).max, np.int32), np.zeros(count, np.int32)
        np.minimum.at(least, owner[there], drawn[low][there])
        np.maximum.at(most, owner[there], drawn[high][there])
        box |= {low: np.where(most > 0, least, 0).astype(np.int32), high: most}
    sums = {name: np.bincount(owner, drawn[name], count) for name in ("electrons", "drawn", "ms")}
    fraction = np.divide(sums["drawn"], sums["electrons"], out=np.zeros(count), where=sums["electrons"] > 0)
    flags = np.bitwise_and.reduceat(drawn["flags"], starts) if count else drawn["flags"]  # OFF_CHIP: all of it
    some = np.zeros(count, flags.dtype)
    np.bitwise_or.at(some, owner[lit], drawn["flags"][lit])
    of_piece = {name: drawn[name][chosen] for name in ("method", "snr", "error")}
    stamp = np.zeros(count, drawn["stamp"].dtype)
    np.maximum.at(stamp, owner, drawn["stamp"])
    return objects.with_columns(
        flags=flags | some, electrons=sums["electrons"], drawn=sums["drawn"], fraction=fraction,
        method=of_piece["method"], snr=of_piece["snr"], error=of_piece["error"], stamp=stamp, **box,
        ms=sums["ms"].astype(drawn["ms"].dtype),
    )  # fmt: skip


def orders_of(orders, row, light):
    """Return the table of orders of pieces with one row for each object, order and grating, that of most light.

    row (m,): the object of each piece; light (m,). Electrons are sums, the box encloses all, `cut` is any piece's.
    """
    if not len(orders):
        return orders
    piece = orders["row"].astype(int)
    mine = row[piece]
    names = np.unique(orders["grating"], return_inverse=True)[1]
    key = np.stack([mine, orders["order"].astype(int), names])
    _, group = np.unique(key, axis=1, return_inverse=True)
    group, count = group.ravel(), int(group.max()) + 1
    order = np.lexsort((np.arange(len(group)), -orders["electrons"], group))
    best = order[np.r_[True, np.diff(group[order]) != 0]]
    kept = orders.take(best)
    box, there = {}, orders["x1"] > orders["x0"]
    for low, high in (("x0", "x1"), ("y0", "y1")):
        least, most = np.full(count, np.iinfo(np.int32).max, np.int32), np.zeros(count, np.int32)
        np.minimum.at(least, group[there], orders[low][there])
        np.maximum.at(most, group[there], orders[high][there])
        box |= {low: np.where(most > 0, least, 0).astype(np.int32), high: most}
    sums = {name: np.bincount(group, orders[name], count) for name in ("electrons", "drawn")}
    any_cut = np.bincount(group, orders["cut"], count) > 0
    kept = kept.with_columns(row=mine[best].astype(np.int32), cut=any_cut, **sums, **box)
    return kept.take(np.lexsort((kept["order"], kept["row"])))
