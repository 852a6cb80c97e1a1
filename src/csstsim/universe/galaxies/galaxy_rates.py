"""Sums of galaxies' spectra times weights, cell by cell of the rest-frame nodes (universe.galaxies.galaxy_sed).

In a cell the spectrum is linear, so its sum against the weights follows from the running sums of w, w lambda and
w lambda^2 (`moments`). Dust (optical depth `dust` times `curve`) is evaluated at the cell's weighted centre. The forest
has no edge inside a cell and is linear there. A cell is cut where the curve jumps (`cuts`).

Each step is a separate loop over all cells that fills one array, so the compiler computes eight cells at a time. Only
the samples of tables, which are not contiguous, are read one by one. A cell without a sample contributes nothing.
"""

from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.universe.galaxies.igm import LYMAN_LIMIT, IgmTables, continuum_depth

_SMALL = 0.01  # optical depth below which the series of exp errs by 1e-9: that of nearly all galaxies
_NO_STOP = np.int64(1 << 60)  # beyond any sample


class Cells(NamedTuple):
    """Components of spectra, linear between nodes: `nodes` (n,) [A, rest frame], values `basis` (k, n) at them."""

    nodes: FloatArray
    basis: FloatArray


class _Spectrum(NamedTuple):
    """A galaxy's spectrum at its nodes, each (nodes,).

    density: photon / A; left: observed wavelength beyond the first sample [A]; slope: to the next node [per A];
    stop: the sample after the last one before the next node.
    """

    density: FloatArray
    left: FloatArray
    slope: FloatArray
    stop: IntArray


class _Sums(NamedTuple):
    """Sums over the samples of each cell (nodes + 1,), and values of `_add_behind_dust` in the same arrays.

    flux: of spectrum x weights; centre: weighted wavelength beyond the first sample [A]; w0, w1: of w and w lambda,
    then the centre's position within a step and the dust's curve at it; at: first sample of a cell; sample: that before
    the centre.
    """

    flux: FloatArray
    centre: FloatArray
    w0: FloatArray
    w1: FloatArray
    at: IntArray
    sample: IntArray


class _Forest(NamedTuple):
    """Absorption towards one redshift.

    blue: observed wavelength [A] below which it begins; reach (terms,): (1 + z)^powers; clear (lines + 1, samples):
    transmission of the first 0, 1, ... lines; tables: IgmTables on samples `step` [A] apart.
    """

    blue: float
    reach: FloatArray
    step: float
    clear: FloatArray
    tables: IgmTables


@numba.njit(cache=True, error_model="numpy")
def integrate(
    z: FloatArray,
    coefficients: FloatArray,
    dust: FloatArray,
    moments: FloatArray,
    ranges: IntArray,
    cells: Cells,
    curve: FloatArray,
    cuts: IntArray,
    igm: IgmTables,
) -> FloatArray:
    """Return (n, bands): sums of spectra x weights over the samples of `igm`; arguments as for GalaxySeds.rates.

    moments (bands, samples + 1, 3): running sums of w, w lambda and w lambda^2; ranges (bands, 2): first and last
    sample (half-open) of each band's weights; curve (samples,): of the dust; cuts: samples at which it jumps.
    """
    nodes = cells.nodes
    grid = igm.wavelength
    step = grid[1] - grid[0]
    samples = len(grid)
    out = np.zeros((len(z), len(ranges)))
    per_step = 1.0 / step
    spectrum = _Spectrum(
        np.empty(len(nodes)), np.empty(len(nodes)), np.empty(len(nodes)), np.empty(len(nodes), np.int64)
    )
    size = len(nodes) + 1
    sums = _Sums(
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size),
        np.empty(size, np.int64),
        np.empty(size, np.int64),
    )
    clear = np.ones((len(igm.edges) + 1, samples))
    for line in range(len(igm.edges)):
        clear[line + 1] = clear[line] * np.exp(-igm.depths[line])
    used = ranges[:, 1] > ranges[:, 0]
    if not used.any():
        return out
    blue = grid[ranges[used, 0].min()]
    red = grid[ranges[used, 1].max() - 1]
    for n in range(len(z)):
        stretch = 1.0 + z[n]
        low, high = _span(nodes, blue / stretch, red / stretch)
        combine(spectrum.density, low, high + 1, coefficients[n], cells.basis)
        _fill_nodes(spectrum, nodes, low, high, stretch, grid[0], per_step)
        forest = _Forest(igm.edges[0] * stretch, stretch**igm.powers, step, clear, igm)
        for b in np.flatnonzero(used):
            begin, end = ranges[b]
            low, high = _span(nodes, grid[begin] / stretch, grid[end - 1] / stretch)
            first = max(int(np.ceil(spectrum.left[low] * per_step)), begin)
            cut = np.searchsorted(cuts, begin, side="right")
            while first < end:
                last = end
                top = high
                if cut < len(cuts) and cuts[cut] < end:
                    last = max(cuts[cut], first)
                    cut = cut + 1
                    top = min(high, np.searchsorted(nodes, grid[last] / stretch, side="right"))
                at = _sum_cells(sums, first, last, low, top, spectrum, moments[b])
                if grid[first] < forest.blue:
                    _absorb(sums, at, low, spectrum.slope, nodes, moments[b], forest)
                out[n, b] = _add_behind_dust(out[n, b], sums, at, -dust[n], per_step, curve)
                first = last
    return out


