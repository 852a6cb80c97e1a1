"""A simple expected image of all orders of all objects: the contamination of a spectrum, and its expected electrons.

    e(X) = sum over cells of a column [A t int S T dlambda] x fraction of the line profile in X
    image(X, row) += e(X) P(row - Y(X); lambda(X))

with the trace X = x + p + q lambda, Y = y + r + s lambda of the orders' truth table, T the order's throughput, S the
spectrum, constant in bins, P and the line profile from measure.spectra.line_profile. They are interpolated between
sizes a factor CLASS apart, with the PSF of one position. Flux in the far wings along the dispersion is added near its
column: in an even spectrum, columns exchange equal amounts. Left out: flux beyond HALF px across, the PSF's change over
the frame, beams divided by the line between two gratings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numba
import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.line_profile import ACROSS, ALONG, HALF, PER_PX, broadened, psf_profile
from csstsim.measure.spectra.near_orders import OrderExtents, near_orders

if TYPE_CHECKING:
    from csstsim.catalog.table import ObjectTable
    from csstsim.instrument.chip import Window
    from csstsim.instrument.grating import Gratings
    from csstsim.measure.spectra.line_profile import Shapes
    from csstsim.optics.scatter.halo import Wing

# radii [px]: SMALLEST CLASS^k; class 0 is a point
CLASS = 1.2
SMALLEST = 0.1
CLASSES = 38
CHUNK = 500  # objects whose spectra are in memory at a time
_STEP = GRID[1] - GRID[0]
# px along the dispersion: reach of the line profile
_REACH_MIN = 7
_REACH_PER_RADIUS = 4.0  # of half-light radii
_REACH_MAX = 40
ONE_REACH = HALF // 2  # px along the dispersion: reach of the line profile for one spectrum
# cells per column: for one spectrum, for all
_FINE = 4
_COARSE = 2
# Of rows (n,) and edges (bins + 1,) [angstrom]: (n, bins) photon / s / m2 / angstrom
BinnedSpectra: TypeAlias = Callable[[IntArray, FloatArray], FloatArray]


class Trace(NamedTuple):
    """The trace of an order: column = column_0 + column_slope lambda, row = row_0 + row_slope lambda [px; angstrom]."""

    column_0: float
    column_slope: float
    row_0: float
    row_slope: float


class ImageCorner(NamedTuple):
    """The position of an image on the chip [px]: columns x0 to x1, half-open, and its first row."""

    x0: int
    x1: int
    y0: int


class TracedOrders(NamedTuple):
    """n orders (n,): `owner`, row of the object in ObjectLight; `pair` of grating and order; the terms of Trace.

    `fraction`: of the order's light that passed its grating.
    """

    owner: IntArray
    pair: IntArray
    column_0: FloatArray
    column_slope: FloatArray
    row_0: FloatArray
    row_slope: FloatArray
    fraction: FloatArray


class ObjectLight(NamedTuple):
    """n objects: `spectra` (n, bins) photon m2 / angstrom in bins of `edges`; `fraction` (n, 2) of their components.

    `size` (n, 2 axes, 2): positions of the components' radii among the classes (`_class_of`).
    """

    spectra: FloatArray
    edges: FloatArray
    fraction: FloatArray
    size: FloatArray


class ModelArrays(NamedTuple):
    """Arrays of SpectralModel; `profiles`: its tables ACROSS."""

    profiles: FloatArray
    kernels: FloatArray
    cumulative: FloatArray
    limits: FloatArray
    bands: FloatArray


class _OrderRows(NamedTuple):
    """Rows of an orders' table with their pairs; `owner`: index of the object in `rows` (of shapes) and `spectra`."""

    orders: ObjectTable
    pairs: IntArray
    owner: IntArray
    rows: IntArray
    spectra: FloatArray


