"""Spectra of a table as means over bins of wavelength: what dispersed light is drawn from.

The same light as universe.spectra, without 18,001 samples an object: galaxies cell by cell of their rest-frame nodes,
each a line, so that an emission line keeps its light whatever bins it falls in.
"""

import numba
import numpy as np

from csstsim.catalog.photometry import bin_means
from csstsim.catalog.table import GALAXY, STAR
from csstsim.instrument.filter import GRID
from csstsim.universe.galaxy_sed import combine, exponential
from csstsim.universe.igm import Intergalactic, absorb
from csstsim.universe.spectra import coefficients, kinds

_LN_MAG = 0.4 * np.log(10.0)


def binned(universe, table, edges):
    """Return (n, bins) photon / s / m2 / angstrom: means of a table's spectra over bins of `edges`, samples of GRID."""
    out = np.zeros((len(table), len(edges) - 1))
    at = np.searchsorted(GRID, edges)
    inside = slice(at[0], at[-1] + 1)
    for chosen, some in kinds(table):
        if some["obj_type"][0] == GALAXY:
            out[chosen] = _galaxies(universe, some, edges)
            continue
        scale = some["sed_scale"].astype(float)
        if some["obj_type"][0] == STAR:
            part = universe.star_seds.surface(some["teff"], some["logg"], some["feh"], GRID[inside])
            part *= scale[:, None] * np.exp(-_LN_MAG * some["av"].astype(float)[:, None] * universe.extinction[inside])
        else:
            part = universe.quasar_seds.spectra(some["z"], coefficients(some), scale, some["av"], GRID[inside])
        out[chosen] = bin_means(part, at - at[0])
    return out


def _galaxies(universe, some, edges):
    seds = universe.galaxy_seds
    centres = 0.5 * (edges[1:] + edges[:-1])
    dust = _LN_MAG * some["av"].astype(float)
    usual = dust.mean()
    curve = np.interp(centres, GRID, universe.extinction)
    out = np.zeros((len(some), len(centres)))
    _integrate(
        out, some["z"].astype(float), np.ascontiguousarray(coefficients(some), dtype=float),
        some["sed_scale"].astype(float), dust - usual, np.exp(-usual * curve), curve, edges, *seds.cells(fine=True),
        *Intergalactic(centres, seds.igm).arrays,
    )  # fmt: skip
    return out


@numba.njit(cache=True, error_model="numpy")
def _integrate(
    out, z, mix, scale, dust, dimmed, curve, edges, nodes, basis, centres, lines, depths, continuum, limits, powers
):
    rest = np.empty(len(nodes))
    last = len(nodes) - 1
    for n in range(len(z)):
        stretch, row = 1.0 + z[n], out[n]
        low = min(max(np.searchsorted(nodes, edges[0] / stretch, side="right") - 1, 0), last - 1)
        high = min(np.searchsorted(nodes, edges[-1] / stretch, side="right"), last)
        combine(rest, low, high + 1, mix[n], basis)
        j, left = low, nodes[low] * stretch
        right = nodes[low + 1] * stretch
        slope = (rest[low + 1] - rest[low]) / (right - left)
        for b in range(len(row)):
            at, end, total = edges[b], edges[b + 1], 0.0
            if end <= left:  # blueward of the first node: no light
                continue
            at = max(at, left)
            while True:
                stop = min(end, right) if j < last else end
                middle = 0.5 * (at + stop) - left
                total += (stop - at) * (rest[j] + slope * middle)
                at = stop
                if at >= end:
                    break
                j += 1
                left = right
                if j < last:
                    right = nodes[j + 1] * stretch
                    slope = (rest[j + 1] - rest[j]) / (right - left)
                else:  # redward of the last node the spectrum is held
                    slope = 0.0
            row[b] = total / (end - edges[b])
        for b in range(len(row)):
            row[b] *= scale[n] * dimmed[b] * exponential(-dust[n] * curve[b])
        absorb(row, 0, len(row), z[n], centres, lines, depths, continuum, limits, powers)
