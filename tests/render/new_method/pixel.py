"""Pixel: for stars so faint that the shape of their image does not matter.

All electrons of a star are added to one pixel of the plane of expected electrons.
"""

import numpy as np
from pydantic import Field

from csstsim.base.model import Model
from csstsim.base.types import BoolArray, FloatArray
from csstsim.render.canvas import Canvas
from csstsim.render.method import Batch, ImagingMethod, Rendered, Targets
from csstsim.render.settings import load_cost


class Cost(Model):
    """CPU time [ns], from config/render.yaml."""

    pixel_object: float = Field(ge=0)


def allowed(targets: Targets) -> BoolArray:
    """Return (n,) bool: points."""
    return ~targets.scene.extended


def cost(targets: Targets) -> FloatArray:
    """Return (n,) CPU time [ns]: the same for every object."""
    return np.full(len(targets), load_cost(Cost).pixel_object)


def error(targets: Targets) -> FloatArray:
    """Return (n,) predicted errors: all of each object's S/N may be lost."""
    return targets.snr


def draw(canvas: Canvas, batch: Batch) -> Rendered:
    """Add the electrons of n objects to the pixels nearest to them."""
    scene = batch.scene
    window = canvas.window
    column = np.rint(scene.x).astype(int) - window.x0
    row = np.rint(scene.y).astype(int) - window.y0
    inside = (column >= 0) & (column < window.nx) & (row >= 0) & (row < window.ny)
    pixels = row[inside], column[inside]
    electrons = np.zeros(len(scene))
    electrons[inside] = scene.electrons.sum(axis=1)[inside] * canvas.response_array[pixels]
    assert canvas.expected is not None
    np.add.at(canvas.expected, pixels, electrons[inside])
    box = np.stack([column, column + 1, row, row + 1], axis=1) + canvas.corner
    return Rendered(electrons, np.where(inside[:, None], box, 0))


PIXEL = ImagingMethod(name="pixel", code=4, allowed=allowed, cost=cost, error=error, draw=draw)
