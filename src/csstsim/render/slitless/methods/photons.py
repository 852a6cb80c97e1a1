"""Photons through a grating: for spectra whose electrons cost less than their pixels, which are all but the brightest.

They are drawn electron by electron into the counted plane (render.slitless.dispersed_photons).
"""

import numpy as np
from pydantic import Field

from csstsim.base.model import Model
from csstsim.base.types import BoolArray, FloatArray
from csstsim.render.canvas import Canvas
from csstsim.render.method import Rendered, SpectraBatch, SpectraMethod, Targets
from csstsim.render.photon_positions import COUNTED_MAX, may_be_counted
from csstsim.render.settings import load_cost, load_numbers
from csstsim.render.slitless.dispersed_photons import shoot_spectra


class Cost(Model):
    """CPU time [ns], from config/render.yaml."""

    spectrum_object: float = Field(ge=0)
    spectrum_star: float = Field(ge=0, description="an electron of a star, in any order")
    spectrum_galaxy: float = Field(ge=0, description="an electron of a galaxy, in any order")


def cost(targets: Targets) -> FloatArray:
    """Return (n,) CPU time [ns]: of each object and of each electron of all orders."""
    numbers = load_cost(Cost)
    disperser = targets.disperser
    assert disperser is not None
    orders = disperser.rates.sum(axis=(0, 1, 2)) / disperser.rates[:, disperser.orders.index(1)].sum()
    return numbers.spectrum_object + targets.maximum * orders * targets.electrons * np.where(
        targets.scene.extended, numbers.spectrum_galaxy, numbers.spectrum_star
    )


def error(targets: Targets) -> FloatArray:
    """Return (n,) predicted errors: of the PSF's density between its stored cells."""
    return targets.psf_error


def coarse(targets: Targets) -> BoolArray:
    """Return (n,) bool: spectra so faint that bins of a pixel are accurate enough."""
    return targets.snr * load_numbers().error.bins <= targets.preset.eps


def draw(canvas: Canvas, batch: SpectraBatch) -> Rendered:
    """Draw the electrons of the visits of n objects into the counted plane."""
    drawing = batch.drawing
    assert drawing.tables is not None  # the stage render gives them
    canvas.count()
    shot = shoot_spectra(canvas, batch.scene, batch.traces, batch.keys, drawing.tables, drawing.wing)
    return Rendered(shot.drawn, shot.box)


# The spectra of a chunk stay in cache
PHOTONS = SpectraMethod(
    name="photons",
    code=2,
    allowed=may_be_counted,
    cost=cost,
    error=error,
    draw=draw,
    chunk=512,
    coarse=coarse,
    electrons_max=COUNTED_MAX,
)
