"""Digitisation to 16 bits (paper, Appendix B item 15); the file itself is written by csstsim.io.level0.

DN are rounded to the nearest integer and clipped to 0..adc_max, never wrapped; the number of pixels clipped at either
end goes to the header. Layout `chip`, the assembled frame of older mocks, has one gain: channels are scaled to their
mean gain before they are rounded, as if all amplifiers were equal. Omitted: missing codes and differential
non-linearity of the converter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import Field

from csstsim.detector.adc import digitise
from csstsim.detector.channels import ReadoutFrame
from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.simulation.state import State

STAGE = "level0"
UNITS = ("DN", "DN")
FRAME = ("readout", "readout")


class Param(LayerParam):
    """obs_param of `quantization_and_output`."""

    layout: Literal["channels", "mosaic", "chip"] = Field(
        "channels",
        description="arrangement on disk: 16 channels side by side; the 2 x 8 mosaic as on the detector; or "
        "'chip', its active pixels alone, with one gain",
    )
    mask: bool = Field(
        False,
        description="a MASK extension next to IMAGE: which pixels are saturated, hit by cosmic rays, defective, ...",
    )
    compress: bool = Field(
        False,
        description="lossless tile compression (RICE, FITS 4.0 section 10) of the file's images: a third of the size",
    )
    sip: bool = Field(
        False, description="header: the assembled frame's WCS has the field distortion as SIP polynomials; else linear"
    )


def apply(state: State, param: Param, rng: Streams) -> State:
    """Replace state.image by its digitised DN, uint16 (a new array of half the size).

    Raises ValueError if a value is not finite.
    """
    if param.layout == "chip":
        _scale_to_mean_gain(state)
    state.image, high, low = digitise(state.image, state.chip.detector.adc_max, state.mask)
    state.header |= {
        "clipped_high": high,
        "clipped_low": low,
        "layout": param.layout,
        "sip": param.sip,
        "compress": param.compress,
    }
    return state


def _scale_to_mean_gain(state: State) -> None:
    """Scale the channels to their mean gain, in place; the header then has it for each, and once for the chip."""
    gains = state.header.get("gain")
    if gains is not None:
        mean = float(np.mean(gains))
        for block in ReadoutFrame.of(state.chip.detector, state.window).blocks:
            state.image[block.whole] *= np.float32(gains[block.channel - 1] / mean)
        state.header |= {"gain": [mean] * len(gains), "one_gain": mean}
    if (noise := state.header.get("read_noise")) is not None:
        state.header["one_read_noise"] = float(np.sqrt(np.mean(np.square(noise))))
