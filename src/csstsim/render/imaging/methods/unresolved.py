"""Unresolved: for objects below the S/N floor of the preset, whose electrons become a smooth background.

They are added to the plane of expected electrons, spread over a mesh (render.imaging.unresolved).
"""

from dataclasses import replace

import numpy as np

from csstsim.base.types import BoolArray, FloatArray
from csstsim.catalog.flags import SKIPPED_FAINT
from csstsim.optics.psf.psf_file import PsfSet
from csstsim.render.canvas import Canvas
from csstsim.render.error_model import half_light_px2
from csstsim.render.imaging.methods import photons
from csstsim.render.imaging.unresolved import MESH, add_unresolved
from csstsim.render.method import Batch, ImagingMethod, Rendered, Targets
from csstsim.render.scene import Scene


def allowed(targets: Targets) -> BoolArray:
    """Return (n,) bool: objects below the floor that are smaller than the mesh.

    The mesh would make a larger object smaller, and so visible.
    """
    return (targets.snr < targets.preset.floor) & (half_light_px2(targets.scene) < (MESH / 2) ** 2)


def error(targets: Targets) -> FloatArray:
    """Return (n,) predicted errors: all of each object's S/N is lost."""
    return targets.snr


def draw(canvas: Canvas, batch: Batch) -> Rendered:
    """Spread the electrons of n objects over the plane of expected electrons."""
    drawing = batch.drawing
    scene = batch.scene if drawing.wing is not None else _inside_box(batch.scene, drawing.psf)
    electrons, box = add_unresolved(canvas, scene)
    return Rendered(electrons, box, SKIPPED_FAINT)


def _inside_box(scene: Scene, psf: PsfSet) -> Scene:
    """Return the Scene with only the electrons that fall within the PSF's box."""
    inside = np.einsum("nk,nkb->nb", scene.weight, np.where(scene.weight[..., None] > 0, psf.flux[scene.node], 0.0))
    return replace(scene, electrons=scene.electrons * inside)


# The cost decides only how the measured time is divided among the objects
UNRESOLVED = ImagingMethod(
    name="unresolved", code=1, allowed=allowed, cost=photons.cost, error=error, draw=draw, preferred=True
)
