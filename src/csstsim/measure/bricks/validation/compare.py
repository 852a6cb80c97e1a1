"""Merged sources against true objects: matches, purity, magnitudes, positions, colours (for `validate`).

The S/N of a galaxy assumes n_eff + 9 r_e^2 px: 8 pi h^2 for a face-on exponential disc of h = r_e / 1.678 (9.06 r_e^2
for a Gaussian). Positions are compared at the epoch of observation (`ra_epoch`: ICRS, with proper motion and parallax)
and matched one to one (bricks.match). Purity is the fraction of the merged sources that match a true object of any
kind.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.arrays.robust_sigma import robust_sigma
from csstsim.base.sphere import offsets, unit_vectors
from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.catalog.table import GALAXY
from csstsim.measure.bricks.match import one_to_one
from csstsim.measure.source_columns import SATURATED

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable

SNR_MAX = 500.0  # brighter sources may be near saturation
SNR_BRIGHT = 20.0  # magnitude and position residuals are tested above this
SNR_SHARP = 50.0  # stars' positions and shapes are tested above this
SNR_GALAXY = (10.0, 20.0, 60.0, 500.0)  # edges of the bins in which galaxies' total magnitudes are evaluated
SNR_GALAXY_COLOUR = (10.0, 20.0, 500.0)  # the same of their colours: measured S/N, in both bands
SNR_COUNT = 20.0  # in one exposure: above it number counts and losses in the merge are tested
SNR_COLOUR = 10.0  # measured, in each band
MATCH_ARCSEC = 0.2  # match radius; for galaxies at least half the half-light radius


def match(truth: ObjectTable, sources: ObjectTable) -> IntArray:
    """Return the row of each true object's merged source (bricks.match), -1 if there is none within the match radius.

    A quasar and its host have the same position: of objects equally far, the brighter has the source.
    """
    positions = unit_vectors(truth["ra_epoch"], truth["dec_epoch"])
    others = unit_vectors(sources["ra"], sources["dec"])
    order = np.argsort(_brightest_magnitude(truth), kind="stable")
    row = np.full(len(truth), -1)
    row[order] = one_to_one(positions[order], others, np.radians(match_radius(truth)[order] / 3600.0))
    return row


def _brightest_magnitude(truth: ObjectTable) -> FloatArray:
    """Return (n,): the magnitude of each object in the band where it is brightest; infinite if none is known."""
    known = [np.nan_to_num(truth[name].astype(float), nan=np.inf) for name in truth if name.startswith("mag_")]
    return np.min(known, axis=0) if known else np.full(len(truth), np.inf)


def half_light(truth: ObjectTable) -> FloatArray:
    """Return half-light radii, arcsec: means of disc and bulge weighted with their flux; 0 for point sources."""
    if not {"size_disk", "size_bulge", "bulge_frac"} <= set(truth):
        return np.zeros(len(truth))
    bulge = truth["bulge_frac"].astype(float)
    size = (1.0 - bulge) * truth["size_disk"] + bulge * truth["size_bulge"]
    return np.where(truth["obj_type"] == GALAXY, np.nan_to_num(size), 0.0)


def area_ratio(truth: ObjectTable, n_eff: float) -> FloatArray:
    """Return (n,): the pixels that each object covers over those of a point source."""
    return 1.0 + 9.0 * truth["half_light_px"] ** 2 / n_eff


def match_radius(truth: ObjectTable) -> FloatArray:
    """Return the match radius of true objects, arcsec."""
    return np.maximum(MATCH_ARCSEC, 0.5 * (truth["half_light"] if "half_light" in truth else half_light(truth)))


def matched_sources(truth: ObjectTable, sources: ObjectTable) -> IntArray:
    """Return the rows of the merged sources that belong to a true object.

    The truth contains all objects that were rendered: those below the campaign's limit are not. If one object gives two
    sources, one of them belongs to it.
    """
    row = match(truth, sources)
    return row[row >= 0]


def magnitudes(
    band: str, truth: ObjectTable, sources: ObjectTable, match: IntArray, infos: Sequence[Mapping[str, Any]]
) -> tuple[dict[str, tuple[FloatArray, FloatArray]], dict[str, Any]]:
    """Return ({kind: (true, out - in)}, {kind: statistics at SNR_BRIGHT}) of isolated stars and galaxies, AB mag.

    Stars have PSF magnitudes, galaxies total ones. The statistics' galaxy_kron are of the same galaxies' Kron
    magnitudes, which leave out the light beyond the ellipse; galaxy_bins those of total magnitudes in the bins of
    SNR_GALAXY, each with its `snr` (low, high).
    """
    arrays: dict[str, tuple[FloatArray, FloatArray]] = {}
    numbers: dict[str, Any] = {}
    galaxy = truth["obj_type"] == GALAXY
    for name, is_kind, prefix in (("star", ~galaxy, ""), ("galaxy", galaxy, "total_")):
        rows = np.flatnonzero(is_kind & ~truth["blended"].astype(bool) & (match >= 0))
        source = match[rows]
        true_mag = truth[f"mag_{band}"][rows].astype(float)
        measured = sources[f"{prefix}mag_{band}"][source]
        # S/N from the true magnitude, so that the selection does not follow the noise of the measured one.
        area = area_ratio(truth, np.median([info["n_eff"] for info in infos]))[rows]
        flux = 10.0 ** (-0.4 * (true_mag - 23.9))
        snr = flux / (sources[f"flux_err_{band}"][source] * np.sqrt(area))
        good = np.isfinite(true_mag) & np.isfinite(measured) & ((sources["flags"][source] & SATURATED) == 0)
        bright = good & (snr > SNR_BRIGHT) & (snr < SNR_MAX)
        arrays[name] = true_mag[good], (measured - true_mag)[good]
        numbers[name] = spread((measured - true_mag)[bright])
        if name == "galaxy":
            numbers["galaxy_bins"] = [
                {"snr": [low, high]} | spread((measured - true_mag)[good & (snr >= low) & (snr < high)])
                for low, high in pairwise(SNR_GALAXY)
            ]
            off = sources[f"kron_mag_{band}"][source] - true_mag
            numbers["galaxy_kron"] = spread(off[bright & np.isfinite(off)])
    return arrays, numbers


def true_snr(band: str, truth: ObjectTable, infos: Sequence[Mapping[str, Any]]) -> FloatArray:
    """Return the S/N (n,) of true objects in one exposure of the band: trials' with the exposures' medians."""
    zeropoint, n_eff, rms = (np.median([info[name] for info in infos]) for name in ("zeropoint", "n_eff", "rms"))
    electrons = 10.0 ** (-0.4 * (truth[f"mag_{band}"].astype(float) - zeropoint))
    return electrons / np.sqrt(electrons + n_eff * area_ratio(truth, n_eff) * rms**2)


def counts(
    band: str,
    truth: ObjectTable,
    sources: ObjectTable,
    match: IntArray,
    real: BoolArray,
    edges: FloatArray,
    infos: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Return the number counts of a band, true and measured, {edges, in, out, excess, n}.

    in: the true objects; out: their sources (`match`) and the false ones (not `real`), stars by PSF magnitude, others
    by total magnitude. excess: the fraction of the isolated true objects of S/N above SNR_COUNT (`true_snr`) that have
    a source in the band, less 1, plus the number of false sources above that measured S/N over that of all true objects
    above it. Blends do not count as lost: detecting two overlapping objects as one is correct. n: isolated objects.
    """
    star = np.asarray(sources["star"]) > 0.5
    measured = np.where(star, sources[f"mag_{band}"], sources[f"total_mag_{band}"])
    false = ~np.asarray(real)
    true_mag = truth[f"mag_{band}"].astype(float)
    matched = np.unique(match[match >= 0])
    got = measured[np.union1d(matched, np.flatnonzero(false))]
    bright = np.nan_to_num(true_snr(band, truth, infos)) > SNR_COUNT
    isolated = bright & ~truth["blended"].astype(bool)
    detected = np.append(np.asarray(sources[f"n_{band}"]) > 0, False)[match]  # in this band; row -1: no match
    false_bright = np.nan_to_num(sources[f"flux_{band}"] / sources[f"flux_err_{band}"])[false] > SNR_COUNT
    n = int(isolated.sum())
    return {
        "edges": list(map(float, edges)),
        "in": np.histogram(true_mag[np.isfinite(true_mag)], edges)[0].tolist(),
        "out": np.histogram(got[np.isfinite(got)], edges)[0].tolist(),
        "excess": float((detected & isolated).sum() / n - 1 + false_bright.sum() / bright.sum()) if n else None,
        "n": n,
    }


