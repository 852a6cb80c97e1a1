"""Bright stars: their light is fitted on the frame and subtracted, so that sources near them can be detected.

A candidate is a group of saturated pixels, or a pixel far above the sky that exceeds its neighbours. The PSF is fitted
to its usable pixels by Gauss-Newton steps: flux, position and a constant. A candidate that does not have the shape of
the PSF, a galaxy, is not subtracted. All the light of a star is subtracted: the PSF's box, the wing beyond it, and its
ghosts (optics.scatter). The noise map includes the noise of the star's light and MODEL_ERROR of its flux.

Left out: stars off the frame, whose wings and ghosts count as background; a second star among the saturated pixels of
another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.measure.calibration.bad_pixels import FULL
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.photometry import psf_tables, render_psf, table_steps

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip, Window
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.optics.scatter.ghosts import Ghosts
    from csstsim.optics.scatter.scattered_light import Scattered

PEAK = 4000.0  # electron above the sky: minimum of a candidate's pixel; in r a star of 16,000 electrons
CORE_HALF = 6  # px, half the side of the stamp of a candidate without saturated pixels
SPILL_REACH = 2  # px about a saturated pixel that charge may have reached
GROUP_RADIUS = 3.0  # px; saturated pixels within it belong to one star
SHIFT_MAX = 6.0  # px; a fit that moves further from its start has failed
MODEL_ERROR = 0.03  # of the flux in a pixel: error of PSF and wing
CHI2_MAX = 4.0  # reduced, MODEL_ERROR included; a candidate with more is a galaxy, or two stars
CLIP = 5.0  # sigma: pixels further above the fit belong to other sources
STEPS = 12
# of the box's half side: radii between which the model passes from the PSF to the wing
BLEND_FROM = 0.7
BLEND_TO = 0.95
WING_LEVEL_MIN = 0.04  # of the noise of a pixel: a wing is subtracted to this level
PSF_CELL = 1152  # px; one PSF for the stars of such a cell
WING_STEP = 0.25  # px
_FLUX, _X, _Y, _CONSTANT = range(4)  # indices of the unknowns of a fit


class StarModel(NamedTuple):
    """Fields of BrightStars that describe the stars' light without ghosts."""

    x: FloatArray
    y: FloatArray
    flux: FloatArray
    table: IntArray
    tables: FloatArray
    per_pixel: int
    wing: FloatArray
    reach: FloatArray


class StarFits(NamedTuple):
    """Fits (n,): flux [electron], position [px], reduced chi2; flux NaN where no fit is possible."""

    flux: FloatArray
    x: FloatArray
    y: FloatArray
    chi2: FloatArray


class _StarFit(NamedTuple):
    """The unknowns of a fit: flux (electron), position [px], constant (electron / px)."""

    flux: float
    x: float
    y: float
    constant: float


class _Step(NamedTuple):
    """A star after a step, the `shift` [px] of the step, and the reduced chi2 before it; chi2 NaN: no step."""

    star: _StarFit
    shift: float
    chi2: float


@dataclass(frozen=True)
class BrightStars:
    """The stars of a frame and the model of their light.

    `x`, `y` [px of the frame], `flux` [electron], `saturated` (n,); `tables` (m, t, t): spline coefficients of PSFs
    (photometry.psf_tables), `per_pixel` along a pixel; `table` (n,): number of each star's PSF; `wing`: fraction of the
    flux per pixel in steps of WING_STEP from the star; `reach` (n,): radius of its wing [px]; `ghosts` (g, 4): x, y,
    radius [px], electron per pixel.
    """

    x: FloatArray
    y: FloatArray
    flux: FloatArray
    saturated: BoolArray
    table: IntArray
    tables: FloatArray
    per_pixel: int
    wing: FloatArray
    reach: FloatArray
    ghosts: FloatArray

    def __len__(self) -> int:
        return len(self.x)

    def subtract_from(self, image: FloatArray) -> None:
        """Subtract the light of all stars from an image (ny, nx), in place."""
        self._add(image, -1.0, np.empty((0, 0), np.float32))

    def restore_to(self, image: FloatArray) -> None:
        """Add the light of all stars to an image (ny, nx), in place."""
        self._add(image, 1.0, np.empty((0, 0), np.float32))

    def add_noise_to(self, rms: FloatArray) -> None:
        """Add the noise of the stars' light, and MODEL_ERROR of it, to a noise map in place.

        rms: noise of a pixel, on bins of BIN px; the variance of a bin is the mean of those of its pixels.
        """
        self._add(np.empty((0, 0), np.float32), 0.0, rms)

    def _add(self, image: FloatArray, sign: float, rms: FloatArray) -> None:
        model = StarModel(self.x, self.y, self.flux, self.table, self.tables, self.per_pixel, self.wing, self.reach)
        _add_stars(image, sign, rms, model)
        _add_ghosts(image, sign, rms, self.ghosts)


