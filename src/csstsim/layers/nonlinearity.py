"""Charge-to-voltage nonlinearity (paper, Appendix B item 8): a third-order polynomial of the charge.

It acts on the active pixels (the paper's order) or on the readout frame (the default, because charge is transferred
before it reaches the amplifier). Above the full well the polynomial is continued by a straight line. There is one
polynomial for the chip, or one for each channel, scaled by a factor within the detector's `nonlinearity_spread` of 1.
Omitted: memory of the amplifier.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from csstsim.base.errors import InputError
from csstsim.detector.channels import ReadoutFrame
from csstsim.detector.cubic import smallest_slope
from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from typing import Any

    from csstsim.base.rng import Streams
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "electron")
AFTER = ("poisson_and_dark",)


class Param(LayerParam):
    """obs_param of `nonlinearity`."""

    nonlinearity_16channel: bool = Field(
        False, description="true: one polynomial per readout channel; false: one for the chip"
    )


def check(param: Param, camera: Camera, pointing: Pointing) -> None:
    """Raise InputError if the signal [e-] might not increase up to the full well in some channel."""
    detector = camera.detector
    spread = detector.nonlinearity_spread if param.nonlinearity_16channel else 0.0
    for scale in (1 - spread, 1 + spread):
        pair = scale * detector.nonlinearity_quadratic, scale * detector.nonlinearity_cubic
        if not smallest_slope(*pair, detector.full_well) > 0:
            raise InputError(
                f"the signal falls with charge within 0..{detector.full_well:g} e-",
                key="nonlinearity",
                value=pair,
                allowed="quadratic, cubic with 1 + 2 quadratic x + 3 cubic x^2 > 0 over that range",
            )


def apply(state: State, param: Param, rng: Streams) -> State:
    """Replace charge by signal in state.image, in place; coefficients of all channels go to the header.

    Raises ValueError if a pixel is not finite or the signal does not increase up to the full well.
    """
    from csstsim.detector.nonlinearity import (
        apply_nonlinearity,
    )  # loads numba (0.5 s), which checking a campaign does not need

    detector = state.chip.detector
    frame = ReadoutFrame.of(detector, state.window)
    scales = [1.0] * frame.n_channels
    if param.nonlinearity_16channel:
        draws = [rng.channel(i + 1, "nonlinearity") for i in range(frame.n_channels)]
        scales = [1 + detector.nonlinearity_spread * draw.uniform(-1.0, 1.0) for draw in draws]
    pairs = [[scale * detector.nonlinearity_quadratic, scale * detector.nonlinearity_cubic] for scale in scales]
    active = state.image.shape == state.window.shape
    parts: dict[int, Any] = {block.channel: block.image if active else block.whole for block in frame.blocks}
    if not param.nonlinearity_16channel:  # in one pass
        parts = {1: np.s_[:]}
    for channel, part in parts.items():
        quadratic, cubic = pairs[channel - 1]
        apply_nonlinearity(state.image[part], quadratic, cubic, detector.full_well)
    state.header["nonlinearity_quadratic"], state.header["nonlinearity_cubic"] = map(list, zip(*pairs, strict=True))
    return state