@dataclass(frozen=True, eq=False)
class SpectralModel:
    """Conversion of spectra to electrons, by pair of grating and order.

    photons: m2 s, area times exposure time; names: {(grating, order): pair}; cumulative: (pairs, len(GRID)) angstrom,
    T summed up to GRID; limits (pairs, 2) angstrom; bands: (4,) angstrom, of the profiles; tables (2 axes, CLASSES,
    2 components, 4, n): profiles by class of size; kernels (CLASSES, 2, 4, cells, columns): line profiles ALONG.
    """

    photons: float
    names: dict[tuple[str, int], int]
    cumulative: FloatArray
    limits: FloatArray
    bands: FloatArray
    tables: FloatArray
    kernels: FloatArray

    def electrons(
        self, one: ObjectTable, columns: IntArray, profile: FloatArray, *spectra: tuple[ArrayLike, ArrayLike]
    ) -> FloatArray:
        """Return (len(spectra), len(columns)) electrons of a row of the orders' table, summed ACROSS the trace.

        one: ObjectTable of one row; columns: consecutive chip columns; profile: (4, n), ALONG; spectra: pairs of
        (bins,) photon / s / m2 / angstrom and the bins' edges [angstrom].
        """
        out = np.zeros((len(spectra), len(columns)))
        sums = self.cumulative[self.pair(one)]
        column_0 = float(one["x"][0] + one["p"][0])
        column_slope = float(one["q"][0])
        kernel = _kernels(profile, _FINE, ONE_REACH)
        for row, (spectrum, edges) in zip(out, spectra, strict=True):
            spectrum = np.asarray(spectrum, float) * self.photons
            edges = np.asarray(edges, float)
            _add_along(sums, edges, spectrum, column_0, column_slope, float(columns[0]), kernel, self.bands, row)
        return out

    def image(
        self,
        orders: ObjectTable,
        shapes: Shapes,
        spectra: BinnedSpectra,
        edges: FloatArray,
        window: Window,
        faintest: float = 0.0,
        boxes: FloatArray | None = None,
    ) -> FloatArray:
        """Return float32 `window.shape`: expected electrons of the rows of an orders' table.

        shapes: Shapes by row of the truth table; spectra(rows, edges): (len(rows), len(edges) - 1); faintest: electrons
        per pixel below which flux is left out, as are orders whose mean along the trace is fainter; boxes (m, 4): x0,
        x1, y0, y1 [px], half-open, in which the image is needed: elsewhere it is incomplete. None: everywhere.
        """
        image = np.zeros(window.shape, np.float32)
        edges = np.asarray(edges, float)
        pairs = self.pairs(orders)
        bright = np.flatnonzero(self._bright_enough(orders, pairs, shapes, faintest))
        bright = bright[np.argsort(orders["row"][bright], kind="stable")]
        orders = orders.take(bright)
        pairs = pairs[bright]
        if boxes is not None:
            near = np.flatnonzero(self._near(orders, pairs, shapes, window, faintest, boxes))
            orders = orders.take(near)
            pairs = pairs[near]
        rows, start = np.unique(orders["row"], return_index=True)
        start = np.append(start, len(orders))
        owner = np.repeat(np.arange(len(rows)), np.diff(start))
        for first in range(0, len(rows), CHUNK):
            chunk = rows[first : first + CHUNK]
            order_rows = slice(start[first], start[min(first + CHUNK, len(rows))])
            chunk_spectra = spectra(chunk, edges)
            part = _OrderRows(
                orders.take(order_rows), pairs[order_rows], owner[order_rows] - first, chunk, chunk_spectra
            )
            self._add(image, window, part, shapes, edges, faintest)
        return image

    def image_of_one(
        self,
        one: ObjectTable,
        shapes: Shapes,
        spectrum: FloatArray,
        edges: FloatArray,
        window: Window,
        faintest: float = 0.0,
    ) -> FloatArray:
        """Return the part of `image` of one row of the orders' table, with its spectrum in bins of edges."""
        image = np.zeros(window.shape, np.float32)
        pairs = np.array([self.pair(one)])
        if self._bright_enough(one, pairs, shapes, faintest).all():
            part = _OrderRows(one, pairs, np.zeros(1, int), one["row"], spectrum[None])
            self._add(image, window, part, shapes, edges, faintest)
        return image

    def _add(
        self, image: FloatArray, window: Window, part: _OrderRows, shapes: Shapes, edges: FloatArray, faintest: float
    ) -> None:
        """Add orders to the image."""
        orders = part.orders
        column_0, column_slope, row_0, row_slope = np.stack(
            [orders["x"] + orders["p"], orders["q"], orders["y"] + orders["r"], orders["s"]]
        )
        _render(
            image,
            ImageCorner(window.x0, window.x1, window.y0),
            TracedOrders(part.owner, part.pairs, column_0, column_slope, row_0, row_slope, _fraction_through(orders)),
            ObjectLight(
                np.ascontiguousarray(part.spectra, float) * self.photons,
                edges,
                shapes.fraction[part.rows],
                _class_of(shapes.radius[part.rows]),
            ),
            ModelArrays(self.tables[ACROSS], self.kernels, self.cumulative, self.limits, self.bands),
            faintest,
        )

    def _bright_enough(self, orders: ObjectTable, pairs: IntArray, shapes: Shapes, faintest: float) -> BoolArray:
        """Return (n,) bool: orders whose mean over their pixels is at least `faintest` electrons."""
        limits = self.limits[pairs]
        length = np.maximum(np.abs(orders["q"]) * (limits[:, 1] - limits[:, 0]), 1.0)
        rows = orders["row"]
        radius = (shapes.fraction[rows] * shapes.radius[rows, ACROSS]).sum(axis=1)
        return orders["electrons"] >= faintest * length * (1 + radius)

    def _near(
        self, orders: ObjectTable, pairs: IntArray, shapes: Shapes, window: Window, faintest: float, boxes: FloatArray
    ) -> BoolArray:
        """Return near_orders of the rows of an orders' table."""
        margin = self.kernels.shape[4] // 2 + 1
        ends = (orders["x"] + orders["p"])[:, None] + orders["q"][:, None] * self.limits[pairs]
        ends = np.stack([ends.min(axis=1) - margin, ends.max(axis=1) + margin], axis=1)
        wave = np.clip((ends - (orders["x"] + orders["p"])[:, None]) / orders["q"][:, None], GRID[0], GRID[-1])
        heights = (orders["y"] + orders["r"])[:, None] + orders["s"][:, None] * wave
        fraction = shapes.fraction[orders["row"]]
        size = np.rint(_class_of(shapes.radius[orders["row"], ACROSS])).astype(int)
        extents = OrderExtents(ends, heights, orders["electrons"], fraction, size)
        return near_orders(extents, self.tables[ACROSS], window, boxes, faintest)

    def pair(self, one: ObjectTable) -> int:
        """Return the pair in `names` of an orders' table of one row."""
        return self.names[str(one["grating"][0]), int(one["order"][0])]

    def pairs(self, orders: ObjectTable) -> IntArray:
        """Return (n,): the pair in `names` of each row of an orders' table."""
        out = np.full(len(orders), -1)
        lit = {name: orders["grating"] == name for name, _ in self.names}
        for (name, number), pair in self.names.items():
            out[lit[name] & (orders["order"] == number)] = pair
        return out