@numba.njit(cache=True, error_model="numpy")
def combine(rest: FloatArray, low: int, high: int, coefficients: FloatArray, basis: FloatArray) -> None:
    """Set rest[low:high] to max(0, sum_k c_k P_k); NaN stays NaN. basis: (k, nodes), k a multiple of 4."""
    sums = rest[low:high]  # with slices the compiler knows that indices are in bounds: seven times faster
    sums[:] = 0.0
    for k in range(0, len(basis), 4):
        c0 = coefficients[k]
        c1 = coefficients[k + 1]
        c2 = coefficients[k + 2]
        c3 = coefficients[k + 3]
        p0 = basis[k, low:high]
        p1 = basis[k + 1, low:high]
        p2 = basis[k + 2, low:high]
        p3 = basis[k + 3, low:high]
        for j in range(len(sums)):
            sums[j] = (((sums[j] + c0 * p0[j]) + c1 * p1[j]) + c2 * p2[j]) + c3 * p3[j]
    for j in range(len(sums)):
        if sums[j] < 0.0:
            sums[j] = 0.0


@numba.njit(inline="always")
def _span(nodes: FloatArray, blue: float, red: float) -> tuple[int, int]:
    """Return the first and last node of the cells between two rest-frame wavelengths."""
    last = min(np.searchsorted(nodes, red, side="right"), len(nodes) - 1)
    return max(np.searchsorted(nodes, blue, side="right") - 1, 0), last  # type: ignore[return-value]  # int64


@numba.njit(cache=True, error_model="numpy")
def _fill_nodes(
    spectrum: _Spectrum, nodes: FloatArray, low: int, high: int, stretch: float, zero: float, per_step: float
) -> None:
    """Fill `left`, `slope` and `stop` of the spectrum at nodes low to high; zero: wavelength of the first sample."""
    left = spectrum.left
    slope = spectrum.slope
    stop = spectrum.stop
    last = min(high, len(nodes) - 2)
    for j in range(low, last + 2):
        left[j] = nodes[j] * stretch - zero
    density = spectrum.density[low : last + 1]
    next_density = spectrum.density[low + 1 : last + 2]
    begin = left[low : last + 1]
    end = left[low + 1 :]
    slopes = slope[low : last + 1]
    stops = stop[low : last + 1]
    for j in range(len(slopes)):
        slopes[j] = (next_density[j] - density[j]) / (end[j] - begin[j])
    for j in range(len(stops)):
        stops[j] = np.int64(end[j] * per_step) + 1
    if high == len(nodes) - 1:  # beyond the last node the spectrum is constant
        slope[high] = 0.0
        stop[high] = _NO_STOP