def bright_stars(
    electrons: FloatArray,
    unusable: IntArray,
    psf: PsfSet,
    scattered: Scattered,
    chip: Chip,
    window: Window,
    read_noise: float,
) -> BrightStars:
    """Return the BrightStars of a calibrated frame.

    `electrons` float32 (ny, nx), sky included; `unusable` uint8 (ny, nx), of bad_pixels.fill_bad_pixels; `psf`: PsfSet
    of the chip; `scattered`: its optics.scatter.scattered_light.Scattered; `window`: the frame's position on the chip;
    `read_noise` electron.
    """
    sky = float(np.median(electrons[::8, ::8]))
    variance = max(sky, 0.0) + read_noise**2
    full, (peak_y, peak_x) = _pixels(electrons, unusable, np.float32(sky + PEAK))
    x, y = _groups(*full)
    saturated = np.repeat([True, False], [len(x), len(peak_x)])
    x = np.concatenate([x, peak_x])
    y = np.concatenate([y, peak_y])
    table, tables = _tables(psf, x + window.x0, y + window.y0)
    per_pixel = table_steps(psf.oversampling)
    half = _half(tables, per_pixel) if len(tables) else 0
    halves = np.where(saturated, half, min(CORE_HALF, half))
    fit = _fit_stars(electrons, _spilled(unusable, *full), tables, per_pixel, table, x, y, halves, sky, read_noise**2)
    good = (fit.flux > 0) & (np.hypot(fit.x - x, fit.y - y) < SHIFT_MAX) & (fit.chi2 < CHI2_MAX)
    good &= saturated | (fit.flux > PEAK)
    good &= ~_repeated(fit, good)
    flux = fit.flux[good]
    x = fit.x[good]
    y = fit.y[good]
    ny, nx = electrons.shape
    longest = math.hypot(ny + SHIFT_MAX + BIN, nx + SHIFT_MAX + BIN)  # from a star beyond a corner to the last bin
    radii = WING_STEP * np.arange(math.ceil(longest / WING_STEP) + 2)
    wing = np.zeros(radii.size)
    if scattered.wing is not None:
        wing = scattered.wing.profile(np.maximum(radii, 1.0)).mean(axis=0)
    level = WING_LEVEL_MIN * math.sqrt(variance) / np.maximum(flux, 1.0)
    reach = WING_STEP * np.searchsorted(-wing, -level) if scattered.wing is not None else np.zeros(len(x))
    ghosts = np.zeros((0, 4)) if scattered.ghosts is None else _ghosts(scattered.ghosts, chip, window, x, y, flux)
    return BrightStars(x, y, flux, saturated[good], table[good], tables, per_pixel, wing, reach.astype(float), ghosts)


def _groups(row: IntArray, column: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return (x, y) of the groups of pixels within GROUP_RADIUS of each other: the middle of their widest rows."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(row) == 0:
        return np.zeros(0), np.zeros(0)
    pairs = cKDTree(np.column_stack([row, column])).query_pairs(GROUP_RADIUS, output_type="ndarray")
    linked = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(len(row), len(row)))
    count, group = connected_components(linked, directed=False)
    line, line_of_pixel = np.unique(group * (row.max() + 1) + row, return_inverse=True)  # one line of one group
    width = np.bincount(line_of_pixel)
    middle = np.bincount(line_of_pixel, column) / np.bincount(line_of_pixel)
    star_of_line, row_of_line = np.divmod(line, row.max() + 1)
    widest = np.zeros(count)
    np.maximum.at(widest, star_of_line, width)
    weight = np.where(width >= 0.7 * widest[star_of_line], width, 0)
    total = np.bincount(star_of_line, weight, count)
    x = np.bincount(star_of_line, weight * middle, count) / total
    return x, np.bincount(star_of_line, weight * row_of_line, count) / total


