"""Expected images of spectra: the sum of monochromatic slabs along the trace.

At one wavelength an object is a stamp (render.imaging.point_stamp, render.imaging.galaxy_stamp), a mixture of its
stamps at the four wavelengths of the PSF set. Slabs are `1 / per_px` of a pixel apart along x. The light of each bin is
divided among four slabs by cubic interpolation, which conserves light, centroid and width of a line. A slab is the sum
over PSF wavelengths of the stamp at its sub-pixel phase times the light. The height of the trace is taken as constant
over blocks of 16 px. The larger a galaxy's components (`densities`), the smoother its spectrum and the fainter the
order (render.slitless.slab_counts), the fewer slabs are needed. Light beyond the PSF's box is added every 8 px
(render.slitless.line_wings). Light beyond the edge of a grating's piece is cut: from the cells of a PSF or the pixels
of a galaxy by the fraction of each, and from the wings. Left out: ghosts of dispersed light.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numba
import numpy as np

from csstsim.base.arrays.polynomial_weights import cubic_weights
from csstsim.base.types import FloatArray, IntArray
from csstsim.catalog.flags import OUTSIDE_PSF_HULL
from csstsim.catalog.profiles.sersic import BULGE, DISK
from csstsim.render.canvas import around
from csstsim.render.imaging.stamper import Stamper
from csstsim.render.psf_mixture import mixer_of
from csstsim.render.slitless.line_wings import add_line, order_wing, points_of
from csstsim.render.slitless.slab_counts import fewest_by_order, roughness
from csstsim.render.slitless.subpixel_stamps import light_inside, subpixel_stamps
from csstsim.render.wings import Wings

if TYPE_CHECKING:
    from csstsim.instrument.chip import Window
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.optics.scatter.scattered_light import Scattered
    from csstsim.render.canvas import Box, Canvas
    from csstsim.render.psf_mixture import Mixer
    from csstsim.render.scene import Scene
    from csstsim.render.slitless.traces import Traces

PER_PX = 4  # slabs to a pixel of a point's spectrum
_SLABS = 8.0, 24.0  # per half-light radius of a disk, of a bulge (more peaked)
_BLOCK = 16  # px of the trace that share a height
_SIDE = 2  # px that a slab's four neighbours may lie beyond a block


@dataclass(frozen=True)
class Drawn:
    """What was rendered of v visits, order by order; wings are in `drawn`, not in `box`."""

    drawn: FloatArray  # (v, orders) float64, electrons put on the window
    box: IntArray  # (v, orders, 4) int64: x0, x1, y0, y1 of the pixels touched, half-open, on the chip; zeros: none
    flags: IntArray  # (v,) int32, catalog.flags
    ms: FloatArray  # (v,) float32, CPU

    @classmethod
    def blank(cls, count: int, orders: int) -> Self:
        """Return the Drawn of `count` visits with nothing drawn."""
        box = np.zeros((count, orders, 4), np.int64)
        return cls(np.zeros((count, orders)), box, np.zeros(count, np.int32), np.zeros(count, np.float32))


def draw_spectra(
    canvas: Canvas,
    scene: Scene,
    traces: Traces,
    psf: PsfSet | Mixer,
    scattered: Scattered | None = None,
    per_px: int | IntArray = PER_PX,
    allowed: FloatArray | None = None,
) -> Drawn:
    """Draw the orders of a Scene's objects as expected electrons; return Drawn.

    traces: Traces of the objects; psf: PsfSet, or the Mixer of one; scattered:
    optics.scatter.scattered_light.Scattered, or None: only stamps are rendered; per_px: slabs per pixel for points, one
    number or (n,); allowed: (n,) allowed error as a fraction of S/N, from which the number of slabs is derived instead.
    """
    assert canvas.expected is not None and scene.wing is not None
    visits = traces.visits
    disperser = traces.disperser
    mixer = mixer_of(psf)
    window = canvas.window
    out = Drawn.blank(len(visits), len(disperser.orders))
    wing = None if scattered is None else scattered.wing
    stamper = Stamper.of(mixer, scene, scattered)
    wings = Wings(canvas, wing, mixer.half)
    lines = disperser.lines(visits, scene.x, scene.y)
    reach = stamper.reach
    counts = np.broadcast_to(per_px, (len(disperser.orders), len(scene))).T
    if allowed is not None and len(visits):
        counts = _counts(traces.spectra, disperser, lines[0, :, 1], allowed)
    density = densities(scene, counts.max(axis=1))
    for v, (i, *_) in enumerate(visits.tolist()):
        start = time.process_time()
        out.flags[v] = OUTSIDE_PSF_HULL if scene.outside[i] else 0
        side = traces.side(scene, v)
        lit = max(side.x0, -side.x1, side.y0, -side.y1) < reach[i] + 1
        stamps = inside = None
        for o, line in enumerate(lines[v]):
            order = traces.order(scene, v, o, line)
            light = order.electrons
            if not light.sum() > 0:
                continue
            parts: list[tuple[float, Box | IntArray | None]] = []
            if lit and meets(order.x, order.y, reach[i] + 2 * _BLOCK, window):
                if stamps is None:
                    stamps = subpixel_stamps(stamper, i, int(density[i]), side)
                step = max(int(density[i]) // int(counts[i, o]), 1)
                drawn, box = _add_slabs(
                    canvas.expected,
                    canvas.response_array,
                    order.x - window.x0,
                    order.y - window.y0,
                    light,
                    disperser.psf_weights,
                    _padded(stamps[:, ::step]),
                )
                if box.any():
                    parts.append((drawn, box + canvas.corner))
            fraction = light.sum() / scene.electrons[i].sum() if wing is not None else 0.0
            shown = order_wing(scene.wing[i], fraction, mixer.half)
            if scattered is not None and (parts or shown > 0):
                inside = light_inside(stamper, i) if inside is None else inside
                points = points_of(order.x, order.y, light * disperser.psf_weights)
                parts.append(add_line(wings, points, inside, shown, stamper.parts(i), side))
            out.drawn[v, o] = sum(electrons for electrons, _ in parts)
            out.box[v, o] = around([box for _, box in parts if box is not None])
        out.ms[v] = 1000 * (time.process_time() - start)
    wings.add_to_canvas()
    return out


def _counts(spectra: FloatArray, disperser: Disperser, q: FloatArray, allowed: FloatArray) -> IntArray:
    """Return (n, orders) slabs per pixel for points; q: (orders,) dispersion of one visit [px / angstrom]."""
    # an order may be missing on one piece
    first = disperser.orders.index(1)
    rates = disperser.rates.max(axis=0)
    electrons = np.einsum("nb,ob->no", spectra, rates)
    return fewest_by_order(electrons, roughness(spectra * rates[first]), np.abs(q) < 0.9 * np.abs(q[first]), allowed)


def densities(scene: Scene, per_px: int | IntArray) -> IntArray:
    """Return the slabs per pixel of each object, (n,) powers of two: the light-weighted mean need of its components.

    per_px: of points, which is the maximum; a number or (n,). A component needs _SLABS per half-light radius, measured
    along x (the dispersion) through the centre.
    """
    chord = np.abs(np.linalg.det(scene.matrix)) / np.hypot(scene.matrix[:, 1, 0], scene.matrix[:, 1, 1])
    steep = np.maximum((scene.sersic[:, :, 0] - DISK) / (BULGE - DISK), 0.0)  # linear in the index, as the error model
    wanted = _SLABS[0] + (_SLABS[1] - _SLABS[0]) * steep
    wanted = wanted / np.maximum(chord[:, None] * scene.sersic[:, :, 2], 1e-3)
    maximum = np.broadcast_to(per_px, len(scene))
    if scene.spot is not None:  # as sharp as points
        wanted = np.where(scene.spot[:, None] >= 0, maximum[:, None], wanted)
    mean = (scene.component_fractions * np.clip(wanted, 1, maximum[:, None])).sum(axis=1)
    return np.clip(2 ** np.round(np.log2(mean)), 1, maximum).astype(int)


def meets(x: FloatArray, y: FloatArray, reach: float, window: Window) -> bool:
    """Whether stamps of this reach around the positions x, y may overlap the window (test of their bounding box)."""
    across = x.max() + reach >= window.x0 and x.min() - reach < window.x1
    return across and y.max() + reach >= window.y0 and y.min() - reach < window.y1


def _padded(phases: FloatArray) -> FloatArray:
    """Return phases (4, density, heights, size, size) with zeros after each row, as room for shifts along a block."""
    out = np.zeros((*phases.shape[:4], phases.shape[3] + _BLOCK + 2 * _SIDE), np.float32)
    out[..., : phases.shape[4]] = phases
    return out


_cubic = numba.njit(inline="always")(cubic_weights)


@numba.njit(cache=True)
def _add_slabs(
    image: FloatArray,
    response: FloatArray,
    x: FloatArray,
    y: FloatArray,
    light: FloatArray,
    mixture: FloatArray,
    phases: FloatArray,
) -> tuple[float, IntArray]:
    """Add slabs of light (bins,) at x, y [px of `image`], block by block of x; return (electrons, box on the image).

    phases: from `_padded`; x must be monotonic. The box is x0, x1, y0, y1, half-open; all 0: nothing was added.
    """
    bins = len(x)
    density = phases.shape[1]
    size = phases.shape[3]
    reach = size // 2
    wide = _BLOCK + 2 * _SIDE
    rows = size + 2
    pitch = phases.shape[4]
    buffer = np.empty(rows * pitch, np.float32)
    stamps = np.empty((4 * density, rows * pitch), np.float32)
    slabs = np.empty((4, wide * density))
    factors = np.empty((4 * density, wide), np.float32)
    used = np.empty(4, np.int64)
    cubic = np.empty(4, np.float32)
    drawn = 0.0
    box = np.array([image.shape[1], 0, image.shape[0], 0])
    b = 0
    while b < bins:
        block = math.floor(x[b] / _BLOCK)
        end = b + 1
        while end < bins and math.floor(x[end] / _BLOCK) == block:
            end += 1
        begin = b
        b = end
        total = 0.0
        height = 0.0
        for k in range(begin, end):
            total += light[k]
            height += light[k] * y[k]
        if not total > 0:
            continue
        height /= total
        row = math.floor(height + 0.5)
        x0 = block * _BLOCK - _SIDE - reach
        y0 = row - reach - 1
        if x0 + pitch <= 0 or x0 >= image.shape[1] or y0 + rows <= 0 or y0 >= image.shape[0]:
            continue
        _deal(slabs, x, light, mixture, begin, end, block * _BLOCK - _SIDE, density)
        bands = 0
        for f in range(4):
            if slabs[f].any():
                for phase in range(density):
                    factors[bands * density + phase] = slabs[f, phase::density]
                used[bands] = f
                bands += 1
        heights = phases.shape[2]
        first = math.floor((height - row) * heights)
        cubic[:] = _cubic((height - row) * heights - first)
        # rows of the stamp on the image
        low = max(-y0, 0)
        high = min(rows, image.shape[0] - y0)
        _move_up(stamps[: bands * density], phases, used[:bands], cubic, first, low, high)
        buffer[:] = 0.0
        _add_shifted(buffer, stamps[: bands * density], factors[: bands * density], low * pitch, high * pitch)
        drawn += _put(image, response, buffer.reshape(rows, pitch), x0, y0)
        box[0] = min(box[0], max(x0, 0))
        box[1] = max(box[1], min(x0 + pitch, image.shape[1]))
        box[2] = min(box[2], max(y0, 0))
        box[3] = max(box[3], min(y0 + rows, image.shape[0]))
    return drawn, box * (box[1] > 0)


@numba.njit(cache=True)
def _move_up(
    stamps: FloatArray, phases: FloatArray, bands: IntArray, cubic: FloatArray, first: int, low: int, high: int
) -> None:
    """Fill rows low to high of stamps (bands x density, rows x pitch) with phases moved up by `first` heights and more.

    cubic: the weights of four heights for the fraction. There is one row more on each side than in a stamp.
    """
    _, density, heights, size, pitch = phases.shape
    stamps[:, low * pitch : high * pitch] = 0.0
    for band in range(len(bands)):
        for column in range(density):
            for k in range(4):
                pixel = (first - 1 + k) // heights
                phase = (first - 1 + k) % heights
                values = phases[bands[band], column, phase].reshape(size * pitch)
                factor = cubic[k]
                start = max(low - 1 - pixel, 0) * pitch
                end = min(high - 1 - pixel, size) * pitch
                out = stamps[band * density + column, (1 + pixel) * pitch :]
                for j in range(start, end):
                    out[j] += factor * values[j]


@numba.njit(cache=True)
def _add_shifted(out: FloatArray, stamps: FloatArray, factors: FloatArray, begin: int, end: int) -> None:
    """Add pixels begin to end of stamps (n, pixels) times factors (n, shifts), shifted by 0, 1, ... pixels.

    Four stamps at a time; what is shifted beyond `end` is left out.
    """
    count = len(stamps)
    for at in range(factors.shape[1]):
        part = out[begin + at : end]
        last = end - begin - at
        for k in range(0, count - 3, 4):
            a = factors[k, at]
            b = factors[k + 1, at]
            c = factors[k + 2, at]
            d = factors[k + 3, at]
            one = stamps[k, begin:end]
            two = stamps[k + 1, begin:end]
            three = stamps[k + 2, begin:end]
            four = stamps[k + 3, begin:end]
            if a != 0.0 or b != 0.0 or c != 0.0 or d != 0.0:
                for j in range(last):
                    part[j] += a * one[j] + b * two[j] + c * three[j] + d * four[j]
        for k in range(count - count % 4, count - 1, 2):
            a = factors[k, at]
            b = factors[k + 1, at]
            one = stamps[k, begin:end]
            two = stamps[k + 1, begin:end]
            for j in range(last):
                part[j] += a * one[j] + b * two[j]
        if count % 2:
            a = factors[count - 1, at]
            one = stamps[count - 1, begin:end]
            for j in range(last):
                part[j] += a * one[j]


@numba.njit(cache=True)
def _deal(
    slabs: FloatArray,
    x: FloatArray,
    light: FloatArray,
    mixture: FloatArray,
    begin: int,
    end: int,
    start: int,
    density: int,
) -> None:
    """Fill slabs (4, ...), by wavelength of the PSF set, `density` per pixel from `start` on, with the light of bins.

    The light of a bin is divided among four slabs by cubic weights.
    """
    slabs[:] = 0.0
    for k in range(begin, end):
        position = (x[k] - start) * density
        j = math.floor(position)
        cubic = _cubic(position - j)
        for f in range(4):
            part = light[k] * mixture[f, k]
            if part > 0.0:
                for i in range(4):
                    slabs[f, j - 1 + i] += part * cubic[i]


@numba.njit(cache=True)
def _put(image: FloatArray, response: FloatArray, stamp: FloatArray, x0: int, y0: int) -> float:
    """Add a stamp with its corner at x0, y0, clipped at zero, times the response; return the sum added."""
    total = 0.0
    lanes = np.zeros(8)
    low = max(-x0, 0)
    high = min(stamp.shape[1], image.shape[1] - x0)
    for row in range(max(-y0, 0), min(stamp.shape[0], image.shape[0] - y0)):
        shown = stamp[row, low:high]
        line = image[y0 + row, x0 + low : x0 + high]
        seen = response[y0 + row, x0 + low : x0 + high]
        for column in range(len(shown)):
            shown[column] = max(shown[column], np.float32(0.0)) * seen[column]
            line[column] += shown[column]
        whole = len(shown) // 8 * 8
        for column in range(0, whole, 8):
            for k in range(8):
                lanes[k] += shown[column + k]
        for column in range(whole, len(shown)):
            total += shown[column]
    return total + lanes.sum()
