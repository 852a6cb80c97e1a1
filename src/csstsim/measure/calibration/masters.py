"""Master calibration frames of a chip, from its bias, dark and lamp exposures, as in a real pipeline.

flat    response of each pixel, 1 on average: the mean of the lamp exposures, divided by its large scales (medians of
        BOX px, bilinear between). The lamps illuminate differently from the sky, so they cannot give larger scales.
bad     pixels with outlying dark charge (hot) or an outlying flat (dead pixels, bad columns)
dark    mean charge of a good pixel of the chip [e-/s]

Exposures are averaged pixel by pixel, without values that a cosmic ray raised. A channel's bias level is that of its
overscan in each exposure; the bias exposures give the remaining offset.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.types import BoolArray, FloatArray
from csstsim.measure.detection.maps import interpolated

if TYPE_CHECKING:
    from csstsim.detector.channels import ReadoutFrame
    from csstsim.measure.calibration.calibrate import Calibrated

BOX = 64  # px
RAY_SIGMA = 5.0  # above the median of the exposures: a value with a cosmic ray
HOT_SIGMA = 5.0  # of a pixel's dark charge, above the median: a hot pixel
FLAT_DEVIATION_MAX = 0.1  # of the flat from 1: pixels that deviate more are bad (PRNU: 0.01 rms)
FLAT_LEVEL_MIN = 100.0  # e-, of lamp exposures


@dataclass(frozen=True)
class Masters:
    """flat (ny, nx) float32; bad (ny, nx) bool; dark [e-/s]; offset {channel: e-}, the remaining bias."""

    flat: FloatArray
    bad: BoolArray
    dark: float
    offset: dict[int, float]


class _MeanExposure(NamedTuple):
    """Mean of exposures of one type: image (ny, nx) float32 [e-], read noise of one exposure [e-], its readout."""

    image: FloatArray
    read_noise: float
    readout: ReadoutFrame


def make_masters(exposures: Mapping[str, Iterable[Calibrated]], exptime: float) -> Masters:
    """Return the Masters of a chip.

    exposures: {"BIAS", "DARK", "FLAT": iterable of calibrate.Calibrated}, all their pixels; exptime: s, of the dark
    exposures. Raises InputError for lamps that are too faint on the chip.
    """
    bias = _mean_exposure(exposures["BIAS"])
    offset = {block.channel: float(np.median(bias.image[block.image])) for block in bias.readout.blocks}
    del bias
    dark = _mean_exposure(exposures["DARK"])
    bad, mean_charge = _hot(dark.image, dark.read_noise)
    del dark
    flat = _mean_exposure(exposures["FLAT"]).image
    large_scales = _large_scales(flat)
    level = float(large_scales.min())
    if not level > FLAT_LEVEL_MIN:
        raise InputError(
            "the lamps are too faint on this chip", key="FLAT", value=level, allowed=f"> {FLAT_LEVEL_MIN} e-"
        )
    flat /= large_scales
    bad |= np.abs(flat - 1) > FLAT_DEVIATION_MAX
    flat[bad] = 1.0
    return Masters(flat, bad, mean_charge / exptime, offset)


def _mean_exposure(exposures: Iterable[Calibrated]) -> _MeanExposure:
    """Return the _MeanExposure of exposures of one type, without values that a cosmic ray raised."""
    images: list[FloatArray] = []
    read_noise: list[float] = []
    for frame in exposures:
        images.append(frame.electrons)
        read_noise += frame.read_noise.values()
        readout = frame.readout
    noise = float(np.mean(read_noise))
    return _MeanExposure(_average(tuple(images), np.float32(noise)), noise, readout)


@numba.njit(cache=True)
def _average(images: tuple[FloatArray, ...], read_noise: np.float32) -> FloatArray:
    """Return the mean of a tuple of images, without values more than RAY_SIGMA above their median."""
    ny, nx = images[0].shape
    out = np.empty((ny, nx), np.float32)
    values = np.empty(len(images), np.float32)
    for y in range(ny):
        for x in range(nx):
            for k in range(len(images)):
                values[k] = images[k][y, x]
            values.sort()
            middle = values[(len(values) - 1) // 2]  # the lower of two middle values: rays only add charge
            limit = middle + RAY_SIGMA * np.sqrt(max(middle, np.float32(0)) + read_noise**2)
            total = 0.0
            count = 0
            for value in values:
                if value <= limit:
                    total += value  # type: ignore[assignment]  # a float64 to numba
                    count += 1
            out[y, x] = total / count
    return out


def _hot(charge: FloatArray, read_noise: float) -> tuple[BoolArray, float]:
    """Return (mask of pixels with outlying charge, mean charge of the others [e-])."""
    middle = float(np.median(charge))
    bad = charge > middle + HOT_SIGMA * np.sqrt(max(middle, 0.0) + read_noise**2)
    return bad, float(charge[~bad].mean(dtype=float))


def _large_scales(image: FloatArray) -> FloatArray:
    """Return the large scales of an image: the medians of boxes, bilinear between their middles."""
    edges = [np.linspace(0, n, max(1, round(n / BOX)) + 1).astype(int) for n in image.shape]
    rows, columns = edges
    mesh = np.array([[np.median(image[a:b, c:d]) for c, d in pairwise(columns)] for a, b in pairwise(rows)])
    return interpolated(mesh, [0.5 * (e[1:] + e[:-1] - 1) for e in edges], image.shape)
