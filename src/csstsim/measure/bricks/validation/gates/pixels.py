"""Background, noise and bias of an exposure's pixels, and its depth."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from csstsim.measure.bricks.validation.gates.record import SIGMAS_OF_MANY, AtMost, Measured

if TYPE_CHECKING:
    from csstsim.measure.bricks.validation.gates.data import FrameData


def _depth(data: FrameData) -> list[Measured]:
    if data.frame.depth is None:
        return []
    depth = data.frame.info["depth_5sigma"]
    return [Measured(float(depth - np.clip(depth, *data.frame.depth)))]


def _off(data: FrameData, name: str) -> list[Measured]:
    """Measure the deviation of every channel, and of the whole frame."""
    return [Measured(one.value, None, one.sigma, one.channel) for one in data.pixels.get(name, ())]


GATES = (
    AtMost(
        "depth beyond the published limits [mag]",
        scope="frame",
        threshold="depth_off_max",
        unit="mag",
        tests="5 sigma depth for a point source (sky and read noise in the PSF's area), outside the range of two "
        "limits of the filter: that of the official simulator (config/instrument/filters.yaml), and one computed from "
        "its throughput (config/limits.yaml); positive: deeper than both, negative: shallower",
        measure=_depth,
    ),
    AtMost(
        "background over sky and dark, less 1",
        scope="frame",
        threshold="level_off_max",
        tests="level of the background, of the frame and of each channel, divided by the camera's sky and dark current",
        measure=partial(_off, name="level"),
        sigmas=SIGMAS_OF_MANY,
    ),
    AtMost(
        "background of a channel over that of all, less 1",
        scope="frame",
        threshold="uneven_max",
        tests="the same, of each channel minus that of all, and the difference between the halves of a frame: a wrong "
        "gain of some pixels shows",
        measure=partial(_off, name="uneven"),
        sigmas=SIGMAS_OF_MANY,
    ),
    AtMost(
        "noise over that of sky, dark and readout, less 1",
        scope="frame",
        threshold="noise_off_max",
        tests="noise of the background, of the frame and of each channel, divided by `sqrt(sky + dark + read noise^2 + "
        "gain^2 / 12)`",
        measure=partial(_off, name="noise"),
        sigmas=SIGMAS_OF_MANY,
    ),
    AtMost(
        "read noise of the overscan over the camera's, less 1",
        scope="frame",
        threshold="read_noise_max",
        tests="read noise of each channel's overscan, with rounding, divided by the camera's",
        measure=partial(_off, name="read_noise"),
        sigmas=SIGMAS_OF_MANY,
    ),
    AtMost(
        "bias of the overscan less the header's [DN]",
        scope="frame",
        threshold="bias_max",
        unit="DN",
        tests="bias of each channel's overscan: DETBIAnn is the offset in electrons divided by the gain, so a wrong "
        "gain shows",
        measure=partial(_off, name="bias"),
        sigmas=SIGMAS_OF_MANY,
    ),
)
