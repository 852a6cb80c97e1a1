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
_MASK16, _MASK20, _LOW32 = (np.uint64(2**b - 1) for b in (16, 20, 32))
_TENS = np.uint64(0x3FF << 32 | 0x3FF)  # ten bits of each half of a word
_ANGLES = 4096
_ANGLE = 2 * np.pi / _ANGLES * (np.arange(_ANGLES) + 0.5)
_REST = 2 * np.pi / _ANGLES * 2.0**-20
_COS, _SIN = np.cos(_ANGLE), np.sin(_ANGLE)
_DISK, _BULGE = RINGED
_POINT, _GAMMA = -1, len(RINGED)  # kinds of profile, the others being the rings
_MANY = 400.0  # electrons above which numbers are drawn for each (component, sub-band, node)
_STRIP = 64  # px: objects of a node are drawn in strips, so that their pixels are in cache


def shoot_scene(counted, window, scene, keys, table, response=None, maximum=1.0):
    """Draw the objects of a Scene into `counted` (int32, window.shape), changed in place.

    keys: (n,) uint64, all different (counter.object_keys). table: PsfTable with the tables of all nodes of the scene.
    response: (ny, nx) share of the light that is counted, at most `maximum`; None: all of it.
    Returns on_window (n,) int64, electrons counted; beyond (n,) int64, electrons, of `maximum` times the light, that
    fell outside the PSF's box; box (n, 4) int64, x0, x1, y0, y1 of the chip's pixels touched, half-open, 0 if none.
    The result does not depend on the order of the objects. Raises ValueError for arrays that do not fit, numbers that
    are not finite, negative weights (a PSF interpolation that is not convex), a response above the maximum.
    """
    if counted.shape != window.shape or counted.dtype != np.int32:
        raise ValueError(f"counted is {counted.dtype} {counted.shape}, not int32 {window.shape}")
    for name in ("x", "y", "electrons", "light", "sersic", "matrix"):
        if not np.isfinite(getattr(scene, name)).all():
            raise ValueError(f"a value of {name} is not finite")
    if not (scene.weight >= 0).all():
        raise ValueError("a PSF mixture with negative weights has no photons")
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
        table.inner, table.outer, table.share, table.cells, table.per_pixel, on_window, beyond, box,
    )  # fmt: skip
    box[on_window > 0] += np.array([window.x0, window.x0, window.y0, window.y0])
    return on_window, beyond, box


@numba.njit(cache=True)
def _shoot(
    counted, response, maximum, order, x, y, matrix, light, sersic, electrons, index, weight, keys, inner, outer, share,
    cells, per_pixel, on_window, beyond, box,
):  # fmt: skip
    side_inner, side_outer = _log4(inner.shape[2]), _log4(outer.shape[2])
    middle_inner, middle_outer = 0.5 * (1 << side_inner), 0.5 * cells
    for i in order:
        key, counter = keys[i], np.uint64(0)
        total = maximum * electrons[i].sum()
        if not total > 0:
            continue
        if total < _MANY:
            number, counter = poisson(total, key, counter)
            for _ in range(number):
                which, how = word(key, counter), word(key, counter + _ONE)
                counter += _TWO
                c = 0 if high(how) < light[i, 0] else 1
                f = _pick(electrons[i], high(which) * total / maximum)
                k = _pick(weight[i], low(which))
                node, u = index[i, k], low(how)
                if u < share[node, f, 0]:
                    table, side, middle = inner[node, f], side_inner, middle_inner
                elif u < share[node, f, 0] + share[node, f, 1]:
                    table, side, middle = outer[node, f], side_outer, middle_outer
                else:
                    beyond[i] += 1
                    continue
                counter = _place(
                    counted, response, maximum, x[i], y[i], matrix[i], sersic[i, c], 1, key, counter, table, side,
                    middle, per_pixel, on_window, box, i,
                )  # fmt: skip
            continue
        lost = 0.0
        for c in range(2):
            for f in range(4):
                for k in range(index.shape[1]):
                    mean = maximum * electrons[i, f] * light[i, c] * weight[i, k]
                    if mean <= 0:
                        continue
                    node = index[i, k]
                    lost += mean * (1.0 - share[node, f, 0] - share[node, f, 1])
                    for part in range(2):
                        number, counter = poisson(mean * share[node, f, part], key, counter)
                        table = inner[node, f] if part == 0 else outer[node, f]
                        counter = _place(
                            counted, response, maximum, x[i], y[i], matrix[i], sersic[i, c], number, key, counter,
                            table, side_outer if part else side_inner, middle_outer if part else middle_inner,
                            per_pixel, on_window, box, i,
                        )  # fmt: skip
        beyond[i], counter = poisson(max(lost, 0.0), key, counter)


