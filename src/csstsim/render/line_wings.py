"""Wings of a spectrum: what a line of light adds beyond the box of the stored PSF (render.wings, of one point).

The spectrum stands as points LINE_STEP apart, less than the radius at which boxes fade (22 px). Their wings' sum is
smooth along and across: near the trace it is read every 8 px of every fourth row, with cubics between, to 4% of its top
where boxes fade and 1% beyond; beyond half of LINE_NEAR it goes over to the mesh of render.far_wings, three points
together, then eight. Where an edge cuts the light before it is dispersed, that of each point's wing is softened over
the points' distance, so their sum has no steps.
"""

import math

import numba
import numpy as np

from csstsim.render.far_wings import NEAR, WHOLE, between
from csstsim.render.octaves import BITS, first_of, read
from csstsim.render.wings import BLOCK, CUBIC, FADE, FAINT_REACH, add_faint, ending, near_part, octaves_of, shown

LINE_STEP = 8.0  # px
LINE_NEAR = NEAR  # px: all of a wing beyond is on the mesh
_FAR_POINTS = 8
_TIERS = (
    (1, 0.5 * LINE_NEAR),
    (3, LINE_NEAR),
    (_FAR_POINTS, math.inf),
)  # points together, px from which the next tier takes over
_LONG = 3  # such radii: shorter wings are left to one tier
_ROWS = BLOCK // 2  # px between rows that are read


def points_of(x, y, light):
    """Return ((m, 2) places, (m, 4) light): a spectrum at x, y (bins,) [px] as points at most LINE_STEP apart.

    light: (4, bins) electrons of each wavelength of the PSF.
    """
    which = np.floor((x - x.min()) / LINE_STEP).astype(int)
    total = light.sum(axis=0)
    sums = np.stack([np.bincount(which, band) for band in light], axis=1)
    lit = sums.sum(axis=1)
    used = lit > 0
    places = np.stack([np.bincount(which, total * v)[used] / lit[used] for v in (x, y)], axis=1)
    return places, sums[used]


def order_wing(wing_px, share, half):
    """Return the reach [px] of an order's wing, of this share of the light whose wing reaches wing_px; 0: hidden.

    A wing that shows goes on as far as the haze of those that do not, so that no order loses light by being brighter.
    """
    reach = wing_px * np.cbrt(min(share, 1.0)) if wing_px > 0 else 0.0
    return max(reach, FAINT_REACH) if reach > 1.5 * half else 0.0


def add_line(image, response, window, places, flux, wing, wing_px, half, far, side=WHOLE):
    """Add the wings of a spectrum; return (electrons, box or None).

    image, response: window.shape; places (m, 2), flux (m, 4): of `points_of`; wing: optics.halo.Wing; wing_px: its
    reach, 0: that of a faint object, on the mesh alone; half: side of the PSF's box [px]; far: FarWings; side:
    (x0, x1, y0, y1) px from each place beyond which its wing is cut off. The box is (x0, x1, y0, y1) on the chip,
    half-open.
    """
    if wing_px <= 0:
        at, light = _together(places, flux, _FAR_POINTS)
        soft = _FAR_POINTS * LINE_STEP
        parts = [add_faint(far, *xy, bands, wing, half, side, soft) for xy, bands in zip(at, light, strict=True)]
        return sum(parts), None
    drawn, boxes, octaves, taken, inner = 0.0, [], octaves_of(wing_px), 0.0, FADE[0] * half
    for points, radius in _TIERS:
        reach = wing_px if wing_px < _LONG * radius else 2 * radius
        until = near_part(octaves, radius) if reach < wing_px else 1.0
        at, light = _together(places, flux, points)
        low = math.floor(2 * math.log2(inner))  # octave of r^2 below which this tier has nothing
        tables = _tables(wing, light, half, wing_px, until - taken, low, octaves_of(reach))
        first = first_of(low)
        if points == 1:
            added = [_near(image, response, window, at, tables, first, reach, side)]
        else:
            soft = points * LINE_STEP
            added = [far.add(*xy, reach, table, first, side, soft) for xy, table in zip(at, tables, strict=True)]
        for electrons, box in filter(None, added):
            drawn += electrons
            boxes.append(box)
        taken, inner = until, radius
        if reach == wing_px:
            break
    if not boxes:
        return drawn, None
    x0, x1, y0, y1 = np.transpose(boxes)
    return drawn, (x0.min(), x1.max(), y0.min(), y1.max())


