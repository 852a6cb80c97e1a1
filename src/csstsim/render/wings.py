"""Light far from an object that its stamp leaves out: the PSF's wing, and ghosts.

Over a ring of 0.7 to 0.95 of the box's half side, the box of the stored PSF is faded out and the wing
(optics.scatter.halo) faded in, by a step with two continuous derivatives. The wing of every object, bright or faint,
covers the whole chip, so that no drawing method loses light. Light that is still missing, because the stamp is smaller
than the box or the box differs from the wing where they join, is added as a smooth ring between core and edge of the
box.

How a wing is rendered depends on whether it exceeds the noise (selection.reach). A wing that does is rendered pixel by
pixel near the object, up to 48 to 192 px, and on the meshes of render.far_wings beyond. A wing hidden by noise, here
called a haze, is rendered on the meshes alone and faded in from the centre, because the box's ring is too narrow for a
mesh.

A wing is read from a table in r^2 (profiles.log_table), with a relative error of 3e-5 for slopes down to -3. The value
at a pixel's centre is used for the pixel, an error of 4e-4 at 45 px and less beyond. Cost: benchmarks/wings.py.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.types import FloatArray, Floats
from csstsim.catalog.profiles.log_table import read
from csstsim.render.extended import POINT, SHARP_PX, WIDE_PX, beyond_stamp, spread
from csstsim.render.far_wings import OVER, FarWings
from csstsim.render.wing_tables import RADII, Annulus, RadialProfile, annuli, light_of, step

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from csstsim.instrument.chip import Chip, Window
    from csstsim.optics.scatter.ghosts import Ghosts
    from csstsim.optics.scatter.halo import Wing
    from csstsim.render.canvas import Box, Canvas
    from csstsim.render.extended import Part

FADE = 0.7, 0.95  # of the box's half side
NEAR = 48.0, 96.0  # px: the meshes take over from here to twice that, for short wings and for others
SMOOTH_PX = 16.0  # half-light radius from which a ring is smooth enough for the meshes
# Of the flux: the maximum that a stamp may leave out, without and with a wing
_NEAR_ALONE = 0.006
_NEAR_WITH_WING = 0.08


def core_fraction(cells: int, per_pixel: int) -> FloatArray:
    """Return the fraction (cells, cells) of each cell of the box, `per_pixel` to a pixel, not replaced by the wing."""
    axis = (np.arange(cells) - (cells - 1) / 2) / per_pixel
    return step(np.hypot(axis, axis[:, None]), *(f * cells / 2 / per_pixel for f in FADE))


@lru_cache
def wing_beyond(wing: Wing, half: float, shows: bool = True) -> RadialProfile:
    """Return the RadialProfile of a wing (optics.scatter.halo.Wing) beyond a box of half side `half` [px].

    shows: whether it is faded in where the box is faded out; otherwise it is faded in from the centre, as a haze.
    """
    inner, outer = (f * half for f in FADE)
    profile = wing.profile(np.maximum(RADII, inner)) * (1 - step(RADII, inner if shows else 0.0, outer))
    return RadialProfile(profile, light_of(profile) + wing.light_beyond(RADII[-1]))


@lru_cache
def ring_within(half: float) -> RadialProfile:
    """Return the RadialProfile of a smooth ring of flux 1 in a box of half side `half` [px], zero at the centre."""
    widest = FADE[0] * half
    ring = (1 - step(RADII, 0.0, widest)) * step(RADII, widest, half)
    return RadialProfile(np.tile(ring / light_of(ring[None]), (4, 1)), np.ones(4))


def near_of(wing_px: float) -> float:
    """Return the radius [px] from which the meshes have a wing that shows up to wing_px; 0: they have all of it."""
    return 0.0 if wing_px <= 0 else NEAR[int(wing_px >= 2 * NEAR[1])]


class StampLight(NamedTuple):
    """The electrons of an object that its PSF's box and its stamp contain: numbers, or (4,) by sub-band."""

    inside: Floats  # in the PSF's box, without those replaced by the wing
    drawn: Floats  # in the stamp
    reach: int = 0  # px, half the side of the stamp


