"""What bright stars add beyond the box of the stored PSF: a radial wing out to the chip's size, and ghosts.

The box is faded out, the wing (optics.halo) faded in over the same ring, 0.7 to 0.95 of the box's half side, by a
step with two continuous derivatives; at its far end the wing is faded out over its last quarter. How far a wing reaches
comes with the object (catalog.reach).

A wing is read from a table in r^2 (render.octaves): 3e-5 of the value for slopes to -3. Its value at a pixel's centre
stands for the pixel: 4e-4 at 45 px, less beyond. Cost: benchmarks/wings.py.
"""

import math

import numba
import numpy as np

from csstsim.render.octaves import first_of, nodes, read

FADE = 0.7, 0.95  # of the box's half side
_TAPER = 0.75  # of the wing's reach
_LOW = 0  # octave of r^2 [px^2] where tables begin
_FIRST = first_of(_LOW)


def step(r, inner, outer):
    """Return 1 within radius `inner`, 0 beyond `outer`, a quintic between them."""
    t = np.clip((r - inner) / (outer - inner), 0.0, 1.0)
    return 1 - t**3 * (10 - 15 * t + 6 * t * t)


def box_share(cells, per_pixel):
    """Return what the box keeps of itself, (cells, cells), `per_pixel` to a pixel; the wing brings the rest."""
    axis = (np.arange(cells) - (cells - 1) / 2) / per_pixel
    return step(np.hypot(axis, axis[:, None]), *(f * cells / 2 / per_pixel for f in FADE))


def wing_table(wing, flux, half, reach):
    """Return the wing per pixel on octaves of r^2. flux: (4,) electrons; half: of the box [px]; reach in px."""
    r = np.sqrt(nodes(_LOW, math.ceil(2 * math.log2(reach)) + 1))
    inner, outer = (f * half for f in FADE)
    shown = (1 - step(r, inner, outer)) * step(r, _TAPER * reach, reach)
    return np.einsum("b,br->r", flux, wing.profile(np.maximum(r, inner))) * shown


def add_beyond(image, response, window, chip, x, y, flux, beyond, wing_px, half):
    """Add an object's wing, if `wing_px` > 0, and its ghosts, if bright enough; return [(electrons, box), ...].

    image: float32 or float64, of `window`, changed in place; response: share of the light that is counted, of the same shape;
    x, y: chip pixels, flux: (4,) electrons; beyond:
    optics.beyond.Beyond; half: side of the PSF's box [px]. Boxes are (x0, x1, y0, y1) on the chip, half-open; what
    misses the window is not listed.
    """
    parts = []
    if wing_px > 0:
        table = wing_table(beyond.wing, flux, half, wing_px)
        parts.append(_on_window(_add_radial, image, response, window, x, y, wing_px, table))
    if beyond.ghosts is not None and beyond.ghosts.visible(flux.sum()):
        ghosts = beyond.ghosts
        for (gx, gy), radius, light in zip(ghosts.centres(chip, x, y), ghosts.radius, ghosts.light, strict=True):
            # The integral of the soft disc; its sum over pixels is within 5e-5 of it for radii above 40 px
            level = light * flux.sum() / (math.pi * (radius**2 + 1 / 12))
            parts.append(_on_window(_add_soft_disc, image, response, window, gx, gy, radius + 0.5, level))
    return [part for part in parts if part is not None]


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
    total = 0.0
    square = np.empty(image.shape[1])
    bits = square.view(np.int64)
    for row in range(image.shape[0]):
        dy2 = (row - y) ** 2
        half = math.sqrt(max(reach**2 - dy2, 0.0))
        first, last = max(0, math.ceil(x - half)), min(image.shape[1], math.floor(x + half) + 1)
        for column in range(first, last):
            square[column] = dy2 + (column - x) ** 2
        line = 0.0
        for column in range(first, last):
            value = read(table, _FIRST, bits[column]) * response[row, column]
            image[row, column] += value
            line += value
        total += line
    return total


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
