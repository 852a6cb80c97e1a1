"""Gates of one exposure of one chip: its stars, galaxies, pixels and header.

A median over exposures would hide a single faulty one. So each exposure is judged, and gates.of_exposures keeps
the failing gates. A release has thousands of exposures, so chance deviations up to WORST sigma are tolerated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.arrays.robust_sigma import sigma_of_deviations
from csstsim.base.types import BoolArray, FloatArray
from csstsim.catalog.table import GALAXY, STAR
from csstsim.catalog.truth_bricks import ID_BITS
from csstsim.measure.bricks.validation.compare import SNR_BRIGHT, SNR_MAX, spread
from csstsim.measure.bricks.validation.facts import header_off, pixels_off
from csstsim.measure.bricks.validation.gates import WORST, at_least, at_most, between
from csstsim.measure.bricks.validation.trials import SHAPES

if TYPE_CHECKING:
    from csstsim.campaign.thresholds import ValidateConfig
    from csstsim.catalog.table import ObjectTable
    from csstsim.measure.bricks.validation.facts import Facts, Off
    from csstsim.measure.bricks.validation.gates import Gate
    from csstsim.measure.bricks.validation.validate import MeasuredFrame

SNR_SHARP = 50.0  # stars' positions and shapes are judged above this
SNR_SHAPE = 20.0  # galaxies' shapes are judged above this
CLIP = 4.0  # sigma; values further off are left out of means
# added to a star's stated error: a few must not dominate a mean
FLOOR_MAG = 0.005
FLOOR_MAS = 1.0
FLOOR_PX = 0.01
BORDER = 2  # stars that proper motion takes across the border of a window
SHAPE_MAX = 1.5  # of a measured shape; longer ones are noise


def frame_gates(table: ObjectTable, frame: MeasuredFrame, limits: ValidateConfig) -> list[Gate]:
    """Return the gates of a validate.MeasuredFrame. table: trials of it; limits: ValidateConfig."""
    where = {"exposure": frame.info.get("obsid"), "chip": frame.info.get("chip")}
    of = _Gates(frame.band, where)
    return (
        _found(table, limits, of)
        + _stars(table, frame.pixel, limits, of)
        + _shapes(table, limits, of)
        + _depth(frame, limits, of)
        + (_pixels(frame, frame.facts, limits, of) + _header(frame.facts, limits, of) if frame.facts else [])
    )


class _Gates:
    """The gates of gates with band, exposure and chip filled in."""

    def __init__(self, band: str, where: Mapping[str, Any]) -> None:
        self.band = band
        self.where = where

    def at_most(
        self, name: str, value: float | None, threshold: float | None, n: int | None, chance: float = 0.0, **more: Any
    ) -> Gate:
        return at_most(name, self.band, value, threshold, n, chance, WORST, **self.where, **more)

    def at_least(self, name: str, value: float | None, threshold: float | None, n: int) -> Gate:
        return at_least(name, self.band, value, threshold, n, **self.where)

    def between(self, name: str, value: float | None, limits: tuple[float, float] | None, n: int) -> Gate:
        return between(name, self.band, value, limits, n, **self.where)

    def worst(self, name: str, found: Iterable[Off], threshold: float | None) -> list[Gate]:
        """Return a list of the gate of the (channel, value, chance) nearest to failing; empty if none is found."""
        gates = [
            self.at_most(name, value, threshold, None, WORST * chance, **({"channel": n} if n else {}))
            for n, value, chance in found
        ]
        return [max(gates, key=lambda gate: gate["margin"] or 0.0)] if gates else []


def count_gates(frame: MeasuredFrame, pix: int, limits: ValidateConfig) -> list[Gate]:
    """Return the gates of the numbers of a frame's objects on brick `pix` against those in the catalogue.

    A frame without an expectation (facts.Facts.expected) has none.
    """
    truth, (x0, x1, y0, y1) = frame.truth, frame.info["window"]
    where = {"exposure": frame.info.get("obsid"), "chip": frame.info.get("chip")}
    expected = frame.facts.expected if frame.facts else {}
    if not expected:
        return []
    x = truth["x"]
    y = truth["y"]
    on = (x > x0 - 0.5) & (x < x1 - 0.5) & (y > y0 - 0.5) & (y < y1 - 0.5) & (truth["id"] >> ID_BITS == pix)
    kinds = truth["obj_type"][on]
    counts = {"galaxies": int((kinds == GALAXY).sum()), "stars": int((kinds == STAR).sum())}
    return [
        at_most(
            f"{kind} of a frame over the catalogue's, less 1",
            frame.band,
            counts[kind] / n - 1 if n else None,
            limits.frame_counts_max,
            n,
            BORDER / n if n else 0.0,
            WORST,
            **where,
        )
        for kind, n in expected.items()
    ]


def _found(table: ObjectTable, limits: ValidateConfig, of: _Gates) -> list[Gate]:
    """Return the gates of completeness of point sources and galaxies, and of the flag of saturated stars."""
    galaxy = table["galaxy"].astype(bool)
    found = table["found"] > 0
    points = judged_points(table, limits)
    some = galaxy & (table["snr"] > limits.galaxy_snr_min) & (table["snr"] < SNR_MAX)
    full = (table["full"] > 0) & found
    return [
        of.at_least("completeness", _share(found[points]), limits.completeness_min, int(points.sum())),
        of.at_least("completeness of galaxies", _share(found[some]), limits.galaxy_completeness_min, int(some.sum())),
        of.at_least(
            "saturated stars with the flag", _share(table["sound"][full] == 0), limits.saturated_min, int(full.sum())
        ),
    ]


def judged_points(table: ObjectTable, limits: ValidateConfig) -> BoolArray:
    """Return the mask of the point sources of trials whose completeness is judged."""
    return (table["galaxy"] == 0) & (table["snr"] > limits.snr_min) & (table["snr"] < SNR_MAX)


def bright_points(table: ObjectTable) -> BoolArray:
    """Return the mask of the stars of trials whose flux is judged: found, not saturated, without neighbours."""
    bright = (table["snr"] > SNR_BRIGHT) & (table["snr"] < SNR_MAX)
    return bright & (table["galaxy"] == 0) & (table["lonely"] > 0) & (table["sound"] > 0)


def _stars(table: ObjectTable, pixel: float, limits: ValidateConfig, of: _Gates) -> list[Gate]:
    stars = bright_points(table)
    sharp = stars & (table["snr"] > SNR_SHARP)
    pull = spread(_finite(table["pull"][stars]))
    off, sigma, n = clipped_mean(table["mag_off"][stars], table["mag_err"][stars], FLOOR_MAG)
    gates = [
        of.between("width of stars' pulls", pull["sigma"], limits.pull_width, pull["n"]),
        of.at_most("zero point of an exposure [mag]", off, limits.zeropoint_max, n, WORST * sigma),
    ]
    error = table["place_err"][sharp]
    places = {
        "astrometric offset of an exposure [mas]": ("east_mas", "north_mas", error, FLOOR_MAS, limits.place_max),
        "position by the header's WCS [px]": (
            "header_east",
            "header_north",
            error / (1000 * pixel),
            FLOOR_PX,
            limits.wcs_max,
        ),
    }
    for name, (east, north, error, floor, limit) in places.items():
        (x, sigma_x, n), (y, sigma_y, _) = (clipped_mean(table[axis][sharp], error, floor) for axis in (east, north))
        value = None if x is None or y is None else float(np.hypot(x, y))
        gates.append(of.at_most(name, value, limit, n, WORST * max(sigma_x, sigma_y)))
    return gates


def _shapes(table: ObjectTable, limits: ValidateConfig, of: _Gates) -> list[Gate]:
    """Return the gates of stars' sizes and distortions against the PSF model, and of galaxies' shapes."""
    stars = bright_points(table) & (table["snr"] > SNR_SHARP)
    allowed = limits.psf_size_max, limits.psf_e_max, limits.psf_e_max
    names = "star size over PSF model, less 1", "star e1 less PSF model", "star e2 less PSF model"
    gates = []
    for name, column, limit in zip(names, SHAPES, allowed, strict=True):
        off = spread(_finite(table[column][stars]))
        gates.append(of.at_most(name, off["median"], limit, off["n"], WORST * (off["error"] or 0.0)))
    slope, sigma, n = shape_slope(table)
    turned = None if slope is None else float(abs(slope - 1))
    return [
        *gates,
        of.at_most("galaxies' shapes, measured over true, less 1", turned, limits.shape_max, n, WORST * sigma),
    ]


def shape_slope(table: ObjectTable) -> tuple[complex | None, float, int]:
    """Return (slope, error on an axis, n): the complex slope of galaxies' measured shapes against the true ones.

    It is 1 if they agree. A rotation by an angle a gives a factor exp(2 i a); a wrong sign of one component gives a
    slope near zero.
    """
    some = (table["galaxy"] > 0) & (table["snr"] > SNR_SHAPE) & (table["snr"] < SNR_MAX)
    true, got = (table[f"{name}1"][some] + 1j * table[f"{name}2"][some] for name in ("true_g", "g"))
    good = np.isfinite(true) & np.isfinite(got) & (np.abs(got) < SHAPE_MAX)
    true = true[good]
    got = got[good]
    n = int(good.sum())
    weight = float(np.sum(np.abs(true) ** 2))
    if n < 2 or weight == 0:
        return None, 0.0, n
    slope = np.sum(got * np.conj(true)) / weight
    scatter = np.sum(np.abs(got - slope * true) ** 2) / (2 * (n - 1))
    return slope, float(np.sqrt(scatter / weight)), n


def _depth(frame: MeasuredFrame, limits: ValidateConfig, of: _Gates) -> list[Gate]:
    if frame.depth is None:
        return []
    off = float(frame.info["depth_5sigma"] - np.clip(frame.info["depth_5sigma"], *frame.depth))
    return [of.at_most("depth beyond the published limits [mag]", off, limits.depth_off_max, None)]


def _pixels(frame: MeasuredFrame, facts: Facts, limits: ValidateConfig, of: _Gates) -> list[Gate]:
    found = pixels_off(frame.info.get("channels", ()), facts, frame.truth, frame.pixel)
    return (
        of.worst("background over sky and dark, less 1", found["level"], limits.level_off_max)
        + of.worst("background of a channel over that of all, less 1", found["uneven"], limits.uneven_max)
        + of.worst("noise over that of sky, dark and readout, less 1", found["noise"], limits.noise_off_max)
        + of.worst("read noise of the overscan over the camera's, less 1", found["read_noise"], limits.read_noise_max)
        + of.worst("bias of the overscan less the header's [DN]", found["bias"], limits.bias_max)
    )


def _header(facts: Facts, limits: ValidateConfig, of: _Gates) -> list[Gate]:
    found = header_off(facts)
    return (
        of.worst("header: gain over the camera's, less 1", found["gain"], limits.header_max)
        + of.worst("header: exposure time over the campaign's, less 1", found["exptime"], limits.header_max)
        + of.worst("header: read noise over the camera's, less 1", found["read_noise"], limits.header_max)
        + of.worst("header: pointing less the campaign's [arcsec]", found["pointing"], limits.pointing_max)
    )


def clipped_mean(values: FloatArray, errors: FloatArray, floor: float) -> tuple[float | None, float, int]:
    """Return (mean, its error, n); each value's sigma is its error and `floor` in quadrature. (None, 0, 0) if empty.

    Values further than CLIP sigma from the median are left out; sigma is scaled up if the values scatter by more. The
    mean's error is the larger of the stated one and that from the scatter.
    """
    good = np.isfinite(values) & np.isfinite(errors)
    values = values[good]
    sigma = np.hypot(errors[good], floor)
    if len(values) == 0:
        return None, 0.0, 0
    pull = (values - np.median(values)) / sigma
    kept = np.abs(pull) < CLIP * max(1.0, sigma_of_deviations(np.abs(pull)))
    values = values[kept]
    weight = sigma[kept] ** -2.0
    mean = float(np.average(values, weights=weight))
    stated = weight.sum() ** -0.5
    scatter = np.sqrt(np.sum(weight**2 * (values - mean) ** 2)) / weight.sum()
    return mean, float(max(stated, scatter)), len(values)


def _share(mask: BoolArray) -> float | None:
    return float(np.mean(mask)) if len(mask) else None


def _finite(values: FloatArray) -> FloatArray:
    return values[np.isfinite(values)]
