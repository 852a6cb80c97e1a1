"""Which method draws an object: the cheapest one whose predicted error is below `eps` of the object's own noise.

| method       | plane    | for                                                                          |
|--------------|----------|------------------------------------------------------------------------------|
| `photons`    | counted  | where its electrons cost less than its pixels: all but the brightest         |
| `stamp`      | expected | bright objects; all objects of a noise-free image                            |
| `unresolved` | expected | objects below the preset's floor in S/N: their light, spread smoothly        |
| `none`       |          | what cannot be drawn (flags say why), or has no light                        |

The choice hangs on nominal light, the stored PSF and config/render.yaml alone: never on a random number or a clock.
When no method is good enough, as for the brightest, it is the cheapest of those within three times the most accurate;
the truth table's `error` says what it is.
"""

from dataclasses import dataclass

import numpy as np

from csstsim.render.error_model import predicted
from csstsim.render.numbers import load_numbers
from csstsim.render.unresolved import MESH

NONE, UNRESOLVED, PHOTONS, STAMP = range(4)
METHODS = np.array(["none", "unresolved", "photons", "stamp"])
WING_NEAR = 192.0  # px: further out a wing costs next to nothing (render.far_wings)
PHOTONS_MAX = 1e8  # electrons: a second; more would at length not fit the counted plane's integers
_AS_GOOD = 3.0
_PSF_HALF_LIGHT = 1.2  # pixel
_GAUSSIAN = 4 * np.pi / (2 * np.log(2))  # effective number of pixels / half-light radius^2 of a Gaussian


@dataclass(frozen=True)
class Choice:
    """For n objects."""

    method: np.ndarray  # (n,) int8
    error: np.ndarray  # (n,) predicted, in units of the object's own noise
    snr: np.ndarray  # (n,)


def choose(scene, reach, wing, variance, fidelity, *, convex, per_pixel, maximum=1.0, ghosts=False):
    """Return the `Choice` for a Scene.

    reach, wing: (n,) pixel, of stamp and wing; variance: of one pixel without the object [e-^2]; fidelity: a preset of
    config/render.yaml; convex: whether the PSF's mixture can be drawn from; per_pixel: its cells to a pixel; maximum:
    of the losses, by which photons are more than the light; ghosts: (n,) whether the object has ghosts, which no
    photons are drawn for.
    """
    numbers = load_numbers()
    preset = numbers.presets[fidelity]
    electrons = scene.electrons.sum(axis=1)
    snr = electrons / noise(scene, electrons, variance)
    cost = np.stack(costs(scene, reach, wing, electrons * maximum, numbers.cost), axis=1)
    # A wing takes over where a point's stamp ends
    shown = np.maximum(reach, wing)
    error = [predicted(m, scene, shown, snr, numbers.error, per_pixel) for m in ("photons", "stamp")]
    error = np.stack(error, axis=1)
    allowed = np.ones_like(cost, bool)
    allowed[:, 0] = (electrons * maximum < PHOTONS_MAX) & convex & (fidelity != "noise_free")
    allowed[:, 0] &= ~np.broadcast_to(ghosts, electrons.shape)
    least = np.where(allowed, error, np.inf).min(axis=1)
    good = allowed & (error <= np.maximum(preset.eps, _AS_GOOD * least)[:, None])
    best = np.where(good, cost, np.inf).argmin(axis=1)
    method = np.where(best == 0, PHOTONS, STAMP).astype(np.int8)
    # What is larger than the mesh of the smooth background would be drawn together by it, and stand out
    faint = (snr < preset.floor) & (half_light_px2(scene) < (MESH / 2) ** 2)
    method[faint], method[electrons <= 0] = UNRESOLVED, NONE
    error = np.take_along_axis(error, best[:, None], 1)[:, 0]
    return Choice(method, np.where(faint, snr, error), snr)


def noise(scene, electrons, variance):
    """Return the noise of each object's own light and of the pixels it covers [electron], (n,)."""
    return np.sqrt(electrons + _GAUSSIAN * (_PSF_HALF_LIGHT**2 + half_light_px2(scene)) * variance)


def half_light_px2(scene):
    """Return the square of a circular half-light radius [pixel^2] of each object's components, weighted by light."""
    stretch2 = np.abs(np.linalg.det(scene.matrix))
    return (scene.light * scene.sersic[:, :, 2] ** 2).sum(axis=1) * stretch2


def costs(scene, reach, wing, electrons, cost):
    """Return (photons, stamp): CPU ns of each object, (n,). cost: render.numbers.Cost."""
    galaxy = (scene.sersic[:, :, 0] > 0).any(axis=1)
    photons = cost.photon_object + electrons * np.where(galaxy, cost.photon_galaxy, cost.photon_star)
    pixels = (2.0 * reach + 1) ** 2
    stamp = np.where(galaxy, cost.stamp_galaxy + cost.stamp_pixel * pixels, cost.stamp_star)
    return photons, stamp + cost.wing_pixel * np.pi * np.minimum(wing, WING_NEAR) ** 2
