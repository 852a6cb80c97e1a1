"""Statistics of a catalogue against the truth: completeness, purity, photometry, positions, shapes and redshifts.

Means and scatters exclude values beyond five robust sigmas and count them (inject.recovery.bins.number).
Photometry, positions and shapes are of isolated objects: none within ISOLATION_ARCSEC has a tenth of their flux.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.sphere import frames, unit_vectors
from csstsim.base.units import MAS_PER_RAD
from csstsim.catalog.table import GALAXY
from csstsim.inject.recovery.bins import fraction, number
from csstsim.studies.release.score.match import brightness

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from typing import Any

    from csstsim.base.types import AnyArray, BoolArray, FloatArray
    from csstsim.studies.release.score.catalogue import Catalogue
    from csstsim.studies.release.score.match import Match

# minimum S/N, in all exposures of a band together: of the completeness in the summary, of positions
SNR_BRIGHT = 10.0
SNR_POSITION = 20.0
# of a neighbour: maximum distance; magnitudes that it may be fainter, a tenth of the flux
ISOLATION_ARCSEC = 1.0
ISOLATION_MAG = 2.5
MAG_STEP = 0.5
BINS_MAX = 400  # bins of magnitude: from -90 to 90
RADIUS_MIN = 0.1  # arcsec: half-light radius of galaxies with shape statistics
OUTLIERS = {"0.15": 0.15, "0.01": 0.01}  # |z - true| / (1 + true): photometric, spectroscopic


def isolated(truth: Mapping[str, AnyArray], band: str | None) -> BoolArray:
    """Return (n,): objects without a neighbour of a tenth of their flux within ISOLATION_ARCSEC."""
    from scipy.spatial import cKDTree

    position = unit_vectors(truth["ra"], truth["dec"]).reshape(-1, 3)
    mag = brightness(truth, band)
    mask = np.ones(len(mag), bool)
    if len(mag) > 1:
        pairs = cKDTree(position).query_pairs(np.radians(ISOLATION_ARCSEC / 3600.0), output_type="ndarray")
        for one, other in (pairs.T, pairs.T[::-1]):
            mask[one[mag[other] < mag[one] + ISOLATION_MAG]] = False
    return mask


def completeness(truth: Mapping[str, AnyArray], match: Match, mag: FloatArray) -> dict[str, list[dict[str, float]]]:
    """Return {kind: bins} of objects by true magnitude mag (n,); a bin has low, high, n, found, merged."""
    galaxy = np.asarray(truth["obj_type"]) == GALAXY
    return {
        name: _bins(mag[rows], {"found": match.found[rows], "merged": match.merged[rows]})
        for name, rows in (("all", np.ones(len(mag), bool)), ("points", ~galaxy), ("galaxies", galaxy))
    }


def purity(match: Match, mag: FloatArray, count: int) -> list[dict[str, float]]:
    """Return bins of sources by their magnitude (count,): low, high, n, real, second."""
    return _bins(mag, {"real": match.real(count), "second": match.second})


def bin_edges(mag: FloatArray) -> FloatArray:
    """Return the edges of bins over the finite magnitudes; empty without any."""
    mag = mag[np.isfinite(mag)]
    if not len(mag):
        return np.zeros(0)
    low = np.floor(mag.min() / MAG_STEP)
    steps = min(np.floor(mag.max() / MAG_STEP) - low + 1, BINS_MAX)
    return MAG_STEP * (low + np.arange(steps + 1))


def _bins(mag: FloatArray, masks: Mapping[str, BoolArray]) -> list[dict[str, float]]:
    edges = bin_edges(mag)
    bins = []
    bin_number = np.digitize(mag, edges) - 1
    for k in range(len(edges) - 1):
        rows = bin_number == k
        if rows.any():
            counts = {name: int(mask[rows].sum()) for name, mask in masks.items()}
            bins.append({"low": float(edges[k]), "high": float(edges[k + 1]), "n": int(rows.sum())} | counts)
    return bins


def half_found_magnitude(bins: Iterable[Mapping[str, float]]) -> float | None:
    """Return the magnitude at which half are found, interpolated where the fraction first falls below; None: never."""
    fraction_before = np.nan  # before the first bin: compares false
    middle_before = np.nan
    for bin_ in bins:
        fraction = bin_["found"] / bin_["n"]
        middle = (bin_["low"] + bin_["high"]) / 2
        if fraction_before >= 0.5 > fraction:
            return middle_before + (fraction_before - 0.5) / (fraction_before - fraction) * (middle - middle_before)
        fraction_before = fraction
        middle_before = middle
    return None


def completeness_of_bright(truth: Mapping[str, AnyArray], match: Match, snr: FloatArray) -> dict[str, dict[str, float]]:
    """Return {kind: {n, completeness, low, high, merged, lost}} at S/N above SNR_BRIGHT; low, high: 68% bounds."""
    galaxy = np.asarray(truth["obj_type"]) == GALAXY
    bright = snr > SNR_BRIGHT
    out = {}
    for name, rows in (("all", bright), ("points", bright & ~galaxy), ("galaxies", bright & galaxy)):
        n = int(rows.sum())
        found = int(match.found[rows].sum())
        value, low, high = fraction(found, n)
        merged = float(match.merged[rows].mean()) if n else np.nan
        out[name] = {
            "n": n,
            "completeness": value,
            "low": low,
            "high": high,
            "merged": merged,
            "lost": max(1 - value - merged, 0.0) if n else np.nan,
        }
    return out


def photometry(
    truth: Mapping[str, AnyArray], sources: Catalogue, match: Match, isolated: BoolArray, band: str, snr: FloatArray
) -> tuple[dict[str, dict[str, Any]], dict[str, AnyArray]]:
    """Return ({points, galaxies: Numbers} at S/N above SNR_BRIGHT, arrays for the figure) of source - true [mag]."""
    rows = np.flatnonzero(match.found & isolated)
    true = np.asarray(truth[f"mag_{band}"], float)[rows]
    difference = np.asarray(sources[f"mag_{band}"], float)[match.source_row[rows]] - true
    galaxy = np.asarray(truth["obj_type"])[rows] == GALAXY
    finite = np.isfinite(difference)
    bright = finite & (snr[rows] > SNR_BRIGHT)
    statistics = {name: asdict(number(difference[bright & kind])) for name, kind in _by_kind(galaxy)}
    return statistics, {"mag": true[finite], "off": difference[finite], "galaxy": galaxy[finite]}


def positions(
    truth: Mapping[str, AnyArray], sources: Catalogue, match: Match, isolated: BoolArray, snr: FloatArray
) -> tuple[dict[str, dict[str, dict[str, Any]]], dict[str, AnyArray]]:
    """Return ({points, galaxies: {axis: Numbers}} at S/N above SNR_POSITION, arrays) of source - true [mas]."""
    rows = np.flatnonzero(match.found & isolated & (snr > SNR_POSITION))
    true_vectors, to_east, to_north = frames(*(np.radians(np.asarray(truth[name])[rows]) for name in ("ra", "dec")))
    ra, dec = (np.asarray(sources[name])[match.source_row[rows]] for name in ("ra", "dec"))
    offset = unit_vectors(ra, dec).reshape(-1, 3) - true_vectors
    east = np.einsum("ni,ni->n", offset, to_east) * MAS_PER_RAD
    north = np.einsum("ni,ni->n", offset, to_north) * MAS_PER_RAD
    galaxy = np.asarray(truth["obj_type"])[rows] == GALAXY
    statistics = {
        name: {"east": asdict(number(east[kind])), "north": asdict(number(north[kind]))}
        for name, kind in _by_kind(galaxy)
    }
    return statistics, {"east": east, "north": north, "galaxy": galaxy}


def shapes(
    truth: Mapping[str, AnyArray], sources: Catalogue, match: Match, isolated: BoolArray, snr: FloatArray
) -> tuple[dict[str, dict[str, float]], dict[str, tuple[FloatArray, FloatArray]]]:
    """Return ({e1, e2: slope, offset, scatter} of resolved galaxies at S/N above SNR_BRIGHT, arrays)."""
    galaxy = (np.asarray(truth["obj_type"]) == GALAXY) & (np.nan_to_num(np.asarray(truth["size"])) > RADIUS_MIN)
    rows = np.flatnonzero(match.found & isolated & galaxy & (snr > SNR_BRIGHT))
    statistics = {}
    arrays = {}
    for axis in ("e1", "e2"):
        true = np.asarray(truth[axis], float)[rows]
        measured = np.asarray(sources[axis], float)[match.source_row[rows]]
        finite = np.isfinite(true) & np.isfinite(measured)
        statistics[axis] = _fit_line(true[finite], measured[finite])
        arrays[axis] = true[finite], measured[finite]
    return statistics, arrays


def _fit_line(true: FloatArray, measured: FloatArray) -> dict[str, float]:
    """Return {n, slope, slope_error, offset, offset_error, scatter} of a straight line: measured against true (n,)."""
    n = len(true)
    nothing = dict.fromkeys(("slope", "slope_error", "offset", "offset_error", "scatter"), np.nan)
    if n < 3 or np.ptp(true) == 0:
        return {"n": n} | nothing
    matrix = np.column_stack([true, np.ones(n)])
    (slope, offset), *_ = np.linalg.lstsq(matrix, measured, rcond=None)
    scatter = np.sqrt(np.sum((measured - slope * true - offset) ** 2) / (n - 2))
    slope_error, offset_error = scatter * np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    values = slope, slope_error, offset, offset_error, scatter
    return {"n": n} | {name: float(value) for name, value in zip(nothing, values, strict=True)}


def redshifts(
    truth: Mapping[str, AnyArray], sources: Catalogue, match: Match
) -> tuple[dict[str, float], dict[str, FloatArray]]:
    """Return ({n, bias, nmad, outliers}, arrays) of (z - true) / (1 + true) of objects that are not stars."""
    true = np.asarray(truth["z"], float)
    rows = np.flatnonzero(match.found & (true > 0))
    measured = np.asarray(sources["z"], float)[match.source_row[rows]]
    true = true[rows]
    finite = np.isfinite(measured)
    difference = (measured[finite] - true[finite]) / (1 + true[finite])
    statistics: dict[str, float] = {"n": len(difference), "of": len(rows)}
    if len(difference):
        middle = float(np.median(difference))
        statistics |= {"bias": middle, "nmad": float(robust_sigma(difference, middle))}
        statistics |= {f"beyond {name}": float((np.abs(difference) > limit).mean()) for name, limit in OUTLIERS.items()}
    return statistics, {"true": true[finite], "seen": measured[finite]}


def _by_kind(galaxy: BoolArray) -> tuple[tuple[str, BoolArray], ...]:
    return ("points", ~galaxy), ("galaxies", galaxy)
