"""Readout noise (paper, Appendix B item 13): Gaussian, independent in every pixel, prescan and overscan included.

Omitted: correlated noise, 1/f drifts and differences between channels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("readout", "readout")


class Param(LayerParam):
    """obs_param of `readout_noise`: none; the level is that of the detector."""


def apply(state: State, param: Param, rng: Streams) -> State:
    """Add the noise to state.image, in place; the level [e-] of each channel goes to the header."""
    from csstsim.detector.noise import add_gaussian  # loads numba (0.5 s), which checking a campaign does not need

    detector = state.chip.detector
    add_gaussian(state.image, detector.read_noise, rng.exposure_key("read"))
    state.header["read_noise"] = [detector.read_noise] * (detector.channels_x * detector.channels_y)
    return state