@numba.njit(cache=True)
def _log4(n):
    power = 0
    while 1 << 2 * power < n:
        power += 1
    return power


@numba.njit(inline="always")
def _pick(row, u):
    """Return the entry of `row` in which u falls, 0 < u < its sum."""
    j = 0
    while j < len(row) - 1 and u >= row[j]:
        u -= row[j]
        j += 1
    return j


@numba.njit(cache=True)
def _place(
    counted, response, maximum, x, y, matrix, sersic, number, key, counter, table, side, middle, per_pixel, on_window,
    box, i,
):  # fmt: skip
    """Draw `number` electrons with the PSF of one alias table of 2^side cells to a side."""
    ny, nx = counted.shape
    n, b, radius = sersic[0], sersic[1], sersic[2]
    kind = _POINT if n == 0 else 0 if n == _DISK else 1 if n == _BULGE else _GAMMA
    m00, m01, m10, m11 = matrix[0, 0] * radius, matrix[0, 1] * radius, matrix[1, 0] * radius, matrix[1, 1] * radius
    scale = 1.0 / (1024 * per_pixel)
    # The middle of the table on the object; half a pixel, so that truncation finds the pixel
    x += 0.5 + (1.5 - 1024 * (1 + middle)) * scale
    y += 0.5 + (1.5 - 1024 * (1 + middle)) * scale
    thinned = response.size > 0
    one = np.int64(1)
    cell_mask, column_mask = np.uint64((one << 2 * side) - 1), (one << side) - 1
    hit = 0
    x_low, x_high, y_low, y_high = nx, 0, ny, 0
    for _ in range(number):
        bits, jitter = word(key, counter), word(key, counter + _ONE)
        counter += _TWO
        slot = np.int64(bits & cell_mask)
        entry = np.int64(table[slot])
        cell = slot if np.int64((bits >> _S16) & _MASK16) < (entry >> 16) else entry & 0xFFFF
        # A draw from the quadratic B-spline is the sum of three uniforms: 3 x 10 bits in each half of the word
        spline = (jitter & _TENS) + ((jitter >> _S10) & _TENS) + ((jitter >> _S20) & _TENS)
        px = x + np.float64(((cell & column_mask) << 10) + np.int64(spline & _LOW32)) * scale
        py = y + np.float64(((cell >> side) << 10) + np.int64(spline >> _S32)) * scale
        if kind != _POINT:
            turn = word(key, counter)
            counter += _ONE
            if kind == _GAMMA:
                r, counter = gamma(2 * n, key, counter)
                r = (r / b) ** n
            else:
                r = ring(kind, turn)
            angle = np.int64(turn >> _S32)
            a, d = angle >> 20, ((angle & 0xFFFFF) - 0x80000) * _REST
            cos, sin = r * (_COS[a] - d * _SIN[a]), r * (_SIN[a] + d * _COS[a])
            px += m00 * cos + m01 * sin
            py += m10 * cos + m11 * sin
        if px >= 0 and py >= 0 and px < nx and py < ny:
            column, row = np.int64(px), np.int64(py)
            if thinned and np.float64(bits >> _S32) * 2.0**-32 * maximum >= response[row, column]:
                continue
            counted[row, column] += 1
            hit += 1
            x_low, x_high = min(x_low, column), max(x_high, column)
            y_low, y_high = min(y_low, row), max(y_high, row)
    if hit > 0:
        if on_window[i] > 0:
            x_low, x_high = min(x_low, box[i, 0]), max(x_high, box[i, 1] - 1)
            y_low, y_high = min(y_low, box[i, 2]), max(y_high, box[i, 3] - 1)
        on_window[i] += hit
        box[i, 0], box[i, 1], box[i, 2], box[i, 3] = x_low, x_high + 1, y_low, y_high + 1
    return counter