def make_model(
    gratings: Gratings, photons: float, cells: FloatArray, per_pixel: int, bands: ArrayLike, wing: Wing | None = None
) -> SpectralModel:
    """Return the SpectralModel of a chip.

    gratings: instrument.grating.Gratings; photons: m2 s; cells (4, n, n), per_pixel, wing: of a PSF, as
    measure.spectra.line_profile.psf_profile takes them; bands: (4,) its wavelengths [angstrom].
    """
    pairs = [(g.name, n, order) for g, _ in gratings.pieces for n, order in g.orders.items()]
    steps = np.stack([0.5 * (o.throughput[1:] + o.throughput[:-1]) * _STEP for _, _, o in pairs])
    limits = np.array([GRID[[lit[0], lit[-1] + 1]] for lit in map(np.flatnonzero, steps)])
    cumulative = np.concatenate([np.zeros((len(pairs), 1)), np.cumsum(steps, axis=1)], axis=1)
    point = [psf_profile(cells, per_pixel, axis, wing) for axis in (ALONG, ACROSS)]
    sizes = np.concatenate([[0.0], SMALLEST * CLASS ** np.arange(CLASSES - 1)])
    tables = np.array([[[broadened(p, one, (r, r)) for one in np.eye(2)] for r in sizes] for p in point])
    kernels = np.array([[_kernels(one, _COARSE, _REACH_MAX) for one in size] for size in tables[ALONG]])
    names = {(name, number): k for k, (name, number, _) in enumerate(pairs)}
    return SpectralModel(photons, names, cumulative, limits, np.asarray(bands, float), tables, kernels)


def _fraction_through(orders: ObjectTable) -> FloatArray:
    """Return (n,): the fraction of an order's light that passed its grating; 1 except on the edge of its piece."""
    fraction = np.clip(orders["drawn"] / np.maximum(orders["electrons"], 1e-9), 0.0, 1.0)
    return np.where(orders["cut"], fraction, 1.0)


