"""Spectra of stars from (Teff, log g, [Fe/H]): a compact model of the ATLAS9 and BT-Settl atmospheres.

    ln S(lambda_j) = M_j + sum_k c_k(theta, log g, [Fe/H]) P_kj,    theta = 5040 K / Teff

S is the photon density leaving the surface [photon / s / m2 / angstrom] at knots 5 A apart, P the principal components
of the atmospheres' ln S and c_k their coefficients at the nodes of a grid: cubic (Hermite, from parabolic slopes) in
theta and [Fe/H], linear in log g; ln S of a black body is linear in theta where hc >> lambda k Teff, hence that axis.
Between knots S is linear in wavelength, so a band integral is exactly a sum over knots with hat-function weights.
An observer at distance d gets S (R / d)^2 10^(-0.4 A_V k(lambda)).

Outside the grid the spectrum is that of the nearest edge. builders/build_star_spectra.py makes the file
(config/universe/star_spectra.fits) from ATLAS9 above about 4000 K and BT-Settl below, both tied to the colours of real
dwarfs below 5200 K; white dwarfs at log g 7 to 9 are tied to published photometry of pure-hydrogen atmospheres. Left
out: chromospheres, rotation, alpha enhancement as an axis, helium white dwarfs.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import fitsio
import numpy as np
from numba import njit

from csstsim.base.errors import InputError
from csstsim.base.files.damage import reading
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.types import FloatArray, Floats, IntArray, PathLike
from csstsim.instrument.filter import GRID

_STEP = 10  # samples of the paper's grid between two knots
KNOTS = GRID[::_STEP]  # angstrom
_LN_MAG = 0.4 * np.log(10.0)
_CHUNK = 64  # stars at a time: their knots fit into the cache


class Seds:
    """Spectra ln S = sum_m w_m rows[i_m]; a subclass defines the rows and weights of a star (`_mix`)."""

    def __init__(self, nodes: Sequence[FloatArray], rows: FloatArray, extinction_curve: FloatArray) -> None:
        self._nodes = nodes  # rising theta, log g, [Fe/H]
        self._rows = np.ascontiguousarray(rows, dtype=float)
        self._curve = np.asarray(extinction_curve, dtype=float)[::_STEP]
        theta, logg, feh = nodes
        self.limits = {
            "teff": (5040.0 / float(theta[-1]), 5040.0 / float(theta[0])),
            "logg": (float(logg[0]), float(logg[-1])),
            "feh": (float(feh[0]), float(feh[-1])),
        }

    def surface(self, teff: Floats, logg: Floats, feh: Floats, wavelength: FloatArray = GRID) -> FloatArray:
        """Return (n, len(wavelength)) photon / s / m2 / angstrom leaving the surface, without extinction.

        wavelength: angstrom; outside 2000-11000 the spectrum has its value at the end. Raises InputError for a value
        that is not a finite number or Teff <= 0.
        """
        index, weight = self._mix(*_parameters(teff, logg, feh))
        out = np.empty((len(index), len(wavelength)))
        for star, i, w in zip(out, index, weight, strict=True):
            star[:] = np.interp(wavelength, KNOTS, np.exp(np.einsum("m,mw->w", w, self._rows[i])))
        return out

    def binned(self, teff: Floats, logg: Floats, feh: Floats, av: Floats, edges: FloatArray) -> FloatArray:
        """Return (n, len(edges) - 1): means of surface x 10^(-0.4 av k) over bins of rising `edges` [angstrom].

        As in `rates`, k is applied at the knots, between which the spectrum is linear.
        """
        index, weight = self._mix(*_parameters(teff, logg, feh))
        span = slice(np.searchsorted(KNOTS, edges[0], side="right") - 1, np.searchsorted(KNOTS, edges[-1]) + 1)
        knots = KNOTS[span]
        rows = np.ascontiguousarray(self._rows[:, span])
        av = np.asarray(av, dtype=float)
        cell = np.clip(np.searchsorted(knots, edges, side="right") - 1, 0, len(knots) - 2)
        offset = edges - knots[cell]
        spacing = KNOTS[1] - KNOTS[0]
        out = np.empty((len(index), len(edges) - 1))
        for first in range(0, len(index), _CHUNK):
            chunk = slice(first, first + _CHUNK)
            ln_flux = np.einsum("nm,nmw->nw", weight[chunk], rows[index[chunk]])
            flux = np.exp(ln_flux - _LN_MAG * av[chunk, None] * self._curve[span])
            cumulative = np.zeros_like(flux)
            np.cumsum(0.5 * spacing * (flux[:, 1:] + flux[:, :-1]), axis=1, out=cumulative[:, 1:])
            slope = np.diff(flux, axis=1) / spacing
            sums = cumulative[:, cell] + offset * (flux[:, cell] + 0.5 * offset * slope[:, cell])
            out[chunk] = np.diff(sums, axis=1) / np.diff(edges)
        return out

    def rates(self, teff: Floats, logg: Floats, feh: Floats, av: Floats, weights: FloatArray) -> FloatArray:
        """Return (n, bands): sum of surface x 10^(-0.4 av k) x weights over the paper's grid.

        weights (bands, 18001): throughput x area x step of the grid (catalog.light.photometry.subband_weights); av
        (n,): A(V) [mag]. k is applied at the knots. Compared with every 0.5 A this errs by 1e-5 at A(V) = 1 mag, and by
        1e-4 where the spectrum is steepest (NUV of cool stars).
        """
        index, weight = self._mix(*_parameters(teff, logg, feh))
        hats = _on_knots(np.asarray(weights, dtype=float))
        av = np.broadcast_to(np.asarray(av, dtype=float), len(index)).copy()
        out = np.zeros((len(index), len(hats)))
        used = np.flatnonzero(hats.any(axis=0))
        if len(used):
            band = slice(used[0], used[-1] + 1)
            rows = np.ascontiguousarray(self._rows[:, band])
            hats = np.ascontiguousarray(hats[:, band])
            index = np.array(index)  # of one layout for any number of stars, so that one version is compiled
            _integrate(index, weight, rows, av, self._curve[band], hats, _spans(hats), out)
        return out

    def _mix(self, teff: FloatArray, logg: FloatArray, feh: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the rows and weights, (n, m), that make the spectra of stars."""
        raise NotImplementedError

    def _cells(self, teff: FloatArray, logg: FloatArray, feh: FloatArray) -> tuple[_Axis, _Axis, _Axis]:
        """Return the _Axis of theta, log g and [Fe/H] for each star."""
        theta_nodes, logg_nodes, feh_nodes = self._nodes
        return cubic(theta_nodes, 5040.0 / teff), linear(logg_nodes, logg), cubic(feh_nodes, feh)


