"""The sky through a slitless chip's gratings: every order of a uniform background, with its edges.

A piece (instrument.grating.Gratings) sends the light of its rectangle of direct images x, y to X, Y = F(x, y), with
one map per order k and wavelength. Radiance is uniform, so a pixel gets

    rate = sum over pieces, orders: integral d(lambda) S T_k |dF|^-1 (fraction of the pixel that F(piece) covers)

S is the spectrum of the sky [photon / s / angstrom / pixel] and |dF| the Jacobian determinant, 1 to 0.06% in the first
order and 0.2% in the second. At the end of a piece an order's light ends over the range of its X - x: a ramp as long
as the first order, a step for the zeroth.
Node rows are computed exactly, rows between them by linear interpolation; along x nothing is sampled. Left out: the
PSF (it smooths the steps by about a pixel), the gradient of the sky between x and X, and the slope of a piece's lower
and upper edges along X (a tenth of a pixel, and no row of the chip is near them in the shipped gratings).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.resampling import read_at
from csstsim.instrument.filter import GRID, Filter
from csstsim.optics.sky import zodiacal
from csstsim.optics.sky.background_spectra import V_BAND, band, sunlight

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from csstsim.base.types import FloatArray, Floats
    from csstsim.instrument.chip import Window
    from csstsim.instrument.grating import DiffractionOrder, Gratings
    from csstsim.optics.sky.parameters import SkyNumbers

_LANES = 8  # sums side by side, which the compiler puts into one register
NODE = 1024  # px between computed rows, and between columns where |dF| is computed: linear to 2e-5 of the sky
_STRIP = 32  # rows added at a time: they stay in cache, and the sky needs no frame of its own
_ITERATIONS = 5  # each reduces the error by a factor 500, because dF is that close to 1


def nominal_spectrum(filter_: Filter, numbers: SkyNumbers) -> FloatArray:
    """Return S, as `sky_spectrum`, of the nominal sky of filters.yaml: zodiacal light far from the Sun + earthshine."""
    wave = filter_.wavelength
    here = np.array([V_BAND])
    earth = numbers.earth.nominal * read_at(wave, *numbers.earth.spectrum.T)
    zodi = zodiacal.spectrum(wave, numbers)[1] / sunlight(wave, numbers)
    zodi_v = zodiacal.spectrum(here, numbers)[1] / sunlight(here, numbers)
    shape = sunlight(wave, numbers) * (zodi / zodi_v + earth)
    return shape / band(filter_, shape)


def sky_spectrum(filter_: Filter, parts: Mapping[str, float], sun_angle: float, numbers: SkyNumbers) -> FloatArray:
    """Return S on the filter's grid [1 / angstrom], normalised to one electron in a whole first order.

    parts: {component of sky.background: e-/s/px}; sun_angle: from boresight to Sun [deg], sets the colour of zodiacal
    light; numbers: SkyNumbers. All components but zodiacal and earth are taken as sunlight.
    """
    wave = filter_.wavelength
    sun = sunlight(wave, numbers)
    colours = {
        "zodiacal": zodiacal.mixture(sun_angle, numbers) @ zodiacal.spectrum(wave, numbers),
        "earth": sun * read_at(wave, *numbers.earth.spectrum.T),
    }
    shapes = {name: colours.get(name, sun) for name in parts}
    return sum(parts[name] * shapes[name] / band(filter_, shapes[name]) for name in parts) / sum(parts.values())


def disperse(
    image: FloatArray,
    sky: Callable[[slice], FloatArray],
    gratings: Gratings,
    window: Window,
    spectrum: FloatArray,
    response: FloatArray | None = None,
) -> float:
    """Add a sky to `image` (ny, nx) float32 of a window, in place, through all orders; return its mean before losses.

    sky: slice of rows -> (rows, nx) float32, the electrons of a whole first order; gratings: Gratings of the chip;
    spectrum: (n,) on filter.GRID, as from `sky_spectrum`; response: (ny, nx) float32, or None for no losses.
    """
    nodes = node_rows(gratings, window)
    fractions = sum(
        order_rows(order, piece, nodes, window, spectrum)
        for grating, piece in gratings.pieces
        for order in grating.orders.values()
    )
    lines = np.maximum(fractions, 0.0).astype(np.float32)
    total = 0.0
    for first in range(0, window.ny, _STRIP):
        rows = slice(first, min(first + _STRIP, window.ny))
        seen = np.empty((0, 0), np.float32) if response is None else response[rows]
        total += _add_strip(image[rows], sky(rows), seen, nodes - window.y0 - first, lines)
    return total / image.size


def order_rows(
    order: DiffractionOrder,
    piece: tuple[float, float, float, float],
    rows: FloatArray,
    window: Window,
    spectrum: FloatArray,
) -> FloatArray:
    """Return (len(rows), nx): light of one order of a piece on rows of the chip, over one whole first order.

    piece: (x0, x1, y0, y1) of its direct images.
    """
    first, last = np.flatnonzero(order.throughput)[[0, -1]]
    wave = GRID[[first, last]]
    weights = (GRID[1] - GRID[0]) * (spectrum * order.throughput)[first : last + 1]
    sides = [_edge(order, x, rows[:, None], wave) - (window.x0 - 0.5) for x in piece[:2]]
    ends = [edge - (rows[:, None] - 0.5) for edge in _ends(order, piece, wave)]
    steps = np.zeros((2, len(rows), window.x1 - window.x0))
    _add_steps(steps, weights, *sides, *ends)
    nodes = _nodes(window.x0, window.x1)
    columns = np.arange(window.x0, window.x1)
    density = _density(order, nodes[:, None], rows[:, None, None], wave)
    out = np.cumsum(steps, axis=2)
    for k in range(2):
        for j in range(len(rows)):
            out[k, j] *= np.interp(columns, nodes, density[j, :, k])
    return out.sum(axis=0)


def node_rows(gratings: Gratings, window: Window) -> FloatArray:
    """Return the rows to compute: every multiple of NODE, and all rows that the end of a piece crosses."""
    regular = _nodes(window.y0, window.y1)
    rows = set(regular)
    for grating, piece in gratings.pieces:
        for order in grating.orders.values():
            for edge in _ends(order, piece, np.array(order.range)):
                rows.update(np.arange(np.floor(edge.min() - 0.5), np.ceil(edge.max() + 0.5) + 1))
    return np.array(sorted(row for row in rows if regular[0] <= row <= regular[-1]))


def _nodes(first: int, stop: int) -> FloatArray:
    return NODE * np.arange(first // NODE, (stop - 1) // NODE + 2, dtype=float)


def landing(order: DiffractionOrder, x: Floats, y: Floats, wave: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return X, Y of direct images at x, y [px] in `wave` [angstrom]."""
    p, q, r, s = np.moveaxis(order.lines(x, y), -1, 0)
    return x + p + q * wave, y + r + s * wave


