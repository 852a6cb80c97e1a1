"""Light of a spectrum beyond the stamps along its trace (render.wings does this for a single point).

The spectrum is represented by points LINE_STEP apart, less than the radius at which boxes fade (22 px). The sum of
their wings is smooth along and across the trace. Near the trace it is computed every 8 px in every fourth row and
interpolated by cubics, to 4% of its maximum where boxes fade and 1% beyond. Further out it is rendered on the meshes of
render.far_wings, with more points merged at larger radii. Where the edge of a grating's piece cuts the light, the cut
of each point's wing is softened over the distance between points, so that the sum has no steps.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.arrays.bounds import bounds_of
from csstsim.base.arrays.polynomial_weights import cubic_weights
from csstsim.base.types import FloatArray
from csstsim.catalog.profiles.log_table import read
from csstsim.render.extended import POINT, SHARP_PX, WIDE_PX, beyond_stamp, spread
from csstsim.render.far_wings import OVER, WHOLE, Side, between
from csstsim.render.wing_tables import Annulus, annuli
from csstsim.render.wings import NEAR, near_light, ring_within, wing_beyond, wing_scale

if TYPE_CHECKING:
    from collections.abc import Sequence

    from csstsim.base.types import Floats
    from csstsim.instrument.chip import Window
    from csstsim.render.canvas import Box, Canvas
    from csstsim.render.extended import Part
    from csstsim.render.wing_tables import RadialProfile
    from csstsim.render.wings import StampLight, Wings

LINE_STEP = 8.0  # px
LINE_NEAR = NEAR[0]  # px: from here to twice that the meshes take over
BLOCK = 8  # px between computed values along a row
_ROWS = BLOCK // 2  # px between computed rows
CUBIC = np.stack(cubic_weights(np.arange(BLOCK) / BLOCK))  # (4, BLOCK)


class _Meshes(NamedTuple):
    """How the annuli around the points of a spectrum are rendered, from the inner to the outer one.

    * edges: between the annuli [px]; from an edge to twice that, the next annulus takes over
    * together: points merged in each annulus
    * levels: mesh of each annulus; None: pixel by pixel
    """

    edges: tuple[float, ...]
    together: tuple[int, ...]
    levels: tuple[int | None, ...]


_SHOWN = _Meshes((LINE_NEAR, 2 * LINE_NEAR, *OVER), (1, 3, 8, 16, 32, 64, 128), (None, 0, 0, 1, 2, 3, 4))
_HAZE = _Meshes(OVER, (8, 16, 32, 64, 128), (0, 1, 2, 3, 4))


class LinePoints(NamedTuple):
    """A spectrum as m points about LINE_STEP apart: positions (m, 2), x and y [px], and electrons (m, 4).

    The electrons are those of each wavelength of the PSF set.
    """

    positions: FloatArray
    electrons: FloatArray


def points_of(x: FloatArray, y: FloatArray, light: FloatArray) -> LinePoints:
    """Return the LinePoints of a spectrum at x, y (bins,) [px].

    light: (4, bins) electrons of each wavelength of the PSF set.
    """
    which = np.floor((x - x.min()) / LINE_STEP).astype(int)
    total = light.sum(axis=0)
    sums = np.stack([np.bincount(which, band) for band in light], axis=1)
    lit = sums.sum(axis=1)
    used = lit > 0
    positions = np.stack([np.bincount(which, total * v)[used] / lit[used] for v in (x, y)], axis=1)
    return LinePoints(positions, sums[used])


def order_wing(wing_px: float, fraction: float, half: float) -> float:
    """Return the radius [px] beyond which noise hides the wing of an order; 0: it hides all of it.

    wing_px: that radius for the object's flux; fraction: the order's flux over the object's; half: half the side of the
    PSF's box [px].
    """
    reach = wing_px * np.cbrt(min(fraction, 1.0))
    return reach if reach > half else 0.0


def add_line(
    wings: Wings,
    points: LinePoints,
    light: StampLight,
    wing_px: float,
    parts: Sequence[Part] = POINT,
    side: Side = WHOLE,
) -> tuple[float, Box | None]:
    """Add the light that the stamps along a spectrum leave out; return (electrons on the window, box or None).

    wings: render.wings.Wings; points: from `points_of`, with all electrons of the spectrum; light: StampLight, (4,)
    fractions of them, by wavelength of the PSF set; wing_px: radius [px] beyond which noise hides the wing, 0:
    everywhere; parts: the object's render.extended.Parts; side: Side of each point, beyond which light is cut off. The
    box (x0, x1, y0, y1 on the chip, half-open) is that of the wing as far as it shows.
    """
    positions = points.positions
    flux = points.electrons
    wing = wings.wing
    half = wings.half
    haze: Floats = 0.0
    added = 0.0
    box = None
    if wing is not None and len(positions):
        faded = wing_beyond(wing, half, wing_px > 0)
        shown = wing_beyond(wing, half)
        total = flux.sum(axis=0)
        ratio = wing_scale(total, (total * light.inside).sum(), shown.light)
        for part in parts:
            meshes, minimum = (_SHOWN, SHARP_PX) if wing_px > 0 else (_HAZE, WIDE_PX)
            electrons = part.fraction * ratio * flux
            added += _add(wings, LinePoints(positions, electrons), spread(faded, part, minimum), meshes, side)
        haze = ratio * (shown.light - faded.light)
        box = _box(wings.canvas.window, positions, wing_px) if wing_px > 0 else None
    missing = light.inside - light.drawn
    tails = beyond_stamp(parts, light.reach) if light.reach >= half else []
    for tail in tails:
        added += _add(wings, LinePoints(positions, tail.fraction * flux * missing), tail.profile, _HAZE, side)
    within = haze + (0.0 if tails else near_light(missing, light.inside, wing))
    for part in parts:
        electrons = part.fraction * flux * within
        added += _add(wings, LinePoints(positions, electrons), spread(ring_within(half), part), _HAZE, side)
    return added, box


def _add(wings: Wings, points: LinePoints, radial: RadialProfile, meshes: _Meshes, side: Side) -> float:
    """Add a RadialProfile around each point; return the electrons on the window."""
    added = 0.0
    add = wings.meshes.add
    for annulus, together, level in zip(annuli(radial, meshes.edges), meshes.together, meshes.levels, strict=True):
        if not annulus.reach:
            continue
        at, lines = _merged(points, together, annulus.table)
        if level is None:
            added += _near(wings.canvas, at, annulus._replace(table=lines), side)
            continue
        soft = together * LINE_STEP
        # Numbers of Python, not of numpy: an annulus costs its pixels, not its arguments
        added += sum(
            add(level, xy, Annulus(line, annulus.first, annulus.reach), side, soft)
            for xy, line in zip(at.tolist(), lines, strict=True)
        )
    return added


def _box(window: Window, positions: FloatArray, reach: float) -> Box | None:
    """Return (x0, x1, y0, y1) of the window's pixels within `reach` of the positions along both axes, or None."""
    x0, x1, y0, y1 = bounds_of(positions)
    left = max(math.ceil(x0 - reach), window.x0)
    right = min(math.floor(x1 + reach) + 1, window.x1)
    bottom = max(math.ceil(y0 - reach), window.y0)
    top = min(math.floor(y1 + reach) + 1, window.y1)
    return (left, right, bottom, top) if left < right and bottom < top else None