def _class_of(radius: FloatArray) -> FloatArray:
    """Return the positions of radii [px] among the classes of size: k is class k, k + 1/2 between k and k + 1."""
    position = np.log(np.maximum(radius, 1e-9) / SMALLEST) / np.log(CLASS) + 1
    return np.where(radius < SMALLEST, np.clip(radius / SMALLEST, 0.0, 1.0), np.minimum(position, CLASSES - 1.0))


def _kernels(profile: FloatArray, per_column: int, reach: int) -> FloatArray:
    """Return (4, per_column, 2 reach + 1): the fraction of the flux of a cell of a column in the columns around it."""
    offset = (np.arange(per_column) + 0.5) / per_column - 0.5
    edges = np.arange(-reach, reach + 2)[None] - 0.5 - offset[:, None]
    position = np.clip((edges + HALF) * PER_PX, 0, profile.shape[1] - 1)
    below = np.stack([np.interp(position, np.arange(profile.shape[1]), band) for band in profile])
    kernel = np.diff(below, axis=2)
    return kernel / kernel.sum(axis=2, keepdims=True)


@numba.njit(cache=True)
def _cumulative_at(wave: float, cumulative: FloatArray) -> float:
    position = (wave - GRID[0]) / _STEP
    k = min(max(int(position), 0), len(cumulative) - 2)
    return cumulative[k] + min(max(position - k, 0.0), 1.0) * (cumulative[k + 1] - cumulative[k])


@numba.njit(cache=True)
def _integral(
    low: float, high: float, cumulative: FloatArray, edges: FloatArray, spectrum: FloatArray, k: int
) -> tuple[float, int]:
    """Return (int S T dlambda from `low` to `high` [angstrom], the bin of `low`); k: a bin near it, or -1."""
    while k + 1 < len(edges) and edges[k + 1] <= low:
        k += 1
    while k >= 0 and edges[k] > low:
        k -= 1
    start = k
    total = 0.0
    before = _cumulative_at(low, cumulative)
    if _cumulative_at(high, cumulative) == before:
        return 0.0, start
    while k < len(spectrum):
        end = min(high, edges[k + 1])
        after = _cumulative_at(end, cumulative)
        if k >= 0:
            total += spectrum[k] * (after - before)
        if end >= high:
            break
        before = after
        k += 1
    return total, start


@numba.njit(cache=True)
def _band(wave: float, bands: FloatArray) -> tuple[int, float]:
    """Return (band, fraction of the next one), as line_profile.band_position."""
    k = 0
    while k < len(bands) - 2 and wave > bands[k + 1]:
        k += 1
    return k, min(max((wave - bands[k]) / (bands[k + 1] - bands[k]), 0.0), 1.0)


@numba.njit(cache=True)
def _add_along(
    cumulative: FloatArray,
    edges: FloatArray,
    spectrum: FloatArray,
    column_0: float,
    column_slope: float,
    first_column: float,
    kernel: FloatArray,
    bands: FloatArray,
    out: FloatArray,
) -> None:
    """Add the electrons of one order to `out`, the columns from `first_column` on."""
    per_column = kernel.shape[1]
    width = kernel.shape[2]
    reach = width // 2
    n = len(out)
    begin = first_column - reach - 0.5
    last = (begin - column_0) / column_slope
    k = -1
    for i in range((n + 2 * reach) * per_column):
        wave = (begin + (i + 1) / per_column - column_0) / column_slope
        electrons, k = _integral(min(wave, last), max(wave, last), cumulative, edges, spectrum, k)
        middle = 0.5 * (wave + last)
        last = wave
        if electrons == 0.0:
            continue
        band, fraction = _band(middle, bands)
        low = kernel[band, i % per_column]
        high = kernel[band + 1, i % per_column]
        column = i // per_column - 2 * reach
        for m in range(max(-column, 0), min(width, n - column)):
            out[column + m] += electrons * ((1.0 - fraction) * low[m] + fraction * high[m])


