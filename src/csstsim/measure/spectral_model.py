"""A simple expected image of all orders of all objects: what contaminates a spectrum, and what it should be.

    e(X) = sum over cells of a column [A t int S T dlambda] x share of the line profile that lands on X
    image(X, row) += e(X) P(row - Y(X); lambda(X))

with the trace X = x + p + q lambda, Y = y + r + s lambda of the orders' truth table, T the order's throughput, S the
spectrum, constant in bins, P and the line profile as measure.line_profile has them (sizes in classes of a factor
CLASS, the PSF of one place). Left out: the wing and the tail of a profile along the dispersion (its light is kept near
where it belongs), the PSF's change over the frame, beams that the line between two gratings divides.
"""

from dataclasses import dataclass

import numba
import numpy as np

from csstsim.instrument.filter import GRID
from csstsim.measure.line_profile import ACROSS, ALONG, HALF, PER_PX, broadened, psf_profile

CLASS, SMALLEST, CLASSES = 1.3, 0.1, 26  # radii [px]: SMALLEST CLASS^k; class 0 is a point
CHUNK = 2000  # objects whose spectra are held at a time
_STEP = GRID[1] - GRID[0]
_REACH = 7, 4.0, 40  # px along the dispersion: least, per half-light radius, most
_FINE, _COARSE = 4, 2  # cells to a column: of one spectrum, of all


