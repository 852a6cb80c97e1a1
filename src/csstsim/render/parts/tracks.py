"""Tracks: light of objects so fast that they are seen as lines, as satellites.

Across a line the light follows the line-spread function, the PSF summed along the line, widened by a disc out of focus
(trail_width). It is computed at the middle of each block of _BLOCK px, and every pixel within its range gets the light
of its distance from the line. Along the line the light of a pixel is the time that the object takes for it, while the
pixel's column is exposed. Behind a grating each order of a line is a line as well, whose profile is the spectrum
projected across it: the sum of line-spread functions over wavelengths.

Light goes to the plane of expected electrons in all fidelities; its Poisson noise is added once, in `poisson_and_dark`.
At its ends a line fades as the PSF summed across it does, as far as the PSF's box. The wing is rendered to _WING px
from the line. Left out: ghosts; the wing beyond the ends; the dispersion along a line where it ends, or passes from one
grating's piece to the other's.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, Self

import numba
import numpy as np
from scipy.ndimage import map_coordinates

from csstsim.base.process.progress import progress
from csstsim.base.types import FloatArray, IntArray
from csstsim.catalog.changing.motion import Motion, positions_at
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.render.canvas import around
from csstsim.render.drawn_table import DrawnTable
from csstsim.render.wing_tables import RADII
from csstsim.render.wings import core_fraction, wing_beyond

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from csstsim.catalog.light.object_spectra import Spectra
    from csstsim.catalog.table import ObjectTable
    from csstsim.instrument.chip import Window
    from csstsim.instrument.grating import DiffractionOrder
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.optics.scatter.halo import Wing
    from csstsim.render.canvas import Box, Canvas
    from csstsim.render.drawing import Drawing

METHOD = "track"
_STEP = 0.125  # px, of the profiles across a line
_NODE = 4.0  # px along the line between the positions that are computed
_BLOCK = 512.0  # px
_WING = 512.0  # px


def draw_tracks(
    canvas: Canvas,
    objects: ObjectTable,
    drawing: Drawing,
    spectra: Spectra | None = None,
    disperser: Disperser | None = None,
) -> ObjectTable:
    """Draw objects that move as lines on a Canvas; return the table with what was rendered (render.drawn_table).

    objects: ObjectTable of catalog.selection.select with rates, all of whose rows have a trail; the others as in
    trails. snr, error and stamp are 0: no other method could render them. Behind a grating they have no orders.
    """
    flux = np.stack([objects[f"flux{i}"] for i in range(4)], axis=1)
    time_seen = objects["trail_end"] - objects["trail_start"]
    out = DrawnTable(objects, flux.sum(axis=1) * time_seen)  # nearly: the line's columns are exposed for other times
    for i in progress(out.rows, "tracks"):
        begin = time.process_time()
        line = _Line.of(objects.take(np.array([i])), drawing)
        out.electrons[i] = flux[i].sum() * line.exposed
        if disperser is None:
            parts: Iterable[tuple[_Line, FloatArray, DiffractionOrder | None]] = [(line, flux[i], None)]
        else:
            assert spectra is not None  # given with a disperser
            light = spectra(np.array([i]), disperser.edges)[0]
            out.electrons[i] = (light * disperser.rates.sum(axis=1).max(axis=0)).sum() * line.exposed
            parts = _orders(line, light, disperser)
        for part, rates, order in parts:
            drawn, box = _draw(canvas, part, rates, order, drawing, float(objects["trail_width"][i]), disperser)
            out.drawn[i] += drawn
            if box is not None:
                out.box[i] = around([out.box[i], box]) if out.box[i, 1] > 0 else box
        out.method[i] = METHOD
        out.ms[i] = 1000 * (time.process_time() - begin)
    out.miss(out.rows[out.box[out.rows, 1] == 0])
    return out.table()


@dataclass(frozen=True, eq=False)
class _Line:
    """A track, or a part of one, at n positions."""

    x: FloatArray  # (n,) px
    y: FloatArray
    seconds: FloatArray  # (n,) of light for each pixel of length, as the response asks for it
    exposed: float  # s, of light of the whole track, as the response asks for it

    @classmethod
    def of(cls, row: ObjectTable, drawing: Drawing) -> Self:
        """Return the track of a table's only row."""
        interval = drawing.interval
        chip = drawing.wcs.chip
        assert interval is not None and drawing.observer is not None  # given for objects that move
        start = float(row["trail_start"][0])
        end = float(row["trail_end"][0])
        count = max(int(np.ceil(row["trail_length"][0] / chip.telescope.pixel_scale / _NODE)), 2) + 1
        t = np.linspace(start, end, count)
        motion = Motion(row.with_columns(ra=row["ra_orig"], dec=row["dec_orig"]), interval)
        positions = positions_at(motion, drawing.wcs, drawing.observer, t[None])
        x = positions.x[0]
        y = positions.y[0]
        opened, closed = interval.exposed(np.clip(x, 0, chip.detector.nx - 1))
        slack = 1e-3 * (end - start)  # the ends are those of the middle's column
        lit = (t >= opened - slack) & (t <= closed + slack)
        along = np.hypot(np.gradient(x), np.gradient(y))
        more = interval.exptime / (closed - opened)
        return cls(x, y, lit * np.gradient(t) / along * more, float(np.trapezoid(more, t)))

    def take(self, rows: IntArray) -> _Line:
        """Return the part of the line at an array of rows, all next to each other."""
        return replace(self, x=self.x[rows], y=self.y[rows], seconds=self.seconds[rows])


