"""Stamps: the expected light of objects on their pixels, without noise, added to a plane of expected electrons.

Points: render.imaging.point_stamp. Galaxies: render.imaging.galaxy_stamp. Light that a stamp does not hold:
render.wings. Of what is off the window only the light is computed, which says how much is left for the wings.
"""

import math
import time
from dataclasses import dataclass

import numba
import numpy as np

from csstsim.base.progress import progress
from csstsim.catalog.flags import FFT_REDUCED, NEGATIVE_CLIPPED, OFF_CHIP, OUTSIDE_PSF_HULL
from csstsim.render.extended import POINT, parts_of
from csstsim.render.far_wings import FarWings
from csstsim.render.imaging.galaxy_stamp import galaxy_stamp, plan_galaxies
from csstsim.render.imaging.point_stamp import point_stamp
from csstsim.render.psf_mixture import Mixer
from csstsim.render.wings import add_far, add_ghosts, box_on_window

_NEGATIVE_LIMIT = 1e-4  # of an object's light, in negative pixels, above which clipping is flagged
_MANY = 8  # galaxies with a size of transform and PSF nodes in common, above which nodes are transformed, not galaxies
_SIZE_KEPT = 160  # px, period of the largest transforms that are kept


@dataclass(frozen=True)
class Drawn:
    """What was drawn of n objects; the wings of faint ones are in `drawn`, not in `box`."""

    drawn: np.ndarray  # (n,) float64, electrons put on the window
    box: np.ndarray  # (n, 4) int64: x0, x1, y0, y1 of the pixels touched, half-open, on the chip; zeros: none
    flags: np.ndarray  # (n,) int32, catalog.flags
    ms: np.ndarray  # (n,) float32, CPU


def draw_scene(image, window, scene, reach, wing_px, psf, beyond=None, response=None, chip=None):
    """Draw the objects of a Scene into `image` (float32 or float64, window.shape, expected e-); return Drawn.

    reach (n,): px, half the side of each stamp; wing_px (n,): px, how far the light beyond the PSF's box shows, 0:
    noise hides it; psf: PsfSet, or the Mixer of one; beyond: optics.scatter.outside_box.Beyond, or None: stamps alone,
    whatever they leave out; response: share of the light that is counted, window.shape, or None: all; chip:
    instrument.chip.Chip, for the ghosts. Points come first, then galaxies by size of transform, both by their PSF
    nodes: the same scene gives the same bits.
    """
    n, mixer = len(scene), psf if isinstance(psf, Mixer) else Mixer(psf)
    out = Drawn(np.zeros(n), np.zeros((n, 4), np.int64), np.zeros(n, np.int32), np.zeros(n, np.float32))
    response = np.broadcast_to(np.ones((), np.float32), window.shape) if response is None else response
    half_box = mixer.cells / 2 / mixer.per_pixel
    reach, wing_px = np.asarray(reach, int), np.asarray(wing_px, float)
    wing, ghosts = (None, None) if beyond is None else (beyond.wing, beyond.ghosts)
    if beyond is not None and wing is None:  # then a stamp holds all there is of a point
        reach = np.maximum(reach, math.ceil(half_box))
    far = FarWings(window, response)
    out.flags[scene.outside] |= OUTSIDE_PSF_HULL
    flux = scene.electrons
    lit = flux.sum(axis=1) > 0
    galaxy = ((scene.sersic[:, :, 0] > 0) & (scene.light > 0)).any(axis=1)
    plan = plan_galaxies(scene, reach, half_box, lit & galaxy)
    share = scene.weight[:, :, None] * flux[:, None, :]
    group = np.column_stack([plan.size, scene.node])
    order = np.lexsort(group.T[::-1])
    _, which, members = np.unique(group, axis=0, return_inverse=True, return_counts=True)
    many = (members[which.ravel()] > _MANY) & (plan.size <= _SIZE_KEPT)
    core = mixer.core if wing is not None else None
    for i in progress(order[lit[order]], "stamps"):
        start = time.process_time()
        x, y = scene.x[i], scene.y[i]
        bounds, parts = _visible(x, y, reach[i], window), []
        if galaxy[i]:
            stamp, whole = galaxy_stamp(mixer, scene, plan, i, share[i], reach[i], bounds, core=core, many=many[i])
            out.flags[i] |= _clip_negative(stamp) | (FFT_REDUCED if plan.rough[i] else 0)
        else:
            stamp, whole = point_stamp(mixer, scene.node[i], share[i], x, y, reach[i], bounds, core=core)
        if bounds:
            x0, x1, y0, y1 = bounds
            cut = slice(y0 - window.y0, y1 - window.y0), slice(x0 - window.x0, x1 - window.x0)
            parts.append((_put(image[cut], stamp, response[cut]), bounds))
        shown = box_on_window(window, x, y, wing_px[i]) if wing_px[i] > 0 and wing is not None else None
        if shown:
            parts.append((0.0, shown))
        if ghosts is not None:
            parts += add_ghosts(image, response, window, chip, x, y, flux[i].sum(), ghosts)
        if parts:
            out.drawn[i] = sum(light for light, _ in parts)
            if beyond is not None:
                inside = mixer.light(scene.node[i], share[i], wing is not None)
                more = wing, wing_px[i], half_box, far
                shape = parts_of(scene.light[i], scene.sersic[i], scene.matrix[i]) if galaxy[i] else POINT
                out.drawn[i] += add_far(
                    image, response, window, x, y, flux[i], inside, whole, *more, parts=shape, reach=reach[i]
                )
            x0, x1, y0, y1 = np.transpose([bounds for _, bounds in parts])
            out.box[i] = x0.min(), x1.max(), y0.min(), y1.max()
        else:
            out.flags[i] |= OFF_CHIP
        out.ms[i] = 1000 * (time.process_time() - start)
    far.lay(image)
    return out


def _visible(x, y, reach, window):
    """Return (x0, x1, y0, y1) of the stamp's pixels on the window, or None."""
    column, row = round(x), round(y)
    x0, x1 = max(column - reach, window.x0), min(column + reach + 1, window.x1)
    y0, y1 = max(row - reach, window.y0), min(row + reach + 1, window.y1)
    return (x0, x1, y0, y1) if x0 < x1 and y0 < y1 else None


@numba.njit(cache=True)
def _put(image, stamp, response):
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
def _clip(stamp):
    """Set what is below zero to zero, the light staying the same; return (light, what was below zero)."""
    total = below = 0.0
    for value in stamp.flat:
        total += value
        below -= min(value, 0.0)
    if below > 0:
        scale = max(total, 0.0) / (total + below)
        for row in range(stamp.shape[0]):
            for column in range(stamp.shape[1]):
                stamp[row, column] = max(stamp[row, column], 0.0) * scale
    return total, below


def _clip_negative(stamp):
    total, below = _clip(stamp)
    return NEGATIVE_CLIPPED if below > _NEGATIVE_LIMIT * abs(total) else 0
