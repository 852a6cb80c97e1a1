"""Photons: objects drawn electron by electron, straight into the counted plane.

An electron's place is that of the object, plus a draw from the profile under its 2 x 2 matrix, plus a draw from the
PSF. The PSF of a place is a mixture of nodes (optics.interpolation), so a node drawn with its weight is an exact draw,
as is a sub-band drawn with its share of the light. Numbers of electrons are Poisson, hence independent for every
(component, sub-band, node): nothing is shot twice and nothing is left to a later Poisson step.

Sersic radii are exact for every index n: with x = b (r / r_e)^(1/n) the light within r is the gamma distribution of
shape 2n, and r = r_e (x / b)^n. Integer 2n (bulge and disk) is a product of uniforms, other shapes follow Marsaglia &
Tsang (2000). b(n): half of the light within r_e.

Left out: electrons beyond the box of the PSF, which are counted.
"""

import math

import numba
import numpy as np

from csstsim.render.counter import high, low, poisson, word

_ONE, _TWO, _THREE = (np.uint64(s) for s in (1, 2, 3))
_MASK16 = np.uint64(0xFFFF)
_S16, _S32, _S48 = (np.uint64(s) for s in (16, 32, 48))
_UNIT16, _UNIT32 = 2.0**-16, 2.0**-32
_ANGLES = 4096
_ANGLE = 2 * np.pi / _ANGLES * np.arange(_ANGLES)
_ANGLE_REST = 2 * np.pi / _ANGLES * 2.0**-20
_COS, _SIN = np.cos(_ANGLE), np.sin(_ANGLE)
_MANY = 200.0  # electrons above which each (sub-band, node) gets a Poisson number of its own


@numba.njit(cache=True)
def shoot(
    counted, x0, y0, x, y, matrix, light, sersic, electrons, index, weight, keys, inner, outer, share, inner_bits,
    cell_bits, per_pixel, on_window, beyond, box,
):  # fmt: skip
    """Draw objects into `counted` (int32, ny x nx, whose first pixel is x0, y0).

    x, y (n,) pixel; matrix (n, 2, 2) pixel per unit of r_e; light (n, 2) share of each component; sersic (n, 2, 3):
    index, b, r_e, index 0 for a point; electrons (n, 4) expected; index, weight (n, k) nodes; keys (n,) uint64;
    inner, outer, share: of PsfTable, of 2^inner_bits and 2^cell_bits cells to a side. Results: on_window (n,) electrons
    on the window, beyond (n,) electrons that fell outside the PSF's box, box (n, 4): x0, x1, y0, y1 of the pixels
    touched, half-open, in window pixels.
    """
    for i in range(len(x)):
        key, counter = keys[i], np.uint64(0)
        box[i] = counted.shape[1], 0, counted.shape[0], 0
        total = electrons[i].sum()
        if not total > 0:
            continue
        many = total >= _MANY
        left = -1  # electrons still to place, where they are chosen one by one
        if not many:
            left, counter = poisson(total, key, counter)
        for c in range(2):
            if light[i, c] <= 0:
                continue
            for f in range(4):
                for k in range(index.shape[1]):
                    mean = electrons[i, f] * light[i, c] * weight[i, k]
                    if mean <= 0:
                        continue
                    if many:
                        number, counter = poisson(mean, key, counter)
                    else:
                        number, counter = _binomial(left, min(mean / total, 1.0), key, counter)
                        left -= number
                        total -= mean
                    if number > 0:
                        node = index[i, k]
                        counter = _place(
                            counted, x[i] - x0, y[i] - y0, matrix[i], sersic[i, c], number, key, counter,
                            inner[node, f], outer[node, f], share[node, f], inner_bits, cell_bits, per_pixel,
                            on_window, beyond, box, i,
                        )  # fmt: skip


@numba.njit(cache=True)
def _binomial(n, p, key, counter):
    """Return (successes of n trials, counter): by inversion, for the small n of faint objects."""
    if n == 0 or p <= 0:
        return 0, counter
    if p >= 1:
        return n, counter
    u = high(word(key, counter))
    counter += _ONE
    flip = p > 0.5
    q = 1 - p if flip else p
    odds = q / (1 - q)
    chance = (1 - q) ** n
    k = 0
    while u > chance and k < n:
        u -= chance
        chance *= odds * (n - k) / (k + 1)
        k += 1
    return (n - k if flip else k), counter


