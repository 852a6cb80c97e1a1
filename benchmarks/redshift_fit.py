"""Redshifts of stacked slitless spectra by fits of templates, without photometry: what redshifts.py scores.

At each redshift a sum of templates with factors of 0 or more is fitted, as by redrock's NMF or EAZY, by coordinate
descent. Templates are broadened by the line spread of the PSF and of an exponential disk of the object's size, in
classes of size. How much larger the chi2 of any other redshift is, further than NEAR (1 + z) off, says how sure one is.
"""

from pathlib import Path

import numba
import numpy as np
from scipy.ndimage import gaussian_filter1d

from csstsim.base.units import C_A_S, H_J_S
from csstsim.catalog.table import ObjectTable
from csstsim.universe.parameters import load_universe

Z_MAX, STEP, TOY_STEP = 1.6, 0.0008, 0.02  # of ln(1 + z)
NEAR = 0.01
SIZES = 0.0, 0.15, 0.25, 0.35, 0.5, 0.8  # arcsec, half-light radii of classes: the lower edges
PIXEL, PSF = 0.074, 1.1  # arcsec; px rms along the trace, of PSF and pixel
PER_PX = {"GV": (0.0, 6200.0, 3.4), "GI": (6200.0, 2e4, 4.7)}  # angstrom: first, last, of a pixel
DUST = 0.0, 1.0  # mag, A(V) of `own` templates
REST = np.arange(1400.0, 11000.0, 1.0)  # angstrom: of templates before broadening
FINE = REST[1] - REST[0]
SWEEPS = 60
BATCH = 200  # galaxies at a time


def redshifts(step: float) -> np.ndarray:
    """Return the (n,) redshifts that are tried."""
    return np.expm1(np.arange(0.0, np.log1p(Z_MAX), step))


def public_templates(folder: Path) -> np.ndarray:
    """Return (t, n) flux per angstrom on REST, of mean 1, of a folder of texts."""
    files = sorted(path for path in Path(folder).iterdir() if path.suffix == ".dat")
    flux = np.array([_rebinned(np.loadtxt(path)) for path in files])
    return flux / flux.mean(axis=1, keepdims=True)


def _rebinned(table):
    """Return the means of a template over the bins of REST: lines keep their light."""
    x, y = table.T
    total = np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(x))])
    edges = np.append(REST - FINE / 2, REST[-1] + FINE / 2)
    return np.diff(np.interp(edges, x, total)) / FINE


def own_templates() -> np.ndarray:
    """Return the same of the five templates of csstsim's galaxies, with each A(V) of DUST."""
    seds = load_universe().galaxy_seds
    nodes, basis = seds.cells
    mix = np.repeat(np.eye(5), len(DUST), axis=0)
    photons = seds.coefficients(mix, np.tile(DUST, 5), np.ones(len(mix))) @ basis
    flux = np.array([np.interp(REST, nodes, row) for row in photons]) * H_J_S * C_A_S / REST
    return flux / flux.mean(axis=1, keepdims=True)


def summed(flux):
    """Return (edges, (t, n + 1) light below them) of templates: bins of any width have it as differences."""
    edges = np.append(REST - FINE / 2, REST[-1] + FINE / 2)
    return edges, np.concatenate([np.zeros((len(flux), 1)), np.cumsum(flux, axis=1) * FINE], axis=1)


def on_bins(templates, z, bins, size):
    """Return (t, bins): templates (of `summed`) at a redshift in even bins [angstrom], broadened by PSF and disk."""
    (edges, light), step = templates, bins[1] - bins[0]
    ends = np.append(bins - step / 2, bins[-1] + step / 2) / (1 + z)
    mean = np.diff(np.array([np.interp(ends, edges, row) for row in light]), axis=1)
    out, along = np.zeros_like(mean), np.hypot(PSF, 1.03 * size / PIXEL)
    for first, last, per_px in PER_PX.values():
        mine = (bins >= first) & (bins < last)
        out[:, mine] = gaussian_filter1d(mean, along * per_px / step, axis=1, mode="nearest")[:, mine]
    return out


