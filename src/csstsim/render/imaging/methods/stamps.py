"""Stamps: for bright objects, and for all objects of an image without noise.

They are added to the plane of expected electrons with their wings and ghosts (render.imaging.stamps).
"""

import numpy as np
from pydantic import Field

from csstsim.base.model import Model
from csstsim.base.types import BoolArray, FloatArray
from csstsim.render.canvas import Canvas
from csstsim.render.imaging.stamps import draw_scene
from csstsim.render.method import Batch, ImagingMethod, Rendered, Targets
from csstsim.render.settings import load_cost

WING_NEAR = 192.0  # px: the cost of a wing further out is negligible (render.far_wings)


class Cost(Model):
    """CPU time [ns], from config/render.yaml."""

    stamp_star: float = Field(ge=0)
    stamp_galaxy: float = Field(ge=0)
    stamp_pixel: float = Field(ge=0, description="a pixel of a galaxy's stamp")
    stamp_spots: float = Field(ge=0, description="more for a stamp of knots or of an image")
    wing_pixel: float = Field(ge=0, description="a pixel of a wing")


def allowed(targets: Targets) -> BoolArray:
    """Return (n,) True: every object may be rendered on a stamp."""
    return np.ones(len(targets), bool)


def cost(targets: Targets) -> FloatArray:
    """Return (n,) CPU time [ns]: of each stamp and its pixels, and of the wing's pixels."""
    numbers = load_cost(Cost)
    scene = targets.scene
    pixels = (2.0 * targets.reach + 1) ** 2
    stamp = np.where(scene.extended, numbers.stamp_galaxy + numbers.stamp_pixel * pixels, numbers.stamp_star)
    if scene.spot is not None:
        stamp = stamp + numbers.stamp_spots * (scene.spot >= 0)
    return stamp + numbers.wing_pixel * np.pi * np.minimum(targets.wing, WING_NEAR) ** 2


def error(targets: Targets) -> FloatArray:
    """Return (n,) predicted errors: of the PSF, of a point's cut-off stamp and of a galaxy's transform."""
    return targets.stamp_error


def draw(canvas: Canvas, batch: Batch) -> Rendered:
    """Add the stamps of n objects to the plane of expected electrons."""
    drawing = batch.drawing
    drawn = draw_scene(canvas, batch.scene, drawing.mixer, drawing.scattered, drawing.wcs.chip)
    return Rendered(drawn.drawn, drawn.box, drawn.flags, drawn.ms)


STAMPS = ImagingMethod(name="stamp", code=3, allowed=allowed, cost=cost, error=error, draw=draw, stamps=True)
