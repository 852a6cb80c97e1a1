"""Slabs: for bright spectra, and for all spectra of an image without noise.

They are added to the plane of expected electrons, a sum of monochromatic stamps along the trace
(render.slitless.slabs).
"""

import numpy as np
from pydantic import Field

from csstsim.base.model import Model
from csstsim.base.types import BoolArray, FloatArray
from csstsim.render.canvas import Canvas
from csstsim.render.method import Rendered, SpectraBatch, SpectraMethod, Targets
from csstsim.render.settings import load_cost
from csstsim.render.slitless.line_wings import LINE_NEAR, LINE_STEP
from csstsim.render.slitless.slab_counts import fewest
from csstsim.render.slitless.slabs import densities, draw_spectra

_USUAL = 0.01  # roughness of a spectrum (render.slitless.slab_counts)


class Cost(Model):
    """CPU time [ns], from config/render.yaml."""

    slabs_star: float = Field(ge=0, description="an object, in all orders")
    slabs_galaxy: float = Field(ge=0, description="more for a galaxy, for each slab to a pixel")
    slab_pixel: float = Field(ge=0, description="a pixel of the stamp, for each slab")
    wing_pixel: float = Field(ge=0, description="a pixel of a wing")


def allowed(targets: Targets) -> BoolArray:
    """Return (n,) True: every spectrum may be rendered as slabs."""
    return np.ones(len(targets), bool)


def cost(targets: Targets) -> FloatArray:
    """Return (n,) CPU time [ns]: of each object, of the pixels of its slabs, and of the wing's pixels."""
    numbers = load_cost(Cost)
    scene = targets.scene
    assert targets.disperser is not None
    length = targets.disperser.length
    count = densities(scene, fewest(_USUAL, targets.allowed_error))
    slab = numbers.slab_pixel * length * (2.0 * targets.reach + 1) ** 2
    slab += np.where(scene.extended, numbers.slabs_galaxy, 0.0)
    wing = numbers.wing_pixel * np.pi * np.minimum(targets.wing, LINE_NEAR) ** 2 * length / LINE_STEP
    return numbers.slabs_star + count * slab + wing


def error(targets: Targets) -> FloatArray:
    """Return (n,) predicted errors: those of the stamps. The slabs are as many as keep their own error below it."""
    return targets.stamp_error


def draw(canvas: Canvas, batch: SpectraBatch) -> Rendered:
    """Add the slabs of the visits of n objects to the plane of expected electrons."""
    drawing = batch.drawing
    drawn = draw_spectra(canvas, batch.scene, batch.traces, drawing.mixer, drawing.scattered, allowed=batch.allowed)
    return Rendered(drawn.drawn, drawn.box, drawn.flags, drawn.ms)


# Chunks are large, because each takes one pass over the chip for far wings
SLABS = SpectraMethod(name="slabs", code=3, allowed=allowed, cost=cost, error=error, draw=draw, stamps=True, chunk=2048)
