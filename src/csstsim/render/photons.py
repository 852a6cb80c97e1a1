"""Photons: objects drawn electron by electron, straight into the counted plane.

An electron's place is that of the object, plus a draw from the profile under its 2 x 2 matrix, plus a draw from the
PSF. The PSF of a place is a mixture of nodes (optics.interpolation), so a node drawn with its weight is an exact draw,
as is a sub-band drawn with its share of the light. The number of an object's electrons is Poisson. Few of them choose
component, sub-band and node one by one; many are split beforehand into independent Poisson numbers: nothing is shot
twice and nothing is left to a later Poisson step.

Losses: numbers are drawn for `maximum` times the light, and an electron on a pixel is kept with probability
response / maximum. A thinned Poisson number is Poisson, so mean = variance holds for every pixel.

Left out: electrons beyond the box of the PSF, which are counted.
"""

import numba
import numpy as np

from csstsim.render.counter import high, low, poisson, word
from csstsim.render.radius import RINGED, gamma, ring

_ONE, _TWO = np.uint64(1), np.uint64(2)
_S10, _S16, _S20, _S32 = (np.uint64(s) for s in (10, 16, 20, 32))
_MASK16, _LOW32 = np.uint64(0xFFFF), np.uint64(0xFFFFFFFF)
_UNIT32 = 2.0**-32
_TENS = np.uint64(0x3FF << 32 | 0x3FF)  # ten bits of each half of a word
_ANGLES = 1024  # between them first order: the radius grows by up to 5e-6
_TURN = np.stack([f(2 * np.pi / _ANGLES * (np.arange(_ANGLES) + 0.5)) for f in (np.cos, np.sin)], axis=1)
_REST = 2 * np.pi / 2.0**32
_DISK, _BULGE = RINGED
_POINT, _GAMMA = -1, len(RINGED)  # kinds of profile, the others being the rings
_MANY = 300.0  # electrons above which numbers are drawn for each (component, sub-band, node)
_RUNS = 1024  # electrons such an object may have: P(more) < 1e-100
_STRIP = 64  # px: objects of a node are drawn in strips, so that their pixels are in cache


