"""Result of one frame's measurement for each isolated true object: found or not, and its errors (validate).

The S/N is that of the truth in optimal photometry, F / sqrt(F + n_eff rms^2), with F the electrons and rms the frame's
noise; a galaxy covers more pixels (compare). `deferred_mas` is the position residual along the columns, positive
away from the amplifier, where charge transfer moves it; `transfers` are the rows to the amplifier.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.sphere import offsets
from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.measure.bricks.match import one_to_one
from csstsim.measure.bricks.validation.compare import SNR_BRIGHT, SNR_MAX, area_ratio, half_light
from csstsim.measure.source_columns import (
    BAD_PIXELS,
    BLENDED,
    NEGATIVE_FLUX,
    NO_SHAPE,
    NOT_CENTRED,
    SATURATED,
    SHARP,
    TRUNCATED,
)

if TYPE_CHECKING:
    from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame

MATCH_PX = 2.5  # match radius of truth and detection in one frame
SHAPES = "psf_size", "psf_e1", "psf_e2"
# Columns that need more of the measured table than fluxes and positions: NaN for another code's table
FULL_TABLE = ("pull", *SHAPES, "mag_off", "mag_err", "east_mas", "north_mas", "place_err", "g1", "g2")
FOUND = ("across_mas", "deferred_mas", "light", "header_east", "header_north", "true_g1", "true_g2", *FULL_TABLE)
COLUMNS = ("galaxy", "snr", "mag", "found", "sound", "clean", "full", "x", "y", "transfers", "lonely", *FOUND)
# distance of a close pair; minimum S/N of both
PAIR_PX = 12.0
PAIR_SNR = 8.0
RESOLVED = 0.3  # minimum resolution (1 - PSF size^2 / size^2) of a galaxy whose shape is tested
SHAPELESS = BLENDED | TRUNCATED | SATURATED | NEGATIVE_FLUX | BAD_PIXELS
# flags with which a merge may leave a single detection out
DOUBTFUL = SATURATED | NOT_CENTRED | SHARP | BAD_PIXELS | NO_SHAPE
PEAK = 2.0  # peak pixel of a star centred on it, in units of its flux / n_eff: exact for a Gaussian
SATURATING = 2.0  # such a peak, in full wells, saturates even a star on a pixel's corner
LONELY = 0.3  # of an object's noise: fainter neighbours do not widen the pulls


def trials(truth: ObjectTable, frame: MeasuredFrame) -> ObjectTable:
    """Return an ObjectTable of COLUMNS, one row per isolated object of truth: measured_frame.truth_inside of `frame`.

    sound: found and not saturated; clean: found without a flag of DOUBTFUL; full: so bright that it must be saturated;
    lonely: neighbours do not affect the pull. The others are NaN if the object was not found:
    light: measured electrons (PSF) over true ones, pull: their difference over the stated error; mag_off: PSF magnitude
    less the true one, mag_err its error; east_mas, north_mas: ICRS position less the true one at the epoch, place_err
    its error on an axis; header_east, header_north [px]: the measured pixel through the header's WCS, less the true
    apparent position. psf_size, psf_e1, psf_e2: a star's size over that of the PSF model there, less 1, and its
    distortion less the model's (measure.light). true_g1, true_g2: a galaxy's sheared shape, g1, g2: the measured one,
    if it is resolved.
    """
    truth = truth.take(~truth["blended"])
    electrons = truth["electrons"].astype(float)
    galaxy = truth["obj_type"] == GALAXY
    area = frame.info["n_eff"] * area_ratio(truth, frame.info["n_eff"])
    row = matched(truth, frame.measured, frame.pixel)
    found = row >= 0
    out = {
        "galaxy": galaxy,
        "snr": electrons / np.sqrt(electrons + area * frame.info["rms"] ** 2),
        "mag": truth[f"mag_{frame.band}"].astype(float),
        "found": found,
        "sound": found.copy(),
        "clean": found.copy(),
    }
    upper = truth["y"] > frame.seam - 0.5
    out["x"], out["y"] = truth["x"], truth["y"]
    out["lonely"] = truth["crowd"] < LONELY * electrons / out["snr"]
    out["transfers"] = np.where(upper, 2 * frame.seam - 1 - truth["y"], truth["y"])
    peak = electrons * PEAK / frame.info["n_eff"]
    out["full"] = ~galaxy & (peak > SATURATING * frame.facts.full_well if frame.facts else np.zeros(len(truth), bool))
    for name in FOUND:
        out[name] = np.full(len(truth), np.nan)
    if found.any():
        rows = row[found]
        measured = frame.measured
        truth = truth.take(found)
        out["sound"][found] = (measured["flags"][rows] & SATURATED) == 0
        out["clean"][found] = (measured["flags"][rows] & DOUBTFUL) == 0
        scale = 1000 * frame.pixel
        out["across_mas"][found] = scale * (measured["x"][rows] - truth["x"])
        away = np.where(upper[found], -1.0, 1.0)
        out["deferred_mas"][found] = scale * away * (measured["y"][rows] - truth["y"])
        out["light"][found] = measured["flux_psf"][rows] / electrons[found]
        if "hsm_sigma" in measured:  # another code's table has fluxes and positions only
            values = _from_full_table(truth, measured, rows, out["mag"][found], electrons[found])
            values |= _by_header(truth, measured, rows, frame)
            for name in values:
                out[name][found] = values[name]
    return ObjectTable(out)


def _from_full_table(
    truth: ObjectTable, measured: ObjectTable, rows: IntArray, mag: FloatArray, electrons: FloatArray
) -> dict[str, FloatArray]:
    """Return {column: values} of FULL_TABLE, and true shapes, of objects found in `rows` of the measured table."""
    galaxy = truth["obj_type"] == GALAXY
    away = offsets(measured["ra"][rows], measured["dec"][rows], truth["ra_epoch"], truth["dec_epoch"])
    east, north = (3600.0 * angle for angle in away)
    out = {
        "pull": (measured["flux_psf"][rows] - electrons) / measured["flux_psf_err"][rows],
        "psf_size": measured["hsm_sigma"][rows] / measured["psf_sigma"][rows] - 1,
        **{f"psf_{axis}": measured[f"hsm_{axis}"][rows] - measured[f"psf_{axis}"][rows] for axis in ("e1", "e2")},
        "east_mas": 1000 * east,
        "north_mas": 1000 * north,
        "place_err": 1000 * measured["pos_err"][rows],
    }
    if "mag_psf" in measured:
        out |= {"mag_off": measured["mag_psf"][rows] - mag, "mag_err": measured["mag_psf_err"][rows]}
    if "g1" in measured and {"e1", "e2", "g1", "g2"} <= set(truth):
        e, g = (truth[f"{name}1"] + 1j * truth[f"{name}2"].astype(float) for name in "eg")
        true = np.where(galaxy, (e + g) / (1 + np.conj(g) * e), complex(np.nan, np.nan))
        resolved = galaxy & (measured["resolution"][rows] > RESOLVED) & ((measured["flags"][rows] & SHAPELESS) == 0)
        out |= {"true_g1": true.real, "true_g2": true.imag}
        out |= {name: np.where(resolved, measured[name][rows], np.nan) for name in ("g1", "g2")}
    return out


def _by_header(
    truth: ObjectTable, measured: ObjectTable, rows: IntArray, frame: MeasuredFrame
) -> dict[str, FloatArray]:
    """Return {header_east, header_north} [px]; empty without a WCS in the header."""
    if frame.facts is None or frame.facts.wcs is None or "ra" not in truth:
        return {}
    ra, dec = frame.facts.wcs.pixel_to_world(measured["x"][rows], measured["y"][rows])
    east, north = offsets(ra, dec, truth["ra"], truth["dec"])
    return {"header_east": 3600.0 * east / frame.pixel, "header_north": 3600.0 * north / frame.pixel}


def matched(truth: ObjectTable, measured: ObjectTable, pixel: float) -> IntArray:
    """Return the row of each object's detection (bricks.match), -1 if there is none within the match radius.

    pixel: its side [arcsec].
    """
    positions, others = (np.column_stack([table["x"], table["y"]]) for table in (truth, measured))
    return one_to_one(positions, others, np.maximum(MATCH_PX, 0.5 * half_light(truth) / pixel))


def close_pairs(truth: ObjectTable, frame: MeasuredFrame) -> IntArray:
    """Return [number found, number] of the fainter objects of close pairs of a frame.

    A pair has two objects within PAIR_PX of each other, both of a true S/N of PAIR_SNR to SNR_MAX. The fainter one is
    found if it has a detection of its own. truth: measured_frame.truth_inside of the frame.
    """
    from scipy.spatial import cKDTree

    if not len(truth):
        return np.zeros(2, int)
    electrons = truth["electrons"].astype(float)
    area = frame.info["n_eff"] * area_ratio(truth, frame.info["n_eff"])
    snr = electrons / np.sqrt(electrons + area * frame.info["rms"] ** 2)
    detectable = np.flatnonzero((snr > PAIR_SNR) & (snr < SNR_MAX))
    pairs = cKDTree(np.column_stack([truth["x"], truth["y"]])[detectable]).query_pairs(PAIR_PX, output_type="ndarray")
    first, second = detectable[pairs].T
    fainter = np.where(electrons[first] < electrons[second], first, second)
    return np.array([(matched(truth, frame.measured, frame.pixel)[fainter] >= 0).sum(), len(fainter)])


def detectable_points(table: ObjectTable, snr_min: float) -> BoolArray:
    """Return the mask of the point sources of trials whose completeness is tested."""
    return (table["galaxy"] == 0) & (table["snr"] > snr_min) & (table["snr"] < SNR_MAX)


def bright_stars(table: ObjectTable) -> BoolArray:
    """Return the mask of the stars of trials whose flux is tested: found, not saturated, without neighbours."""
    bright = (table["snr"] > SNR_BRIGHT) & (table["snr"] < SNR_MAX)
    return bright & (table["galaxy"] == 0) & (table["lonely"] > 0) & (table["sound"] > 0)


def joined(tables: Sequence[ObjectTable]) -> ObjectTable:
    """Return one table of several frames' trials."""
    return ObjectTable({name: np.concatenate([table[name] for table in tables] or [np.zeros(0)]) for name in COLUMNS})


def magnitude_at_fraction(
    mag: FloatArray, found: BoolArray, fraction: float = 0.5, step: float = 0.25, min_objects: int = 10
) -> float | None:
    """Return the magnitude at which a fraction of the objects are found, from bins of `step` [mag].

    None if no bins of `min_objects` or more cross it.
    """
    known = np.isfinite(mag)
    if not known.any():
        return None
    mag = mag[known]
    found = found[known]
    edges = np.arange(np.floor(mag.min()), mag.max() + step, step)
    n, n_found = (np.histogram(values, edges)[0] for values in (mag, mag[found]))
    good = n >= min_objects
    middle = 0.5 * (edges[1:] + edges[:-1])[good]
    found_fraction = n_found[good] / n[good]
    cross = np.flatnonzero((found_fraction[:-1] >= fraction) & (found_fraction[1:] < fraction))
    if not len(cross):
        return None
    k = cross[-1]
    first, second = found_fraction[k : k + 2]
    return float(middle[k] + (middle[k + 1] - middle[k]) * (first - fraction) / (first - second))
