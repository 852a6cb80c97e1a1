"""Photons: objects drawn electron by electron, straight into the counted plane.

An electron's place is that of the object, plus a draw from the profile under its 2 x 2 matrix, plus a draw from the
PSF. The PSF of a place is a mixture of nodes (optics.interpolation), so a node drawn with its weight is an exact draw,
as is a sub-band drawn with its share of the light. The number of an object's electrons is Poisson. Few of them choose
component, sub-band and node one by one; many are split beforehand into independent Poisson numbers: nothing is shot
twice and nothing is left to a later Poisson step.

Losses: numbers are drawn for `maximum` times the light, and an electron on a pixel is kept with probability
response / maximum. A thinned Poisson number is Poisson, so mean = variance holds for every pixel.

Electrons beyond the PSF's box follow the radial wing (optics.halo), all of it: none is lost because noise hides it.
"""

import numba
import numpy as np

from csstsim.counter import high, low, poisson, word
from csstsim.render.octaves import first_of, nodes, read
from csstsim.render.radius import RINGED, gamma, ring

_ONE, _TWO = np.uint64(1), np.uint64(2)
_S10, _S16, _S20, _S32 = (np.uint64(s) for s in (10, 16, 20, 32))
_MASK16, _LOW32 = np.uint64(0xFFFF), np.uint64(0xFFFFFFFF)
_TENS = np.uint64(0x3FF << 32 | 0x3FF)  # ten bits of each half of a word
_ANGLES = 1024  # between them first order: the radius grows by up to 5e-6
_TURN = np.stack([f(2 * np.pi / _ANGLES * (np.arange(_ANGLES) + 0.5)) for f in (np.cos, np.sin)], axis=1)
_REST = 2 * np.pi / 2.0**32
_DISK, _BULGE = RINGED
_MANY = 300.0  # electrons above which numbers are drawn for each (component, sub-band, node)
_BATCH = 512  # electrons drawn at a time, and the most that are chosen one by one: P(more) < 1e-25
_RAREST = -10  # octave of the share of the wing's light that ends its table, 1000 boxes out
_TAIL_FIRST = first_of(_RAREST)
_STRIP = 64  # px: objects of a node are drawn in strips, so that their pixels are in cache


def shoot_scene(counted, window, scene, keys, table, response=None, maximum=1.0, wing=None):
    """Draw the objects of a Scene into `counted` (int32, window.shape), changed in place.

    keys: (n,) uint64, all different (counter.object_keys). table: PsfTable with the tables of all nodes of the scene.
    response: (ny, nx) share of the light that is counted, at most `maximum`; None: all of it. wing: optics.halo.Wing,
    where electrons beyond the PSF's box go, or None: nowhere.
    Returns on_window (n,) int64, electrons counted; beyond (n,) int64, electrons, of `maximum` times the light, that
    fell outside the PSF's box; box (n, 4) int64, x0, x1, y0, y1 of the chip's pixels reached, half-open, 0 if none.
    The result does not depend on the order of the objects. Raises ValueError for arrays that do not fit, a response
    above the maximum, and what a Scene must not hold: numbers that are not finite, negative light, 2^31 electrons in an
    object, negative weights (a PSF interpolation that is not convex), nodes without tables.
    """
    if counted.shape != window.shape or counted.dtype != np.int32:
        raise ValueError(f"counted is {counted.dtype} {counted.shape}, not int32 {window.shape}")
    _check(scene, table, maximum)
    response = np.empty((0, 0), np.float32) if response is None else np.ascontiguousarray(response, np.float32)
    if response.size and (response.shape != window.shape or not response.max() <= maximum * (1 + 1e-6)):
        raise ValueError(f"the response must be {window.shape} and at most {maximum}")
    n = len(scene)
    on_window, beyond, box = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros((n, 4), np.int64)
    order = np.lexsort((scene.x, np.floor(scene.y / _STRIP), scene.node[:, 0])) if n else np.zeros(0, np.int64)
    floats = (scene.matrix, scene.light, scene.sersic, scene.electrons)
    objects = scene.x - window.x0, scene.y - window.y0, *(np.ascontiguousarray(a, np.float64) for a in floats)
    objects += np.ascontiguousarray(scene.node), np.ascontiguousarray(scene.weight), keys
    psf = table.words.reshape(-1), table.share, table.bits, table.cells, table.per_pixel
    tail = np.empty(0) if wing is None else _tail(wing, table.cells / table.per_pixel / 2)
    _shoot((counted, response, float(maximum)), objects, psf, tail, (on_window, beyond, box), order)
    box[on_window > 0] += np.array([window.x0, window.x0, window.y0, window.y0])
    return on_window, beyond, box


def _tail(wing, half):
    """Return the radii [px] beyond which a share u of the light outside radius `half` lies, on octaves of u to 1."""
    r = np.geomspace(half, half * 2.0**-_RAREST, 4096)
    share = wing.beyond(r).mean(axis=0)
    share /= share[0]
    return np.exp(np.interp(np.log(nodes(_RAREST, 0)), np.log(share[::-1]), np.log(r[::-1])))


