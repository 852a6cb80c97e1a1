"""Photons through a grating: draw the wavelength and order of each electron, then its position, then shift it.

The wavelength follows spectrum x (throughput of all orders). The order is drawn by its fraction at that wavelength, the
PSF node by its weight, and one of the two nearest PSF wavelengths by weight (optics.gratings.dispersion); all are exact
draws from a mixture. The position without the grating (object + profile + PSF) decides which of the two gratings
disperses the electron: an object whose light reaches the edge of a piece visits both pieces, and each visit drops the
electrons that fall outside its piece. The electron is then shifted to

    x + p + q lambda,   y + r + s lambda,

with p, q, r, s at the object's centre; they change by a thousandth across a galaxy of 10". Numbers are Poisson and
thinned by losses as in render.imaging.photons.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.counter import high, low, poisson, unit, word
from csstsim.base.types import FloatArray, IntArray
from csstsim.render.photon_positions import (
    CountedImage,
    Profile,
    PsfSampler,
    SceneProfiles,
    check_scene,
    contiguous,
    cumulative,
    first_word,
    from_profile,
    from_psf,
    from_wing,
    pick,
    profiles_of,
    sampler_of,
)

if TYPE_CHECKING:
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.optics.scatter.halo import Wing
    from csstsim.render.canvas import Canvas
    from csstsim.render.psf_table import PsfTable
    from csstsim.render.scene import Scene
    from csstsim.render.slitless.traces import Traces

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


class _Objects(NamedTuple):
    """The arrays of a Scene (n, ...) that compiled loops need; x, y [px of the window]."""

    x: FloatArray
    y: FloatArray
    matrix: FloatArray
    light: FloatArray
    node: IntArray
    weight: FloatArray


class _Visits(NamedTuple):
    """v visits of objects to pieces of the grating.

    * visit: (v, 3), object, piece, whether the piece's edge cuts its light
    * key: (v,) uint64
    * lines: (v, orders, 4), p, q, r, s
    """

    visit: IntArray
    key: IntArray
    lines: FloatArray


class _Optics(NamedTuple):
    """What gratings and spectra have in common.

    * spectra: (n, bins)
    * rates: (2, bins), of all orders of each piece
    * order_fractions: (2, bins, orders) float32, running sums over orders of their fractions of `rates`
    * psf_wave: (bins,) float32, position of each bin among the wavelengths of the PSF set, 0 to 3
    * first_wave, step: first edge and width of the bins [angstrom]
    * sides: (2, 4), x0, x1, y0, y1 of the pieces [px of the window]
    """

    spectra: FloatArray
    rates: FloatArray
    order_fractions: FloatArray
    psf_wave: FloatArray
    first_wave: float
    step: float
    sides: FloatArray


class _Mixture(NamedTuple):
    """What wavelength, order and PSF node of a visit's electrons are drawn from.

    * running: (bins + 1,), running sums of the electrons of bins
    * guide: entries of `_fill`
    * order_fractions: (bins, orders), see `_Optics`, as for psf_wave, first_wave and step
    * nodes: (k,), running sums of the weights of `node`
    * lines: (orders, 4), p, q, r, s
    """

    running: FloatArray
    guide: IntArray
    order_fractions: FloatArray
    psf_wave: FloatArray
    first_wave: float
    step: float
    nodes: FloatArray
    node: IntArray
    lines: FloatArray


class _Component(NamedTuple):
    """A component of the object of visit number `visit`, at x, y [px of the window].

    cut: whether electrons outside `side` (x0, x1, y0, y1) are dropped before they are dispersed.
    """

    visit: int
    x: float
    y: float
    profile: Profile
    side: FloatArray
    cut: bool


class _Batch(NamedTuple):
    """Electrons drawn together (_BATCH,): table (`first_word`), order, position from the object and shift [px]."""

    first: IntArray
    order: IntArray
    px: FloatArray
    py: FloatArray
    shift_x: FloatArray
    shift_y: FloatArray


class ShotSpectra(NamedTuple):
    """The electrons of v visits, by order.

    * drawn: (v, orders) int64, counted on the window
    * box: (v, orders, 4) int64, x0, x1, y0, y1 of the pixels reached, half-open; 0 if none
    """

    drawn: IntArray
    box: IntArray


def shoot_spectra(
    canvas: Canvas, scene: Scene, traces: Traces, keys: IntArray, table: PsfTable, wing: Wing | None = None
) -> ShotSpectra:
    """Draw the orders of a Scene's objects into the counted plane of a Canvas, which must be there.

    traces: Traces of the objects; keys: (v,) uint64 of their visits, all different; scene.electrons is not used. table,
    wing: as render.imaging.photons.shoot_scene. The boxes are of pixels of the chip. The result does not depend on the
    order of the visits. Raises ValueError, as shoot_scene, and for a spectrum that is negative or not finite.
    """
    spectra = traces.spectra
    visits = traces.visits
    disperser = traces.disperser
    window = canvas.window
    assert canvas.counted is not None
    check_scene(scene, table, canvas.maximum)
    if not _usable(spectra):
        raise ValueError("a spectrum is negative or not finite")
    orders = len(disperser.orders)
    count = len(visits)
    shot = ShotSpectra(np.zeros((count, orders), np.int64), np.zeros((count, orders, 4), np.int64))
    image = CountedImage(canvas.counted, contiguous(canvas.response), float(canvas.maximum))
    objects = _Objects(
        scene.x - window.x0,
        scene.y - window.y0,
        np.ascontiguousarray(scene.matrix, np.float64),
        np.ascontiguousarray(scene.component_fractions, np.float64),
        np.ascontiguousarray(scene.node),
        np.ascontiguousarray(scene.weight, np.float64),
    )
    lines = disperser.lines(visits, scene.x, scene.y)
    optics = _optics(spectra, disperser, disperser.rectangles - canvas.corner)
    visited = _Visits(np.ascontiguousarray(visits), keys, lines)
    _shoot(image, objects, profiles_of(scene), optics, visited, sampler_of(table, wing), shot)
    shot.box[shot.drawn > 0] += canvas.corner
    return shot


@numba.njit(cache=True)
def _usable(spectra: FloatArray) -> bool:
    """Whether no value of `spectra` (n, bins) is negative or not finite."""
    wrong = 0
    for i in range(len(spectra)):
        for value in spectra[i]:
            wrong += not 0.0 <= value < np.inf
    return wrong == 0


def _optics(spectra: FloatArray, disperser: Disperser, sides: FloatArray) -> _Optics:
    """Return the _Optics of spectra (n, bins) and a Disperser."""
    rates = disperser.rates
    total = rates.sum(axis=1)
    running = (np.cumsum(rates, axis=1) / np.where(total > 0, total, 1.0)[:, None]).astype(np.float32)
    lower, upper = disperser.psf_mixture
    return _Optics(
        np.ascontiguousarray(spectra, np.float64),
        total,
        running.transpose(0, 2, 1).copy(),
        (lower + upper).astype(np.float32),
        float(disperser.edges[0]),
        float(np.diff(disperser.edges[:2])[0]),
        sides,
    )


@numba.njit(cache=True)
def _shoot(
    image: CountedImage,
    objects: _Objects,
    profiles: SceneProfiles,
    optics: _Optics,
    visits: _Visits,
    psf: PsfSampler,
    shot: ShotSpectra,
) -> None:
    """Draw the visits, and write what was drawn to `shot`."""
    ny, nx = image.counted.shape
    bins = optics.spectra.shape[1]
    orders = shot.drawn.shape[1]
    running = np.empty(bins + 1)
    guide = np.empty(_GUIDE + 1, np.uint16)
    floats = np.empty((4, _BATCH))  # px, py and the shifts
    batch = _Batch(np.empty(_BATCH, np.int64), np.empty(_BATCH, np.int64), floats[0], floats[1], floats[2], floats[3])
    sums = np.empty(objects.node.shape[1])
    for v in range(len(visits.visit)):
        i, piece, cut = visits.visit[v]
        shot.box[v, :, 0] = nx
        shot.box[v, :, 1] = 0
        shot.box[v, :, 2] = ny
        shot.box[v, :, 3] = 0
        running[0] = 0.0
        for b in range(bins):
            running[b + 1] = running[b] + optics.spectra[i, b] * optics.rates[piece, b]
        if running[bins] > 0:
            key = visits.key[v]
            counter = np.uint64(0)
            entries = _fill(guide, running, image.maximum)
            mixture = _Mixture(
                running,
                guide[: entries + 1],
                optics.order_fractions[piece],
                optics.psf_wave,
                optics.first_wave,
                optics.step,
                cumulative(objects.weight[i], sums),
                objects.node[i],
                visits.lines[v],
            )
            for c in range(2):
                profile = Profile(
                    objects.matrix[i],
                    profiles.kind[i, c],
                    profiles.fraction[i, c],
                    profiles.radius[i, c],
                    profiles.tables,
                )
                component = _Component(v, objects.x[i], objects.y[i], profile, optics.sides[piece], cut == 1)
                mean = image.maximum * objects.light[i, c]
                if mean * running[bins] > _DENSE * bins:
                    counter = _by_bins(mean, mixture, component, image, psf, shot, batch, key, counter)
                    continue
                number, counter = poisson(mean * running[bins], key, counter)
                while number > 0:
                    count = min(number, _BATCH)
                    near, counter = _choose(count, mixture, psf, batch, key, counter)
                    counter = _add_electrons(near, count, component, image, psf, shot, batch, key, counter)
                    number -= count
        for o in range(orders):
            if shot.drawn[v, o] == 0:
                shot.box[v, o] = 0


@numba.njit(cache=True)
def _fill(guide: IntArray, running: FloatArray, maximum: float) -> int:
    """Fill the guide: entry j is the bin at which the fraction j / entries of the flux is reached; return `entries`."""
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
    number: int, mixture: _Mixture, psf: PsfSampler, batch: _Batch, key: np.uint64, counter: np.uint64
) -> tuple[int, np.uint64]:
    """Choose each electron's bin, then call `_assign`; return (number inside the PSF's box, counter)."""
    running = mixture.running
    guide = mixture.guide
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
        near, far = _assign(b, near, far, mixture, psf, batch, key, counter + _ONE)  # type: ignore[arg-type]  # an int64 is an int to numba
        counter += _FOUR
    return near, counter


@numba.njit(cache=True)
def _by_bins(
    mean: float,
    mixture: _Mixture,
    component: _Component,
    image: CountedImage,
    psf: PsfSampler,
    shot: ShotSpectra,
    batch: _Batch,
    key: np.uint64,
    counter: np.uint64,
) -> np.uint64:
    """Draw an object of many electrons, with a Poisson number per node, PSF wavelength and bin; return the counter.

    mean: electrons to draw for one of `mixture.running`.
    """
    running = mixture.running
    nodes = mixture.nodes
    psf_wave = mixture.psf_wave
    lines = mixture.lines
    first = batch.first
    order = batch.order
    shift_x = batch.shift_x
    shift_y = batch.shift_y
    near = 0
    far = _BATCH
    before = 0.0
    for k in range(len(mixture.node)):
        weight = mean * (nodes[k] - before) / nodes[-1]
        before = nodes[k]
        for f in range(4 if weight > 0.0 else 0):
            node = mixture.node[k]
            inner = psf.fraction[node, f, 0]
            outer = psf.fraction[node, f, 1]
            word_inner = first_word(psf, node, f, 0)
            word_outer = first_word(psf, node, f, 1)
            for b in range(len(psf_wave)):
                light = weight * (1.0 - abs(psf_wave[b] - f)) * (running[b + 1] - running[b])
                if light <= 0.0:
                    continue
                number, counter = poisson(light, key, counter)
                fractions = mixture.order_fractions[b]
                for _ in range(number):
                    bits = word(key, counter)
                    counter += _ONE
                    u = (np.float64(np.int64(bits >> _S36)) + 0.5) * _UNIT28
                    o = pick(fractions, (np.float64(np.int64(bits & _LOW26)) + 0.5) * _UNIT26)
                    within = (np.float64(np.int64((bits >> _S26) & _LOW10)) + 0.5) * _UNIT10
                    wave = mixture.first_wave + mixture.step * (b + within)
                    inside = u < inner + outer
                    far -= np.int64(not inside)  # type: ignore[assignment]  # an int64 is an int to numba
                    slot = near if inside else far
                    near += np.int64(inside)  # type: ignore[assignment]  # an int64 is an int to numba
                    first[slot] = word_inner if u < inner else word_outer
                    order[slot] = o
                    shift_x[slot] = lines[o, 0] + lines[o, 1] * wave
                    shift_y[slot] = lines[o, 2] + lines[o, 3] * wave
                    if near == far:
                        counter = _add_electrons(near, _BATCH, component, image, psf, shot, batch, key, counter)
                        near = 0
                        far = _BATCH
    # Electrons beyond the box are at the end of the arrays: move them up to the others
    count = near + _BATCH - far
    for j in range(_BATCH - far):
        target = near + j
        source = far + j
        first[target] = first[source]
        order[target] = order[source]
        shift_x[target] = shift_x[source]
        shift_y[target] = shift_y[source]
    return _add_electrons(near, count, component, image, psf, shot, batch, key, counter)


@numba.njit(inline="always")
def _assign(
    b: int,
    near: int,
    far: int,
    mixture: _Mixture,
    psf: PsfSampler,
    batch: _Batch,
    key: np.uint64,
    counter: np.uint64,
) -> tuple[int, int]:
    """Draw wavelength, order, node and part of the PSF of an electron of bin b from three words; return (near, far).

    The first `near` entries of the batch are electrons in the PSF's box, those from `far` on are beyond it.
    """
    lines = mixture.lines
    nodes = mixture.nodes
    one = word(key, counter)
    two = word(key, counter + _ONE)
    three = word(key, counter + _TWO)
    o = pick(mixture.order_fractions[b], low(one))
    # The upper of the two wavelengths with probability equal to its weight, else the lower one
    node = mixture.node[pick(nodes, low(two) * nodes[-1])]
    f = np.int64(mixture.psf_wave[b] + high(two))
    wave = mixture.first_wave + mixture.step * (b + low(three))
    u = high(three)
    inner, outer = psf.fraction[node, f]
    inside = u < inner + outer
    far -= np.int64(not inside)  # type: ignore[assignment]  # an int64 is an int to numba
    slot = near if inside else far
    batch.first[slot] = first_word(psf, node, f, np.int64(u >= inner))  # type: ignore[arg-type]  # an int64 is an int to numba
    batch.order[slot] = o
    batch.shift_x[slot] = lines[o, 0] + lines[o, 1] * wave
    batch.shift_y[slot] = lines[o, 2] + lines[o, 3] * wave
    return near + np.int64(inside), far  # type: ignore[return-value]  # an int64 is an int to numba


@numba.njit(cache=True)
def _add_electrons(
    near: int,
    number: int,
    component: _Component,
    image: CountedImage,
    psf: PsfSampler,
    shot: ShotSpectra,
    batch: _Batch,
    key: np.uint64,
    counter: np.uint64,
) -> np.uint64:
    """Draw the positions of electrons, from `near` on in the wing, and count them; return the counter."""
    x0, x1, y0, y1 = component.side
    for part in range(2):
        begin, end = (0, near) if part == 0 else (near, number)
        count = end - begin
        if count == 0 or (part == 1 and psf.tail.size == 0):
            continue
        selected = _Batch(
            batch.first[begin:end],
            batch.order[begin:end],
            batch.px[begin:end],
            batch.py[begin:end],
            batch.shift_x[begin:end],
            batch.shift_y[begin:end],
        )
        keep = counter
        counter += _TWO * np.uint64(count)
        if part == 0:
            from_psf(count, psf, selected.first, selected.px, selected.py, key, keep)
        else:
            counter = from_wing(count, psf, selected.px, selected.py, key, counter)
        counter = from_profile(count, component.profile, selected.px, selected.py, key, counter)
        if component.cut:
            for j in range(count):
                u = component.x + selected.px[j]
                w = component.y + selected.py[j]
                if not (x0 <= u < x1 and y0 <= w < y1):
                    selected.px[j] = _AWAY
        _count(count, component, selected, image, shot, key, keep)
    return counter


@numba.njit(cache=True)
def _count(
    count: int,
    component: _Component,
    batch: _Batch,
    image: CountedImage,
    shot: ShotSpectra,
    key: np.uint64,
    counter: np.uint64,
) -> None:
    """Count the electrons that fall on the window and are kept."""
    counted = image.counted
    response = image.response
    maximum = image.maximum
    box = shot.box
    v = component.visit
    ny, nx = counted.shape
    # truncation then finds the pixel
    x = component.x + 0.5
    y = component.y + 0.5
    for j in range(count):
        u = batch.px[j] + batch.shift_x[j] + x
        w = batch.py[j] + batch.shift_y[j] + y
        if u >= 0 and w >= 0 and u < nx and w < ny:
            column = np.int64(u)
            row = np.int64(w)
            seen = response[row, column] if response.size > 0 else np.float32(1.0)
            detected = np.int64(high(word(key, counter + _TWO * np.uint64(j))) * maximum < seen)
            counted[row, column] += detected
            o = batch.order[j]
            shot.drawn[v, o] += detected
            # Rarely true: a branch is cheaper than a number that waits for the one before it
            if column < box[v, o, 0]:
                box[v, o, 0] = column
            if column >= box[v, o, 1]:
                box[v, o, 1] = column + 1
            if row < box[v, o, 2]:
                box[v, o, 2] = row
            if row >= box[v, o, 3]:
                box[v, o, 3] = row + 1