def lost(truth: ObjectTable, match: IntArray, required: Sequence[IntArray]) -> dict[str, tuple[float | None, int]]:
    """Return {"stars", "galaxies": (fraction, n)}: the fraction without a source, of n objects (ids `required`)."""
    found = np.isin(truth["id"], np.concatenate(required or [np.zeros(0, int)]))
    out = {}
    galaxy = truth["obj_type"] == GALAXY
    for name, kind in (("stars", found & ~galaxy), ("galaxies", found & galaxy)):
        out[name] = (float((match[kind] < 0).mean()) if kind.any() else None), int(kind.sum())
    return out


def duplicates(truth: ObjectTable, sources: ObjectTable, match: IntArray) -> tuple[float | None, int]:
    """Return (fraction, n): surplus sources at the positions of n isolated true objects with a source, over n.

    The surplus is of sources over true objects, faint ones included, within the match radius.
    """
    rows = np.flatnonzero(~truth["blended"].astype(bool) & (match >= 0))
    if len(rows) == 0:
        return None, 0
    from scipy.spatial import cKDTree

    positions = unit_vectors(truth["ra_epoch"], truth["dec_epoch"])
    radii = np.radians(match_radius(truth) / 3600.0)[rows]
    true, found = (
        cKDTree(points).query_ball_point(positions[rows], radii, return_length=True)
        for points in (positions, unit_vectors(sources["ra"], sources["dec"]))
    )
    return float(np.maximum(found - true, 0).sum() / len(rows)), len(rows)


