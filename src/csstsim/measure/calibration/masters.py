"""Master calibration frames of a chip, from its bias, dark and lamp exposures, as in a real pipeline.

flat    response of each pixel, 1 on average: the mean of the lamps' exposures, divided by its own large scales (medians
        of BOX px, bilinear between). The lamps illuminate differently from the sky, so they cannot give larger scales.
bad     pixels with outlying dark charge (hot) or an outlying flat (dead pixels, bad columns)
dark    mean charge of a good pixel of the chip [e-/s]

Exposures are averaged pixel by pixel, without values that a cosmic ray raised. A channel's bias level is that of its
overscan in each exposure; the bias exposures give the remaining offset.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numba
import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.types import BoolArray, FloatArray
from csstsim.measure.detection.maps import interpolated

if TYPE_CHECKING:
    from csstsim.detector.channels import ReadoutFrame
    from csstsim.measure.calibration.calibrate import Calibrated

BOX = 64  # px
RAY_SIGMA = 5.0  # above the median of the exposures
HOT_SIGMA = 5.0  # of a pixel's dark charge
ODD = 0.1  # of a flat's level: pixels further off are bad (PRNU: 0.01 rms)
FAINTEST = 100.0  # e-


@dataclass(frozen=True)
class Masters:
    """flat (ny, nx) float32; bad (ny, nx) bool; dark [e-/s]; offset {channel: e-}, the remaining bias."""

    flat: FloatArray
    bad: BoolArray
    dark: float
    offset: dict[int, float]


def make_masters(exposures: Mapping[str, Iterable[Calibrated]], exptime: float) -> Masters:
    """Return the Masters of a chip.

    exposures: {"BIAS", "DARK", "FLAT": iterable of calibrate.Calibrated}, all their pixels; exptime: s, of the dark
    exposures. Raises InputError for lamps that are too faint on the chip.
    """
    level, _, readout = _mean("BIAS", exposures)
    offset = {block.channel: float(np.median(level[block.image])) for block in readout.blocks}
    level, noise, _ = _mean("DARK", exposures)
    bad, rate = _hot(level, noise)
    lit, _, _ = _mean("FLAT", exposures)
    large = _large_scales(lit)
    if not large.min() > FAINTEST:
        raise InputError(
            "the lamps are too faint on this chip", key="FLAT", value=float(large.min()), allowed=f"> {FAINTEST} e-"
        )
    lit /= large
    bad |= np.abs(lit - 1) > ODD
    lit[bad] = 1.0
    return Masters(lit, bad, rate / exptime, offset)


def _mean(kind: str, exposures: Mapping[str, Iterable[Calibrated]]) -> tuple[FloatArray, float, ReadoutFrame]:
    """Return (mean (ny, nx) float32 of exposures of a kind without cosmic rays, read noise of one, readout)."""
    images: list[FloatArray] = []
    noise: list[float] = []
    for frame in exposures[kind]:
        images.append(frame.electrons)
        noise += frame.read_noise.values()
        readout = frame.readout
    mean = float(np.mean(noise))
    return _average(tuple(images), np.float32(mean)), mean, readout


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
            middle = values[(len(values) - 1) // 2]  # the lower one of two: rays only add
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
    """Return (outlying pixels, mean charge of the others)."""
    middle = float(np.median(charge))
    bad = charge > middle + HOT_SIGMA * np.sqrt(max(middle, 0.0) + read_noise**2)
    return bad, float(charge[~bad].mean(dtype=float))


def _large_scales(image: FloatArray) -> FloatArray:
    """Return the medians of boxes of an image, bilinear between their middles."""
    edges = [np.linspace(0, n, max(1, round(n / BOX)) + 1).astype(int) for n in image.shape]
    rows, columns = edges
    mesh = np.array([[np.median(image[a:b, c:d]) for c, d in pairwise(columns)] for a, b in pairwise(rows)])
    return interpolated(mesh, [0.5 * (e[1:] + e[:-1] - 1) for e in edges], image.shape)
