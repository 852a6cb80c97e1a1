"""Sums of galaxies' spectra times weights, cell by cell of the rest-frame nodes (universe.galaxies.galaxy_sed).

In a cell the spectrum is linear, so its sum against the weights follows from the running sums of w, w lambda and
w lambda^2 (`moments`). Dust (optical depth `dust` times `curve`) is evaluated at the cell's weighted centre. The forest
has no edge inside a cell and is linear there. A cell is cut where the curve jumps (`cuts`).

Steps are loops of their own over all cells, with one array filled in each: the compiler then computes eight cells at a
time. Only the samples of tables, which are anywhere, are read one by one. A cell without a sample counts nothing.
"""

import numba
import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.universe.galaxies.igm import LYMAN_LIMIT, continuum_depth

_SMALL = 0.01  # optical depth below which the series of exp is exact to 1e-9: nearly all galaxies
_NEVER = np.int64(1 << 60)  # beyond any sample


@numba.njit(cache=True, error_model="numpy")
def integrate(
    z: FloatArray,
    coefficients: FloatArray,
    dust: FloatArray,
    moments: FloatArray,
    ranges: IntArray,
    nodes: FloatArray,
    basis: FloatArray,
    curve: FloatArray,
    cuts: IntArray,
    grid: FloatArray,
    edges: FloatArray,
    depths: FloatArray,
    continuum: FloatArray,
    limits: FloatArray,
    powers: FloatArray,
) -> FloatArray:
    """Return (n, bands): sums of spectra x weights over the samples of `grid`; arguments as in GalaxySeds.rates.

    ranges: (bands, 2), first and last sample (half-open) of each band's weights.
    """
    step = grid[1] - grid[0]
    samples = len(grid)
    out = np.zeros((len(z), len(ranges)))
    per_step = 1.0 / step
    lines = np.empty(len(nodes)), np.empty(len(nodes)), np.empty(len(nodes)), np.empty(len(nodes), np.int64)
    work = np.empty((4, len(nodes) + 1)), np.empty((2, len(nodes) + 1), np.int64)
    clear = np.ones((len(edges) + 1, samples))  # transmission of the first 0, 1, ... lines
    for line in range(len(edges)):
        clear[line + 1] = clear[line] * np.exp(-depths[line])
    used = ranges[:, 1] > ranges[:, 0]
    if not used.any():
        return out
    blue = grid[ranges[used, 0].min()]
    red = grid[ranges[used, 1].max() - 1]
    for n in range(len(z)):
        stretch = 1.0 + z[n]
        low, high = _span(nodes, blue / stretch, red / stretch)
        combine(lines[0], low, high + 1, coefficients[n], basis)
        _lines(lines, nodes, low, high, stretch, grid[0], per_step)
        forest = edges[0] * stretch, stretch**powers, grid, step, edges, clear, continuum, limits
        for b in np.flatnonzero(used):
            begin, end = ranges[b]
            low, high = _span(nodes, grid[begin] / stretch, grid[end - 1] / stretch)
            first = max(int(np.ceil(lines[1][low] * per_step)), begin)
            cut = np.searchsorted(cuts, begin, side="right")
            while first < end:
                last = end
                top = high
                if cut < len(cuts) and cuts[cut] < end:
                    last = max(cuts[cut], first)
                    cut = cut + 1
                    top = min(high, np.searchsorted(nodes, grid[last] / stretch, side="right"))
                at = _light(work, first, last, low, top, lines, moments[b])
                if grid[first] < forest[0]:
                    _absorb(work, at, low, lines[2], nodes, moments[b], forest)
                out[n, b] = _behind_dust(out[n, b], work, at, -dust[n], per_step, curve)
                first = last
    return out


@numba.njit(cache=True, error_model="numpy")
def combine(rest: FloatArray, low: int, high: int, coefficients: FloatArray, basis: FloatArray) -> None:
    """Put max(0, sum_k c_k P_k) into rest[low:high]; NaN stays NaN. basis: (k, nodes), k a multiple of 4."""
    part = rest[low:high]  # slices let the compiler see that no index is out of bounds: seven times faster
    part[:] = 0.0
    for k in range(0, len(basis), 4):
        a = coefficients[k]
        b = coefficients[k + 1]
        c = coefficients[k + 2]
        d = coefficients[k + 3]
        one = basis[k, low:high]
        two = basis[k + 1, low:high]
        three = basis[k + 2, low:high]
        four = basis[k + 3, low:high]
        for j in range(len(part)):
            part[j] = (((part[j] + a * one[j]) + b * two[j]) + c * three[j]) + d * four[j]
    for j in range(len(part)):
        if part[j] < 0.0:
            part[j] = 0.0


@numba.njit(inline="always")
def _span(nodes: FloatArray, blue: float, red: float) -> tuple[int, int]:
    """Return the first and last node of the cells that reach from one rest-frame wavelength to another."""
    last = min(np.searchsorted(nodes, red, side="right"), len(nodes) - 1)
    return max(np.searchsorted(nodes, blue, side="right") - 1, 0), last  # type: ignore[return-value]  # int64


