"""Spectra of a table as means over wavelength bins, from which dispersed light is rendered.

They are those of catalog.light.embedded_spectra, without 18,001 samples per object. Galaxies are integrated cell by
cell between rest-frame nodes, where spectra are linear, so the flux of an emission line does not depend on the bins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.types import FloatArray
from csstsim.catalog.light.embedded_spectra import as_star, by_spectrum, coefficients, with_companions
from csstsim.catalog.light.photometry import bin_means
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.universe.galaxies.galaxy_rates import combine
from csstsim.universe.galaxies.igm import IgmTables, Intergalactic, absorb

if TYPE_CHECKING:
    from csstsim.base.types import IntArray
    from csstsim.universe.parameters import Universe

_SMALL = 0.02  # limit of A(V) ln 10 / 2.5 below which the series of exp is exact to 1e-9
_LN_MAG = 0.4 * np.log(10.0)


class _Galaxies(NamedTuple):
    """Of galaxies (n,): redshift; mix (n, 20), coefficients of components; scale of the spectrum; dust.

    dust: optical depth of the foreground at unit extinction, above the mean of the table.
    """

    z: FloatArray
    mix: FloatArray
    scale: FloatArray
    dust: FloatArray


class _Bins(NamedTuple):
    """Wavelength bins: edges (bins + 1,) [angstrom]; curve (bins,): extinction at their middles; dimmed (bins,).

    dimmed: transmission of the mean dust over the width of the bin [1 / angstrom].
    """

    edges: FloatArray
    curve: FloatArray
    dimmed: FloatArray


def binned(universe: Universe, table: ObjectTable, edges: FloatArray) -> FloatArray:
    """Return (n, bins) photon / s / m2 / angstrom: means of a table's spectra over bins of `edges`, samples of GRID."""
    out = np.zeros((len(table), len(edges) - 1))
    at = np.searchsorted(GRID, edges)
    inside = slice(at[0], at[-1] + 1)
    for chosen, group in by_spectrum(table):
        if group["obj_type"][0] == GALAXY:
            _galaxies(out, np.flatnonzero(chosen), universe, group, edges)
            continue
        scale = group["sed_scale"].astype(float)
        if as_star(group["obj_type"][0]):
            means = with_companions(universe.star_seds.binned, group, group["av"], edges)
            out[chosen] = means * scale[:, None]
        else:
            means = universe.quasar_seds.spectra(group["z"], coefficients(group), scale, group["av"], GRID[inside])
            out[chosen] = bin_means(means, at - at[0])
    return out


def _galaxies(out: FloatArray, rows: IntArray, universe: Universe, galaxies: ObjectTable, edges: FloatArray) -> None:
    """Fill `rows` of `out` with the means of galaxies."""
    seds = universe.galaxy_seds
    centres = 0.5 * (edges[1:] + edges[:-1])
    depth = _LN_MAG * galaxies["av"].astype(float)
    mean_depth = depth.mean()
    curve = np.interp(centres, GRID, universe.extinction)
    _integrate(
        out,
        rows,
        _Galaxies(
            galaxies["z"].astype(float),
            np.ascontiguousarray(coefficients(galaxies), dtype=float),
            galaxies["sed_scale"].astype(float),
            depth - mean_depth,
        ),
        _Bins(edges, curve, np.exp(-mean_depth * curve) / np.diff(edges)),
        *seds.cells,
        Intergalactic(centres, seds.igm).tables,
    )


@numba.njit(cache=True, error_model="numpy")
def _integrate(
    out: FloatArray,
    rows: IntArray,
    galaxies: _Galaxies,
    bins: _Bins,
    nodes: FloatArray,
    basis: FloatArray,
    igm: IgmTables,
) -> None:
    """Fill `rows` of `out`; nodes, basis: GalaxySeds.cells; igm: Intergalactic.tables at the middles of the bins."""
    edges = bins.edges
    curve = bins.curve
    dimmed = bins.dimmed
    rest = np.empty(len(nodes))
    slope = np.empty(len(nodes))
    running = np.empty(len(nodes))
    last = len(nodes) - 1
    for n in range(len(rows)):
        stretch = 1.0 + galaxies.z[n]
        row = out[rows[n]]
        excess = -galaxies.dust[n]
        low = min(max(np.searchsorted(nodes, edges[0] / stretch, side="right") - 1, 0), last - 1)
        high = min(np.searchsorted(nodes, edges[-1] / stretch, side="right"), last)
        combine(rest, low, high + 1, galaxies.mix[n], basis)
        running[low] = 0.0
        for j in range(low, high):
            width = stretch * (nodes[j + 1] - nodes[j])
            slope[j] = (rest[j + 1] - rest[j]) / width
            running[j + 1] = running[j] + 0.5 * width * (rest[j] + rest[j + 1])
        slope[high] = 0.0  # redward of the last node the spectrum is constant
        j = low
        previous = 0.0
        for b in range(len(edges)):
            while j < high and nodes[j + 1] * stretch <= edges[b]:
                j += 1
            distance = max(edges[b] - nodes[j] * stretch, 0.0)  # blueward of the first node the flux is zero
            integral = running[j] + distance * (rest[j] + 0.5 * slope[j] * distance)
            if b > 0:
                row[b - 1] = integral - previous
            previous = integral
        for b in range(len(row)):
            x = excess * curve[b]
            row[b] *= galaxies.scale[n] * dimmed[b] * (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x / 24.0))))
        if abs(excess) > _SMALL:  # rare: this galaxy's dust differs much from the mean
            for b in range(len(row)):
                x = excess * curve[b]
                row[b] *= np.exp(x) / (1.0 + x * (1.0 + x * (0.5 + x * (1.0 / 6.0 + x / 24.0))))
        absorb(row, 0, len(row), galaxies.z[n], igm)