class Wings:
    """Adds the light that the stamps of objects leave out to one Canvas."""

    def __init__(self, canvas: Canvas, wing: Wing | None, half: float) -> None:
        """wing: optics.scatter.halo.Wing, light beyond the PSF's box, or None; half: half the side of the box [px]."""
        self.canvas = canvas
        self.wing = wing
        self.half = half
        self.meshes = FarWings(canvas)

    def add_to_canvas(self) -> None:
        """Add the light on the meshes to the canvas; call it once, after all objects."""
        self.meshes.add_to_canvas()

    def add(
        self,
        at: tuple[float, float],
        flux: FloatArray,
        light: StampLight,
        wing_px: float,
        parts: Sequence[Part] = POINT,
        near: float | None = None,
    ) -> float:
        """Add the light around an object at `at` (x, y) [chip pixel]; return the electrons on the window.

        flux (4,): all electrons of the object; light: StampLight; wing_px: radius [px] beyond which noise hides the
        wing, 0: everywhere; parts: its render.extended.Parts; near: px from which meshes take over, None: `near_of`
        wing_px.
        """
        missing = light.inside - light.drawn
        haze = 0.0
        added = 0.0
        if self.wing is not None:
            near = near_of(wing_px) if near is None else near
            faded = wing_beyond(self.wing, self.half, near > 0)
            shown = wing_beyond(self.wing, self.half)
            flux = flux * wing_scale(flux, light.inside, shown.light)
            for part in parts:
                blurred = spread(faded, part, SHARP_PX if near else WIDE_PX)
                added += self._add(at, part.fraction * flux, blurred, near)
            haze = (flux * (shown.light - faded.light)).sum()
        tails = beyond_stamp(parts, light.reach) if light.reach >= self.half else []
        for tail in tails:
            added += self._add(at, _one_band(tail.fraction * missing), tail.profile, 0.0)
        ring = ring_within(self.half)
        within = haze + (0.0 if tails else near_light(missing, light.inside, self.wing))
        for part in parts:
            if (blurred := spread(ring, part)) is not ring:
                from_px = NEAR[0] if part.size < SMOOTH_PX else 0.0
                added += self._add(at, _one_band(part.fraction * within), blurred, from_px)
                continue
            [annulus] = annuli(ring, ())
            added += self._add_near(at, Annulus(part.fraction * within * annulus.table[0], annulus.first, self.half))
        return added

    def _add(self, at: tuple[float, float], flux: FloatArray, radial: RadialProfile, near: float) -> float:
        """Add a RadialProfile times flux (4,), on the meshes from `near` [px] on; return electrons on the window."""
        first, *others = annuli(radial, (near, *OVER))
        added = 0.0
        if near:
            added += self._add_near(at, _mixed(flux, first))
        for level, annulus in enumerate(others):
            if annulus.reach:
                added += self.meshes.add(level, at, _mixed(flux, annulus))
        return added

    def _add_near(self, at: tuple[float, float], annulus: Annulus) -> float:
        """Add an annulus, its table (n,), pixel by pixel; return the electrons on the window."""
        part = _on_window(_add_radial, self.canvas, at, annulus.reach, annulus.table, annulus.first)
        return part[0] if part else 0.0


def _one_band(light: Floats) -> FloatArray:
    return np.array([light, 0.0, 0.0, 0.0])


def near_light(missing: Floats, inside: Floats, wing: Wing | None) -> FloatArray:
    """Return the `missing` light, but 0 where there is so much of it that the profile must be larger than its stamp.

    Such light is far from the object and not rendered; TRUNCATED_STAMP or the truth's `fraction` show this.
    """
    maximum = _NEAR_ALONE if wing is None else _NEAR_WITH_WING
    return np.where(np.abs(missing) < maximum * inside, missing, 0.0)


