"""Digitisation to 16 bits (paper, Appendix B item 15); the file itself is written by csstsim.io.level0.

DN are rounded to the nearest integer and clipped to 0..adc_max, never wrapped; the number of pixels clipped at either
end goes to the header. Left out: missing codes and differential non-linearity of the converter.
"""

from typing import Literal

from pydantic import Field

from csstsim.detector.adc import digitise
from csstsim.layers.param import LayerParam

STAGE = "level0"
UNITS = ("DN", "DN")
FRAME = ("readout", "readout")


class Param(LayerParam):
    """obs_param of `quantization_and_output`."""

    layout: Literal["channels", "mosaic"] = Field(
        "channels", description="arrangement on disk: 16 channels side by side, or the 2 x 8 mosaic as on the detector"
    )
    mask: bool = Field(
        False,
        description="a MASK extension beside IMAGE: which pixels are saturated, hit by cosmic rays, defective, ...",
    )
    compress: bool = Field(
        False,
        description="lossless tile compression (RICE, FITS 4.0 section 10) of the file's images: a third of the size",
    )
    sip: bool = Field(
        False, description="header: the assembled frame's WCS has the field distortion as SIP polynomials; else linear"
    )


def apply(state, param, rng):
    """Replace state.image by its digitised DN, uint16 (a new array of half the size).

    Raises ValueError if a value is not finite.
    """
    state.image, high, low = digitise(state.image, state.chip.detector.adc_max, state.mask)
    state.header |= {"clipped_high": high, "clipped_low": low, "layout": param.layout, "sip": param.sip,
        "compress": param.compress}  # fmt: skip
    return state
