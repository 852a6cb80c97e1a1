"""Wings of a spectrum: what a line of light adds beyond the box of the stored PSF (render.wings, of one point).

The spectrum stands as points LINE_STEP apart, less than the radius at which boxes fade (22 px). Their wings' sum is
smooth along and across: near the trace it is read every 8 px of every fourth row, with cubics between, to 4% of its top
where boxes fade and 1% beyond; beyond NEAR to twice that it goes to the mesh of render.far_wings, every few points
together. Where an edge cuts the light before it is dispersed, that of each point's wing is softened over the points'
distance, so their sum has no steps.
"""

import math

import numba
import numpy as np

from csstsim.render.far_wings import NEAR, WHOLE, between
from csstsim.render.octaves import read
from csstsim.render.wings import BLOCK, CUBIC, FIRST, add_faint, near_part, octaves_of, wing_table

LINE_STEP = 8.0  # px
_FAR_POINTS = 8
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
    """Return the reach [px] of an order's wing, of this share of the light whose wing reaches wing_px; 0: hidden."""
    reach = wing_px * np.cbrt(min(share, 1.0)) if wing_px > 0 else 0.0
    return reach if reach > 1.5 * half else 0.0


def add_line(image, response, window, places, flux, wing, wing_px, half, far, side=WHOLE):
    """Add the wings of a spectrum; return (electrons, box or None).

    image, response: window.shape; places (m, 2), flux (m, 4): of `points_of`; wing: optics.halo.Wing; wing_px: its
    reach, 0: that of a faint object, on the mesh alone; half: side of the PSF's box [px]; far: FarWings; side:
    (x0, x1, y0, y1) px from each place beyond which its wing is cut off. The box is (x0, x1, y0, y1) on the chip,
    half-open.
    """
    drawn, boxes = 0.0, []
    whole = 0 < wing_px <= 2 * NEAR
    if wing_px > 0:
        near = 1.0 if whole else near_part(octaves_of(wing_px))
    if not whole:
        soft = _FAR_POINTS * LINE_STEP
        groups = np.arange(0, len(places), _FAR_POINTS)
        light = np.add.reduceat(flux, groups)
        at = np.add.reduceat(flux.sum(axis=1)[:, None] * places, groups) / light.sum(axis=1)[:, None]
        tables = wing_table(wing, light, half, wing_px) * (1 - near) if wing_px > 0 else None
        for k, (x, y) in enumerate(at.tolist()):
            if tables is None:
                drawn += add_faint(far, x, y, light[k], wing, half, side, soft)
                continue
            added = far.add(x, y, wing_px, tables[k], FIRST, side, soft)
            if added:
                drawn += added[0]
                boxes.append(added[1])
    if wing_px > 0:
        reach = min(wing_px, 2 * NEAR)
        (x0, y0), (x1, y1) = places.min(axis=0) - reach, places.max(axis=0) + reach
        box = [max(math.ceil(x0), window.x0), min(math.floor(x1) + 1, window.x1)]
        box += [max(math.ceil(y0), window.y0), min(math.floor(y1) + 1, window.y1)]
        if box[0] < box[1] and box[2] < box[3]:
            cut = slice(box[2] - window.y0, box[3] - window.y0), slice(box[0] - window.x0, box[1] - window.x0)
            tables = wing_table(wing, flux, half, wing_px) * near
            corner = np.array([box[0], box[2]], float)
            drawn += _add_near(image[cut], response[cut], places - corner, reach, tables, side)
            boxes.append(tuple(box))
    if not boxes:
        return drawn, None
    x0, x1, y0, y1 = np.transpose(boxes)
    return drawn, (x0.min(), x1.max(), y0.min(), y1.max())


@numba.njit(cache=True)
def _add_near(image, response, places, reach, tables, side):
    """Add the tables' values around places (m, 2), pixel positions of `image`; return the sum."""
    ny, nx = image.shape
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
                mesh[row, column] += read(tables[m], FIRST, bits[0]) * inside * between(dx, side[0], side[1], LINE_STEP)
    line, total = np.empty(columns), 0.0
    for row in range(ny):
        at, phase = row // _ROWS + 1, row % _ROWS * (BLOCK // _ROWS)
        for j in range(columns):
            line[j] = (
                CUBIC[0, phase] * mesh[at - 1, j] + CUBIC[1, phase] * mesh[at, j] + CUBIC[2, phase] * mesh[at + 1, j]
                + CUBIC[3, phase] * mesh[at + 2, j]
            )  # fmt: skip
        for x in range(0, nx, BLOCK):
            j = x // BLOCK + 1
            for k in range(min(BLOCK, nx - x)):
                value = (
                    CUBIC[0, k] * line[j - 1] + CUBIC[1, k] * line[j] + CUBIC[2, k] * line[j + 1]
                    + CUBIC[3, k] * line[j + 2]
                )  # fmt: skip
                if value > 0.0:
                    value *= response[row, x + k]
                    image[row, x + k] += value
                    total += value
    return total
