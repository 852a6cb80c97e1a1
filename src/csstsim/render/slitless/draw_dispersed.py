"""Drawing the objects of a spectroscopic chip: as render.imaging.draw, each object's light sent through the gratings.

The policy's choice (render.policy) rests on the first order's electrons over the pixels that a spectrum covers. Objects
are taken some at a time, for their spectra are too many to hold. Truth is kept object by object, as on imaging chips,
and order by order.
"""

import time

import numba
import numpy as np

from csstsim.base.counter import word
from csstsim.base.progress import progress
from csstsim.catalog.flags import BAD_VALUE, OFF_CHIP, OUTSIDE_PSF_HULL, STRONG_LENSING, TRUNCATED_STAMP
from csstsim.catalog.table import ObjectTable
from csstsim.render import policy
from csstsim.render.imaging.draw import object_keys_of
from csstsim.render.psf_mixture import Mixer
from csstsim.render.scene import make_scene
from csstsim.render.slitless.dispersed_photons import shoot_spectra
from csstsim.render.slitless.slabs import draw_spectra

# Objects at a time, by method and whether bins are coarse: spectra in cache; few passes for far wings
CHUNK = {(policy.STAMP, False): 2048, (policy.PHOTONS, False): 512, (policy.PHOTONS, True): 2048}
_UNDRAWN = BAD_VALUE | STRONG_LENSING
FAINTEST = 1.0  # electron: an order with less, none of which was drawn, has no row in the table of orders
_MOST = 1e15  # electrons of an object
_STRIP = 64  # px: objects are taken in strips, so that their pixels are in cache


def draw_dispersed(
    image, window, objects, spectra, disperser, wcs, psf, exptime, *, tables, beyond, response, maximum, variance, key,
    fidelity,
):  # fmt: skip
    """Draw a spectroscopic chip's objects; return (table with what was drawn, table of orders, counted or None).

    As render.imaging.draw.draw_objects; spectra: catalog.light.object_spectra.Spectra of `objects`; disperser:
    optics.gratings.dispersion.Disperser. `electrons` are those of all orders, `method` is photons or slabs. The table
    of orders has a row for each object, piece and order of which light may land on the window: io.orders has its
    columns.
    """
    mixer = psf if isinstance(psf, Mixer) else Mixer(psf)
    psf = mixer.psf
    work = Work(objects, wcs, psf, exptime, disperser, beyond, window)
    scene, wing, visits, result = work.scene, work.wing, work.visits, work.result
    choice = policy.choose_dispersed(
        scene, work.part["reach"], wing, variance, fidelity, disperser, convex=psf.convex, per_pixel=psf.oversampling,
        maximum=maximum,
    )  # fmt: skip
    counted = np.zeros(window.shape, np.int32) if (choice.method == policy.PHOTONS).any() else None
    own = _visit_keys(object_keys_of(key, scene.ids), visits)
    for kind, optics, chunk in progress(_chunks(scene, choice, disperser), "spectra"):
        at, some = _visits_of(chunk, visits, len(scene))
        light = _light(
            work, choice, chunk, spectra, optics, exptime, policy.PHOTONS_MAX if kind == policy.PHOTONS else _MOST
        )
        result.nominal(at, some, light, optics.rates)
        begin = time.process_time()
        if kind == policy.STAMP:
            drawn = draw_spectra(
                image, window, scene.take(chunk), light, some, work.part["reach"][chunk], wing[chunk], optics, mixer,
                beyond, response, allowed=choice.allowed[chunk],
            )  # fmt: skip
            result.drawn[at], result.box[at], result.ms[at] = drawn.drawn, drawn.box, drawn.ms
            np.bitwise_or.at(work.flags, work.rows[visits[at, 0]], drawn.flags)
            continue
        result.drawn[at], result.box[at] = shoot_spectra(
            counted, window, scene.take(chunk), light, some, optics, own[at], tables, response, maximum, beyond.wing
        )
        result.ms[at] = 1000 * (time.process_time() - begin) / max(len(at), 1)
    return *tables_of(work, choice), counted


def _chunks(scene, choice, disperser):
    """Yield (method, Disperser with bins enough, objects) of some objects at a time, those of one strip together."""
    if len(scene) == 0:
        return
    order = np.lexsort((scene.x, np.floor(scene.y / _STRIP), scene.node[:, 0]))
    for (kind, coarse), size in CHUNK.items():
        mine = order[(choice.method[order] == kind) & (choice.coarse[order] == coarse)]
        for start in range(0, len(mine), size):
            yield kind, disperser.coarse if coarse else disperser, mine[start : start + size]