class StarSeds(Seds):
    """The compact model in the FITS file `path`; `extinction_curve` is A(lambda) / A(V) on the paper's grid, (18001,).

    Raises InputError for a file that cannot be read as such a model.
    """

    def __init__(self, path: PathLike, extinction_curve: FloatArray) -> None:
        check_headers(path)
        with reading(path, "star spectra"), fitsio.FITS(path) as file:
            nodes: list[FloatArray] = [
                np.float64(file[name].read())  # type: ignore[misc]  # an array of an array
                for name in ("THETA", "LOGG", "FEH")
            ]
            coefficients = _scaled(file["COEFF"])
            basis = _scaled(file["BASIS"])
            shape = (*map(len, nodes), len(basis) - 1)
        finite = all(np.isfinite(part).all() for part in (*nodes, coefficients, basis))
        rising = all(len(axis) > 1 and (np.diff(axis) > 0).all() for axis in nodes)
        if coefficients.shape != shape or basis.shape[1:] != KNOTS.shape or not finite or not rising:
            raise InputError("nodes, COEFF and BASIS do not fit together", file=Path(path), value=coefficients.shape)
        # Row 0 of the basis is the mean: its coefficient is 1.
        self._table = np.concatenate([np.ones((*shape[:3], 1)), coefficients], axis=3)
        super().__init__(nodes, basis, extinction_curve)

    def _mix(self, teff: FloatArray, logg: FloatArray, feh: FloatArray) -> tuple[IntArray, FloatArray]:
        (i, a), (j, b), (k, c) = self._cells(teff, logg, feh)  # indices and weights along theta, log g, [Fe/H]
        mix = np.zeros((len(teff), len(self._rows)))
        for p in range(4):
            for q in range(2):
                for r in range(4):
                    fraction = a[:, p] * b[:, q] * c[:, r]
                    mix += fraction[:, None] * self._table[i[:, p], j[:, q], k[:, r]]
        return np.broadcast_to(np.arange(len(self._rows)), mix.shape), mix


def _scaled(hdu: fitsio.hdu.ImageHDU) -> FloatArray:
    """Return an image as float64. Integers are scaled here in float32, because cfitsio rounds differently."""
    hdu.ignore_scaling = True
    values = hdu.read()
    scale = hdu.read_header().get("BSCALE", 1.0)
    values = values.astype(np.float32) * np.float32(scale) if values.dtype.kind == "i" else values
    return np.float64(values)  # type: ignore[return-value]  # an array of an array


