"""What bright stars add beyond the box of the stored PSF: a radial wing out to the chip's size, and ghosts.

The box is faded out, the wing (optics.halo) faded in over the same ring, 0.7 to 0.95 of the box's half side, by a
step with two continuous derivatives; at its far end the wing is faded out over its last quarter. How far a wing reaches
comes with the object (catalog.reach). Objects whose own wing hides in the noise have one of FAINT_REACH, on the mesh of
render.far_wings alone: what they put beyond the box, 3 to 5% of their light, is a smooth haze, but not nothing.

A wing is read from a table in r^2 (render.octaves): 3e-5 of the value for slopes to -3. Beyond 256 px it is read every
8th pixel of a row, with the cubic through four such values between: 1e-5. Its value at a pixel's centre stands for the
pixel: 4e-4 at 45 px, less beyond. Cost: benchmarks/wings.py.
"""

import math
from functools import lru_cache

import numba
import numpy as np

from csstsim.render.far_wings import NEAR, WHOLE
from csstsim.render.octaves import first_of, nodes, read

FADE = 0.7, 0.95  # of the box's half side
_TAPER = 0.75  # of the wing's reach
FAINT_REACH = 512.0  # px; beyond lies 0.5% of the light
_LOW = 0  # octave of r^2 [px^2] where tables begin
FIRST = first_of(_LOW)
_NEAR_PX = 256.0  # radius within which every pixel is read from the table
_LONG = 4  # NEAR: shorter wings are drawn here whole
BLOCK = 8  # px between values read beyond
_AT = np.arange(BLOCK) / BLOCK
CUBIC = np.stack([  # weights of four values, at -1, 0, 1, 2, at each place between 0 and 1
    -_AT * (_AT - 1) * (_AT - 2) / 6, (_AT + 1) * (_AT - 1) * (_AT - 2) / 2,
    -(_AT + 1) * _AT * (_AT - 2) / 2, (_AT + 1) * _AT * (_AT - 1) / 6,
])  # fmt: skip


def step(r, inner, outer):
    """Return 1 within radius `inner`, 0 beyond `outer`, a quintic between them."""
    t = np.clip((r - inner) / (outer - inner), 0.0, 1.0)
    return 1 - t**3 * (10 - 15 * t + 6 * t * t)


def box_share(cells, per_pixel):
    """Return what the box keeps of itself, (cells, cells), `per_pixel` to a pixel; the wing brings the rest."""
    axis = (np.arange(cells) - (cells - 1) / 2) / per_pixel
    return step(np.hypot(axis, axis[:, None]), *(f * cells / 2 / per_pixel for f in FADE))


def wing_table(wing, flux, half, reach):
    """Return the wing per pixel on octaves of r^2. flux: (..., 4) electrons; half: of the box [px]; reach in px."""
    octaves = octaves_of(reach)
    table = np.einsum("...b,br->...r", flux, shown(wing, half, octaves))  # no BLAS: bits
    end, taper = ending(reach)
    table[..., end:] *= taper
    return table


def ending(reach):
    """Return the first node of the tables at which a wing is faded out, and by what, from there on."""
    r = _radii(octaves_of(reach))
    end = np.searchsorted(r, _TAPER * reach)
    return end, step(r[end:], _TAPER * reach, reach)


@lru_cache
def _radii(octaves):
    return np.sqrt(nodes(_LOW, octaves))


@lru_cache
def shown(wing, half, octaves):
    """Return the wing of each sub-band, (4, nodes), faded in where the box is faded out."""
    r = _radii(octaves)
    inner, outer = (f * half for f in FADE)
    return wing.profile(np.maximum(r, inner)) * (1 - step(r, inner, outer))


@lru_cache
def near_part(octaves, near=NEAR):
    """Return the part of a long wing that is drawn here, not by the FarWings: all up to `near` px, none at twice."""
    return step(_radii(octaves), near, 2 * near)


def octaves_of(reach):
    """Return how many octaves of the squared radius a wing of `reach` [px] spans."""
    return math.ceil(2 * math.log2(reach)) + 1


def add_beyond(image, response, window, chip, x, y, flux, beyond, wing_px, half, far=None):
    """Add an object's wing, if `wing_px` > 0, and its ghosts, if bright enough; return [(electrons, box), ...].

    image: float32 or float64, of `window`, changed in place; response: share of the light that is counted, of the same
    shape; x, y: chip pixels, flux: (4,) electrons; beyond: optics.beyond.Beyond; half: side of the PSF's box [px].
    Boxes are (x0, x1, y0, y1) on the chip, half-open; what misses the window is not listed. `far`: a FarWings that
    takes the part of a long wing that is far from the object, or None: all of it is drawn here.
    """
    parts = []
    if wing_px > 0:
        table = wing_table(beyond.wing, flux, half, wing_px)
        if far is not None and wing_px > _LONG * NEAR:
            near = near_part(octaves_of(wing_px))
            parts.append(far.add(x, y, wing_px, table * (1 - near), FIRST))
            table, wing_px = table * near, 2 * NEAR
        parts.append(_on_window(_add_radial, image, response, window, x, y, wing_px, table))
    if beyond.ghosts is not None and beyond.ghosts.visible(flux.sum()):
        ghosts = beyond.ghosts
        for (gx, gy), radius, light in zip(ghosts.centres(chip, x, y), ghosts.radius, ghosts.light, strict=True):
            # The integral of the soft disc; its sum over pixels is within 5e-5 of it for radii above 40 px
            level = light * flux.sum() / (math.pi * (radius**2 + 1 / 12))
            parts.append(_on_window(_add_soft_disc, image, response, window, gx, gy, radius + 0.5, level))
    return [part for part in parts if part is not None]