def wing_scale(flux: FloatArray, inside: Floats, light: FloatArray) -> Floats:
    """Return the ratio of the electrons that the box does not hold to those of the wing.

    flux: electrons of the object; inside: electrons in the box; light: of the wing, per electron of the object.
    """
    return np.maximum(np.sum(flux) - inside, 0.0) / np.sum(flux * light)


def _mixed(flux: FloatArray, annulus: Annulus) -> Annulus:
    """Return an annulus of sub-bands as one of their sum, weighted by flux (4,)."""
    return annulus._replace(table=np.einsum("b,br->r", flux, annulus.table))  # not BLAS, whose bits vary by machine


def add_ghosts(
    canvas: Canvas, chip: Chip | None, at: tuple[float, float], electrons: float, ghosts: Ghosts
) -> list[tuple[float, Box]]:
    """Add the ghosts (optics.scatter.ghosts.Ghosts) of an object at x, y [chip pixel], if it is bright enough.

    Returns [(electrons on the window, box), ...]; boxes are (x0, x1, y0, y1) on the chip, half-open; ghosts that miss
    the window are not listed.
    """
    if not ghosts.visible(electrons):
        return []
    assert chip is not None  # given with ghosts
    parts = []
    for centre, radius, light in zip(ghosts.centres(chip, *at), ghosts.radius, ghosts.light, strict=True):
        # The integral of the soft disc; its sum over pixels is within 5e-5 of it for radii above 40 px
        level = light * electrons / (math.pi * (radius**2 + 1 / 12))
        parts.append(_on_window(_add_soft_disc, canvas, centre, radius + 0.5, level))
    return [part for part in parts if part is not None]


def box_on_window(window: Window, x: float, y: float, reach: float) -> Box | None:
    """Return (x0, x1, y0, y1) of the window's pixels within `reach` of x, y along both axes, or None."""
    x0 = max(math.ceil(x - reach), window.x0)
    x1 = min(math.floor(x + reach) + 1, window.x1)
    y0 = max(math.ceil(y - reach), window.y0)
    y1 = min(math.floor(y + reach) + 1, window.y1)
    return (x0, x1, y0, y1) if x0 < x1 and y0 < y1 else None


def _on_window(
    add: Callable[..., float], canvas: Canvas, at: tuple[float, float], reach: float, *what: FloatArray | float
) -> tuple[float, Box] | None:
    """Call `add` on the window's pixels within `reach` of x, y; return (electrons, box), or None without pixels."""
    x, y = at
    box = box_on_window(canvas.window, x, y, reach)
    if box is None:
        return None
    assert canvas.expected is not None  # None: for photons alone
    cut = canvas.cut(box)
    image = canvas.expected[cut]
    return add(image, canvas.response_array[cut], float(x - box[0]), float(y - box[2]), float(reach), *what), box


@numba.njit(cache=True)
def _add_radial(
    image: FloatArray, response: FloatArray, x: float, y: float, reach: float, table: FloatArray, first: int
) -> float:
    """Add the table's value at r^2 around pixel position x, y of `image`; return the sum."""
    columns = image.shape[1]
    total = 0.0
    square = np.empty(columns)
    bits = square.view(np.int64)
    for row in range(image.shape[0]):
        dy2 = (row - y) ** 2
        line = 0.0
        half = math.sqrt(max(reach**2 - dy2, 0.0))
        begin = max(0, math.ceil(x - half))
        end = min(columns, math.floor(x + half) + 1)
        for column in range(begin, end):
            square[column] = dy2 + (column - x) ** 2
        for column in range(begin, end):
            value = read(table, first, bits[column]) * response[row, column]
            image[row, column] += value
            line += value
        total += line
    return total


@numba.njit(cache=True)
def _add_soft_disc(image: FloatArray, response: FloatArray, x: float, y: float, reach: float, level: float) -> float:
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