class _Axis(NamedTuple):
    """Interpolation along one axis: indices of nodes and their weights, each (n, m)."""

    nodes: IntArray
    weights: FloatArray


def linear(nodes: FloatArray, x: FloatArray) -> _Axis:
    """Return the two nodes about x (n,) and their weights (n, 2), constant beyond the ends of the rising `nodes`."""
    x = np.clip(x, nodes[0], nodes[-1])
    i = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    t = (x - nodes[i]) / (nodes[i + 1] - nodes[i])
    return _Axis(np.stack([i, i + 1], axis=1), np.stack([1 - t, t], axis=1))


def cubic(nodes: FloatArray, x: FloatArray) -> _Axis:
    """Return the nodes and weights (n, 4) of the cubic with parabolic slopes, constant beyond the ends."""
    between = linear(nodes, x)
    t = between.weights[:, 1]
    index = np.clip(between.nodes[:, :1] + np.arange(-1, 3), 0, len(nodes) - 1)
    h = np.diff(nodes[index], axis=1)  # 0 beyond an end, where the slope is the secant
    low = h[:, 0] / (h[:, 0] + h[:, 1])
    high = h[:, 2] / (h[:, 1] + h[:, 2])
    # Slopes x h1 at both ends of the cell: `low` times its secant plus 1 - low times the one before, and so on.
    before = np.divide((1 - low) * h[:, 1], h[:, 0], out=np.zeros_like(t), where=h[:, 0] > 0)
    after = np.divide((1 - high) * h[:, 1], h[:, 2], out=np.zeros_like(t), where=h[:, 2] > 0)
    low = np.where(h[:, 0] > 0, low, 1.0)
    high = np.where(h[:, 2] > 0, high, 1.0)
    d0 = t * (1 - t) ** 2
    d1 = -(t**2) * (1 - t)
    weight = np.stack(
        [
            -d0 * before,
            (1 + 2 * t) * (1 - t) ** 2 + d0 * (before - low) - d1 * high,
            t**2 * (3 - 2 * t) + d0 * low + d1 * (high - after),
            d1 * after,
        ],
        axis=1,
    )
    return _Axis(index, weight)


def _parameters(*values: Floats) -> tuple[FloatArray, ...]:
    """Return teff, logg and feh as float64 arrays of one length."""
    values = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, dtype=float)) for v in values))
    for name, value in zip(("teff", "logg", "feh"), values, strict=True):
        if not np.isfinite(value).all() or (name == "teff" and (value <= 0).any()):
            raise InputError("a star's parameter must be a finite number, and Teff positive", key=name)
    return values


def _on_knots(weights: FloatArray) -> FloatArray:
    """Return (bands, 1801): weights on the paper's grid distributed to the knots, exact for S linear in between."""
    t = np.arange(_STEP) / _STEP
    cells = weights[:, :-1].reshape(len(weights), -1, _STEP)
    out = np.zeros((len(weights), len(KNOTS)))
    out[:, :-1] += np.einsum("bct,t->bc", cells, 1 - t)
    out[:, 1:] += np.einsum("bct,t->bc", cells, t)
    out[:, -1] += weights[:, -1]
    return out


def _spans(hats: FloatArray) -> IntArray:
    """Return (bands, 2): first and one past the last knot in use."""
    used = [np.flatnonzero(row) for row in hats]
    return np.array([(u[0], u[-1] + 1) if len(u) else (0, 0) for u in used])


@njit(cache=True)
def _integrate(
    index: IntArray,
    weight: FloatArray,
    rows: FloatArray,
    av: FloatArray,
    curve: FloatArray,
    hats: FloatArray,
    spans: IntArray,
    out: FloatArray,
) -> None:
    spectrum = np.empty(rows.shape[1])
    for s in range(len(index)):
        spectrum[:] = -0.4 * np.log(10.0) * av[s] * curve
        for m in range(index.shape[1]):
            w = weight[s, m]
            row = rows[index[s, m]]
            for j in range(len(spectrum)):
                spectrum[j] += w * row[j]
        for j in range(len(spectrum)):
            spectrum[j] = np.exp(spectrum[j])
        for b in range(len(hats)):
            total = 0.0
            for j in range(spans[b, 0], spans[b, 1]):
                total += spectrum[j] * hats[b, j]
            out[s, b] = total
