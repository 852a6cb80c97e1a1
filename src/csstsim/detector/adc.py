"""Electrons to DN: the channels' gains, and the analogue-digital converter (paper, Appendix B items 14 and 15)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.types import FloatArray, IntArray
from csstsim.detector.mask import CLIPPED

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.instrument.chip import Detector

CLIPPED_MAX = 1e-3  # maximum fraction of pixels at 0 DN that rounding and rare noise explain
FULL_MAX = 0.2  # maximum fraction at adc_max that bright stars explain
_ROWS = 16


class Digitised(NamedTuple):
    """A digitised image, (ny, nx) uint16 [DN], and how many of its pixels were clipped."""

    image: IntArray
    high: int  # clipped at adc_max
    low: int  # clipped at 0


def digitise(image: FloatArray, adc_max: int = 65535, mask: IntArray | None = None) -> Digitised:
    """Return the Digitised image of float32 DN.

    Values are rounded to nearest (ties to even) and clipped to 0..adc_max. `mask`: uint8 of the image's shape, in which
    CLIPPED is set where a value is clipped, or None. Raises ValueError if a value is not finite.
    """
    if not 0 < adc_max <= 65535:
        raise ValueError(f"adc_max = {adc_max} does not fit 16 bits")
    dn = np.empty(image.shape, np.uint16)
    high = low = bad = 0
    for start in range(0, image.shape[0], _ROWS):
        rows = slice(start, start + _ROWS)
        value = np.rint(image[rows])
        if value.min() >= 0 and value.max() <= adc_max:  # both are false if there is a NaN
            dn[rows] = value
            continue
        bad += value.size - int(np.count_nonzero(np.isfinite(value)))
        above = value > adc_max
        below = value < 0
        high += int(np.count_nonzero(above))
        low += int(np.count_nonzero(below))
        if mask is not None:
            mask[rows][above | below] |= CLIPPED
        if not bad:
            dn[rows] = np.clip(value, 0, adc_max, out=value)
    if bad:
        raise ValueError(f"{bad} pixel(s) to digitise are not finite")
    return Digitised(dn, high, low)


def clipping_fault(clipped: int, pixels: int) -> str:
    """Return a message if more than CLIPPED_MAX of a frame's pixels were clipped at 0, else ""."""
    if clipped <= CLIPPED_MAX * pixels:
        return ""
    return (
        f"the converter clipped {100 * clipped / pixels:.2g}% of the pixels at 0 DN, which raises their mean: "
        "the layer bias, or a larger detector.bias, keeps the noise above 0"
    )


def full_fault(clipped: int, pixels: int) -> str:
    """Return a message if more than FULL_MAX of a frame's pixels were clipped at adc_max, else ""."""
    if clipped <= FULL_MAX * pixels:
        return ""
    return (
        f"the converter clipped {100 * clipped / pixels:.3g}% of the pixels at its maximum: check detector.bias, "
        "detector.gain, the sky and the exposure time"
    )


def channel_gains(detector: Detector, rng: Streams, *, per_channel: bool) -> list[float]:
    """Return the gains of all channels of a chip [e-/DN].

    per_channel: each channel has its own gain; otherwise all have the same.
    """
    count = detector.channels_x * detector.channels_y
    generators = [rng.channel(i + 1, "gain") for i in range(count)] if per_channel else [rng.chip("gain")]
    gains = [detector.gain * (1.0 + detector.gain_spread * generator.uniform(-1.0, 1.0)) for generator in generators]
    return gains if per_channel else gains * count
