"""Poisson noise and dark current (paper, Appendix B item 5).

The image becomes counted + Poisson(expected + dark rate x exposure time). Counted electrons, sampled one by one,
already have Poisson noise. Omitted: warm pixels (detector_defects) and dark gradients.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from csstsim.layers.param import EXPTIME, LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "active")


class Param(LayerParam):
    """obs_param of `poisson_and_dark`."""

    exptime: float | None = Field(None, ge=0, le=1e5, description=EXPTIME)


def apply(state: State, param: Param, rng: Streams) -> State:
    """Turn expected electrons into counted ones, in place; state.counted is merged and set to None.

    Raises ValueError if an expected value is negative or not finite.
    """
    from csstsim.detector.noise import add_poisson  # loads numba (0.5 s), which checking a campaign does not need

    dark = state.chip.detector.dark * state.exposure.exptime
    add_poisson(state.image, rng.exposure_key("shot"), dark=dark, counted=state.take_counted())
    state.header["dark_electrons"] = dark
    return state
