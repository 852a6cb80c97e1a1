"""Which method draws an object: the cheapest one whose predicted error is below `eps` of the object's own noise.

| method       | plane    | for                                                                          |
|--------------|----------|------------------------------------------------------------------------------|
| `photons`    | counted  | objects whose electrons cost less than their pixels: all but the brightest   |
| `stamp`      | expected | bright objects; all objects of a noise-free image                            |
| `unresolved` | expected | objects below the preset's S/N floor: their light is spread smoothly         |
| `none`       |          | objects that cannot be rendered (see their flags) or have no electrons       |

The choice is deterministic: it depends only on nominal light, the stored PSF and config/render.yaml. If no method is
below `eps`, as for the brightest objects, the cheapest method within three times the smallest error is taken. The
column `error` of the truth table has the predicted error.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from csstsim.render.error_model import predicted
from csstsim.render.imaging.unresolved import MESH
from csstsim.render.settings import load_numbers
from csstsim.render.slitless.line_wings import LINE_NEAR, LINE_STEP
from csstsim.render.slitless.slab_counts import allowed_error, fewest
from csstsim.render.slitless.slabs import densities

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray, IntArray
    from csstsim.optics.gratings.dispersion import Disperser
    from csstsim.render.drawing import Drawing
    from csstsim.render.scene import Scene
    from csstsim.render.settings import Cost, Fidelity

NONE, UNRESOLVED, PHOTONS, STAMP = range(4)
METHODS = np.array(["none", "unresolved", "photons", "stamp"])
WING_NEAR = 192.0  # px: the cost of a wing further out is negligible (render.far_wings)
PHOTONS_MAX = 1e8  # electrons, about a second; well within the integers of the counted plane
_AS_GOOD = 3.0
_PSF_HALF_LIGHT = 1.2  # pixel
_USUAL = 0.01  # roughness of a spectrum (render.slitless.slab_counts)
_GAUSSIAN = 4 * np.pi / (2 * np.log(2))  # effective number of pixels / half-light radius^2 of a Gaussian


class Costs(NamedTuple):
    """CPU time of n objects by method [ns], each (n,); stamp: slabs of dispersed light."""

    photons: FloatArray
    stamp: FloatArray


@dataclass(frozen=True)
class Choice:
    """Method and predicted error of n objects."""

    method: IntArray  # (n,) int8
    error: FloatArray  # (n,) predicted, in units of the object's own noise
    snr: FloatArray  # (n,)
    allowed: FloatArray | None = None  # (n,) allowed error of slabs as a fraction of S/N, for dispersed light
    coarse: BoolArray | None = None  # (n,) whether the bins of Disperser.coarse are fine enough


def choose(scene: Scene, drawing: Drawing, maximum: float = 1.0) -> Choice:
    """Return the `Choice` for a Scene.

    drawing: render.drawing.Drawing, of which fidelity, variance, PSF and ghosts are used; maximum: largest response;
    photons are drawn for `maximum` times the light. Objects with ghosts are never drawn as photons.
    """
    numbers = load_numbers()
    fidelity = drawing.fidelity
    electrons = scene.electrons.sum(axis=1)
    snr = scene.total_electrons / noise(scene, scene.total_electrons, drawing.variance)
    cost = costs(scene, electrons * maximum, numbers.cost)
    photons = _may_be_photons(electrons * maximum, drawing)
    if drawing.ghosts is not None:
        photons &= ~np.asarray(drawing.ghosts.visible(electrons))
    choice = _cheapest(scene, snr, cost, photons, drawing)
    # An object larger than the mesh would be made smaller by it, and so become visible
    faint = (snr < numbers.presets[cast("Fidelity", fidelity)].floor) & (half_light_px2(scene) < (MESH / 2) ** 2)
    method = np.where(faint, UNRESOLVED, choice.method)
    method[electrons <= 0] = NONE
    return Choice(method, np.where(faint, snr, choice.error), snr)


def choose_dispersed(scene: Scene, drawing: Drawing, disperser: Disperser, maximum: float = 1.0) -> Choice:
    """Return the `Choice` for a Scene whose light is dispersed: photons or slabs (STAMP), never unresolved.

    Arguments as in `choose`; scene.electrons: of the first order; disperser: optics.gratings.dispersion.Disperser.
    """
    assert scene.reach is not None and scene.wing is not None  # select gives them
    numbers = load_numbers()
    electrons = scene.electrons.sum(axis=1)
    eps = numbers.presets[cast("Fidelity", drawing.fidelity)].eps
    px = disperser.length
    snr = scene.total_electrons / noise(scene, scene.total_electrons, drawing.variance, length=px)
    cost = numbers.cost
    galaxy = scene.extended
    orders = disperser.rates.sum(axis=(0, 1, 2)) / disperser.rates[:, disperser.orders.index(1)].sum()
    shot = cost.spectrum_object + maximum * orders * electrons * np.where(
        galaxy, cost.spectrum_galaxy, cost.spectrum_star
    )
    allowed = allowed_error(snr, drawing.psf.oversampling, eps)
    slab = cost.slab_pixel * px * (2.0 * scene.reach + 1) ** 2 + np.where(galaxy, cost.slabs_galaxy, 0.0)
    slabs = cost.slabs_star + densities(scene, fewest(_USUAL, allowed)) * slab
    slabs += cost.wing_pixel * np.pi * np.minimum(scene.wing, LINE_NEAR) ** 2 * px / LINE_STEP
    choice = _cheapest(scene, snr, Costs(shot, slabs), _may_be_photons(electrons * maximum, drawing), drawing)
    choice.method[electrons <= 0] = NONE
    coarse = (choice.method == PHOTONS) & (snr * numbers.error.bins <= eps)
    return replace(choice, allowed=allowed, coarse=coarse)


def _may_be_photons(electrons: FloatArray, drawing: Drawing) -> BoolArray:
    """Whether electrons may be drawn one by one: at most PHOTONS_MAX, a convex PSF mixture, not noise-free."""
    return (electrons < PHOTONS_MAX) & drawing.psf.convex & (drawing.fidelity != "noise_free")


def _cheapest(scene: Scene, snr: FloatArray, cost: Costs, photons: BoolArray, drawing: Drawing) -> Choice:
    """Return the Choice of the cheapest accurate method: photons, where `photons` (n,) allows them, or stamps."""
    assert scene.reach is not None and scene.wing is not None  # select gives them
    # A wing takes over where a point's stamp ends
    shown = np.maximum(scene.reach, scene.wing)
    numbers = load_numbers()
    per_pixel = drawing.psf.oversampling
    errors = [predicted(m, scene, shown, snr, numbers.error, per_pixel) for m in ("photons", "stamp")]
    error = np.stack(errors, axis=1)
    allowed = np.stack(np.broadcast_arrays(photons, np.ones(len(scene), bool)), axis=1)
    smallest = np.where(allowed, error, np.inf).min(axis=1)
    eps = numbers.presets[cast("Fidelity", drawing.fidelity)].eps
    good = allowed & (error <= np.maximum(eps, _AS_GOOD * smallest)[:, None])
    best = np.where(good, np.stack([cost.photons, cost.stamp], axis=1), np.inf).argmin(axis=1)
    method = np.where(best == 0, PHOTONS, STAMP).astype(np.int8)
    return Choice(method, np.take_along_axis(error, best[:, None], 1)[:, 0], snr)


def noise(scene: Scene, electrons: FloatArray, variance: float, length: float = 0.0) -> FloatArray:
    """Return the noise of each object's own light and of the pixels it covers [electron], (n,); length: of a trace."""
    size2 = _PSF_HALF_LIGHT**2 + half_light_px2(scene)
    return np.sqrt(electrons + (_GAUSSIAN * size2 + length * np.sqrt(_GAUSSIAN * size2)) * variance)


def half_light_px2(scene: Scene) -> FloatArray:
    """Return the light-weighted mean of the squared circular half-light radii [pixel^2] of each object's components."""
    stretch2 = np.abs(np.linalg.det(scene.matrix))
    return (scene.component_fractions * scene.sersic[:, :, 2] ** 2).sum(axis=1) * stretch2


def costs(scene: Scene, electrons: FloatArray, cost: Cost) -> Costs:
    """Return the Costs of a Scene's objects; cost: render.settings.Cost."""
    assert scene.reach is not None and scene.wing is not None  # select gives them
    galaxy = scene.extended
    photons = cost.photon_object + electrons * np.where(galaxy, cost.photon_galaxy, cost.photon_star)
    pixels = (2.0 * scene.reach + 1) ** 2
    stamp = np.where(galaxy, cost.stamp_galaxy + cost.stamp_pixel * pixels, cost.stamp_star)
    if scene.spot is not None:
        stamp = stamp + cost.stamp_spots * (scene.spot >= 0)
    return Costs(photons, stamp + cost.wing_pixel * np.pi * np.minimum(scene.wing, WING_NEAR) ** 2)
