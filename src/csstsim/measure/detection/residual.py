"""What is left of a frame after the models of its sources are subtracted, in units of its noise.

Sources too faint for one frame are found in the sum of what is left of all (measure.bricks.joint). Eight bits a pixel
are enough: a step of 0.25 of the noise adds 0.3% to it.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.measure.detection.maps import BIN

STEP = 0.25  # noise of a pixel
BLANK = 0  # no value
ZERO = 128
HIDDEN = 1.0  # noise: a source whose model is brighter hides what is behind it, and its model's errors are seen
NOISY = 1.25
MESH = 32  # px between the values of the noise


class Residual(NamedTuple):
    """What is left of a frame.

    `steps` uint8 (ny, nx): ZERO + (image - models) / noise / STEP, BLANK where it is not known; `noise` float32,
    electrons, at every MESH-th pixel.
    """

    steps: IntArray
    noise: FloatArray


def residual(image: FloatArray, left: FloatArray, rms: FloatArray, unusable: IntArray) -> Residual:
    """Return the Residual of an image and of what is `left` of it without the models; arrays (ny, nx).

    rms: noise of a pixel, on bins of BIN px; unusable: 0 for good pixels. Pixels with NOISY times the usual noise are
    not known: around bright stars, errors of the model are part of the noise, and they are the same in all exposures of
    a position angle.
    """
    noise = rms[:: MESH // BIN, :: MESH // BIN].astype(np.float32)
    return Residual(_steps(image, left, rms, unusable, NOISY * float(np.median(noise))), noise)


@numba.njit(cache=True)
def _steps(image: FloatArray, left: FloatArray, rms: FloatArray, unusable: IntArray, noisiest: float) -> IntArray:
    out = np.full(image.shape, BLANK, np.uint8)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            noise = rms[y // BIN, x // BIN]
            if unusable[y, x] or not 0.0 < noise < noisiest or not abs(image[y, x] - left[y, x]) < HIDDEN * noise:
                continue
            value = left[y, x] / (STEP * noise)
            if abs(value) < ZERO - 1:
                out[y, x] = ZERO + round(value)
    return out


@numba.njit(cache=True)
def values(steps: IntArray) -> FloatArray:
    """Return float32: `steps` of a Residual in units of the noise, 0 where they are not known."""
    out = np.zeros(steps.shape, np.float32)
    for y in range(steps.shape[0]):
        for x in range(steps.shape[1]):
            if steps[y, x] != BLANK:
                out[y, x] = STEP * (int(steps[y, x]) - ZERO)
    return out
