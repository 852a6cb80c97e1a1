"""Gain (paper, Appendix B item 14): electrons to DN.

Each channel (or the chip) has a gain [e-/DN] that is the same in all exposures, random and uniform within a fraction
`gain_spread` of the detector's `gain`. Omitted: drift of the gain with temperature.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from csstsim.detector.adc import channel_gains
from csstsim.detector.channels import ReadoutFrame
from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "DN")
FRAME = ("readout", "readout")


class Param(LayerParam):
    """obs_param of `gain`."""

    gain_16channel: bool = Field(True, description="true: one gain per readout channel; false: one for the chip")


def apply(state: State, param: Param, rng: Streams) -> State:
    """Divide the readout frame by the gains, in place; gains [e-/DN] of all channels go to the header."""
    gains = channel_gains(state.chip.detector, rng, per_channel=param.gain_16channel)
    for block in ReadoutFrame.of(state.chip.detector, state.window).blocks:
        state.image[block.whole] /= gains[block.channel - 1]
    state.unit = "DN"
    state.header["gain"] = gains
    return state
