"""A satellite's trail (Kruk et al. 2023, Nature Astronomy 7, 262), through a random place of each window.

Focused at infinity, the mirror makes it a disc as wide as itself at the satellite. Left out: PSF, tumbling, gratings.
"""

import numpy as np
from pydantic import Field

from csstsim.layers.param import LayerParam

STAGE, UNITS, FRAME, EXPOSURES = "render", ("electron", "electron"), ("active", "active"), ("SCIE",)


class Param(LayerParam):
    """obs_param of `mylab.glint`: the satellite."""

    mag: float = Field(4.0, description="AB magnitude, did it stand still")
    speed: float = Field(0.5, gt=0, description="across the sky [deg/s]")
    distance: float = Field(600.0, gt=0, description="from the telescope [km]")


def apply(state, param, rng):
    """Add the trail's expected electrons to state.image, in place; electrons per pixel of its length to the header."""
    telescope, (y, x) = state.telescope, np.indices(state.image.shape, np.float32)
    x0, y0, angle = rng.exposure("path").uniform(0, (*state.window.shape[::-1], np.pi))
    radius = np.degrees(telescope.diameter_m / (2e3 * param.distance)) * 3600 / telescope.pixel_scale
    offset = ((x - x0) * np.sin(angle) - (y - y0) * np.cos(angle)) / radius
    rate = 10 ** (0.4 * (state.filter.zeropoint(telescope) - param.mag))
    state.header["trail"] = float(rate * telescope.pixel_scale / (3600 * param.speed))
    state.image += state.header["trail"] * 2 / (np.pi * radius) * np.sqrt(np.maximum(1 - offset**2, 0))
    return state
