"""Figures of each readout channel from a frame's pixels: bias, read noise, level and noise of the background.

They include the response (fraction of light that was counted): division of the image by it raised noise and dark
current.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.types import FloatArray
from csstsim.measure.detection.maps import BIN

if TYPE_CHECKING:
    from csstsim.detector.channels import ReadoutFrame
    from csstsim.measure.calibration.calibrate import Calibrated

SAMPLE = 8  # every eighth pixel each way: medians of maps that vary over hundreds of pixels


def block_means(image: FloatArray, readout: ReadoutFrame | None) -> dict[int, float]:
    """Return {channel: mean} of a sample of an image (ny, nx) in each channel; empty without a readout.

    The difference between the means of two images that differ by a smooth map is the mean of that map, without noise.
    """
    blocks = readout.blocks if readout is not None else ()
    sample = np.s_[::SAMPLE, ::SAMPLE]
    return {block.channel: float(image[block.image][sample].mean(dtype=np.float64)) for block in blocks}


def channel_figures(
    calibrated: Calibrated, before: Mapping[int, float], image: FloatArray, rms: FloatArray
) -> list[dict[str, Any]]:
    """Return a list of {channel, window, bias [DN], read_noise, level, noise [e-], response, overscan}, JSON-like.

    calibrated: calibrate.Calibrated; before: `block_means` before the background was subtracted, so that level
    is the mean of what was subtracted; image: (ny, nx) without background; rms: its noise, on bins of BIN px. level and
    noise refer to light before flat field and shutter.
    """
    if calibrated.readout is None:
        return []
    after = block_means(image, calibrated.readout)
    out = []
    x0, _, y0, _ = calibrated.readout.window
    for block in calibrated.readout.blocks:
        rows, columns = block.image
        overscan_rows, overscan_columns = block.serial_overscan
        overscan_height = overscan_rows.stop - overscan_rows.start
        overscan_width = overscan_columns.stop - overscan_columns.start
        part = slice(rows.start, rows.stop, SAMPLE), slice(columns.start, columns.stop, SAMPLE)
        row, column = np.mgrid[part].reshape(2, -1)
        fraction = 1.0 if calibrated.response is None else float(np.median(calibrated.response.at(row, column)))
        n = block.channel
        out.append(
            {
                "channel": int(n),
                "window": [x0 + columns.start, x0 + columns.stop, y0 + rows.start, y0 + rows.stop],
                "bias": calibrated.bias[n],
                "read_noise": calibrated.read_noise[n],
                "level": before[n] - after[n],
                "noise": float(np.median(rms[row // BIN, column // BIN])),
                "response": fraction,
                "overscan": overscan_height * overscan_width,
            }
        )
    return out
