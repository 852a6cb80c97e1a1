"""Photons: for objects whose electrons cost less than their pixels, which are all but the brightest.

They are drawn electron by electron into the counted plane, with their Poisson noise (render.imaging.photons).
"""

import numpy as np
from pydantic import Field

from csstsim.base.model import Model
from csstsim.base.types import BoolArray, FloatArray
from csstsim.render.canvas import Canvas
from csstsim.render.imaging.photons import shoot_scene
from csstsim.render.method import Batch, ImagingMethod, Rendered, Targets
from csstsim.render.photon_positions import may_be_counted
from csstsim.render.settings import load_cost


class Cost(Model):
    """CPU time [ns], from config/render.yaml."""

    photon_object: float = Field(ge=0)
    photon_star: float = Field(ge=0, description="an electron of a star")
    photon_galaxy: float = Field(ge=0, description="an electron of a galaxy")


def allowed(targets: Targets) -> BoolArray:
    """Return (n,) bool: objects whose electrons may be counted and that have no visible ghosts."""
    counted = may_be_counted(targets)
    ghosts = targets.drawing.ghosts
    return counted if ghosts is None else counted & ~np.asarray(ghosts.visible(targets.electrons))


def cost(targets: Targets) -> FloatArray:
    """Return (n,) CPU time [ns]: of each object and of each electron."""
    numbers = load_cost(Cost)
    electrons = targets.electrons * targets.maximum
    return numbers.photon_object + electrons * np.where(
        targets.scene.extended, numbers.photon_galaxy, numbers.photon_star
    )


def error(targets: Targets) -> FloatArray:
    """Return (n,) predicted errors: of the PSF's density between its stored cells."""
    return targets.psf_error


def draw(canvas: Canvas, batch: Batch) -> Rendered:
    """Draw the electrons of n objects into the counted plane."""
    drawing = batch.drawing
    assert drawing.tables is not None  # the stage render gives them
    canvas.count()
    shot = shoot_scene(canvas, batch.scene, batch.keys, drawing.tables, drawing.wing)
    return Rendered(shot.on_window, shot.box)


PHOTONS = ImagingMethod(name="photons", code=2, allowed=allowed, cost=cost, error=error, draw=draw)
