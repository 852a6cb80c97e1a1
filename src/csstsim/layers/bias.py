"""Bias (paper, Appendix B item 12): a constant offset in electrons, added before the gain.

Each channel (or the chip) has an offset that is the same in all exposures, drawn uniformly within `bias_spread` of the
detector's `bias`. A laboratory map (instrument.maps) adds the structure within the channels. Omitted: drifts between
exposures, and structure without such a map.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from csstsim.detector.channels import ReadoutFrame
from csstsim.instrument.maps.lab_map import frame_of
from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.base.types import FloatArray
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("readout", "readout")
AFTER = ("nonlinearity",)


class Param(LayerParam):
    """obs_param of `bias`."""

    bias_16channel: bool = Field(True, description="true: one level per readout channel; false: one for the chip")


def apply(state: State, param: Param, rng: Streams) -> State:
    """Add the bias to every pixel of the readout frame, in place; the levels [e-] of all channels go to the header.

    Raises InputError for a map with a value that is not allowed.
    """
    detector = state.chip.detector
    frame = ReadoutFrame.of(detector, state.window)
    if param.bias_16channel:
        draws = [rng.channel(channel + 1, "bias") for channel in range(frame.n_channels)]
    else:
        draws = [rng.chip("bias")]
    levels = [detector.bias + detector.bias_spread * draw.uniform(-1.0, 1.0) for draw in draws]
    levels = levels if param.bias_16channel else levels * frame.n_channels
    for block in frame.blocks:
        state.image[block.whole] += levels[block.channel - 1]
    if state.chip.maps.bias:
        structure = frame_of(state.chip.maps.bias, frame)
        state.image += structure
        state.header["bias_structure"] = _largest_sum(structure, frame)
    state.header["bias"] = levels
    return state


def _largest_sum(structure: FloatArray, frame: ReadoutFrame) -> float:
    """Return the largest sum [electron] of a map's structure in a frame after subtraction of its channels' levels.

    The level is that of the serial overscan, or without it the one that the header states.
    """
    total = 0.0
    for block in frame.blocks:
        whole = structure[block.whole]
        scan = structure[block.serial_overscan]
        levels = [0.0, float(np.median(scan))] if scan.size else [0.0]
        total += max(
            abs(float(part.sum(dtype=float)) - part.size * level)
            for part in (whole, structure[block.active])
            for level in levels
        )
    return total