class _Across(NamedTuple):
    """The profile across a line: electrons / s (n,) for each px across, at distances d (n,) [px], _STEP apart.

    shift: of the line's light along it [px], the mean.
    """

    d: FloatArray
    spread: FloatArray
    shift: float


class _End(NamedTuple):
    """How a line rises at its end: the fractions (n,) of its light, by _STEP from the distance `before` [px] on."""

    before: float
    rise: FloatArray


class _Stretch(NamedTuple):
    """A nearly straight stretch of a line on a window.

    * x, y: of its first end [px of the window]
    * cos, sin: of its angle
    * length: from end to end [px]
    * seconds: of light for each pixel of length, at every pixel of length
    * bend: distance of the line from the straight one [px], likewise
    """

    x: float
    y: float
    cos: float
    sin: float
    length: float
    seconds: FloatArray
    bend: FloatArray


def _orders(
    line: _Line, light: FloatArray, disperser: Disperser
) -> Iterator[tuple[_Line, FloatArray, DiffractionOrder]]:
    """Yield (part of the line, (bins,) electron / s, order) of the orders of each grating's piece."""
    for piece, (grating, _) in enumerate(disperser.gratings.pieces):
        x0, x1, y0, y1 = disperser.rectangles[piece]
        rows = np.flatnonzero((line.x >= x0) & (line.x < x1) & (line.y >= y0) & (line.y < y1))
        if len(rows) < 2:
            continue
        for number, order in grating.orders.items():
            rates = light * disperser.rates[piece, disperser.orders.index(number)]
            if rates.sum() > 0:
                yield line.take(rows), rates, order


def _draw(
    canvas: Canvas,
    line: _Line,
    rates: FloatArray,
    order: DiffractionOrder | None,
    drawing: Drawing,
    width: float,
    disperser: Disperser | None,
) -> tuple[float, Box | None]:
    """Draw a line, one order of it or all; return (electrons on the window, box on the chip or None)."""
    length = np.r_[0.0, np.cumsum(np.hypot(np.diff(line.x), np.diff(line.y)))]
    blocks = max(round(length[-1] / _BLOCK), 1)
    edges = np.searchsorted(length, np.linspace(0, length[-1], blocks + 1)[1:-1])
    drawn = 0.0
    boxes = []
    for first, last in zip(np.r_[0, edges], np.r_[edges, len(length) - 1], strict=True):
        if last <= first:
            continue
        part = line.take(np.arange(first, last + 1))
        x = part.x
        y = part.y
        angle = np.arctan2(y[-1] - y[0], x[-1] - x[0])
        middle = 0.5 * (x[0] + x[-1]), 0.5 * (y[0] + y[-1])
        if order is None and not _meets(canvas.window, x, y):
            continue
        profile = _profile(rates, order, middle, angle, drawing, width, disperser)
        mix = rates if disperser is None else disperser.psf_weights @ rates
        found, box = _add_line(canvas, part, angle, profile, _end(mix, middle, angle, drawing, width))
        drawn += found
        boxes += [box] if box is not None else []
    return (drawn, around(boxes)) if boxes else (0.0, None)


def _meets(window: Window, x: FloatArray, y: FloatArray) -> bool:
    """Whether light of a stretch may reach a window."""
    reach = 2 * _WING
    return not (
        x.max() + reach < window.x0
        or x.min() - reach > window.x1
        or y.max() + reach < window.y0
        or y.min() - reach > window.y1
    )