@numba.njit(cache=True)
def _render(
    image: FloatArray,
    corner: ImageCorner,
    orders: TracedOrders,
    objects: ObjectLight,
    model: ModelArrays,
    faintest: float,
) -> None:
    """Add orders to the image; the profiles of components are interpolated between the classes of size."""
    tables = model.profiles
    kernels = model.kernels
    reach_max = kernels.shape[4] // 2
    last_object = -1
    for i in range(len(orders.pair)):
        k = orders.owner[i]
        pair = orders.pair[i]
        fractions = objects.fraction[k]
        along, across = objects.size[k]
        first_fraction, second_fraction = fractions
        trace = Trace(orders.column_0[i], orders.column_slope[i], orders.row_0[i], orders.row_slope[i])
        ends = trace.column_0 + trace.column_slope * model.limits[pair]
        first_size, second_size = along
        radius = first_fraction * _radius(first_size) + second_fraction * _radius(second_size)
        reach = int(min(_REACH_MIN + _REACH_PER_RADIUS * radius, reach_max))
        first = int(max(ends.min() - reach, corner.x0))
        last = int(min(ends.max() + reach + 1, corner.x1))
        if last <= first:
            continue
        if k != last_object:
            part = slice(reach_max - reach, reach_max + reach + 1)
            profile = np.zeros(tables.shape[2:])
            kernel = np.zeros((kernels.shape[2], kernels.shape[3], 2 * reach + 1))
            for c in range(2):
                if fractions[c] != 0.0:
                    low, weight = _between(across[c], len(tables))
                    profile += fractions[c] * ((1 - weight) * tables[low, c] + weight * tables[low + 1, c])
                    low, weight = _between(along[c], len(tables))
                    kernel += fractions[c] * ((1 - weight) * kernels[low, c] + weight * kernels[low + 1, c])[:, :, part]
            kernel /= kernel.sum(axis=2).reshape(kernel.shape[0], kernel.shape[1], 1)  # flux beyond is added within
            last_object = k
        column = np.zeros(last - first)
        cumulative = model.cumulative[pair]
        spectrum = objects.spectra[k]
        _add_along(
            cumulative,
            objects.edges,
            spectrum,
            trace.column_0,
            trace.column_slope,
            float(first),
            kernel,
            model.bands,
            column,
        )
        column *= orders.fraction[i]
        _add_across(image, corner, column, first, trace, profile, model.bands, faintest)


@numba.njit(cache=True)
def _between(position: float, count: int) -> tuple[int, float]:
    """Return (class, fraction of the next one) of a position among `count` classes."""
    low = min(int(position), count - 2)
    return low, position - low


@numba.njit(cache=True)
def _radius(position: float) -> float:
    """Return the radius [px] of a position among the classes of size."""
    return SMALLEST * (CLASS ** (position - 1.0) if position > 1.0 else position)


@numba.njit(cache=True)
def _add_across(
    image: FloatArray,
    corner: ImageCorner,
    column: FloatArray,
    first: int,
    trace: Trace,
    profile: FloatArray,
    bands: FloatArray,
    faintest: float,
) -> None:
    """Distribute the electrons of columns, from `first` on, over the rows of the image."""
    ny = image.shape[0]
    for i in range(len(column)):
        electrons = column[i]
        if electrons <= faintest:
            continue
        wave = (first + i - trace.column_0) / trace.column_slope
        band, fraction = _band(wave, bands)
        wave = min(max(wave, GRID[0]), GRID[-1])
        centre = trace.row_0 + trace.row_slope * wave - corner.y0
        nearest = int(np.rint(centre))
        for side in (-1, 1):
            row = nearest if side > 0 else nearest - 1
            edge = _below(profile, band, fraction, row - 0.5 * side - centre)
            while abs(row - centre) < HALF - 1 and (row < ny if side > 0 else row >= 0):
                next_edge = _below(profile, band, fraction, row + 0.5 * side - centre)
                in_row = side * (next_edge - edge)
                if electrons * in_row < faintest:
                    break
                if 0 <= row < ny:
                    image[row, first + i - corner.x0] += electrons * in_row
                row = row + side
                edge = next_edge


@numba.njit(inline="always")
def _below(profile: FloatArray, band: int, fraction: float, offset: float) -> float:
    """Return the fraction of the flux below `offset` [px] of a profile interpolated between two bands."""
    position = (offset + HALF) * PER_PX
    k = min(int(position), profile.shape[1] - 2)
    t = position - k
    low = (1.0 - t) * profile[band, k] + t * profile[band, k + 1]
    high = (1.0 - t) * profile[band + 1, k] + t * profile[band + 1, k + 1]
    return (1.0 - fraction) * low + fraction * high