@numba.njit(cache=True, error_model="numpy")
def _sum_cells(
    sums: _Sums, first: int, last: int, low: int, top: int, spectrum: _Spectrum, running: FloatArray
) -> IntArray:
    """Fill flux and centre of cells low to top of `sums`; return (cells + 1,) the samples where they begin.

    first, last: samples, half-open; running (samples + 1, 3): sums of w, w lambda and w lambda^2 before each sample.
    """
    cells = top + 1 - low
    density = spectrum.density[low : top + 1]
    left = spectrum.left[low : top + 1]
    slope = spectrum.slope[low : top + 1]
    stop = spectrum.stop[low : top + 1]
    at = sums.at[: cells + 1]
    flux = sums.flux[:cells]
    centre = sums.centre[:cells]
    w0 = sums.w0[: cells + 1]
    w1 = sums.w1[: cells + 1]
    at[0] = first
    after = at[1:]
    for k in range(cells):
        after[k] = min(max(stop[k], first), last)
    after[cells - 1] = last
    for k in range(cells + 1):
        w0[k] = running[at[k], 0]
        w1[k] = running[at[k], 1]
    next0 = w0[1:]
    next1 = w1[1:]
    for k in range(cells):
        w0[k] = next0[k] - w0[k]
    for k in range(cells):
        w1[k] = next1[k] - w1[k]
    for k in range(cells):
        centre[k] = w1[k] / w0[k] if w0[k] > 0.0 else 0.0
    for k in range(cells):
        flux[k] = density[k] * w0[k] + slope[k] * (w1[k] - left[k] * w0[k]) if w0[k] > 0.0 else 0.0
    return at


@numba.njit(cache=True, error_model="numpy")
def _absorb(
    sums: _Sums,
    at: IntArray,
    low: int,
    slope: FloatArray,
    nodes: FloatArray,
    running: FloatArray,
    forest: _Forest,
) -> None:
    """Multiply the flux of cells from node `low` by the intergalactic transmission; `at`: from `_sum_cells`."""
    grid = forest.tables.wavelength
    edges = forest.tables.edges
    transmissions = forest.clear
    step = forest.step
    flux = sums.flux
    centre = sums.centre
    absorbing = len(edges)  # lines that absorb: fewer towards the red
    for k in range(len(at) - 1):
        start = at[k]
        last = at[k + 1]
        j = low + k
        if not grid[start] < forest.blue:
            break
        middle = 0.5 * (nodes[j] + nodes[min(j + 1, len(nodes) - 1)])
        while absorbing > 0 and not middle < edges[absorbing - 1]:
            absorbing -= 1
        if flux[k] == 0.0:
            continue
        per_sample = 1.0 / step / max(last - 1 - start, 1)
        offset = centre[k] - start * step
        tilt = (transmissions[absorbing, last - 1] - transmissions[absorbing, start]) * per_sample
        transmission = transmissions[absorbing, start] + tilt * offset
        if middle < LYMAN_LIMIT:
            depth = continuum_depth(start, forest.reach, forest.tables)
            depth_slope = (continuum_depth(last - 1, forest.reach, forest.tables) - depth) * per_sample
            continuum = np.exp(-depth - depth_slope * offset)
            transmission, tilt = transmission * continuum, (tilt - transmission * depth_slope) * continuum
        w1 = running[last, 1] - running[start, 1]
        w2 = running[last, 2] - running[start, 2]
        flux[k] = flux[k] * transmission + tilt * slope[j] * (w2 - centre[k] * w1)


@numba.njit(cache=True, error_model="numpy")
def _add_behind_dust(total: float, sums: _Sums, at: IntArray, dust: float, per_step: float, curve: FloatArray) -> float:
    """Return `total` plus the flux of the cells behind dust of optical depth -dust x curve; `at`: of `_sum_cells`."""
    cells = len(at) - 1
    flux = sums.flux[:cells]
    centre = sums.centre[:cells]
    x = sums.w0[:cells]
    depth = sums.w1[:cells]
    sample = sums.sample[:cells]
    first = at[:-1]
    last = at[1:]
    for k in range(cells):
        sample[k] = max(min(np.int64(centre[k] * per_step), last[k] - 2), first[k])
    for k in range(cells):
        x[k] = (centre[k] * per_step - sample[k]) * (last[k] - first[k] > 1)  # no step across a cut
    for k in range(cells):
        depth[k] = curve[sample[k]] + x[k] * (curve[sample[k] + 1] - curve[sample[k]])
    depth_max = 0.0
    for k in range(cells):
        x[k] = dust * depth[k]
        depth_max = max(depth_max, abs(x[k]))
    if depth_max < _SMALL:
        for k in range(cells):
            flux[k] *= _exp_series(x[k])
    else:  # rare: this galaxy's dust differs much from the mean
        for k in range(cells):
            flux[k] *= _exp_series(x[k]) if abs(x[k]) < _SMALL else np.exp(x[k])
    for k in range(cells):
        total += flux[k]
    return total


@numba.njit(inline="always")
def _exp_series(x: float) -> float:
    """Return exp(x) for small x."""
    return 1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x / 24.0)))