def _add_line(canvas: Canvas, part: _Line, angle: float, profile: _Across, end: _End) -> tuple[float, IntArray | None]:
    """Add a straight stretch to a Canvas; return (electrons, box or None)."""
    window = canvas.window
    cos = np.cos(angle)
    sin = np.sin(angle)
    u = part.x - part.x[0]
    v = part.y - part.y[0]
    along = u * cos + v * sin
    off = v * cos - u * sin
    x = part.x[0] - window.x0 + profile.shift * cos
    y = part.y[0] - window.y0 + profile.shift * sin
    grid = np.arange(0.0, along[-1] + 1.0)  # px
    seconds = np.interp(grid, along, part.seconds)
    bend = np.interp(grid, along, off)
    touched = np.array([window.nx, 0, window.ny, 0])
    assert canvas.expected is not None  # None: for photons alone
    stretch = _Stretch(x, y, cos, sin, float(along[-1]), seconds, bend)
    total = _fill(canvas.expected, canvas.response_array, stretch, profile, end, touched)
    return total, None if touched[1] == 0 else touched + canvas.corner


@numba.njit(cache=True)
def _rises(end: _End, s: float) -> float:
    """Return the fraction of an end's light before a position s [px] from it."""
    rise = end.rise
    step = (s - end.before) / _STEP
    if step <= 0.0:
        return 0.0
    j = int(step)
    if j >= len(rise) - 1:
        return 1.0
    return rise[j] + (step - j) * (rise[j + 1] - rise[j])


@numba.njit(cache=True)
def _fill(
    image: FloatArray, response: FloatArray, stretch: _Stretch, profile: _Across, end: _End, touched: IntArray
) -> float:
    """Add a stretch to `image`; return the electrons, and widen the box `touched` (x0, x1, y0, y1)."""
    cos = stretch.cos
    sin = stretch.sin
    length = stretch.length
    seconds = stretch.seconds
    bend = stretch.bend
    spread = profile.spread
    total = 0.0
    first = profile.d[0]
    last = first + (len(spread) - 1) * _STEP
    reach = max(-first, last) + np.abs(bend).max() + 1.0
    x_end = stretch.x + length * cos
    y_end = stretch.y + length * sin
    low = max(int(min(stretch.y, y_end) - reach), 0)
    high = min(int(max(stretch.y, y_end) + reach) + 1, image.shape[0])
    left = max(int(min(stretch.x, x_end) - reach), 0)
    right = min(int(max(stretch.x, x_end) + reach) + 1, image.shape[1])
    for row in range(low, high):
        line = 0.0
        v = row - stretch.y
        for column in range(left, right):
            u = column - stretch.x
            s = u * cos + v * sin
            if s < end.before or s > length - end.before:
                continue
            at = min(max(s, 0.0), length)
            k = min(int(at), len(seconds) - 2)
            w = at - k
            d = v * cos - u * sin - ((1 - w) * bend[k] + w * bend[k + 1])
            if d < first or d >= last:
                continue
            step = (d - first) / _STEP
            j = int(step)
            f = step - j
            light = ((1 - w) * seconds[k] + w * seconds[k + 1]) * ((1 - f) * spread[j] + f * spread[j + 1])
            light *= _rises(end, s) - _rises(end, s - length)
            value = light * response[row, column]
            if value > 0:
                image[row, column] += value
                line += value
                touched[0] = min(touched[0], column)
                touched[1] = max(touched[1], column + 1)
                touched[2] = min(touched[2], row)
                touched[3] = max(touched[3], row + 1)
        total += line
    return total


def _profile(
    rates: FloatArray,
    order: DiffractionOrder | None,
    middle: tuple[float, float],
    angle: float,
    drawing: Drawing,
    width: float,
    disperser: Disperser | None,
) -> _Across:
    """Return the profile across a line at its middle; rates: (4,) of sub-bands, or (bins,) of an order [electron / s].

    width: of the disc that an object out of focus is [arcsec].
    """
    d, bands = _line_spread(drawing, middle, angle)
    if width > 0:
        bands = _widened(bands, width / drawing.wcs.chip.telescope.pixel_scale)
        d = d[0] + _STEP * (np.arange(bands.shape[1]) - (bands.shape[1] - len(d)) / 2)
    if order is None:
        return _Across(d, rates @ bands, 0.0)
    assert disperser is not None  # of which it is an order
    p, q, r, s = order.lines(np.array([middle[0]]), np.array([middle[1]]))[0]
    waves = 0.5 * (disperser.edges[1:] + disperser.edges[:-1])
    dx = p + q * waves
    dy = r + s * waves
    across = dy * np.cos(angle) - dx * np.sin(angle)
    along = dx * np.cos(angle) + dy * np.sin(angle)
    lit = rates > 0
    first = across[lit].min() + d[0]
    last = across[lit].max() + d[-1]
    count = int(np.ceil((last - first) / _STEP)) + 2
    steps = (across[lit] - across[lit].min()) / _STEP
    weights = rates[lit] * disperser.psf_weights[:, lit]
    spots = np.zeros((4, count - len(d) + 1))
    k = steps.astype(int)
    f = steps - k
    for band in range(4):
        np.add.at(spots[band], k, (1 - f) * weights[band])
        np.add.at(spots[band], np.minimum(k + 1, spots.shape[1] - 1), f * weights[band])
    spread: FloatArray = sum(np.convolve(spots[band], bands[band]) for band in range(4))  # type: ignore[assignment]  # not 0
    shift = float(np.average(along[lit], weights=rates[lit]))
    return _Across(first + _STEP * np.arange(len(spread)), spread, shift)