def _check(scene, table, maximum):
    for name in ("x", "y", "electrons", "light", "sersic", "matrix", "weight"):
        values = getattr(scene, name)
        if not np.isfinite(values).all():
            raise ValueError(f"a value of {name} is not finite")
        if name in ("electrons", "light", "weight") and (values < 0).any():
            raise ValueError(f"a value of {name} is negative: it has no photons")
    if (maximum * scene.electrons.sum(axis=1) >= 2**31).any():
        raise ValueError("an object has more electrons than counted can hold")
    if not (table.share[scene.node[scene.weight > 0]].sum(axis=(1, 2)) > 0).all():
        raise ValueError("a PSF node has no tables")


@numba.njit(cache=True)
def _shoot(image, objects, psf, tail, results, order):
    counted, _, maximum = image
    x, y, matrix, light, sersic, electrons, index, weight, keys = objects
    share, sides = psf[1], psf[2]
    on_window, _, box = results
    work = np.empty(_BATCH, np.int64), np.empty(_BATCH), np.empty(_BATCH)
    sums = np.empty(4 + index.shape[1])
    for i in order:
        key, counter = keys[i], np.uint64(0)
        box[i] = counted.shape[1], 0, counted.shape[0], 0
        bands, nodes = _cumulative(electrons[i], sums[:4]), _cumulative(weight[i], sums[4:])
        for c in range(2):
            mean = maximum * light[i, c] * bands[3]
            place = x[i], y[i], matrix[i], sersic[i, c], i
            if not mean > 0:
                continue
            if mean < _MANY:
                number, counter = poisson(mean, key, counter)
                count, counter = _choose(min(number, _BATCH), bands, nodes, index[i], share, sides, key, counter, work)
                counter = _draw(count, place, image, psf, results, work, key, counter)
                counter = _draw_beyond(number - count, place, image, psf, tail, results, work, key, counter)
                continue
            lost = 0.0
            for k in range(index.shape[1]):
                for f in range(4):
                    node, here = index[i, k], maximum * light[i, c] * electrons[i, f] * weight[i, k]
                    lost += here * max(1.0 - share[node, f, 0] - share[node, f, 1], 0.0)
                    for part in range(2):
                        number, counter = poisson(here * share[node, f, part], key, counter)
                        work[0][: min(number, _BATCH)] = _first(node, f, part, sides)
                        while number > 0:
                            count = min(number, _BATCH)
                            counter = _draw(count, place, image, psf, results, work, key, counter)
                            number -= count
            number, counter = poisson(lost, key, counter)
            counter = _draw_beyond(number, place, image, psf, tail, results, work, key, counter)
        if on_window[i] == 0:
            box[i] = 0


@numba.njit(cache=True)
def _choose(number, bands, nodes, index, share, sides, key, counter, work):
    """Choose node, sub-band and part for each of few electrons; return (those in the box, counter)."""
    first, count = work[0], 0
    for _ in range(number):
        which, u = word(key, counter), high(word(key, counter + _ONE))
        counter += _TWO
        f, k = _pick(bands, high(which) * bands[3]), _pick(nodes, low(which) * nodes[-1])
        inner, outer = share[index[k], f]
        first[count] = _first(index[k], f, np.int64(u >= inner), sides)
        count += np.int64(u < inner + outer)
    return count, counter


@numba.njit(inline="always")
def _first(node, f, part, sides):
    """Return twice the place in the words of the first of a table, plus part; part 0 is the middle."""
    inner, outer = 1 << 2 * sides[0], 1 << 2 * sides[1]
    return 2 * ((4 * node + f) * (inner + outer) + part * inner) + part


@numba.njit(inline="always")
def _cumulative(values, sums):
    total = 0.0
    for j in range(len(values)):
        total += values[j]
        sums[j] = total
    return sums


@numba.njit(inline="always")
def _pick(cumulative, u):
    """Return how many entries u has passed: no branch on the outcome, which no processor could foresee."""
    passed = 0
    for j in range(len(cumulative) - 1):
        passed += np.int64(u >= cumulative[j])
    return passed


@numba.njit(cache=True)
def _draw(count, place, image, psf, results, work, key, counter):
    """Draw the electrons whose tables stand in `work`, three short loops over all; return the counter."""
    x, y, matrix, sersic, i = place
    first, px, py = work
    _from_psf(count, psf, first, px, py, key, counter)
    after = counter + _TWO * np.uint64(count)
    if sersic[0] > 0:
        after = _from_profile(count, matrix, sersic, px, py, key, after)
    _count(count, x, y, px, py, image, results, i, key, counter)
    return after