@numba.njit(cache=True, error_model="numpy")
def _lines(
    lines: tuple[FloatArray, FloatArray, FloatArray, IntArray],
    nodes: FloatArray,
    low: int,
    high: int,
    stretch: float,
    zero: float,
    per_step: float,
) -> None:
    """Fill the observed wavelength of nodes low to high, the spectrum's slope from there on, and where its cell stops.

    lines: (spectrum, wavelength from `zero` on, slope, sample after the cell's last), each (nodes,).
    """
    rest, left, slope, stop = lines
    last = min(high, len(nodes) - 2)
    for j in range(low, last + 2):
        left[j] = nodes[j] * stretch - zero
    here = rest[low : last + 1]
    following = rest[low + 1 : last + 2]
    begin = left[low : last + 1]
    end = left[low + 1 :]
    slopes = slope[low : last + 1]
    stops = stop[low : last + 1]
    for j in range(len(slopes)):
        slopes[j] = (following[j] - here[j]) / (end[j] - begin[j])
    for j in range(len(stops)):
        stops[j] = np.int64(end[j] * per_step) + 1
    if high == len(nodes) - 1:  # beyond the last node the spectrum is constant
        slope[high] = 0.0
        stop[high] = _NEVER


@numba.njit(cache=True, error_model="numpy")
def _light(
    work: tuple[FloatArray, IntArray],
    first: int,
    last: int,
    low: int,
    top: int,
    lines: tuple[FloatArray, FloatArray, FloatArray, IntArray],
    running: FloatArray,
) -> IntArray:
    """Put the light and centre of cells low to top into `work`; return (cells + 1,) the samples where they begin.

    first, last: samples, half-open; work: (light, centre, w, w lambda) and integers.
    """
    (floats, integers), cells = work, top + 1 - low
    rest, left, slope, stop = lines
    rest = rest[low : top + 1]
    left = left[low : top + 1]
    slope = slope[low : top + 1]
    stop = stop[low : top + 1]
    at = integers[0, : cells + 1]
    light = floats[0, :cells]
    centre = floats[1, :cells]
    w0 = floats[2, : cells + 1]
    w1 = floats[3, : cells + 1]
    at[0], after = first, at[1:]
    for k in range(cells):
        after[k] = min(max(stop[k], first), last)
    after[cells - 1] = last
    for k in range(cells + 1):
        w0[k], w1[k] = running[at[k], 0], running[at[k], 1]
    next0 = w0[1:]
    next1 = w1[1:]
    for k in range(cells):
        w0[k] = next0[k] - w0[k]
    for k in range(cells):
        w1[k] = next1[k] - w1[k]
    for k in range(cells):
        centre[k] = w1[k] / w0[k] if w0[k] > 0.0 else 0.0
    for k in range(cells):
        light[k] = rest[k] * w0[k] + slope[k] * (w1[k] - left[k] * w0[k]) if w0[k] > 0.0 else 0.0
    return at


@numba.njit(cache=True, error_model="numpy")
def _absorb(
    work: tuple[FloatArray, IntArray],
    at: IntArray,
    low: int,
    slope: FloatArray,
    nodes: FloatArray,
    running: FloatArray,
    forest: tuple[float, FloatArray, FloatArray, float, FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Multiply the light of cells from node `low` on by the intergalactic transmission; `at`: from `_light`."""
    blue, reach, grid, step, edges, clear, continuum, limits = forest
    light = work[0][0]
    centre = work[0][1]
    reaching = len(edges)  # lines that absorb: fewer towards the red
    for k in range(len(at) - 1):
        start = at[k]
        last = at[k + 1]
        j = low + k
        if not grid[start] < blue:
            break
        middle = 0.5 * (nodes[j] + nodes[min(j + 1, len(nodes) - 1)])
        while reaching > 0 and not middle < edges[reaching - 1]:
            reaching -= 1
        if light[k] == 0.0:
            continue
        across = 1.0 / step / max(last - 1 - start, 1)
        on = centre[k] - start * step
        tilt = (clear[reaching, last - 1] - clear[reaching, start]) * across
        gas = clear[reaching, start] + tilt * on
        if middle < LYMAN_LIMIT:
            one = continuum_depth(start, reach, continuum, limits)
            fall = (continuum_depth(last - 1, reach, continuum, limits) - one) * across
            through = np.exp(-one - fall * on)
            gas, tilt = gas * through, (tilt - gas * fall) * through
        w1 = running[last, 1] - running[start, 1]
        w2 = running[last, 2] - running[start, 2]
        light[k] = light[k] * gas + tilt * slope[j] * (w2 - centre[k] * w1)


@numba.njit(cache=True, error_model="numpy")
def _behind_dust(
    total: float, work: tuple[FloatArray, IntArray], at: IntArray, more: float, per_step: float, curve: FloatArray
) -> float:
    """Return `total` plus the light of the cells behind dust of optical depth -more x curve; `at`: from `_light`."""
    (floats, integers), cells = work, len(at) - 1
    light = floats[0, :cells]
    centre = floats[1, :cells]
    x = floats[2, :cells]
    depth = floats[3, :cells]
    sample = integers[1, :cells]
    first = at[:-1]
    last = at[1:]
    for k in range(cells):
        sample[k] = max(min(np.int64(centre[k] * per_step), last[k] - 2), first[k])
    for k in range(cells):
        x[k] = (centre[k] * per_step - sample[k]) * (last[k] - first[k] > 1)  # no step across a cut
    for k in range(cells):
        depth[k] = curve[sample[k]] + x[k] * (curve[sample[k] + 1] - curve[sample[k]])
    most = 0.0
    for k in range(cells):
        x[k] = more * depth[k]
        most = max(most, abs(x[k]))
    if most < _SMALL:
        for k in range(cells):
            light[k] *= _series(x[k])
    else:  # rare: this galaxy's dust differs much from the usual
        for k in range(cells):
            light[k] *= _series(x[k]) if abs(x[k]) < _SMALL else np.exp(x[k])
    for k in range(cells):
        total += light[k]
    return total


@numba.njit(inline="always")
def _series(x: float) -> float:
    """Return exp(x) for small x."""
    return 1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x / 24.0)))