@dataclass(frozen=True, eq=False)
class SpectralModel:
    """What makes electrons of spectra. `photons` m2 s, area times exposure time; `cumulative` {(grating, order): (n,)
    angstrom, T summed up to GRID}; `bands` (4,) angstrom, of the profiles; `point` (2 axes, 4, n) profiles of a point;
    `tables` (2 axes, CLASSES, 2 components, 4, n) of classes of size."""

    photons: float
    cumulative: dict
    bands: np.ndarray
    point: np.ndarray
    tables: np.ndarray

    def electrons(self, one, columns, profile, spectrum, edges):
        """Return electrons (len(columns),) of a row of the orders' table, ACROSS all of the trace.

        one: ObjectTable of one row; columns: consecutive chip columns; profile: (4, n), ALONG; spectrum: (len(edges) -
        1,) photon / s / m2 / angstrom in bins of edges [angstrom].
        """
        out = np.zeros(len(columns))
        sums = self.cumulative[str(one["grating"][0]), int(one["order"][0])]
        at, per = float(one["x"][0] + one["p"][0]), float(one["q"][0])
        kernel = _kernels(profile, _FINE, HALF // 2)
        spectrum = np.asarray(spectrum, float) * self.photons
        _along(sums, np.asarray(edges, float), spectrum, at, per, float(columns[0]), kernel, self.bands, out)
        return out

    def image(self, orders, shapes, spectra, edges, window, faintest=0.0):
        """Return float32 `window.shape`: expected electrons of the rows of an orders' table.

        shapes: Shapes by row of the truth table; spectra(rows): (len(rows), len(edges) - 1); faintest: electrons of a
        pixel below which light is left out.
        """
        image = np.zeros(window.shape, np.float32)
        edges = np.asarray(edges, float)
        ordered = orders.take(np.argsort(orders["row"], kind="stable"))
        rows, start = np.unique(ordered["row"], return_index=True)
        start = np.append(start, len(ordered))
        for first in range(0, len(rows), CHUNK):
            last = min(first + CHUNK, len(rows))
            seds = np.asarray(spectra(rows[first:last]), float) * self.photons
            for i in range(first, last):
                part = ordered.take(slice(start[i], start[i + 1]))
                self._draw(image, part, shapes, rows[i], seds[i - first], edges, window, faintest)
        return image

    def _draw(self, image, part, shapes, row, spectrum, edges, window, faintest):
        """Add all orders of one object."""
        light, radius = shapes.light[row], shapes.radius[row]
        along, across = (self._of_class(axis, light, radius[axis]) for axis in (ALONG, ACROSS))
        reach = int(min(_REACH[0] + _REACH[1] * (light * radius[ALONG]).sum(), _REACH[2]))
        kernel = _kernels(along, _COARSE, reach)
        for k in range(len(part)):
            sums = self.cumulative[str(part["grating"][k]), int(part["order"][k])]
            lit = np.flatnonzero(np.diff(sums))
            at, per = part["x"][k] + part["p"][k], part["q"][k]
            ends = np.sort(at + per * GRID[[lit[0], lit[-1] + 1]])
            first, last = int(max(ends[0] - reach, window.x0)), int(min(ends[1] + reach + 1, window.x1))
            if last <= first:
                continue
            column = np.zeros(last - first)
            _along(sums, edges, spectrum, at, per, float(first), kernel, self.bands, column)
            trace = at, per, part["y"][k] + part["r"][k], part["s"][k]
            _across(image, window.x0, window.y0, column, first, *trace, across, self.bands, faintest)

    def _of_class(self, axis, light, radius):
        size = np.log(np.maximum(radius, 1e-9) / SMALLEST) / np.log(CLASS)
        k = np.clip(np.rint(size).astype(int) + 1, 0, CLASSES - 1)
        table = self.tables[axis]
        return light[0] * table[k[0], 0] + light[1] * table[k[1], 1]


def make_model(gratings, photons, cells, per_pixel, bands, wing=None):
    """Return the SpectralModel of a chip. gratings: instrument.grating.Gratings; photons: m2 s; cells (4, n, n),
    per_pixel, wing: of a PSF, as measure.line_profile.psf_profile takes them; bands: (4,) its wavelengths [angstrom]."""
    cumulative = {}
    for grating, _ in gratings.pieces:
        for number, order in grating.orders.items():
            steps = 0.5 * (order.throughput[1:] + order.throughput[:-1]) * _STEP
            cumulative[grating.name, number] = np.concatenate([[0.0], np.cumsum(steps)])
    point = np.stack([psf_profile(cells, per_pixel, axis, wing) for axis in (ALONG, ACROSS)])
    sizes = np.concatenate([[0.0], SMALLEST * CLASS ** np.arange(CLASSES - 1)])
    tables = [[[broadened(p, one, (r, r)) for one in np.eye(2)] for r in sizes] for p in point]
    return SpectralModel(photons, cumulative, np.asarray(bands, float), point, np.array(tables))


def _kernels(profile, per_column, reach):
    """Return (4, per_column, 2 reach + 1): where the light of a cell of a column lands, in columns about its own."""
    offset = (np.arange(per_column) + 0.5) / per_column - 0.5
    edges = np.arange(-reach, reach + 2)[None] - 0.5 - offset[:, None]
    place = np.clip((edges + HALF) * PER_PX, 0, profile.shape[1] - 1)
    below = np.stack([np.interp(place, np.arange(profile.shape[1]), band) for band in profile])
    kernel = np.diff(below, axis=2)
    return kernel / kernel.sum(axis=2, keepdims=True)


@numba.njit(cache=True)
def _summed(wave, cumulative):
    place = (wave - GRID[0]) / _STEP
    k = min(max(int(place), 0), len(cumulative) - 2)
    return cumulative[k] + min(max(place - k, 0.0), 1.0) * (cumulative[k + 1] - cumulative[k])


@numba.njit(cache=True)
def _counted(low, high, cumulative, edges, spectrum):
    """Return int S T dlambda from `low` to `high` [angstrom]."""
    total, before = 0.0, _summed(low, cumulative)
    if _summed(high, cumulative) == before:
        return 0.0
    k = np.searchsorted(edges, low, side="right") - 1
    while k < len(spectrum):
        end = min(high, edges[k + 1])
        after = _summed(end, cumulative)
        if k >= 0:
            total += spectrum[k] * (after - before)
        if end >= high:
            break
        before = after
        k += 1
    return total


@numba.njit(cache=True)
def _band(wave, bands):
    """Return (band, share of the next one), as line_profile.mixed."""
    k = 0
    while k < len(bands) - 2 and wave > bands[k + 1]:
        k += 1
    return k, min(max((wave - bands[k]) / (bands[k + 1] - bands[k]), 0.0), 1.0)


@numba.njit(cache=True)
def _along(cumulative, edges, spectrum, at, per, first, kernel, bands, out):
    """Add the electrons of one order to columns first, first + 1, ..."""
    per_column, width = kernel.shape[1], kernel.shape[2]
    reach, n = width // 2, len(out)
    begin = first - reach - 0.5
    last = (begin - at) / per
    for i in range((n + 2 * reach) * per_column):
        wave = (begin + (i + 1) / per_column - at) / per
        e = _counted(min(wave, last), max(wave, last), cumulative, edges, spectrum)
        middle, last = 0.5 * (wave + last), wave
        if e == 0.0:
            continue
        b, share = _band(middle, bands)
        low, high = kernel[b, i % per_column], kernel[b + 1, i % per_column]
        column = i // per_column - 2 * reach
        for k in range(max(-column, 0), min(width, n - column)):
            out[column + k] += e * ((1.0 - share) * low[k] + share * high[k])


@numba.njit(cache=True)
def _across(image, x0, y0, column, first, at, per, middle, slope, profile, bands, faintest):
    """Spread columns of electrons over the rows of the image, which begins at x0, y0."""
    ny, steps = image.shape[0], profile.shape[1] - 1
    for i in range(len(column)):
        e = column[i]
        if e <= faintest:
            continue
        wave = (first + i - at) / per
        b, share = _band(wave, bands)
        wave = min(max(wave, GRID[0]), GRID[-1])
        centre = middle + slope * wave - y0
        nearest = int(np.rint(centre))
        for side in (-1, 1):
            row = nearest if side > 0 else nearest - 1
            while abs(row - centre) < HALF - 1:
                place = (row - 0.5 - centre + HALF) * PER_PX
                k = int(place)
                rest, light = place - k, 0.0
                for sign, m in ((-1.0, k), (1.0, k + PER_PX)):
                    m = min(m, steps - 1)
                    low = (1.0 - rest) * profile[b, m] + rest * profile[b, m + 1]
                    high = (1.0 - rest) * profile[b + 1, m] + rest * profile[b + 1, m + 1]
                    light += sign * ((1.0 - share) * low + share * high)
                if e * light < faintest:
                    break
                if 0 <= row < ny:
                    image[row, first + i - x0] += e * light
                row += side
