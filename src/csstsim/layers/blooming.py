"""Pixel saturation and bleeding (paper, Appendix B item 9): charge above the full well spills along columns and rows.

Half of the excess spills in each direction, to the nearest pixels below the full well, also across the middle of the
chip. Electrons that reach the window's border leave it and are counted (csstsim.detector.blooming). Omitted:
differences between wells.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
AFTER = ("poisson_and_dark",)


class Param(LayerParam):
    """obs_param of `blooming`."""

    row_share: float | None = Field(
        None, ge=0, le=1, description="fraction of each excess that spills along its row; null = the detector's"
    )


def apply(state: State, param: Param, rng: Streams) -> State:
    """Spill the excess charge of state.image, in place, and set bits of state.mask.

    The numbers of saturated pixels and of electrons that left go to the header.

    Raises ValueError if counted electrons were not merged or a pixel is not finite.
    """
    from csstsim.detector.blooming import bloom  # loads numba (0.5 s), which checking a campaign does not need

    if state.counted is not None:
        raise ValueError("counted electrons were not merged: poisson_and_dark must come before blooming")
    detector = state.chip.detector
    row_fraction = detector.bloom_row_share if param.row_share is None else param.row_share
    number, lost = bloom(state.image, detector.full_well, row_fraction, state.mask)
    state.header |= {"saturated": number, "bloom_lost": lost}
    return state
