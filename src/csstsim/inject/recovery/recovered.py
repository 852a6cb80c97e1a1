"""Injected objects matched with measured sources: found or not, and measured minus true values.

A source of the injected frame belongs to the closest of all injected objects and all sources of the original frame. A
source that is unchanged from the original has exactly the same position, so it never matches an injected object.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

from csstsim.catalog.table import GALAXY, ObjectTable
from csstsim.measure.bricks.match import one_to_one
from csstsim.measure.bricks.validation.density import RADIUS
from csstsim.measure.source_columns import BAD_PIXELS, SATURATED, TRUNCATED

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, ComplexArray, FloatArray
    from csstsim.instrument.chip import Window

MATCH_RADIUS = 3.0  # px: the farthest match
WHY = {SATURATED: "saturated", TRUNCATED: "cut by the edge", BAD_PIXELS: "on bad pixels"}  # flags, not evaluated
DIRTY = SATURATED | TRUNCATED | BAD_PIXELS
DENSITY_SNR = 5.0  # minimum S/N of the sources of a density: most fainter ones are noise
COLUMNS = {  # {name: (type, what it is, as read by studies.compare.tables.units_of)}
    "id": (np.int64, "the injected object"),
    "point": (np.bool_, "it is a point"),
    "x": (np.float64, "px on the chip, from 0"),
    "y": (np.float64, "the same"),
    "mag": (np.float64, "AB, true"),
    "size": (np.float64, "arcsec, half-light radius; 0 of a point"),
    "density": (np.float64, "sources of S/N above 5 of the original frame within 15 arcsec, per square arcmin"),
    "found": (np.bool_, "a source belongs to it"),
    "flags": (np.int64, "bits of the source, as in measured tables; 0 if none was found"),
    "clean": (np.bool_, "found, and neither saturated nor cut nor on bad pixels"),
    "snr": (np.float64, "the source's"),
    "d_mag": (np.float64, "mag, measured minus true; PSF magnitude of points, total of galaxies"),
    "flux_pull": (np.float64, "measured minus true flux, divided by its stated error"),
    "d_x": (np.float64, "px, measured minus true"),
    "d_y": (np.float64, "the same"),
    "x_pull": (np.float64, "d_x divided by its stated error"),
    "y_pull": (np.float64, "d_y divided by its stated error"),
    "d_g1": (np.float64, "measured minus true ellipticity, component 1; NaN of points and without a shape"),
    "d_g2": (np.float64, "measured minus true ellipticity, component 2"),
}


def recovered(
    truth: ObjectTable, sources: ObjectTable, before: ObjectTable, window: Window, pixel_scale: float
) -> ObjectTable:
    """Return the ObjectTable of COLUMNS, with a row for each injected object whose position is in the window.

    truth: of the injected objects, io.truth.read_truth; sources, before: measured tables (measure.catalogue) of the
    injected and the original frame; window: instrument.chip.Window; pixel_scale [arcsec]. Its meta has the numbers of
    injected objects without a row: those `outside` the window, and those without electrons in it, `dark`.
    """
    inside = cast("BoolArray", window.contains(truth["x"], truth["y"]))
    has_electrons = truth["drawn"] > 0
    meta = {"outside": int((~inside).sum()), "dark": int((inside & ~has_electrons).sum())}
    truth = truth.take(np.flatnonzero(inside & has_electrons))
    count = len(truth)
    true_positions = _positions(truth)
    measured_positions = _positions(sources)
    original_positions = _positions(before)
    positions = np.concatenate([true_positions, original_positions])
    match = one_to_one(positions, measured_positions, np.full(len(positions), MATCH_RADIUS))[:count]
    found = match >= 0
    point = truth["obj_type"] != GALAXY
    row = np.where(found, match, 0)

    def measured(name: str) -> FloatArray:
        return np.where(found, sources[name][row], np.nan) if len(sources) else np.full(count, np.nan)

    flux = np.where(point, measured("flux_psf"), measured("flux_total"))
    error = np.where(point, measured("flux_psf_err"), measured("flux_total_err"))
    mag = np.where(point, measured("mag_psf"), measured("mag_total"))
    zeropoint = measured("zeropoint")
    true_flux = 10 ** (0.4 * (zeropoint - truth["mag"]))
    position_error = measured("pos_err") / pixel_scale
    flags = np.nan_to_num(measured("flags")).astype(int)
    e = _true_shape(truth)
    density_sources = original_positions[before["snr"] > DENSITY_SNR] if len(original_positions) else original_positions
    d_x = measured("x") - truth["x"]
    d_y = measured("y") - truth["y"]
    return ObjectTable({
        "id": truth["id"], "point": point, "x": truth["x"], "y": truth["y"], "mag": truth["mag"].astype(float),
        "size": np.where(point, 0.0, truth["size"]), "density": density(true_positions, density_sources, pixel_scale),
        "found": found, "flags": flags, "clean": found & (flags & DIRTY == 0), "snr": measured("snr"),
        "d_mag": mag - truth["mag"],
        "flux_pull": (flux - true_flux) / error, "d_x": d_x, "d_y": d_y, "x_pull": d_x / position_error,
        "y_pull": d_y / position_error, "d_g1": np.where(point, np.nan, measured("g1") - e.real),
        "d_g2": np.where(point, np.nan, measured("g2") - e.imag),
    }, meta)  # fmt: skip


def _positions(table: ObjectTable) -> FloatArray:
    """Return x, y (n, 2) px of a table's rows."""
    return np.column_stack([table["x"], table["y"]]).astype(float)


def density(positions: FloatArray, others: FloatArray, pixel_scale: float) -> FloatArray:
    """Return (n,) arcmin-2: the density of others (m, 2) within RADIUS of positions (n, 2), all in px."""
    from scipy.spatial import cKDTree

    if not len(others) or not len(positions):
        return np.zeros(len(positions))
    near = cKDTree(others).query_ball_point(positions, RADIUS / pixel_scale, return_length=True)
    return near / (np.pi * (RADIUS / 60.0) ** 2)


def _true_shape(truth: ObjectTable) -> ComplexArray:
    """Return the complex ellipticity (a - b) / (a + b) of each object, sheared by its lens (Seitz & Schneider 1997)."""
    e = truth["e1"].astype(float) + 1j * truth["e2"].astype(float)
    g = truth["g1"].astype(float) + 1j * truth["g2"].astype(float)
    return (e + g) / (1 + np.conj(g) * e)