def _together(places, flux, points):
    """Return places and light of so many points together."""
    if points == 1:
        return places, flux
    groups = np.arange(0, len(places), points)
    light, weight = np.add.reduceat(flux, groups), flux.sum(axis=1)[:, None]
    return np.add.reduceat(weight * places, groups) / np.add.reduceat(weight, groups), light


def _tables(wing, flux, half, wing_px, share, low, high):
    """Return the tables (m, nodes) of wings of flux (m, 4), as `wing_table`, times a share; octaves `low` to `high`."""
    profile = shown(wing, half, octaves_of(wing_px)) * share
    end, taper = ending(wing_px)
    profile[:, end:] *= taper
    return np.einsum("mb,br->mr", flux, profile[:, low << BITS : (high << BITS) + 1])  # no BLAS: bits


def _near(image, response, window, places, tables, first, reach, side):
    """Add the tables' values around places on the chip, pixel by pixel; return (electrons, box), None if they miss."""
    (x0, y0), (x1, y1) = places.min(axis=0) - reach, places.max(axis=0) + reach
    box = max(math.ceil(x0), window.x0), min(math.floor(x1) + 1, window.x1)
    box += max(math.ceil(y0), window.y0), min(math.floor(y1) + 1, window.y1)
    if box[0] >= box[1] or box[2] >= box[3]:
        return None
    cut = box[0] - window.x0, box[1] - window.x0, box[2] - window.y0, box[3] - window.y0
    corner = np.array([box[0], box[2]], float)
    return _add_near(image, response, cut, places - corner, reach, tables, first, side), box


@numba.njit(cache=True)
def _add_near(image, response, box, places, reach, tables, first_node, side):
    """Add the tables' values around places (m, 2), seen from the corner of a box of pixels; return the sum."""
    x0, x1, y0, y1 = box
    ny, nx = y1 - y0, x1 - x0
    columns, rows = nx // BLOCK + 4, ny // _ROWS + 4  # mesh point 1 stands at pixel 0
    mesh = np.zeros((rows, columns))
    place = np.empty(1)
    bits = place.view(np.int64)
    for m in range(len(places)):
        x, y = places[m]
        for row in range(rows):
            dy = (row - 1) * _ROWS - y
            dy2, inside = dy * dy, between(dy, side[2], side[3], LINE_STEP)
            half = math.sqrt(max(reach * reach - dy2, 0.0))
            first = max(0, math.ceil((x - half) / BLOCK) + 1)
            for column in range(first, min(columns, math.floor((x + half) / BLOCK) + 2)):
                dx = (column - 1) * BLOCK - x
                place[0] = dy2 + dx * dx
                cut = inside * between(dx, side[0], side[1], LINE_STEP)
                mesh[row, column] += read(tables[m], first_node, bits[0]) * cut
    line, values, sums = np.empty(columns), np.empty(columns * BLOCK), np.zeros(BLOCK)
    for row in range(ny):
        at, phase = row // _ROWS + 1, row % _ROWS * (BLOCK // _ROWS)
        for j in range(columns):
            line[j] = (
                CUBIC[0, phase] * mesh[at - 1, j] + CUBIC[1, phase] * mesh[at, j] + CUBIC[2, phase] * mesh[at + 1, j]
                + CUBIC[3, phase] * mesh[at + 2, j]
            )  # fmt: skip
        seen, lit = response[y0 + row, x0:x1], image[y0 + row, x0:x1]
        for j in range(columns - 3):
            part = values[j * BLOCK : (j + 1) * BLOCK]
            for k in range(BLOCK):
                value = (
                    CUBIC[0, k] * line[j] + CUBIC[1, k] * line[j + 1] + CUBIC[2, k] * line[j + 2]
                    + CUBIC[3, k] * line[j + 3]
                )  # fmt: skip
                part[k] = max(value, 0.0)
        values[nx:] = 0.0
        for x in range(nx):
            values[x] *= seen[x]
            lit[x] += values[x]
        for x in range(0, nx, BLOCK):
            for k in range(BLOCK):
                sums[k] += values[x + k]
    return sums.sum()