@numba.njit(cache=True)
def _pixels(electrons: FloatArray, unusable: IntArray, minimum: np.float32) -> tuple[IntArray, IntArray]:
    """Return (y, x) of the saturated pixels, and of peaks.

    A peak is a usable pixel of at least `minimum` that exceeds the 24 around it, all of which are usable.
    """
    ny, nx = electrons.shape
    peaks = [(0, 0) for _ in range(0)]
    saturated = [(0, 0) for _ in range(0)]
    for y in range(ny):
        for x in range(nx):
            if unusable[y, x] & FULL:
                saturated.append((y, x))
            if not electrons[y, x] >= minimum or unusable[y, x] or min(x, y, nx - 1 - x, ny - 1 - y) < 2:
                continue
            highest = True
            for v in range(y - 2, y + 3):
                for u in range(x - 2, x + 3):
                    higher = electrons[v, u] > electrons[y, x] or (
                        electrons[v, u] == electrons[y, x] and (v, u) < (y, x)
                    )
                    if higher or unusable[v, u]:
                        highest = False
            if highest:
                peaks.append((y, x))
    return _rows(saturated), _rows(peaks)


@numba.njit(cache=True)
def _spilled(unusable: IntArray, row: IntArray, column: IntArray) -> IntArray:
    """Return `unusable` (ny, nx) with FULL in all pixels within SPILL_REACH steps of those at `row`, `column`."""
    ny, nx = unusable.shape
    out = unusable.copy()
    for k in range(row.size):
        for v in range(max(row[k] - SPILL_REACH, 0), min(row[k] + SPILL_REACH + 1, ny)):
            half_width = SPILL_REACH - abs(v - row[k])
            out[v, max(column[k] - half_width, 0) : min(column[k] + half_width + 1, nx)] = FULL
    return out


@numba.njit(cache=True)
def _rows(pairs: list[tuple[int, int]]) -> IntArray:
    out = np.empty((2, len(pairs)), np.int64)
    for k in range(len(pairs)):
        out[0, k], out[1, k] = pairs[k]
    return out