def _end(mix: FloatArray, middle: tuple[float, float], angle: float, drawing: Drawing, width: float) -> _End:
    """Return the _End of a line, as round as the PSF's box makes it; mix: (4,) light of the sub-bands."""
    _, bands = _box_spread(drawing, middle, angle - np.pi / 2)
    if width > 0:
        bands = _widened(bands, width / drawing.wcs.chip.telescope.pixel_scale)
    along = mix @ bands
    rise = np.cumsum(along) - 0.5 * along  # to the middle of each step
    return _End(-_STEP * (len(along) - 1) / 2, rise / along.sum())


def _line_spread(drawing: Drawing, middle: tuple[float, float], angle: float) -> tuple[FloatArray, FloatArray]:
    """Return (d, (4, n)): light of each sub-band for each px across a line, of light 1 for each px along it.

    angle [rad]: of the line, from x to y.
    """
    across, box = _box_spread(drawing, middle, angle)
    if drawing.wing is None:
        return across, box
    psf = drawing.psf
    d, wide = _wing(drawing.wing, psf.image.shape[-1] / 2 / psf.oversampling)
    wide = wide.copy()
    start = round((across[0] - d[0]) / _STEP)
    wide[:, start : start + len(across)] += box
    return d, wide


def _box_spread(drawing: Drawing, middle: tuple[float, float], angle: float) -> tuple[FloatArray, FloatArray]:
    """Return `_line_spread` of the light in the PSF's box."""
    psf = drawing.psf
    node, weight, _ = psf.weights(*(np.array([v]) for v in middle))
    cells = sum(w * psf.node(int(n)) for n, w in zip(node[0], weight[0], strict=True) if w != 0)
    if drawing.wing is not None:
        cells = cells * core_fraction(psf.image.shape[-1], psf.oversampling)
    lattice = pixel_response(cells, psf.oversampling)
    half = (lattice.shape[-1] - 1) / 2 / psf.oversampling  # px
    across = np.arange(-np.ceil(half / _STEP), np.ceil(half / _STEP) + 1) * _STEP
    along = np.arange(-half * 1.5, half * 1.5, 1 / psf.oversampling)
    x = along * np.cos(angle) - across[:, None] * np.sin(angle)
    y = along * np.sin(angle) + across[:, None] * np.cos(angle)
    at = np.stack([y, x]) * psf.oversampling + (lattice.shape[-1] - 1) / 2
    box = np.stack([map_coordinates(band.astype(float), at, order=3, mode="constant").sum(axis=1) for band in lattice])
    box /= psf.oversampling
    # Interpolation keeps the light to some 1e-4: made exact
    box *= (lattice.sum(axis=(1, 2)) / psf.oversampling**2 / (box.sum(axis=1) * _STEP))[:, None]
    return across, box


@lru_cache(16)
def _wing(wing: Wing, half: float) -> tuple[FloatArray, FloatArray]:
    """Return (d, (4, n)): the wing beyond a box of half side `half` [px] summed along a line, at distances d [px]."""
    d = np.arange(-_WING, _WING + _STEP, _STEP)
    s = np.concatenate([[0.0], np.geomspace(0.5, 4096.0, 120)])
    distance = np.unique(np.concatenate([np.linspace(0, 2 * half, 64), np.linspace(2 * half, _WING + _STEP, 64)]))
    profile = wing_beyond(wing, half).profile
    r = np.hypot(s, distance[:, None])
    sums = [2 * np.trapezoid(np.interp(r, RADII, band, right=0.0), s, axis=1) for band in profile]
    return d, np.stack([np.interp(np.abs(d), distance, of_band) for of_band in sums])


def _widened(bands: FloatArray, width: float) -> FloatArray:
    """Return the line-spread functions (4, n) convolved with a disc of `width` px seen edge-on."""
    edges = np.arange(-np.ceil(width / 2 / _STEP) - 0.5, np.ceil(width / 2 / _STEP) + 1) * _STEP
    z = np.clip(2 * edges / width, -1.0, 1.0)
    fractions = np.diff(0.5 + (z * np.sqrt(1 - z**2) + np.arcsin(z)) / np.pi)
    return np.stack([np.convolve(band, fractions) for band in bands])