def astrometry(
    truth: ObjectTable, sources: ObjectTable, match: IntArray, bands: Iterable[str], snr_min: float = SNR_BRIGHT
) -> tuple[FloatArray, FloatArray]:
    """Return residuals (east, north) of the merged positions of isolated point sources above an S/N, out - in, mas."""
    rows = np.flatnonzero((truth["obj_type"] != GALAXY) & ~truth["blended"].astype(bool) & (match >= 0))
    source = match[rows]
    snr = [np.nan_to_num(sources[f"flux_{b}"][source] / sources[f"flux_err_{b}"][source]) for b in bands]
    good = (np.max(snr, axis=0, initial=0.0) > snr_min) & ((sources["flags"][source] & SATURATED) == 0)
    rows = rows[good]
    source = source[good]
    east, north = offsets(
        sources["ra"][source], sources["dec"][source], truth["ra_epoch"][rows], truth["dec_epoch"][rows]
    )
    return east * 3.6e6, north * 3.6e6


def colour_bands(bands: Collection[str]) -> tuple[str, ...]:
    """Return the three neighbouring bands whose colours are shown: from the second on, if there are four or more."""
    first = 1 if len(bands) > 3 else 0
    return tuple(bands)[first : first + 3]


def colours(
    truth: ObjectTable,
    sources: ObjectTable,
    match: IntArray,
    bands: Collection[str],
    snr_min: float = SNR_COLOUR,
    kind: str | None = None,
) -> dict[str, Any]:
    """Return the colours of the same sources, true and measured: {bands, input, output (2, n), galaxy (n,)}.

    Sources are matched and unblended with S/N > `snr_min` in the three bands; with fewer bands the arrays are empty.
    kind: "star" leaves galaxies out. Magnitudes and S/N are PSF ones for stars and quasars, those of the Gaussian
    aperture for galaxies.
    """
    complete = len(truth) and len(bands) == 3
    rows = np.flatnonzero(~truth["blended"].astype(bool) & (match >= 0)) if complete else np.zeros(0, int)
    source = match[rows]
    galaxy = truth["obj_type"][rows] == GALAXY if len(rows) else np.zeros(0, bool)
    good = (np.asarray(sources["flags"])[source] & SATURATED) == 0
    good &= ~galaxy if kind == "star" else True
    true = []
    measured = []
    for band in bands if complete else ():
        snr, mag = (
            np.where(galaxy, *(values[source] for values in pair))
            for pair in (
                [sources[f"{p}flux_{band}"] / sources[f"{p}flux_err_{band}"] for p in ("gaap_", "")],
                [sources[f"{p}mag_{band}"] for p in ("gaap_", "")],
            )
        )
        good &= np.nan_to_num(snr) > snr_min
        true.append(truth[f"mag_{band}"][rows].astype(float))
        measured.append(mag)
    true_mags, measured_mags = (np.array(mags) if complete else np.zeros((3, 0)) for mags in (true, measured))
    good &= np.isfinite(true_mags).all(axis=0) & np.isfinite(measured_mags).all(axis=0)
    colours = (np.stack([m[0] - m[1], m[1] - m[2]])[:, good] for m in (true_mags, measured_mags))
    return {"bands": tuple(bands)} | dict(zip(("input", "output"), colours, strict=True)) | {"galaxy": galaxy[good]}