@numba.njit(cache=True)
def _place(
    counted, x, y, matrix, sersic, number, key, counter, inner, outer, share, inner_bits, cell_bits, per_pixel,
    on_window, beyond, box, i,
):  # fmt: skip
    ny, nx = counted.shape
    n, b, radius = sersic
    m00, m01, m10, m11 = matrix[0, 0], matrix[0, 1], matrix[1, 0], matrix[1, 1]
    middle, rest = share[0], share[0] + share[1]
    scale = 1.0 / per_pixel
    corner_inner, corner_outer = 0.5 * (1 << inner_bits) + 1.0, 0.5 * (1 << cell_bits) + 1.0
    hit, missed = 0, 0
    x_low, x_high, y_low, y_high = box[i]
    for _ in range(number):
        bits, jx, jy = word(key, counter), word(key, counter + _ONE), word(key, counter + _TWO)
        counter += _THREE
        u = np.float64(((jx >> _S48) << _S16) | (jy >> _S48)) * _UNIT32
        if u < middle:
            column, row = _cell(inner, inner_bits, bits)
            corner = corner_inner
        elif u < rest:
            column, row = _cell(outer, cell_bits, bits)
            corner = corner_outer
        else:
            missed += 1
            continue
        px = x + (column + _spline(jx) - corner) * scale
        py = y + (row + _spline(jy) - corner) * scale
        if n > 0:
            r, counter = _radius(n, b, radius, key, counter)
            angle = np.int64(bits >> _S32)
            a, d = angle >> 20, (angle & 0xFFFFF) * _ANGLE_REST
            cos, sin = r * (_COS[a] - d * _SIN[a]), r * (_SIN[a] + d * _COS[a])
            px += m00 * cos + m01 * sin
            py += m10 * cos + m11 * sin
        if px >= -0.5 and py >= -0.5 and px < nx - 0.5 and py < ny - 0.5:
            column, row = int(px + 0.5), int(py + 0.5)
            counted[row, column] += 1
            hit += 1
            x_low, x_high = min(x_low, column), max(x_high, column + 1)
            y_low, y_high = min(y_low, row), max(y_high, row + 1)
    on_window[i] += hit
    beyond[i] += missed
    box[i, 0], box[i, 1], box[i, 2], box[i, 3] = x_low, x_high, y_low, y_high
    return counter


@numba.njit(inline="always")
def _cell(table, side_bits, bits):
    """Return (column, row) of a cell drawn from an alias table of 2^side_bits cells to a side."""
    i = np.int64(bits & ((_ONE << np.uint64(2 * side_bits)) - _ONE))
    entry = np.int64(table[i])
    cell = i if np.int64((bits >> _S16) & _MASK16) < (entry >> 16) else entry & 0xFFFF
    return cell & ((1 << side_bits) - 1), cell >> side_bits


@numba.njit(inline="always")
def _spline(bits):
    """Return a draw from the quadratic B-spline on (0, 3): the sum of three uniforms of 16 bits."""
    total = (bits & _MASK16) + ((bits >> _S16) & _MASK16) + ((bits >> _S32) & _MASK16)
    return (np.float64(total) + 1.5) * _UNIT16


@numba.njit(cache=True)
def _radius(n, b, radius, key, counter):
    """Return (radius drawn from a circular Sersic profile, counter)."""
    if n == 1.0:
        bits = word(key, counter)
        return -math.log(high(bits) * low(bits)) * radius / b, counter + _ONE
    if n == 4.0:
        product = 1.0
        for _ in range(4):
            bits = word(key, counter)
            counter += _ONE
            product *= high(bits) * low(bits)
        ratio = -math.log(product) / b
        ratio *= ratio
        return radius * ratio * ratio, counter
    x, counter = _gamma(2 * n, key, counter)
    return radius * (x / b) ** n, counter


@numba.njit(cache=True)
def _gamma(shape, key, counter):
    """Return (gamma variate of this shape > 0, counter): Marsaglia & Tsang 2000, ACM TOMS 26, 363."""
    boost = 1.0
    if shape < 1.0:
        boost = high(word(key, counter)) ** (1.0 / shape)
        counter += _ONE
        shape += 1.0
    d = shape - 1.0 / 3.0
    c = 1.0 / math.sqrt(9.0 * d)
    while True:
        bits = word(key, counter)
        u = high(word(key, counter + _ONE))
        counter += _TWO
        normal = math.sqrt(-2.0 * math.log(high(bits))) * math.cos(2 * math.pi * low(bits))
        v = 1.0 + c * normal
        if v <= 0:
            continue
        v = v * v * v
        if math.log(u) < 0.5 * normal * normal + d - d * v + d * math.log(v):
            return d * v * boost, counter