def _tables(psf: PsfSet, x: FloatArray, y: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return (number (n,), tables): the PSFs in the middles of the cells of PSF_CELL that contain chip positions."""
    cell_of_star = np.floor(np.column_stack([x, y]) / PSF_CELL).astype(int)
    cells, number = np.unique(cell_of_star, axis=0, return_inverse=True)
    if not len(cells):
        return number.reshape(-1), np.zeros((0, 0, 0))
    table_at = psf_tables(psf)
    return number.reshape(-1), np.array([table_at(*(PSF_CELL * (cell + 0.5) - 0.5)) for cell in cells])


@numba.njit(cache=True)
def _half(tables: FloatArray, per_pixel: int) -> int:
    """Return half the side [px] of the largest stamp of tables (m, t, t) that is complete at any subpixel position."""
    return (tables.shape[-1] - per_pixel - 5) // (2 * per_pixel)


@numba.njit(cache=True)
def _fit_stars(
    electrons: FloatArray,
    unusable: IntArray,
    tables: FloatArray,
    per_pixel: int,
    table: IntArray,
    x: FloatArray,
    y: FloatArray,
    half: IntArray,
    sky: float,
    read_variance: float,
) -> StarFits:
    """Return the fits of candidates at `x`, `y` (n,), each to a stamp of `half` px about it."""
    out = StarFits(np.full(x.size, np.nan), np.full(x.size, np.nan), np.full(x.size, np.nan), np.full(x.size, np.nan))
    for k in range(x.size):
        side = 2 * half[k] + 1
        stamp = np.empty((side, side))
        shifted = np.empty((4, side, side))
        star = _StarFit(0.0, x[k], y[k], sky)
        for step in range(STEPS):
            result = _improved(
                electrons, unusable, tables[table[k]], per_pixel, half[k], star, read_variance, stamp, shifted, step > 2
            )
            star = result.star
            if not result.chi2 >= 0.0:
                star = _StarFit(np.nan, star.x, star.y, star.constant)
                break
            out.chi2[k] = result.chi2
            if step > 3 and result.shift < 1e-3:
                break
        out.flux[k] = star.flux
        out.x[k] = star.x
        out.y[k] = star.y
    return out


@numba.njit(cache=True)
def _improved(
    electrons: FloatArray,
    unusable: IntArray,
    table: FloatArray,
    per_pixel: int,
    half: int,
    star: _StarFit,
    read_variance: float,
    stamp: FloatArray,
    shifted: FloatArray,
    clip: bool,
) -> _Step:
    """Return the result of one step; `stamp` (side, side), `shifted` (4, side, side): PSFs, overwritten."""
    ny, nx = electrons.shape
    column = round(star.x)
    row = round(star.y)
    dx = star.x - column
    dy = star.y - row
    delta = 0.05
    left, right, below, above = shifted[0], shifted[1], shifted[2], shifted[3]  # contiguous, as `stamp`
    render_psf(table, per_pixel, dx, dy, stamp)
    render_psf(table, per_pixel, dx - delta, dy, left)
    render_psf(table, per_pixel, dx + delta, dy, right)
    render_psf(table, per_pixel, dx, dy - delta, below)
    render_psf(table, per_pixel, dx, dy + delta, above)
    normal = np.zeros((4, 4))
    vector = np.zeros(4)
    chi2 = 0.0
    n = 0
    derivatives = np.empty(4)
    flux = star.flux
    for r in range(2 * half + 1):
        for c in range(2 * half + 1):
            v = row + r - half
            u = column + c - half
            if v < 0 or v >= ny or u < 0 or u >= nx or unusable[v, u]:
                continue
            star_flux = max(flux, 0.0) * stamp[r, c]
            variance = max(electrons[v, u], 0.0) + read_variance + (MODEL_ERROR * star_flux) ** 2
            residual = electrons[v, u] - flux * stamp[r, c] - star.constant
            if clip and residual > CLIP * math.sqrt(variance):
                continue
            derivatives[_FLUX] = stamp[r, c]
            derivatives[_CONSTANT] = 1.0
            derivatives[_X] = flux * (right[r, c] - left[r, c]) / (2 * delta)
            derivatives[_Y] = flux * (above[r, c] - below[r, c]) / (2 * delta)
            chi2 += residual * residual / variance
            n += 1
            for i in range(4):
                vector[i] += derivatives[i] * residual / variance
                for j in range(4):
                    normal[i, j] += derivatives[i] * derivatives[j] / variance
    if n < 12 or normal[_FLUX, _FLUX] <= 0.0:
        return _Step(star, 0.0, np.nan)
    if flux <= 0.0:  # no gradient yet: flux and constant alone
        cross = normal[_FLUX, _CONSTANT]
        det = normal[_FLUX, _FLUX] * normal[_CONSTANT, _CONSTANT] - cross**2
        if det <= 0.0:
            return _Step(star, 0.0, np.nan)
        flux_change = (normal[_CONSTANT, _CONSTANT] * vector[_FLUX] - cross * vector[_CONSTANT]) / det
        constant_change = (normal[_FLUX, _FLUX] * vector[_CONSTANT] - cross * vector[_FLUX]) / det
        new = _StarFit(star.flux + flux_change, star.x, star.y, star.constant + constant_change)
        return _Step(new, 1.0, chi2 / (n - 4))
    for i in range(4):
        normal[i, i] *= 1.0 + 1e-9
    flux_change, change_x, change_y, constant_change = np.linalg.solve(normal, vector)
    shift = math.hypot(change_x, change_y)
    scale = min(1.0, 1.0 / shift) if shift > 0.0 else 1.0  # at most a pixel
    new = _StarFit(
        max(star.flux + flux_change, 0.5 * flux),  # a step too far is shortened
        star.x + scale * change_x,
        star.y + scale * change_y,
        star.constant + constant_change,
    )
    return _Step(new, shift, chi2 / (n - 4))


def _repeated(fit: StarFits, good: BoolArray) -> BoolArray:
    """Return a mask of the fits that ended within GROUP_RADIUS of a brighter one."""
    from scipy.spatial import cKDTree

    rows = np.flatnonzero(good)
    out = np.zeros(len(fit.flux), bool)
    if len(rows):
        tree = cKDTree(np.column_stack([fit.x[rows], fit.y[rows]]))
        first, second = rows[tree.query_pairs(GROUP_RADIUS, output_type="ndarray").reshape(-1, 2)].T
        out[np.where(fit.flux[first] < fit.flux[second], first, second)] = True
    return out


def _ghosts(ghosts: Ghosts, chip: Chip, window: Window, x: FloatArray, y: FloatArray, flux: FloatArray) -> FloatArray:
    """Return (g, 4): x, y [px of the frame], radius [px], electron per pixel of the visible ghosts."""
    parts = [np.zeros((0, 4))]
    for star in np.flatnonzero(ghosts.visible(flux)):
        centres = ghosts.centres(chip, x[star] + window.x0, y[star] + window.y0) - [window.x0, window.y0]
        parts.append(np.column_stack([centres, ghosts.radius, flux[star] * ghosts.level]))
    return np.concatenate(parts)


@numba.njit(cache=True)
def _add_stars(image: FloatArray, sign: float, rms: FloatArray, stars: StarModel) -> None:
    """Add `sign` times the stars' light to `image`, and its noise to `rms` on bins; either may be empty (size 0)."""
    ny, nx = _pixels_of(image, rms)
    if stars.tables.shape[-1] == 0:
        return
    half = _half(stars.tables, stars.per_pixel)
    stamp = np.empty((2 * half + 1, 2 * half + 1))
    inner = BLEND_FROM * half
    outer = BLEND_TO * half
    wing = stars.wing
    for k in range(stars.x.size):
        x = stars.x[k]
        y = stars.y[k]
        column = round(x)
        row = round(y)
        render_psf(stars.tables[stars.table[k]], stars.per_pixel, x - column, y - row, stamp)
        radius_max = max(stars.reach[k], float(half))
        for v in range(max(math.ceil(y - radius_max), 0), min(math.floor(y + radius_max) + 1, ny)):
            half_width = math.sqrt(max(radius_max * radius_max - (v - y) ** 2, 0.0))
            for u in range(max(math.ceil(x - half_width), 0), min(math.floor(x + half_width) + 1, nx)):
                radius = math.sqrt((u - x) * (u - x) + (v - y) * (v - y))
                fraction = 0.0
                if radius > inner:
                    position = radius / WING_STEP
                    step = int(position)
                    fraction = wing[step] + (position - step) * (wing[step + 1] - wing[step])
                if radius < outer:
                    wing_weight = max((radius - inner) / (outer - inner), 0.0)
                    wing_weight = wing_weight * wing_weight * (3.0 - 2.0 * wing_weight)
                    in_stamp = stamp[v - row + half, u - column + half]
                    fraction = wing_weight * fraction + (1.0 - wing_weight) * in_stamp
                _add_to_pixel(image, sign, rms, v, u, stars.flux[k] * fraction)


@numba.njit(cache=True)
def _add_ghosts(image: FloatArray, sign: float, rms: FloatArray, ghosts: FloatArray) -> None:
    ny, nx = _pixels_of(image, rms)
    for k in range(len(ghosts)):
        x, y, radius, flux = ghosts[k]
        for v in range(max(math.ceil(y - radius), 0), min(math.floor(y + radius) + 1, ny)):
            half_width = math.sqrt(max(radius * radius - (v - y) ** 2, 0.0))
            for u in range(max(math.ceil(x - half_width), 0), min(math.floor(x + half_width) + 1, nx)):
                _add_to_pixel(image, sign, rms, v, u, flux)


@numba.njit(cache=True)
def _pixels_of(image: FloatArray, rms: FloatArray) -> tuple[int, int]:
    """Return the shape of the image, or that of all bins of `rms` if it is not empty."""
    ny, nx = rms.shape
    return (BIN * ny, BIN * nx) if rms.size else image.shape


@numba.njit(cache=True)
def _add_to_pixel(image: FloatArray, sign: float, rms: FloatArray, v: int, u: int, flux: float) -> None:
    if image.size:
        image[v, u] += np.float32(sign * flux)
    if rms.size:
        variance = max(flux, 0.0) + (MODEL_ERROR * flux) ** 2
        rms[v // BIN, u // BIN] = math.sqrt(rms[v // BIN, u // BIN] ** 2 + variance / BIN**2)