@numba.njit(cache=True)
def _merged(points: LinePoints, together: int, profile: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the positions (g, 2) and profiles (g, nodes) of groups of `together` consecutive points, merged into one.

    profile: (4, nodes). A group stands at its mean position, weighted by electrons.
    """
    positions = points.positions
    flux = points.electrons
    groups = -(-len(positions) // together)
    at = np.zeros((groups, 2))
    lines = np.zeros((groups, profile.shape[1]))
    for g in range(groups):
        begin = g * together
        end = min((g + 1) * together, len(positions))
        dark = not np.abs(flux[begin:end]).sum() > 0
        weights = 0.0
        for m in range(begin, end):
            weight = 1.0 if dark else abs(flux[m, 0]) + abs(flux[m, 1]) + abs(flux[m, 2]) + abs(flux[m, 3])
            weights += weight
            at[g, 0] += weight * positions[m, 0]
            at[g, 1] += weight * positions[m, 1]
        at[g] = at[g] / weights if together > 1 else positions[g]
        line = lines[g]
        for b in range(len(profile)):
            light = flux[begin:end, b].sum()
            row = profile[b]
            for r in range(len(row)):
                line[r] += light * row[r]
    return at, lines


def _near(canvas: Canvas, positions: FloatArray, annulus: Annulus, side: Side) -> float:
    """Add annuli around positions (m, 2) on the chip, pixel by pixel; return the electrons on the window.

    annulus: its table (m, nodes), of each.
    """
    window = canvas.window
    box = _box(window, positions, annulus.reach)
    if box is None:
        return 0.0
    assert canvas.expected is not None  # None: for photons alone
    x0, x1, y0, y1 = box
    cut = x0 - window.x0, x1 - window.x0, y0 - window.y0, y1 - window.y0
    corner = np.array([x0, y0], float)
    return _add_near(canvas.expected, canvas.response_array, cut, positions - corner, annulus, side)


@numba.njit(cache=True)
def _add_near(
    image: FloatArray,
    response: FloatArray,
    box: Box,
    positions: FloatArray,
    annulus: Annulus,
    side: Side,
) -> float:
    """Add annuli around positions (m, 2), relative to the corner of a box of pixels; return the sum.

    annulus: its table (m, nodes), of each.
    """
    x0, x1, y0, y1 = box
    lines = annulus.table
    reach = annulus.reach
    ny = y1 - y0
    nx = x1 - x0
    # mesh point 1 is at pixel 0
    columns = nx // BLOCK + 4
    rows = ny // _ROWS + 4
    mesh = np.zeros((rows, columns))
    square = np.empty(1)
    bits = square.view(np.int64)
    for m in range(len(positions)):
        x, y = positions[m]
        for row in range(rows):
            dy = (row - 1) * _ROWS - y
            dy2 = dy * dy
            inside = between(dy, side.y0, side.y1, LINE_STEP)
            half = math.sqrt(max(reach * reach - dy2, 0.0))
            first = max(0, math.ceil((x - half) / BLOCK) + 1)
            for column in range(first, min(columns, math.floor((x + half) / BLOCK) + 2)):
                dx = (column - 1) * BLOCK - x
                square[0] = dy2 + dx * dx
                cut = inside * between(dx, side.x0, side.x1, LINE_STEP)
                mesh[row, column] += read(lines[m], annulus.first, bits[0]) * cut
    line = np.empty(columns)
    values = np.empty(columns * BLOCK)
    sums = np.zeros(BLOCK)
    for row in range(ny):
        at = row // _ROWS + 1
        phase = row % _ROWS * (BLOCK // _ROWS)
        for j in range(columns):
            line[j] = (
                CUBIC[0, phase] * mesh[at - 1, j]
                + CUBIC[1, phase] * mesh[at, j]
                + CUBIC[2, phase] * mesh[at + 1, j]
                + CUBIC[3, phase] * mesh[at + 2, j]
            )
        seen = response[y0 + row, x0:x1]
        lit = image[y0 + row, x0:x1]
        for j in range(columns - 3):
            part = values[j * BLOCK : (j + 1) * BLOCK]
            for k in range(BLOCK):
                value = (
                    CUBIC[0, k] * line[j]
                    + CUBIC[1, k] * line[j + 1]
                    + CUBIC[2, k] * line[j + 2]
                    + CUBIC[3, k] * line[j + 3]
                )
                part[k] = max(value, 0.0)
        values[nx:] = 0.0
        for x in range(nx):
            values[x] *= seen[x]
            lit[x] += values[x]
        for x in range(0, nx, BLOCK):
            for k in range(BLOCK):
                sums[k] += values[x + k]
    return sums.sum()