def add_faint(far, x, y, flux, wing, half, side=WHOLE, soft=1.0):
    """Add a faint object's wing to the mesh of a FarWings, cut as its `add` does; return what the window has of it."""
    added = far.add(x, y, FAINT_REACH, np.einsum("b,br->r", flux, _haze(wing, half)), FIRST, side, soft)
    return added[0] if added else 0.0


@lru_cache
def _haze(wing, half):
    """Return a faint object's wing in each sub-band, (4, nodes), of the light of the wing that its box leaves out.

    It is faded in from the middle on, not over the box's ring, which is too narrow for the mesh.
    """
    r = _radii(octaves_of(FAINT_REACH))
    taper = step(r, _TAPER * FAINT_REACH, FAINT_REACH)
    outer = FADE[1] * half
    smooth = wing.profile(np.maximum(r, FADE[0] * half)) * (1 - step(r, 0.0, outer)) * taper
    wanted = np.trapezoid(shown(wing, half, octaves_of(FAINT_REACH)) * taper * r, r, axis=1)
    return smooth * (wanted / np.trapezoid(smooth * r, r, axis=1))[:, None]


def _on_window(add, image, response, window, x, y, reach, what):
    """Call `add` on the pixels of the window within `reach` of x, y; return (electrons, box), or None if none is."""
    x0, x1 = max(math.ceil(x - reach), window.x0), min(math.floor(x + reach) + 1, window.x1)
    y0, y1 = max(math.ceil(y - reach), window.y0), min(math.floor(y + reach) + 1, window.y1)
    if x0 >= x1 or y0 >= y1:
        return None
    cut = slice(y0 - window.y0, y1 - window.y0), slice(x0 - window.x0, x1 - window.x0)
    return add(image[cut], response[cut], float(x - x0), float(y - y0), float(reach), what), (x0, x1, y0, y1)


@numba.njit(cache=True)
def _add_radial(image, response, x, y, reach, table):
    """Add the table's value at r^2 around pixel position x, y of `image`; return the sum."""
    columns = image.shape[1]
    total = 0.0
    square, value, sums = np.empty(columns + 1), np.empty(columns + BLOCK), np.empty(BLOCK)
    bits = square.view(np.int64)
    for row in range(image.shape[0]):
        dy2 = (row - y) ** 2
        half, near = math.sqrt(max(reach**2 - dy2, 0.0)), math.sqrt(max(_NEAR_PX**2 - dy2, 0.0))
        first, last = max(0, math.ceil(x - half)), min(columns, math.floor(x + half) + 1)
        if first >= last:
            continue
        left = min(max(math.ceil(x - near), first), last)
        right = min(max(math.floor(x + near) + 1, left), last)
        _coarse(value, first, left, x, dy2, table)
        for column in range(left, right):
            square[column] = dy2 + (column - x) ** 2
        for column in range(left, right):
            value[column] = read(table, FIRST, bits[column])
        _coarse(value, right, last, x, dy2, table)
        shown, line, seen = value[first:last], image[row, first:last], response[row, first:last]
        for column in range(len(shown)):
            shown[column] *= seen[column]
            line[column] += shown[column]
        sums[:] = 0.0
        whole = len(shown) // BLOCK * BLOCK
        for column in range(0, whole, BLOCK):
            for k in range(BLOCK):
                sums[k] += shown[column + k]
        for column in range(whole, len(shown)):
            sums[0] += shown[column]
        total += sums.sum()
    return total


@numba.njit(cache=True)
def _coarse(value, first, last, x, dy2, table):
    """Fill value[first:last] of a row from table values BLOCK apart."""
    if first >= last:
        return
    place = np.empty(1)
    bits = place.view(np.int64)
    before = here = after = 0.0
    for block in range(-3, (last - first + BLOCK - 1) // BLOCK):
        place[0] = dy2 + (first + (block + 2) * BLOCK - x) ** 2
        beyond = read(table, FIRST, bits[0])
        if block >= 0:
            start = first + block * BLOCK
            for k in range(min(BLOCK, len(value) - start)):
                value[start + k] = (
                    CUBIC[0, k] * before + CUBIC[1, k] * here + CUBIC[2, k] * after + CUBIC[3, k] * beyond
                )
            if beyond <= 0.0:  # where the wing ends, a cubic dips by rounding
                for k in range(min(BLOCK, len(value) - start)):
                    value[start + k] = max(value[start + k], 0.0)
        before, here, after = here, after, beyond


@numba.njit(cache=True)
def _add_soft_disc(image, response, x, y, reach, level):
    """Add a uniform disc whose edge falls from `level` to 0 over the pixel that ends at `reach`; return the sum."""
    total = 0.0
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            inside = reach - math.sqrt((column - x) ** 2 + (row - y) ** 2)
            if inside > 0.0:
                value = level * min(inside, 1.0) * response[row, column]
                image[row, column] += value
                total += value
    return total
