"""Level-0 frame to electrons: overscan, gain, nonlinearity, moved charge, flat; the first step of the measurement.

The bias of each readout channel is the robust mean of its own serial overscan (bias + read noise only), and its read
noise the robust scatter there. measure.charge_correction moves charge back to where light created it. The result is
divided by the response of flat field and shutter. Dark current and sky are part of the background in `measure.detect`.
"""

from dataclasses import dataclass

import numpy as np

from csstsim.base.errors import InputError
from csstsim.detector.cubic import straighten

# Deferred and bloomed charge leaks into the first overscan columns; they are not pure bias.
OVERSCAN_SKIP = 4
GAIN_MAX = 1000.0  # e-/DN: with more, 65535 DN would exceed any full well by far
_ROWS = 64


@dataclass(frozen=True)
class Calibrated:
    """Active image in electrons, sky and dark included.

    `electrons` float32 (ny, nx), before losses to flat field and shutter; `response` (ny, nx): the share of them that
    was counted (None: all); `saturated`, `bad` (known defects) bool (ny, nx); `bias` (DN) and `read_noise` (electron)
    per readout channel in the frame, {channel: value}.
    """

    electrons: np.ndarray
    saturated: np.ndarray
    bias: dict
    read_noise: dict
    readout: object
    bad: np.ndarray
    response: object = None

    def sigma(self):
        """Return the noise of each pixel, electron (ny, nx): own Poisson noise (>= 0) and read noise in quadrature."""
        counted = self.electrons if self.response is None else self.electrons * self.response
        variance = np.maximum(counted, np.float32(0.0))
        for block in self.readout.blocks:
            variance[block.image] += np.float32(self.read_noise[block.channel] ** 2)
        sigma = np.sqrt(variance, out=variance)
        return sigma if self.response is None else np.divide(sigma, self.response, out=sigma)

    def counted(self, x, y):
        """Return the share of light that was counted at frame positions (n,) [px], from the nearest pixel."""
        if self.response is None:
            return np.ones(np.shape(x))
        ny, nx = self.response.shape
        row, column = (np.clip(np.rint(v).astype(int), 0, n - 1) for v, n in ((y, ny), (x, nx)))
        return self.response[row, column].astype(float)


def calibrate(
    frame, readout, gain, *, nonlinearity=None, adc_max=65535, full_well=None, response=None, bad=None, offset=None,
    correct=None,
):  # fmt: skip
    """Turn a raw frame into electrons.

    `frame`: uint16 DN of shape `readout.shape`; `readout`: detector.channels.ReadoutFrame of its window;
    `gain`: {channel: electron/DN}, channels as in the Level-0 keywords GAINnn; `nonlinearity`:
    {channel: (quadratic, cubic)}, undone up to `full_well`, where the file states it. A pixel is saturated at
    `adc_max` DN or from `full_well` electrons; `response`: share of the light that was counted; `bad`:
    known defects, or None; `offset`: {channel: electrons} of bias in addition to the overscan's; `correct`: a function
    that moves electrons (ny, nx) back to where light made them, or None. Returns `Calibrated`. Raises InputError when
    the frame does not have the readout's shape or a channel's gain is missing or not positive.
    """
    if frame.shape != readout.shape:
        raise InputError("the frame does not have the shape of its readout", value=frame.shape, allowed=readout.shape)
    x0, x1, y0, y1 = readout.window
    electrons = np.empty((y1 - y0, x1 - x0), np.float32)
    saturated = np.empty(electrons.shape, bool)
    bias, read_noise = {}, {}
    for block in readout.blocks:
        factor = gain.get(block.channel)
        if factor is None or not 0 < factor < GAIN_MAX:
            allowed = f"> 0, < {GAIN_MAX:g} e-/DN"
            raise InputError(
                "the gain is missing or out of range", key=f"GAIN{block.channel:02d}", value=factor, allowed=allowed
            )
        if nonlinearity and full_well and block.channel not in nonlinearity:
            raise InputError("missing, though other channels have it", key=f"NLQ{block.channel:02d}, NLC")
        level, scatter = overscan_level(frame[block.serial_overscan], from_right=block.flip_x)
        bias[block.channel], read_noise[block.channel] = level, scatter * factor
        raw, zero = frame[block.active], level + (offset or {}).get(block.channel, 0.0) / factor
        electrons[block.image] = (raw - np.float32(zero)) * np.float32(factor)
        if nonlinearity and full_well:
            _straighten(electrons[block.image], *nonlinearity[block.channel], full_well)
        saturated[block.image] = raw >= adc_max
    if full_well is not None:
        saturated |= electrons >= full_well
    if correct is not None:
        electrons = correct(electrons)
    if response is not None:
        electrons /= response
    bad = np.zeros(electrons.shape, bool) if bad is None else bad
    return Calibrated(electrons, saturated, bias, read_noise, readout, bad, response)


def _straighten(electrons, quadratic, cubic, limit):
    """Undo the nonlinearity, in place, some rows at a time."""
    if quadratic or cubic:
        for first in range(0, len(electrons), _ROWS):
            rows = electrons[first : first + _ROWS]
            rows[:] = straighten(rows, quadratic, cubic, limit)


def overscan_level(overscan, *, from_right=False, clip=4.0):
    """Return (level, scatter) of an overscan region in its own unit: clipped mean and standard deviation.

    The columns next to the active pixels are left out (the last ones when `from_right`). Clipping is at
    `clip` robust sigma about the median, which removes leaked charge and keeps the mean unbiased by the
    rounding to whole DN (a median would be off by up to half a DN).
    """
    skip = OVERSCAN_SKIP if overscan.shape[1] > 2 * OVERSCAN_SKIP else 0
    if not overscan.size:
        raise InputError("a channel without serial overscan has no bias level", key="overscan", value=0, allowed="> 0")
    pixels = overscan[:, : overscan.shape[1] - skip] if from_right else overscan[:, skip:]
    pixels = pixels.astype(np.float64).ravel()
    centre = np.median(pixels)
    spread = max(1.4826 * np.median(np.abs(pixels - centre)), 1.0)  # at least the rounding step
    kept = pixels[np.abs(pixels - centre) <= clip * spread]
    return float(kept.mean()), float(kept.std())