@numba.njit(cache=True)
def _draw_beyond(number, place, image, psf, tail, results, work, key, counter):
    """Draw electrons of the wing beyond the PSF's box, and count that they are; return the counter."""
    x, y, matrix, sersic, i = place
    _, px, py = work
    results[1][i] += number
    half = 0.5 * psf[3] / psf[4]
    while number > 0 and tail.size > 0:
        count = min(number, _BATCH)
        after = _from_wing(count, tail, half, px, py, key, counter + _TWO * np.uint64(count))
        if sersic[0] > 0:
            after = _from_profile(count, matrix, sersic, px, py, key, after)
        _count(count, x, y, px, py, image, results, i, key, counter)
        counter = after
        number -= count
    return counter


@numba.njit(cache=True)
def _from_wing(count, tail, half, px, py, key, counter):
    """Set px, py [pixel] to places of the wing outside the square of this half side; return the counter."""
    share = np.empty(1)
    bits = share.view(np.int64)
    for j in range(count):
        px[j] = py[j] = 0.0
        while abs(px[j]) < half and abs(py[j]) < half:
            draw = word(key, counter)
            counter += _ONE
            share[0] = high(draw)
            r, angle = read(tail, _TAIL_FIRST, bits[0]), 2 * np.pi * low(draw)
            px[j], py[j] = r * np.cos(angle), r * np.sin(angle)
    return counter


@numba.njit(cache=True)
def _from_psf(count, psf, first, px, py, key, counter):
    """Set px, py [pixel] to draws from the PSF: two words each, whose upper first half is not used."""
    words, _, sides, cells, per_pixel = psf
    inner, outer = sides
    scale = 1.0 / (1024 * per_pixel)
    # The middle of the table is the middle of the PSF
    corner_inner, corner_outer = 1.5 - 1024 * (1 + 0.5 * (1 << inner)), 1.5 - 1024 * (1 + 0.5 * cells)
    for j in range(count):
        at = counter + _TWO * np.uint64(j)
        bits, jitter = word(key, at), word(key, at + _ONE)
        start, part = first[j] >> 1, first[j] & 1
        side, corner = (outer, corner_outer) if part else (inner, corner_inner)
        slot = np.int64(bits) & ((1 << 2 * side) - 1)
        entry = np.int64(words[np.uint64(start + slot)])
        cell = slot if np.int64((bits >> _S16) & _MASK16) < (entry >> 16) else entry & 0xFFFF
        # A draw from the quadratic B-spline is the sum of three uniforms: 3 x 10 bits in each half of the word
        spline = (jitter & _TENS) + ((jitter >> _S10) & _TENS) + ((jitter >> _S20) & _TENS)
        column, row = cell & ((1 << side) - 1), cell >> side
        px[j] = (np.float64((column << 10) + np.int64(spline & _LOW32)) + corner) * scale
        py[j] = (np.float64((row << 10) + np.int64(spline >> _S32)) + corner) * scale


@numba.njit(cache=True)
def _from_profile(count, matrix, sersic, px, py, key, counter):
    """Add to px, py draws from a Sersic profile; return the counter."""
    n, b, radius = sersic[0], sersic[1], sersic[2]
    m00, m01, m10, m11 = matrix[0, 0] * radius, matrix[0, 1] * radius, matrix[1, 0] * radius, matrix[1, 1] * radius
    rings = 0 if n == _DISK else 1 if n == _BULGE else -1
    after = counter + np.uint64(count)
    for j in range(count):
        turn = word(key, counter + np.uint64(j))
        if rings >= 0:
            r = ring(rings, turn)
        else:
            r, after = gamma(2 * n, key, after)
            r = (r / b) ** n
        angle = np.int64(turn >> _S32)
        a, d = np.uint64(angle >> 22), np.float64((angle & 0x3FFFFF) - 0x200000) * _REST
        cos, sin = r * (_TURN[a, 0] - d * _TURN[a, 1]), r * (_TURN[a, 1] + d * _TURN[a, 0])
        px[j] += m00 * cos + m01 * sin
        py[j] += m10 * cos + m11 * sin
    return after


@numba.njit(cache=True)
def _count(count, x, y, px, py, image, results, i, key, counter):
    """Count the electrons that fall on the window and are kept."""
    counted, response, maximum = image
    on_window, _, box = results
    ny, nx = counted.shape
    x, y = x + 0.5, y + 0.5  # truncation then finds the pixel
    hit, x0, x1, y0, y1 = 0, box[i, 0], box[i, 1] - 1, box[i, 2], box[i, 3] - 1
    for j in range(count):
        u, v = px[j] + x, py[j] + y
        if u >= 0 and v >= 0 and u < nx and v < ny:
            column, row = np.uint64(np.int64(u)), np.uint64(np.int64(v))
            kept = 1
            if response.size > 0:
                bits = word(key, counter + _TWO * np.uint64(j))
                kept = np.int64(high(bits) * maximum < response[row, column])
            counted[row, column] += kept
            hit += kept
            x0, x1 = min(x0, np.int64(column)), max(x1, np.int64(column))
            y0, y1 = min(y0, np.int64(row)), max(y1, np.int64(row))
    on_window[i] += hit
    box[i, 0], box[i, 1], box[i, 2], box[i, 3] = x0, x1 + 1, y0, y1 + 1
