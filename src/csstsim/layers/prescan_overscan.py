"""Prescan and overscan sections (paper, Appendix B item 11).

The active pixels of the window are put into the readout frame of csstsim.detector.channels. The added pixels have no
charge, except for charge trailed into the overscan by charge transfer inefficiency.
Omitted: charge generated in the registers (dark current, clock-induced charge).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.detector.channels import ReadoutFrame
from csstsim.detector.embedding import embedded
from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "readout")
AFTER = ("poisson_and_dark",)


class Param(LayerParam):
    """obs_param of `prescan_overscan`: none."""


def apply(state: State, param: Param, rng: Streams) -> State:
    """Replace state.image, and state.mask, by their readout frames, in the same memory if nothing else refers to it.

    Raises ValueError if counted electrons were not merged by poisson_and_dark.
    """
    if state.counted is not None:
        raise ValueError("counted electrons were not merged: poisson_and_dark must come before prescan_overscan")
    frame = ReadoutFrame.of(state.chip.detector, state.window)
    planes, state.image = [state.image], None  # type: ignore[assignment]  # until the next line
    state.image = embedded(planes, frame)
    if state.mask is not None:
        planes = [state.mask]
        state.mask = None
        state.mask = embedded(planes, frame)
    if state.trailed is not None:
        state.trailed.write_into(state.image, frame)
        state.trailed = None
    return state