def shoot_scene(counted, window, scene, keys, table, response=None, maximum=1.0):
    """Draw the objects of a Scene into `counted` (int32, window.shape), changed in place.

    keys: (n,) uint64, all different (counter.object_keys). table: PsfTable with the tables of all nodes of the scene.
    response: (ny, nx) share of the light that is counted, at most `maximum`; None: all of it.
    Returns on_window (n,) int64, electrons counted; beyond (n,) int64, electrons, of `maximum` times the light, that
    fell outside the PSF's box; box (n, 4) int64, x0, x1, y0, y1 of the chip's pixels touched, half-open, 0 if none.
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
    _shoot(
        counted, response, float(maximum), order, scene.x - window.x0, scene.y - window.y0,
        *(np.ascontiguousarray(a, np.float64) for a in (scene.matrix, scene.light, scene.sersic, scene.electrons)),
        np.ascontiguousarray(scene.node), np.ascontiguousarray(scene.weight), keys,
        table.words.reshape(-1), table.share, table.bits, table.cells, table.per_pixel, on_window, beyond, box,
    )  # fmt: skip
    box[on_window > 0] += np.array([window.x0, window.x0, window.y0, window.y0])
    return on_window, beyond, box


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
def _shoot(
    counted, response, maximum, order, x, y, matrix, light, sersic, electrons, index, weight, keys, words, share, sides,
    cells, per_pixel, on_window, beyond, box,
):  # fmt: skip
    runs = np.empty((_RUNS + 16 * index.shape[1], 4), np.int64)  # component, part, first word of the table, electrons
    sums = np.empty(4 + index.shape[1])
    middle = 0.5 * (1 << sides[0]), 0.5 * cells
    for i in order:
        key, mean = keys[i], 0.0
        for f in range(4):
            mean += maximum * electrons[i, f]
        if not mean > 0:
            continue
        source = light[i], electrons[i], index[i], weight[i], sums
        if mean < _MANY:
            count, beyond[i], counter = _one_by_one(mean, source, share, sides, key, np.uint64(0), runs)
        else:
            count, beyond[i], counter = _independent(mean, source, share, sides, key, np.uint64(0), runs)
        on_window[i] = _place(
            counted, response, maximum, x[i], y[i], matrix[i], sersic[i], words, sides, middle, per_pixel, key, counter,
            runs[:count], box[i],
        )  # fmt: skip


@numba.njit(cache=True)
def _one_by_one(mean, source, share, sides, key, counter, runs):
    """Choose component, node and sub-band of each electron. Return (runs, electrons beyond the box, counter)."""
    light, electrons, index, weight, sums = source
    number, counter = poisson(mean, key, counter)
    bands, nodes = _cumulative(electrons, sums[:4]), _cumulative(weight, sums[4:])
    count, lost = 0, 0
    for _ in range(min(number, _RUNS)):
        which, how = word(key, counter), word(key, counter + _ONE)
        counter += _TWO
        f, k = _pick(bands, high(which) * bands[3]), _pick(nodes, low(which))
        node, u = index[k], low(how)
        part = 0 if u < share[node, f, 0] else 1
        if u < share[node, f, 0] + share[node, f, 1]:
            runs[count, 0], runs[count, 1] = 0 if high(how) < light[0] else 1, part
            runs[count, 2], runs[count, 3] = _first(node, f, part, sides), 1
            count += 1
        else:
            lost += 1
    return count, lost, counter


@numba.njit(cache=True)
def _independent(mean, source, share, sides, key, counter, runs):
    """Draw the electrons of each component, node and sub-band. Return (runs, electrons beyond the box, counter)."""
    light, electrons, index, weight, _ = source
    scale = mean / electrons.sum()
    count, beyond = 0, 0.0
    for k in range(len(index)):
        for f in range(4):
            node, light_here = index[k], scale * electrons[f] * weight[k]
            beyond += light_here * max(1.0 - share[node, f, 0] - share[node, f, 1], 0.0)
            for c in range(2):
                for part in range(2):
                    expected = light_here * light[c] * share[node, f, part]
                    if expected > 0:
                        number, counter = poisson(expected, key, counter)
                        runs[count, 0], runs[count, 1] = c, part
                        runs[count, 2], runs[count, 3] = _first(node, f, part, sides), number
                        count += 1
    lost, counter = poisson(beyond, key, counter)
    return count, lost, counter


@numba.njit(inline="always")
def _first(node, f, part, sides):
    """Return the place in the words of the first of a table; part 0 is the middle."""
    inner, outer = 1 << 2 * sides[0], 1 << 2 * sides[1]
    return (4 * node + f) * (inner + outer) + part * inner


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
def _place(
    counted, response, maximum, x, y, matrix, sersic, words, sides, middle, per_pixel, key, counter, runs, box
):  # fmt: skip
    """Draw the electrons of one object; return how many were counted, and in `box` where."""
    ny, nx = counted.shape
    thinned = response.size > 0
    scale = 1.0 / (1024 * per_pixel)
    hit, x_low, x_high, y_low, y_high = 0, nx, -1, ny, -1
    for run in range(len(runs)):
        c, part, first = runs[run, 0], runs[run, 1], runs[run, 2]
        side = sides[part]
        slots, columns = np.uint64((1 << 2 * side) - 1), (1 << side) - 1
        # The middle of the table on the object; half a pixel, so that truncation finds the pixel
        corner = 0.5 + (1.5 - 1024 * (1 + middle[part])) * scale
        n, b, radius = sersic[c, 0], sersic[c, 1], sersic[c, 2]
        kind = _POINT if n == 0 else 0 if n == _DISK else 1 if n == _BULGE else _GAMMA
        for _ in range(runs[run, 3]):
            bits, jitter = word(key, counter), word(key, counter + _ONE)
            counter += _TWO
            slot = np.int64(bits & slots)
            entry = np.int64(words[np.uint64(first + slot)])
            cell = slot if np.int64((bits >> _S16) & _MASK16) < (entry >> 16) else entry & 0xFFFF
            # A draw from the quadratic B-spline is the sum of three uniforms: 3 x 10 bits in each half of the word
            spline = (jitter & _TENS) + ((jitter >> _S10) & _TENS) + ((jitter >> _S20) & _TENS)
            px = x + corner + np.float64(((cell & columns) << 10) + np.int64(spline & _LOW32)) * scale
            py = y + corner + np.float64(((cell >> side) << 10) + np.int64(spline >> _S32)) * scale
            if kind != _POINT:
                turn = word(key, counter)
                counter += _ONE
                if kind == _GAMMA:
                    r, counter = gamma(2 * n, key, counter)
                    r = (r / b) ** n
                else:
                    r = ring(kind, turn)
                r *= radius
                angle = np.int64(turn >> _S32)
                a, d = np.uint64(angle >> 22), ((angle & 0x3FFFFF) - 0x200000) * _REST
                cos, sin = r * (_TURN[a, 0] - d * _TURN[a, 1]), r * (_TURN[a, 1] + d * _TURN[a, 0])
                px += matrix[0, 0] * cos + matrix[0, 1] * sin
                py += matrix[1, 0] * cos + matrix[1, 1] * sin
            if px >= 0 and py >= 0 and px < nx and py < ny:
                column, row = np.int64(px), np.int64(py)
                kept = 1
                if thinned:  # no branch on the outcome, which no processor could foresee
                    kept = np.int64(high(bits) * maximum < response[np.uint64(row), np.uint64(column)])
                counted[np.uint64(row), np.uint64(column)] += kept
                hit += kept
                x_low, x_high = min(x_low, column), max(x_high, column)
                y_low, y_high = min(y_low, row), max(y_high, row)
    if hit > 0:
        box[0], box[1], box[2], box[3] = x_low, x_high + 1, y_low, y_high + 1
    return hit