def _visits_of(chunk, visits, count):
    """Return the visits of a chunk of `count` objects, and what they are with the objects' places in the chunk."""
    place = np.full(count, -1)
    place[chunk] = np.arange(len(chunk))
    at = np.flatnonzero(place[visits[:, 0]] >= 0)
    return at, np.column_stack([place[visits[at, 0]], visits[at, 1:]])


def _light(work, choice, chunk, spectra, optics, exptime, most):
    """Return a chunk's (n, bins) spectra times the exposure time; bad ones are dark, flagged and not drawn.

    Bad: negative, not finite, or of more than `most` electrons, which selection's fluxes did not announce.
    """
    light = spectra(work.rows[chunk], optics.edges) * exptime
    bad = ~(np.isfinite(light) & (light >= 0)).all(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        bad |= ~(np.einsum("nb,b->n", light, optics.rates.sum(axis=1).max(axis=0)) <= most)
    light[bad] = 0.0
    work.flags[work.rows[chunk[bad]]] |= BAD_VALUE
    choice.method[chunk[bad]] = policy.NONE
    return light


class Work:
    """What there is to draw: the rows that can be, their Scene, the pieces they visit, and what comes of it."""

    def __init__(self, objects, wcs, psf, exptime, disperser, beyond, window):
        self.objects, self.disperser, self.flags = objects, disperser, objects["flags"].copy()
        first = np.sum([objects[f"flux{i}"] for i in range(4)], axis=0) * exptime
        self.rows = np.flatnonzero((self.flags & _UNDRAWN == 0) & (first > 0))
        self.part = objects.take(self.rows)
        self.scene = make_scene(self.part, wcs, psf, exptime)
        self.flags[self.rows[self.scene.outside]] |= OUTSIDE_PSF_HULL
        wings = beyond is not None and beyond.wing is not None
        self.flags[self.rows[(self.part["wing"] > 0) & (not wings)]] |= TRUNCATED_STAMP
        self.wing = self.part["wing"] * np.float64(wings)
        self.visits = disperser.visits(self.scene.x, self.scene.y, np.maximum(self.part["reach"], self.wing))
        self.result = _Result(self.visits, disperser, window)


class _Result:
    """What came of each visit, order by order."""

    def __init__(self, visits, disperser, window):
        self.window = window
        shape = len(visits), len(disperser.orders)
        self.electrons, self.drawn, self.box = np.zeros(shape), np.zeros(shape), np.zeros((*shape, 4), np.int64)
        self.ms = np.zeros(len(visits))

    def nominal(self, at, visits, light, rates):
        """Note the electrons of visits: (n, bins) light of their objects, rates of a Disperser of the same bins."""
        for piece in range(2):
            mine = visits[:, 1] == piece
            self.electrons[at[mine]] = _sums(light, visits[mine, 0], rates[piece])


@numba.njit(cache=True)
def _visit_keys(keys, visits):
    """Return a key for each visit: an object that visits both pieces has two."""
    out = np.empty(len(visits), np.uint64)
    for v in range(len(visits)):
        out[v] = word(keys[visits[v, 0]], np.uint64(visits[v, 1]))
    return out


@numba.njit(cache=True)
def _sums(light, rows, rates):
    """Return (len(rows), orders): electrons of each order."""
    out, orders = np.zeros((len(rows), len(rates))), len(rates)
    turned = np.ascontiguousarray(rates.T)
    for k in range(len(rows)):
        sums, spectrum = out[k], light[rows[k]]
        for b in range(len(turned)):
            for o in range(orders):
                sums[o] += spectrum[b] * turned[b, o]
    return out


def tables_of(work, choice, slabs="slabs"):
    """Return (the table of objects, that of their orders); `slabs`: the method's name where STAMP was chosen."""
    objects, rows, part, flags, visits, result = (
        work.objects, work.rows, work.part, work.flags, work.visits, work.result,
    )  # fmt: skip
    count, at = len(objects), rows[visits[:, 0]]
    drawn, electrons = np.zeros(count), np.zeros(count)
    np.add.at(drawn, at, result.drawn.sum(axis=1))
    # Of an object on the line between the pieces both visits name all its light
    np.maximum.at(electrons, at, result.electrons.sum(axis=1))
    ms, error, snr = (np.zeros(count, np.float32) for _ in range(3))
    np.add.at(ms, at, result.ms)
    error[rows], snr[rows] = choice.error, choice.snr
    method = np.full(count, policy.METHODS[policy.NONE], dtype="U10")
    method[rows] = np.where(choice.method == policy.STAMP, slabs, policy.METHODS[choice.method])
    stamp = np.zeros(count, np.int32)
    drawn_as = choice.method == policy.STAMP
    stamp[rows[drawn_as]] = 2 * np.maximum(part["reach"], np.ceil(work.wing))[drawn_as] + 1
    lit = result.box[..., 1] > 0
    low, high = np.full((count, 2), np.iinfo(np.int32).max), np.zeros((count, 2), np.int64)
    v, o = np.nonzero(lit)
    box = result.box[v, o]
    np.minimum.at(low, at[v], box[:, ::2])
    np.maximum.at(high, at[v], box[:, 1::2])
    low[high[:, 0] == 0] = 0
    off = (drawn == 0) & (method == slabs)
    flags[off] |= OFF_CHIP
    method[off] = policy.METHODS[policy.NONE]
    fraction = np.divide(drawn, electrons, out=np.zeros(count), where=electrons > 0)
    table = objects.with_columns(
        flags=flags, electrons=electrons, drawn=drawn, fraction=fraction, method=method, snr=snr, error=error,
        stamp=stamp, x0=low[:, 0].astype(np.int32), x1=high[:, 0].astype(np.int32), y0=low[:, 1].astype(np.int32),
        y1=high[:, 1].astype(np.int32), ms=ms,
    )  # fmt: skip
    cut = work.disperser.cut(visits, work.scene.x, work.scene.y, part["reach"])
    return table, _orders(objects, at, work.scene, visits, cut, result, work.disperser)


def _orders(objects, at, scene, visits, cut, result, disperser):
    """Return the table of orders: one row a visit and order; `at` (v,) rows of the objects table, `cut` (v,) bool."""
    window = result.window
    columns = []
    for piece, (grating, _) in enumerate(disperser.gratings.pieces):
        for o, number in enumerate(disperser.orders):
            if number not in grating.orders:
                continue
            order = grating.orders[number]
            mine = np.flatnonzero(
                (visits[:, 1] == piece) & ((result.drawn[:, o] > 0) | (result.electrons[:, o] >= FAINTEST))
            )
            x, y = scene.x[visits[mine, 0]], scene.y[visits[mine, 0]]
            p, q, r, s = order.lines(x, y).T
            low, high = _range(p, q, r, s, x, y, window, order.range)
            lands = np.flatnonzero((low < high) | (result.drawn[mine, o] > 0))
            mine, box = mine[lands], result.box[mine[lands], o]
            columns.append({
                "id": objects["id"][at[mine]], "row": at[mine].astype(np.int32),
                "order": np.full(len(mine), number, np.int8), "grating": np.full(len(mine), grating.name),
                "cut": cut[mine], "x": x[lands], "y": y[lands],
                "p": p[lands], "q": q[lands], "r": r[lands], "s": s[lands],
                **{name: values for name, values in order.coefficients_at(x[lands], y[lands]).items()},
                "electrons": result.electrons[mine, o], "drawn": result.drawn[mine, o],
                **{name: box[:, k].astype(np.int32) for k, name in enumerate(("x0", "x1", "y0", "y1"))},
                "wave_min": low[lands].astype(np.float32), "wave_max": high[lands].astype(np.float32),
            })  # fmt: skip
    table = {name: np.concatenate([part[name] for part in columns]) for name in columns[0]}
    sort = np.lexsort((table["order"], table["row"]))
    return ObjectTable({name: values[sort] for name, values in table.items()})


def _range(p, q, r, s, x, y, window, limits):
    """Return the (first, last) wavelengths, within `limits`, whose light lands on the window; NaN: none."""
    low, high = np.full(len(x), limits[0]), np.full(len(x), limits[1])
    for at, offset, slope, first, last in ((x, p, q, window.x0, window.x1), (y, r, s, window.y0, window.y1)):
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort([(edge - 0.5 - at - offset) / slope for edge in (first, last)], axis=0)
        flat = slope == 0
        inside = (at + offset >= first - 0.5) & (at + offset < last - 0.5)
        low = np.maximum(low, np.where(flat, np.where(inside, -np.inf, np.inf), ends[0]))
        high = np.minimum(high, np.where(flat, np.inf, ends[1]))
    none = ~(low <= high)
    return np.where(none, np.nan, low), np.where(none, np.nan, high)
