"""Photons through a grating: draw the wavelength and order of each electron, then its position, then shift it.

The wavelength follows spectrum x (throughput of all orders). The order is drawn by its share at that wavelength, the
PSF node by its weight, and one of the two nearest PSF wavelengths by weight (optics.gratings.dispersion); all are exact
draws from a mixture. The position without the grating (object + profile + PSF) decides which of the two gratings
disperses the electron: an object whose light reaches the edge of a piece visits both pieces, and each visit drops the
electrons that fall outside its piece. The electron is then shifted to

    x + p + q lambda,   y + r + s lambda,

with p, q, r, s at the object's centre; they change by a thousandth across a galaxy of 10". Numbers are Poisson and
thinned by losses as in render.imaging.photons.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numba
import numpy as np

from csstsim.base.counter import high, low, poisson, unit, word
from csstsim.base.types import AnyArray, FloatArray, IntArray
from csstsim.render.photon_positions import (
    Cells,
    Shapes,
    check_scene,
    contiguous,
    cumulative,
    first_word,
    from_profile,
    from_psf,
    from_wing,
    pick,
    profiles_of,
    tail_table,
)

if TYPE_CHECKING:
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.optics.scatter.halo import Wing
    from csstsim.render.canvas import Canvas
    from csstsim.render.psf_table import PsfTable
    from csstsim.render.scene import Scene
    from csstsim.render.slitless.traces import Traces

# What compiled loops pass on: counted, response and maximum; what an electron's wavelength and node are drawn from
# (running, guide, shares, between, first, step, nodes, index, lines); of a visit x, y, matrix, profile, shapes, number,
# side and whether it cuts; drawn and box; of each electron first word, order, px, py and shifts
Image: TypeAlias = tuple[IntArray, FloatArray, float]
Draw: TypeAlias = tuple[FloatArray, IntArray, FloatArray, FloatArray, float, float, FloatArray, IntArray, FloatArray]
Place: TypeAlias = tuple[float, float, FloatArray, FloatArray, Shapes, int, FloatArray, bool]
Results: TypeAlias = tuple[IntArray, IntArray]
Work: TypeAlias = tuple[IntArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray]
_ONE, _TWO, _FOUR = (np.uint64(k) for k in (1, 2, 4))
# a word in three: 26, 10 and 28 bits
_S26 = np.uint64(26)
_S36 = np.uint64(36)
_LOW26 = np.uint64((1 << 26) - 1)
_LOW10 = np.uint64((1 << 10) - 1)
_UNIT26 = 2.0**-26
_UNIT10 = 2.0**-10
_UNIT28 = 2.0**-28
_BATCH = 512
_GUIDE = 8192  # largest number of entries in the guide table for the search of a wavelength
_DENSE = 8.0  # electrons a bin above which each bin has its own Poisson numbers
_AWAY = 1e9  # px: position given to electrons outside the piece, off any window


def shoot_spectra(
    canvas: Canvas, scene: Scene, traces: Traces, keys: IntArray, table: PsfTable, wing: Wing | None = None
) -> tuple[IntArray, IntArray]:
    """Draw the orders of a Scene's objects into the counted plane of a Canvas, which must be there.

    traces: Traces of the objects; keys: (v,) uint64 of their visits, all different; scene.electrons is not used. table,
    wing: as render.imaging.photons.shoot_scene.
    Returns drawn (v, orders) int64, electrons counted, and box (v, orders, 4) int64 of the chip's pixels reached,
    half-open, 0 if none. The result does not depend on the order of the visits.
    """
    (spectra, visits, disperser), window = traces, canvas.window
    assert canvas.counted is not None
    check_scene(scene, table, canvas.maximum)
    if not _usable(spectra):
        raise ValueError("a spectrum is negative or not finite")
    orders = len(disperser.orders)
    count = len(visits)
    drawn = np.zeros((count, orders), np.int64)
    box = np.zeros((count, orders, 4), np.int64)
    lines = disperser.lines(visits, scene.x, scene.y)
    rates = disperser.rates
    total = rates.sum(axis=1)
    shares = (np.cumsum(rates, axis=1) / np.where(total > 0, total, 1.0)[:, None]).astype(np.float32)
    profile, shapes = profiles_of(scene)
    floats = (scene.matrix, scene.light, profile, scene.weight)
    objects: tuple[AnyArray, ...]
    objects = scene.x - window.x0, scene.y - window.y0, *(np.ascontiguousarray(a, np.float64) for a in floats)
    objects += (np.ascontiguousarray(scene.node),)
    psf = table.words.reshape(-1), table.share, table.bits, table.cells, table.per_pixel
    tail = np.empty(0) if wing is None else tail_table(wing, table.cells / table.per_pixel / 2)
    sides = disperser.rectangles - canvas.corner
    light = np.ascontiguousarray(spectra, np.float64), total, shares.transpose(0, 2, 1).copy()
    image = canvas.counted, contiguous(canvas.response), float(canvas.maximum)
    optics = *_wavelengths(disperser), lines, sides
    _shoot(image, objects, shapes, light, optics, np.ascontiguousarray(visits), keys, psf, tail, (drawn, box))
    box[drawn > 0] += canvas.corner
    return drawn, box


@numba.njit(cache=True)
def _usable(spectra: FloatArray) -> bool:
    """Whether no value of `spectra` (n, bins) is negative or not finite."""
    wrong = 0
    for i in range(len(spectra)):
        for value in spectra[i]:
            wrong += not 0.0 <= value < np.inf
    return wrong == 0


def _wavelengths(disperser: Disperser) -> tuple[FloatArray, float, float]:
    """Return the position of each bin among the PSF set's wavelengths, 0 to 3, and the bins' first edge and step."""
    lower, upper = disperser.psf_mixture
    return (lower + upper).astype(np.float32), float(disperser.edges[0]), float(np.diff(disperser.edges[:2])[0])


@numba.njit(cache=True)
def _shoot(
    image: Image,
    objects: tuple[AnyArray, ...],
    shapes: Shapes,
    light: tuple[FloatArray, FloatArray, FloatArray],
    optics: tuple[FloatArray, float, float, FloatArray, AnyArray],
    visits: IntArray,
    keys: IntArray,
    psf: Cells,
    tail: FloatArray,
    results: Results,
) -> None:
    maximum = image[2]
    x, y, matrix, parts, profile, weight, index = objects
    spectra, total, shares = light
    between, first, step, lines, sides = optics
    drawn, box = results
    bins = spectra.shape[1]
    orders = drawn.shape[1]
    running = np.empty(bins + 1)
    guide = np.empty(_GUIDE + 1, np.uint16)
    floats = np.empty((4, _BATCH))  # px, py and the shifts
    work = np.empty(_BATCH, np.int64), np.empty(_BATCH, np.int64), floats[0], floats[1], floats[2], floats[3]
    sums = np.empty(index.shape[1])
    for v in range(len(visits)):
        i, piece, cut = visits[v]
        box[v, :, 0], box[v, :, 1], box[v, :, 2], box[v, :, 3] = image[0].shape[1], 0, image[0].shape[0], 0
        running[0] = 0.0
        for b in range(bins):
            running[b + 1] = running[b] + spectra[i, b] * total[piece, b]
        if running[bins] > 0:
            key = keys[v]
            counter = np.uint64(0)
            entries = _fill(guide, running, maximum)
            nodes = cumulative(weight[i], sums)
            draw = running, guide[: entries + 1], shares[piece], between, first, step, nodes, index[i], lines[v]
            for c in range(2):
                place = x[i], y[i], matrix[i], profile[i, c], shapes, v, sides[piece], cut == 1
                mean = maximum * parts[i, c]
                if mean * running[bins] > _DENSE * bins:
                    counter = _by_bins(mean, draw, place, image, psf, tail, work, results, key, counter)
                    continue
                number, counter = poisson(mean * running[bins], key, counter)
                while number > 0:
                    count = min(number, _BATCH)
                    near, counter = _choose(count, draw, psf, work, key, counter)
                    counter = _land(near, count, place, image, psf, tail, work, results, key, counter)
                    number -= count
        for o in range(orders):
            if drawn[v, o] == 0:
                box[v, o] = 0


@numba.njit(cache=True)
def _fill(guide: IntArray, running: FloatArray, maximum: float) -> int:
    """Fill the guide: entry j is the bin at which the share j / entries of the light is reached; return `entries`."""
    bins = len(running) - 1
    light = running[-1]
    entries = 8
    while entries < _GUIDE and entries < 4 * maximum * light:
        entries *= 2
    b = 0
    for j in range(entries + 1):
        while b < bins - 1 and running[b + 1] * entries <= j * light:
            b += 1
        guide[j] = b
    return entries


@numba.njit(cache=True)
def _choose(
    number: int, draw: Draw, psf: Cells, work: Work, key: np.uint64, counter: np.uint64
) -> tuple[int, np.uint64]:
    """Choose each electron's bin, then call `_assign`; return (number inside the PSF's box, counter)."""
    running = draw[0]
    guide = draw[1]
    light = running[-1]
    entries = len(guide) - 1
    last = len(running) - 2
    near = 0
    far = number
    for _ in range(number):
        at = unit(word(key, counter))
        b = np.int64(guide[np.int64(at * entries)])
        at *= light
        while running[b + 1] <= at and b < last:
            b += 1
        near, far = _assign(b, near, far, draw, psf, work, key, counter + _ONE)  # type: ignore[arg-type]  # an int64 is an int to numba
        counter += _FOUR
    return near, counter


@numba.njit(cache=True)
def _by_bins(
    mean: float,
    draw: Draw,
    place: Place,
    image: Image,
    psf: Cells,
    tail: FloatArray,
    work: Work,
    results: Results,
    key: np.uint64,
    counter: np.uint64,
) -> np.uint64:
    """Draw an object of many electrons, with a Poisson number per node, PSF wavelength and bin; return the counter.

    mean: electrons per unit of the light in `running`.
    """
    running, _, shares, between, start, step, nodes, index, lines = draw
    first, order, _, _, shift_x, shift_y = work
    near = 0
    far = _BATCH
    before = 0.0
    for k in range(len(index)):
        weight = mean * (nodes[k] - before) / nodes[-1]
        before = nodes[k]
        for f in range(4 if weight > 0.0 else 0):
            node = index[k]
            inner = psf[1][node, f, 0]
            outer = psf[1][node, f, 1]
            word_inner = first_word(node, f, 0, psf[2])
            word_outer = first_word(node, f, 1, psf[2])
            for b in range(len(between)):
                light = weight * (1.0 - abs(between[b] - f)) * (running[b + 1] - running[b])
                if light <= 0.0:
                    continue
                number, counter = poisson(light, key, counter)
                share = shares[b]
                for _ in range(number):
                    bits = word(key, counter)
                    counter += _ONE
                    u = (np.float64(np.int64(bits >> _S36)) + 0.5) * _UNIT28
                    o = pick(share, (np.float64(np.int64(bits & _LOW26)) + 0.5) * _UNIT26)
                    wave = start + step * (b + (np.float64(np.int64((bits >> _S26) & _LOW10)) + 0.5) * _UNIT10)
                    inside = u < inner + outer
                    far -= np.int64(not inside)  # type: ignore[assignment]  # an int64 is an int to numba
                    slot = near if inside else far
                    near += np.int64(inside)  # type: ignore[assignment]  # an int64 is an int to numba
                    first[slot] = word_inner if u < inner else word_outer
                    order[slot] = o
                    shift_x[slot] = lines[o, 0] + lines[o, 1] * wave
                    shift_y[slot] = lines[o, 2] + lines[o, 3] * wave
                    if near == far:
                        counter = _land(near, _BATCH, place, image, psf, tail, work, results, key, counter)
                        near = 0
                        far = _BATCH
    # Electrons beyond the box are at the end of the arrays: move them up to the others
    count = near + _BATCH - far
    for j in range(_BATCH - far):
        for_j = near + j
        from_j = far + j
        first[for_j], order[for_j] = first[from_j], order[from_j]
        shift_x[for_j], shift_y[for_j] = shift_x[from_j], shift_y[from_j]
    return _land(near, count, place, image, psf, tail, work, results, key, counter)


@numba.njit(inline="always")
def _assign(
    b: int, near: int, far: int, draw: Draw, psf: Cells, work: Work, key: np.uint64, counter: np.uint64
) -> tuple[int, int]:
    """Draw wavelength, order, node and part of the PSF of an electron of bin b from three words; return (near, far).

    The first `near` entries of the work arrays are electrons in the PSF's box, those from `far` on are beyond it.
    """
    _, _, shares, between, start, step, nodes, index, lines = draw
    first, order, _, _, shift_x, shift_y = work
    one = word(key, counter)
    two = word(key, counter + _ONE)
    three = word(key, counter + _TWO)
    o = pick(shares[b], low(one))
    # The upper of the two wavelengths with probability equal to its weight, else the lower one
    node = index[pick(nodes, low(two) * nodes[-1])]
    f = np.int64(between[b] + high(two))
    wave = start + step * (b + low(three))
    u = high(three)
    inner, outer = psf[1][node, f]
    inside = u < inner + outer
    far -= np.int64(not inside)  # type: ignore[assignment]  # an int64 is an int to numba
    slot = near if inside else far
    first[slot] = first_word(node, f, np.int64(u >= inner), psf[2])  # type: ignore[arg-type]  # an int64 is an int to numba
    order[slot] = o
    shift_x[slot] = lines[o, 0] + lines[o, 1] * wave
    shift_y[slot] = lines[o, 2] + lines[o, 3] * wave
    return near + np.int64(inside), far  # type: ignore[return-value]  # an int64 is an int to numba


@numba.njit(cache=True)
def _land(
    near: int,
    number: int,
    place: Place,
    image: Image,
    psf: Cells,
    tail: FloatArray,
    work: Work,
    results: Results,
    key: np.uint64,
    counter: np.uint64,
) -> np.uint64:
    """Draw the positions of electrons, from `near` on in the wing, and count them; return the counter."""
    x, y, matrix, profile, shapes, v, side, cut = place
    first, order, px, py, shift_x, shift_y = work
    for part in range(2):
        begin, end = (0, near) if part == 0 else (near, number)
        count = end - begin
        if count == 0 or (part == 1 and tail.size == 0):
            continue
        ax = px[begin:end]
        ay = py[begin:end]
        keep = counter
        counter += _TWO * np.uint64(count)
        if part == 0:
            from_psf(count, psf, first, ax, ay, key, keep)
        else:
            counter = from_wing(count, tail, 0.5 * psf[3] / psf[4], ax, ay, key, counter)
        counter = from_profile(count, matrix, profile, shapes, ax, ay, key, counter)
        if cut:
            for j in range(count):
                u = x + ax[j]
                w = y + ay[j]
                if not (side[0] <= u < side[1] and side[2] <= w < side[3]):
                    ax[j] = _AWAY
        _count(
            count, x, y, ax, ay, shift_x[begin:end], shift_y[begin:end], order[begin:end], image, results, v, key, keep
        )
    return counter


@numba.njit(cache=True)
def _count(
    count: int,
    x: float,
    y: float,
    px: FloatArray,
    py: FloatArray,
    shift_x: FloatArray,
    shift_y: FloatArray,
    order: IntArray,
    image: Image,
    results: Results,
    v: int,
    key: np.uint64,
    counter: np.uint64,
) -> None:
    """Count the electrons that fall on the window and are kept."""
    counted, response, maximum = image
    drawn, box = results
    ny, nx = counted.shape
    # truncation then finds the pixel
    x = x + 0.5
    y = y + 0.5
    for j in range(count):
        u = px[j] + shift_x[j] + x
        w = py[j] + shift_y[j] + y
        if u >= 0 and w >= 0 and u < nx and w < ny:
            column = np.int64(u)
            row = np.int64(w)
            seen = response[row, column] if response.size > 0 else np.float32(1.0)
            kept = np.int64(high(word(key, counter + _TWO * np.uint64(j))) * maximum < seen)
            counted[row, column] += kept
            o = order[j]
            drawn[v, o] += kept
            # Rarely true: a branch is cheaper than a number that waits for the one before it
            if column < box[v, o, 0]:
                box[v, o, 0] = column
            if column >= box[v, o, 1]:
                box[v, o, 1] = column + 1
            if row < box[v, o, 2]:
                box[v, o, 2] = row
            if row >= box[v, o, 3]:
                box[v, o, 3] = row + 1