def fitted(flux, weight, models):
    """Return (n, z) chi2 less that of zero, of (n, bins) spectra and inverse variances; models (z, t, bins)."""
    count, t, _ = models.shape
    upper = np.triu_indices(t)
    out = np.zeros((len(flux), count), np.float32)
    for k in range(count):
        model = models[k]
        pairs = (model[upper[0]] * model[upper[1]]) @ weight.T  # (pairs, n)
        right = model @ (flux * weight).T
        matrix = np.zeros((len(flux), t, t))
        matrix[:, upper[0], upper[1]] = matrix[:, upper[1], upper[0]] = pairs.T
        out[:, k] = _best(matrix, np.ascontiguousarray(right.T, dtype=float))
    return out


@numba.njit(cache=True)
def _best(matrix, right):
    """Return (n,): the least x M x - 2 x r with x >= 0, by coordinate descent."""
    out = np.zeros(len(right))
    t = right.shape[1]
    for i in range(len(right)):
        x, slope = np.zeros(t), -right[i].copy()
        for _ in range(SWEEPS):
            moved = 0.0
            for j in range(t):
                if matrix[i, j, j] <= 0.0:
                    continue
                new = max(x[j] - slope[j] / matrix[i, j, j], 0.0)
                step = new - x[j]
                if step != 0.0:
                    x[j] = new
                    moved = max(moved, step * step * matrix[i, j, j])
                    for m in range(t):
                        slope[m] += step * matrix[i, m, j]
            if moved < 1e-3:
                break
        for j in range(t):
            out[i] += x[j] * (slope[j] - right[i, j])
    return out


def answer(chi2: np.ndarray, z: np.ndarray, step: float) -> tuple[float, float]:
    """Return (z, dchi2) of a galaxy: the minimum by a parabola, and how much higher the next one is elsewhere."""
    k = int(np.argmin(chi2))
    best = z[k]
    if 0 < k < len(z) - 1:
        a, b, c = chi2[k - 1 : k + 2].astype(float)
        bend = a - 2 * b + c
        best = np.expm1(np.log1p(z[k]) + step * (0.5 * (a - c) / bend if bend > 0 else 0.0))
    far = np.abs(z - best) > NEAR * (1 + best)
    return best, float(chi2[far].min() - chi2[k])


def fit(stack: ObjectTable, objects: ObjectTable, templates: np.ndarray, step: float) -> dict[int, tuple[float, float]]:
    """Return {id: (z, how much larger the chi2 of another one is)} of the tables of `csstsim budget redshift`."""
    ids, row = np.unique(stack["id"], return_inverse=True)
    width, first = np.diff(np.unique(stack["wavelength"])).min(), stack["wavelength"].min()
    column = np.rint((stack["wavelength"] - first) / width).astype(int)
    bins, light = first + width * np.arange(column.max() + 1), summed(templates)
    flux, weight = np.zeros((2, len(ids), len(bins)), np.float32)
    scale = np.median(np.abs(stack["flux"]))
    flux[row, column] = stack["flux"] / scale
    weight[row, column] = (scale / stack["flux_err"]) ** 2
    known = dict(zip(objects["id"].tolist(), objects["size"].tolist(), strict=True))
    size = np.array([known[int(k)] for k in ids])
    group = np.searchsorted(SIZES, size, side="right") - 1
    z, found = redshifts(step), {}
    for k in np.unique(group):
        mine = np.flatnonzero(group == k)
        middle = float(np.median(size[mine]))
        models = np.array([on_bins(light, one, bins, middle) for one in z], np.float32)
        for start in range(0, len(mine), BATCH):
            some = mine[start : start + BATCH]
            for i, chi2 in zip(some, fitted(flux[some], weight[some], models), strict=True):
                found[int(ids[i])] = answer(chi2, z, step)
    return found