def _edge(order: DiffractionOrder, x: float, rows: FloatArray, wave: FloatArray) -> FloatArray:
    """Return (rows, 2): X where light of direct images at x reaches `rows`, at the two ends of the band."""
    y = rows + 0.0 * wave
    for _ in range(_ITERATIONS):
        y = y + rows - landing(order, x, y, wave)[1]
    return landing(order, x, y, wave)[0]


def _ends(order: DiffractionOrder, piece: tuple[float, float, float, float], wave: FloatArray) -> list[FloatArray]:
    """Return [(2,), (2,)]: Y of a piece's lower and upper end, at its middle in x, at the two ends of the band."""
    x0, x1, *ends = piece
    return [landing(order, np.full(2, 0.5 * (x0 + x1)), y, wave)[1] for y in ends]


def _density(order: DiffractionOrder, columns: FloatArray, rows: FloatArray, wave: FloatArray) -> FloatArray:
    """Return |dF|^-1 of the light that reaches columns, rows."""
    x, y = (v + 0.0 * (columns + rows + wave) for v in (columns, rows))
    for _ in range(_ITERATIONS):
        reached = landing(order, x, y, wave)
        x = x + columns - reached[0]
        y = y + rows - reached[1]
    (xx, yx), (xy, yy) = (
        [
            0.5 * (b - a)
            for a, b in zip(landing(order, x - dx, y - dy, wave), landing(order, x + dx, y + dy, wave), strict=True)
        ]
        for dx, dy in ((1.0, 0.0), (0.0, 1.0))
    )
    return 1.0 / np.abs(xx * yy - xy * yx)


@numba.njit(cache=True)
def _add_steps(
    out: FloatArray, weights: FloatArray, left: FloatArray, right: FloatArray, low: FloatArray, high: FloatArray
) -> None:
    """Add an order's light to `out` (2, rows, nx) as differences along x, shared between the two ends of its band.

    left, right: (rows, 2) where it begins and ends, from the window's left side; low, high: the same in y, from the
    row's lower side. For a wavelength inside the band these are interpolated linearly.
    """
    last = max(len(weights) - 1, 1)
    for j in range(len(left)):
        for i in range(len(weights)):
            t = i / last
            lit = _above(low[j, 0] + t * (low[j, 1] - low[j, 0])) - _above(high[j, 0] + t * (high[j, 1] - high[j, 0]))
            _add_step(out[:, j], left[j, 0] + t * (left[j, 1] - left[j, 0]), t, weights[i] * lit)
            _add_step(out[:, j], right[j, 0] + t * (right[j, 1] - right[j, 0]), t, -weights[i] * lit)


@numba.njit(cache=True)
def _above(edge: float) -> float:
    """Return the fraction of the pixel 0..1 that is above an edge."""
    return min(max(1.0 - edge, 0.0), 1.0)


@numba.njit(cache=True)
def _add_step(out: FloatArray, position: float, t: float, weight: float) -> None:
    column = int(np.floor(position))
    before = position - column  # fraction of pixel `column` before the step
    for k, fraction in ((column, 1.0 - before), (column + 1, before)):
        if k < out.shape[1]:
            out[0, max(k, 0)] += (1.0 - t) * fraction * weight
            out[1, max(k, 0)] += t * fraction * weight


@numba.njit(cache=True)
def _add_strip(image: FloatArray, sky: FloatArray, response: FloatArray, rows: FloatArray, lines: FloatArray) -> float:
    """Add `sky` times `lines` (n, nx) times the response; return the sum before the response.

    lines: given at `rows` (n,) from the image's first row; linear in between.
    """
    j = 0
    nx = image.shape[1]
    light = np.empty(-(-nx // _LANES) * _LANES, np.float32)
    lanes = np.zeros(_LANES)
    light[nx:] = 0.0
    for y in range(image.shape[0]):
        while rows[j + 1] < y:
            j += 1
        upper = np.float32((y - rows[j]) / (rows[j + 1] - rows[j]))
        below = lines[j]
        above = lines[j + 1]
        level = sky[y]
        line = image[y]
        for x in range(nx):
            light[x] = level[x] * (below[x] + upper * (above[x] - below[x]))
        for x in range(0, len(light), _LANES):
            for k in range(_LANES):
                lanes[k] += light[x + k]
        if response.size > 0:
            seen = response[y]
            for x in range(nx):
                line[x] += light[x] * seen[x]
        else:
            for x in range(nx):
                line[x] += light[x]
    return lanes.sum()
