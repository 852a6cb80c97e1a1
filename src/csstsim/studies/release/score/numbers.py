"""What a catalogue is worth: completeness, purity, photometry, positions, shapes and redshifts against the truth.

Means and scatters leave out values beyond five robust sigmas, and say how many (inject.recovery.bins.number).
Photometry, positions and shapes are of objects that are alone: no other within ALONE_ARCSEC has a tenth of their light.
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
    from csstsim.studies.release.score.match import Matched

SNR_HEAD = 10.0  # of all exposures of a band together: the completeness of the headline
SNR_POSITION = 20.0
# a tenth of the light
ALONE_ARCSEC = 1.0
ALONE_MAG = 2.5
MAG_STEP = 0.5
LARGEST_STEPS = 400  # bins of magnitude: from -90 to 90
RESOLVED = 0.1  # arcsec: half-light radius of galaxies whose shapes are evaluated
OUTLIERS = {"0.15": 0.15, "0.01": 0.01}  # |z - true| / (1 + true): photometric, spectroscopic


def alone(truth: Mapping[str, AnyArray], band: str | None) -> BoolArray:
    """Return (n,): objects without a neighbour of a tenth of their light within ALONE_ARCSEC."""
    from scipy.spatial import cKDTree

    place = unit_vectors(truth["ra"], truth["dec"]).reshape(-1, 3)
    mag = brightness(truth, band)
    mask = np.ones(len(mag), bool)
    if len(mag) > 1:
        pairs = cKDTree(place).query_pairs(np.radians(ALONE_ARCSEC / 3600.0), output_type="ndarray")
        for one, other in (pairs.T, pairs.T[::-1]):
            mask[one[mag[other] < mag[one] + ALONE_MAG]] = False
    return mask


def completeness(truth: Mapping[str, AnyArray], match: Matched, mag: FloatArray) -> dict[str, list[dict[str, float]]]:
    """Return {kind: bins} of objects by true magnitude mag (n,); a bin has low, high, n, found, merged."""
    galaxy = np.asarray(truth["obj_type"]) == GALAXY
    return {
        name: _bins(mag[rows], {"found": match.found[rows], "merged": match.merged[rows]})
        for name, rows in (("all", np.ones(len(mag), bool)), ("points", ~galaxy), ("galaxies", galaxy))
    }


def purity(match: Matched, mag: FloatArray, count: int) -> list[dict[str, float]]:
    """Return bins of sources by their magnitude (count,): low, high, n, real, second."""
    return _bins(mag, {"real": match.real(count), "second": match.second})


def edges_of(mag: FloatArray) -> FloatArray:
    """Return the edges of bins of finite magnitudes; [] of none."""
    mag = mag[np.isfinite(mag)]
    if not len(mag):
        return np.zeros(0)
    low = np.floor(mag.min() / MAG_STEP)
    steps = min(np.floor(mag.max() / MAG_STEP) - low + 1, LARGEST_STEPS)
    return MAG_STEP * (low + np.arange(steps + 1))


def _bins(mag: FloatArray, masks: Mapping[str, BoolArray]) -> list[dict[str, float]]:
    edges = edges_of(mag)
    found = []
    at = np.digitize(mag, edges) - 1
    for k in range(len(edges) - 1):
        rows = at == k
        if rows.any():
            held = {name: int(mask[rows].sum()) for name, mask in masks.items()}
            found.append({"low": float(edges[k]), "high": float(edges[k + 1]), "n": int(rows.sum())} | held)
    return found


def half_found(bins: Iterable[Mapping[str, float]]) -> float | None:
    """Return the magnitude at which half are found: between the bins where the fraction falls below; None of none."""
    fraction_before = np.nan  # of no bin: compares false
    middle_before = np.nan
    for one in bins:
        fraction = one["found"] / one["n"]
        middle = (one["low"] + one["high"]) / 2
        if fraction_before >= 0.5 > fraction:
            return middle_before + (fraction_before - 0.5) / (fraction_before - fraction) * (middle - middle_before)
        fraction_before = fraction
        middle_before = middle
    return None


def shares(truth: Mapping[str, AnyArray], match: Matched, snr: FloatArray) -> dict[str, dict[str, float]]:
    """Return {kind: {n, found, low, high, merged, lost}} of objects of S/N above SNR_HEAD; low, high: 68% bounds."""
    galaxy = np.asarray(truth["obj_type"]) == GALAXY
    bright = snr > SNR_HEAD
    made = {}
    for name, rows in (("all", bright), ("points", bright & ~galaxy), ("galaxies", bright & galaxy)):
        n = int(rows.sum())
        found = int(match.found[rows].sum())
        p, low, high = fraction(found, n)
        merged = float(match.merged[rows].mean()) if n else np.nan
        made[name] = {
            "n": n,
            "completeness": p,
            "low": low,
            "high": high,
            "merged": merged,
            "lost": max(1 - p - merged, 0.0) if n else np.nan,
        }
    return made


def photometry(
    truth: Mapping[str, AnyArray], sources: Catalogue, match: Matched, clean: BoolArray, band: str, snr: FloatArray
) -> tuple[dict[str, dict[str, Any]], dict[str, AnyArray]]:
    """Return (Numbers of {points, galaxies} at S/N above SNR_HEAD, arrays for the figure): source less true [mag]."""
    rows = np.flatnonzero(match.found & clean)
    true = np.asarray(truth[f"mag_{band}"], float)[rows]
    off = np.asarray(sources[f"mag_{band}"], float)[match.row[rows]] - true
    galaxy = np.asarray(truth["obj_type"])[rows] == GALAXY
    good = np.isfinite(off)
    bright = good & (snr[rows] > SNR_HEAD)
    numbers = {name: asdict(number(off[bright & kind])) for name, kind in _kinds(galaxy)}
    return numbers, {"mag": true[good], "off": off[good], "galaxy": galaxy[good]}


def positions(
    truth: Mapping[str, AnyArray], sources: Catalogue, match: Matched, clean: BoolArray, snr: FloatArray
) -> tuple[dict[str, dict[str, dict[str, Any]]], dict[str, AnyArray]]:
    """Return (Numbers of {points, galaxies} by axis [mas] at S/N above SNR_POSITION, arrays): source less true."""
    rows = np.flatnonzero(match.found & clean & (snr > SNR_POSITION))
    at = match.row[rows]
    there, to_east, to_north = frames(*(np.radians(np.asarray(truth[name])[rows]) for name in ("ra", "dec")))
    apart = unit_vectors(np.asarray(sources["ra"])[at], np.asarray(sources["dec"])[at]).reshape(-1, 3) - there
    east = np.einsum("ni,ni->n", apart, to_east) * MAS_PER_RAD
    north = np.einsum("ni,ni->n", apart, to_north) * MAS_PER_RAD
    galaxy = np.asarray(truth["obj_type"])[rows] == GALAXY
    numbers = {
        name: {"east": asdict(number(east[kind])), "north": asdict(number(north[kind]))}
        for name, kind in _kinds(galaxy)
    }
    return numbers, {"east": east, "north": north, "galaxy": galaxy}


def shapes(
    truth: Mapping[str, AnyArray], sources: Catalogue, match: Matched, clean: BoolArray, snr: FloatArray
) -> tuple[dict[str, dict[str, float]], dict[str, tuple[FloatArray, FloatArray]]]:
    """Return (slope, offset and scatter of e1, e2 of resolved galaxies at S/N above SNR_HEAD, arrays)."""
    galaxy = (np.asarray(truth["obj_type"]) == GALAXY) & (np.nan_to_num(np.asarray(truth["size"])) > RESOLVED)
    rows = np.flatnonzero(match.found & clean & galaxy & (snr > SNR_HEAD))
    numbers = {}
    arrays = {}
    for axis in ("e1", "e2"):
        true = np.asarray(truth[axis], float)[rows]
        seen = np.asarray(sources[axis], float)[match.row[rows]]
        good = np.isfinite(true) & np.isfinite(seen)
        numbers[axis] = _line(true[good], seen[good])
        arrays[axis] = true[good], seen[good]
    return numbers, arrays


def _line(true: FloatArray, seen: FloatArray) -> dict[str, float]:
    """Return {n, slope, slope_error, offset, offset_error, scatter} of the straight line through seen against true."""
    n = len(true)
    nothing = dict.fromkeys(("slope", "slope_error", "offset", "offset_error", "scatter"), np.nan)
    if n < 3 or np.ptp(true) == 0:
        return {"n": n} | nothing
    matrix = np.column_stack([true, np.ones(n)])
    (slope, offset), *_ = np.linalg.lstsq(matrix, seen, rcond=None)
    scatter = np.sqrt(np.sum((seen - slope * true - offset) ** 2) / (n - 2))
    slope_error, offset_error = scatter * np.sqrt(np.diag(np.linalg.inv(matrix.T @ matrix)))
    values = slope, slope_error, offset, offset_error, scatter
    return {"n": n} | {name: float(value) for name, value in zip(nothing, values, strict=True)}


def redshifts(
    truth: Mapping[str, AnyArray], sources: Catalogue, match: Matched
) -> tuple[dict[str, float], dict[str, FloatArray]]:
    """Return ({n, bias, nmad, outliers}, arrays) of (z - true) / (1 + true) of objects that are not stars."""
    true = np.asarray(truth["z"], float)
    rows = np.flatnonzero(match.found & (true > 0))
    seen = np.asarray(sources["z"], float)[match.row[rows]]
    true = true[rows]
    good = np.isfinite(seen)
    off = (seen[good] - true[good]) / (1 + true[good])
    numbers: dict[str, float] = {"n": len(off), "of": len(rows)}
    if len(off):
        middle = float(np.median(off))
        numbers |= {"bias": middle, "nmad": float(robust_sigma(off, middle))}
        numbers |= {f"beyond {name}": float((np.abs(off) > most).mean()) for name, most in OUTLIERS.items()}
    return numbers, {"true": true[good], "seen": seen[good]}


def _kinds(galaxy: BoolArray) -> tuple[tuple[str, BoolArray], ...]:
    return ("points", ~galaxy), ("galaxies", galaxy)