def galaxy_colours(
    truth: ObjectTable, sources: ObjectTable, match: IntArray, bands: Iterable[str]
) -> list[dict[str, Any]]:
    """Return [{bands, snr, median, error, sigma, n}]: isolated galaxies' colours, out - in [mag], by their S/N.

    Colours are those of the Gaussian aperture in neighbouring bands; the S/N is the lower one of the two.
    """
    rows = np.flatnonzero((truth["obj_type"] == GALAXY) & ~truth["blended"].astype(bool) & (match >= 0))
    source = match[rows]
    parts = []
    sound = (np.asarray(sources["flags"])[source] & SATURATED) == 0
    for pair in pairwise(bands):
        snr = np.minimum(*(sources[f"gaap_flux_{b}"][source] / sources[f"gaap_flux_err_{b}"][source] for b in pair))
        true_colour, measured_colour = (
            first[at].astype(float) - second[at]
            for (first, second), at in (
                ([truth[f"mag_{b}"] for b in pair], rows),
                ([sources[f"gaap_mag_{b}"] for b in pair], source),
            )
        )
        off = measured_colour - true_colour
        good = sound & np.isfinite(off) & np.isfinite(snr)
        for low, high in pairwise(SNR_GALAXY_COLOUR):
            in_bin = good & (snr >= low) & (snr < high)
            parts.append({"bands": list(pair), "snr": [low, high]} | spread(off[in_bin]))
    return parts


def spread(values: FloatArray) -> dict[str, Any]:
    """Return median, its standard error, robust sigma and count, JSON-like; those that n is too small for are None."""
    n = len(values)
    if n == 0:
        return {"median": None, "error": None, "sigma": None, "n": 0}
    median = float(np.median(values))
    if n == 1:
        return {"median": median, "error": None, "sigma": None, "n": 1}
    sigma = float(robust_sigma(values, median))
    return {"median": median, "error": float(1.2533 * sigma / np.sqrt(n)), "sigma": sigma, "n": n}
