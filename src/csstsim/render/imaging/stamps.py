"""Stamps: noise-free images of objects, added to the plane of expected electrons.

Points: render.imaging.point_stamp. Galaxies: render.imaging.galaxy_stamp. Light that a stamp does not hold:
render.wings. For the part of a stamp outside the window only the total light is computed, which the wings need.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.process.progress import progress
from csstsim.base.types import FloatArray, IntArray
from csstsim.catalog.flags import NEGATIVE_CLIPPED, OFF_CHIP, OUTSIDE_PSF_HULL
from csstsim.render.canvas import around
from csstsim.render.imaging.stamper import Stamper
from csstsim.render.psf_mixture import mixer_of
from csstsim.render.wings import StampLight, Wings, add_ghosts, box_on_window

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip, Window
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.optics.scatter.scattered_light import Scattered
    from csstsim.render.canvas import Box, Canvas
    from csstsim.render.psf_mixture import Mixer
    from csstsim.render.scene import Scene

_NEGATIVE_LIMIT = 1e-4  # of an object's light, in negative pixels, above which clipping is flagged
_MANY = 8  # above so many galaxies with equal transform size and PSF nodes, the nodes' transforms are cached
_SIZE_CACHED = 160  # px, period of the largest transforms that are cached


@dataclass(frozen=True)
class Drawn:
    """What was rendered of n objects; wings hidden by noise are in `drawn`, not in `box`."""

    drawn: FloatArray  # (n,) float64, electrons put on the window
    box: IntArray  # (n, 4) int64: x0, x1, y0, y1 of the pixels touched, half-open, on the chip; zeros: none
    flags: IntArray  # (n,) int32, catalog.flags
    ms: FloatArray  # (n,) float32, CPU


def draw_scene(
    canvas: Canvas, scene: Scene, psf: PsfSet | Mixer, scattered: Scattered | None = None, chip: Chip | None = None
) -> Drawn:
    """Draw the objects of a Scene as expected electrons, without noise.

    The drawing order is fixed (points, then galaxies by size of transform, both sorted by PSF nodes), so the same scene
    gives the same bits.

    Parameters
    ----------
    canvas
        With a plane of expected electrons, to which the objects are added.
    scene
        n objects, with the half sides of their stamps and the radii of their wings [px].
    psf
        Of the chip; the Mixer of a PsfSet saves time when it is kept between calls.
    scattered
        Light beyond the PSF's box; None: only stamps are rendered.
    chip
        For the positions of ghosts; it must be given if `scattered` has ghosts.

    Returns
    -------
    Drawn
        What was rendered of each object.
    """
    assert canvas.expected is not None and scene.wing is not None
    n = len(scene)
    mixer = mixer_of(psf)
    image = canvas.expected
    window = canvas.window
    out = Drawn(np.zeros(n), np.zeros((n, 4), np.int64), np.zeros(n, np.int32), np.zeros(n, np.float32))
    flux = scene.electrons
    wing_px = np.asarray(scene.wing, float)
    lit = flux.sum(axis=1) > 0
    wing, ghosts = (None, None) if scattered is None else (scattered.wing, scattered.ghosts)
    stamper = Stamper.of(mixer, scene, scattered, lit)
    wings = Wings(canvas, wing, mixer.half)
    plan = stamper.plan
    reach = stamper.reach
    out.flags[scene.outside] |= OUTSIDE_PSF_HULL
    node_electrons = scene.weight[:, :, None] * flux[:, None, :]
    group = np.column_stack([plan.size, scene.node])
    order = np.lexsort(group.T[::-1])
    _, which, members = np.unique(group, axis=0, return_inverse=True, return_counts=True)
    many = (members[which.ravel()] > _MANY) & (plan.size <= _SIZE_CACHED)
    for i in progress(order[lit[order]], "stamps"):
        start = time.process_time()
        at = scene.x[i], scene.y[i]
        bounds = _visible(*at, reach[i], window)
        parts: list[tuple[float, Box]] = []
        stamp, whole = stamper.stamp(i, node_electrons[i], bounds, many[i])
        if plan.size[i]:
            out.flags[i] |= _clip_negative(stamp)
        if bounds:
            cut = canvas.cut(bounds)
            parts.append((_put(image[cut], stamp, canvas.response_array[cut]), bounds))
        shown = box_on_window(window, *at, wing_px[i]) if wing_px[i] > 0 and wing is not None else None
        if shown:
            parts.append((0.0, shown))
        if ghosts is not None:
            parts += add_ghosts(canvas, chip, at, flux[i].sum(), ghosts)
        if parts:
            out.drawn[i] = sum(electrons for electrons, _ in parts)
            if scattered is not None:
                inside = mixer.light(scene.node[i], node_electrons[i], wing is not None)
                light = StampLight(inside, whole, reach[i])
                out.drawn[i] += wings.add(at, flux[i], light, wing_px[i], stamper.parts(i))
            out.box[i] = around([bounds for _, bounds in parts])
        else:
            out.flags[i] |= OFF_CHIP
        out.ms[i] = 1000 * (time.process_time() - start)
    wings.add_to_canvas()
    return out


def _visible(x: float, y: float, reach: int, window: Window) -> Box | None:
    """Return (x0, x1, y0, y1) of the stamp's pixels on the window, or None."""
    column = round(x)
    row = round(y)
    x0 = max(column - reach, window.x0)
    x1 = min(column + reach + 1, window.x1)
    y0 = max(row - reach, window.y0)
    y1 = min(row + reach + 1, window.y1)
    return (x0, x1, y0, y1) if x0 < x1 and y0 < y1 else None


@numba.njit(cache=True)
def _put(image: FloatArray, stamp: FloatArray, response: FloatArray) -> float:
    """Add a stamp times the response; return the sum of what was added."""
    total = 0.0
    for row in range(stamp.shape[0]):
        line = 0.0
        for column in range(stamp.shape[1]):
            value = stamp[row, column] * response[row, column]
            image[row, column] += value
            line += value
        total += line
    return total


@numba.njit(cache=True)
def _clip(stamp: FloatArray) -> tuple[float, float]:
    """Set negative pixels to zero, keeping the total light; return (light, sum of what was below zero)."""
    total = below = 0.0
    for value in stamp.flat:
        total += value  # type: ignore[assignment]  # a number to numba
        below -= min(value, 0.0)  # type: ignore[operator]  # the same
    if below > 0:
        scale = max(total, 0.0) / (total + below)
        for row in range(stamp.shape[0]):
            for column in range(stamp.shape[1]):
                stamp[row, column] = max(stamp[row, column], 0.0) * scale
    return total, below


def _clip_negative(stamp: FloatArray) -> int:
    total, below = _clip(stamp)
    return NEGATIVE_CLIPPED if below > _NEGATIVE_LIMIT * abs(total) else 0
