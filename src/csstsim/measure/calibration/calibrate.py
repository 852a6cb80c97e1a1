"""Level-0 frame to electrons: overscan, gain, nonlinearity, moved charge, flat; the first step of the measurement.

The bias of each readout channel is the robust mean of its serial overscan (bias + read noise only), and its read noise
is the robust scatter there. For a frame without overscan (layout `chip`), both come from its header. charge_correction
moves charge back to where light created it. The result is divided by the response of flat field and shutter. Dark
current and sky are part of the background in `detect`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np

from csstsim.base.arrays.robust_sigma import SIGMA_PER_MAD
from csstsim.base.errors import InputError
from csstsim.base.types import BoolArray, FloatArray, IntArray
from csstsim.detector.cubic import linearise
from csstsim.measure.calibration.bad_pixels import BAD, FULL

if TYPE_CHECKING:
    from csstsim.detector.channels import ReadoutFrame
    from csstsim.instrument.chip import Detector
    from csstsim.io.level0 import Level0
    from csstsim.optics.throughput.response import Response

# Deferred and bloomed charge leaks into the first overscan columns; they are not pure bias.
OVERSCAN_SKIP = 4
GAIN_MAX = 1000.0  # e-/DN: with more, 65535 DN would exceed any full well many times
DN = 1 << 16  # number of values of a raw pixel: the electrons of each are computed once per channel
_ROWS = 64


@dataclass(frozen=True)
class Calibrated:
    """Active image in electrons, sky and dark included.

    `electrons` float32 (ny, nx), before losses to flat field and shutter; `marks` uint8 (ny, nx), bits FULL and BAD of
    measure.calibration.bad_pixels; `response`: the fraction of the electrons that was counted, with `rows` and `at` of
    optics.throughput.response.Response (None: all); `bias` (DN) and `read_noise` (electron) per readout channel in the
    frame, {channel: value}.
    """

    electrons: FloatArray
    marks: IntArray
    bias: dict[int, float]
    read_noise: dict[int, float]
    readout: ReadoutFrame
    response: Response | None = None

    @property
    def saturated(self) -> BoolArray:
        """Bool (ny, nx): pixels at the converter's limit or the full well."""
        return (self.marks & FULL) > 0

    @property
    def bad(self) -> BoolArray:
        """Bool (ny, nx): known defects."""
        return (self.marks & BAD) > 0

    def sigma(self) -> FloatArray:
        """Return the noise of each pixel, electron (ny, nx): its Poisson noise (>= 0) and read noise in quadrature."""
        sigma = np.maximum(self.electrons, np.float32(0.0))
        for rows, fraction in self._fractions():
            sigma[rows] *= fraction
        for block in self.readout.blocks:
            sigma[block.image] += np.float32(self.read_noise[block.channel] ** 2)
        np.sqrt(sigma, out=sigma)
        for rows, fraction in self._fractions():
            sigma[rows] /= fraction
        return sigma

    def _fractions(self) -> Iterable[tuple[slice, FloatArray]]:
        return () if self.response is None else _by_rows(self.response, len(self.electrons))

    def counted(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the fraction of light that was counted at frame positions (n,) [px], that of the nearest pixel."""
        if self.response is None:
            return np.ones(np.shape(x))
        ny, nx = self.electrons.shape
        row = np.clip(np.rint(y).astype(int), 0, ny - 1)
        column = np.clip(np.rint(x).astype(int), 0, nx - 1)
        return self.response.at(row, column).astype(float)


def _by_rows(response: Response, ny: int) -> Iterator[tuple[slice, FloatArray]]:
    """Yield (slice of rows, response of these), a few rows at a time."""
    for first in range(0, ny, _ROWS):
        rows = slice(first, min(first + _ROWS, ny))
        yield rows, response.rows(rows.start, rows.stop)


class Electronics(NamedTuple):
    """Properties of the channels that turn DN into electrons, {channel: value}; numbered as in the keywords GAINnn.

    `gain`: electron/DN; `nonlinearity`: (quadratic, cubic), undone up to `full_well` [electron], where the file states
    it; a pixel is saturated at `adc_max` DN or from `full_well`; `levels`: (bias [DN], read noise [electron]), used
    where there is no overscan.
    """

    gain: Mapping[int, float]
    nonlinearity: Mapping[int, tuple[float, float]] | None = None
    adc_max: int = 65535
    full_well: float | None = None
    levels: Mapping[int, tuple[float, float]] | None = None

    @classmethod
    def of(cls, file: Level0, detector: Detector) -> Electronics:
        """Return the Electronics that a Level-0 file states, with the limits of its detector."""
        return cls(file.gain, file.nonlinearity, detector.adc_max, detector.full_well, file.levels)


class Corrections(NamedTuple):
    """Corrections of a frame; None: not corrected.

    `response`: fraction of the light that was counted, as in Calibrated; `bad`: bool (ny, nx), known defects; `offset`:
    {channel: electrons} of bias in addition to the overscan's; `structure`: electrons (readout.shape) of the bias
    within its channels; `correct`: a function that moves electrons (ny, nx) back, in place, to where light made them.
    """

    response: Response | None = None
    bad: BoolArray | None = None
    offset: Mapping[int, float] | None = None
    structure: FloatArray | None = None
    correct: Callable[[FloatArray], object] | None = None


NO_CORRECTIONS = Corrections()


def calibrate(
    frame: IntArray, readout: ReadoutFrame, electronics: Electronics, corrections: Corrections = NO_CORRECTIONS
) -> Calibrated:
    """Turn a raw frame into electrons.

    Parameters
    ----------
    frame : ndarray of uint16
        DN of shape `readout.shape`.
    readout : ReadoutFrame
        Of the frame's window (detector.channels).
    electronics : Electronics
        Gain, nonlinearity and limits of the channels.
    corrections : Corrections
        Of response, defects, bias and moved charge.

    Returns
    -------
    Calibrated
        Electrons, marks, bias and read noise of the window.

    Raises
    ------
    InputError
        If the frame does not have the readout's shape, or a channel's gain is missing or not positive.
    """
    gain, nonlinearity, adc_max, full_well, levels = electronics
    response, bad, offset, structure, correct = corrections
    if frame.shape != readout.shape:
        raise InputError("the frame does not have the shape of its readout", value=frame.shape, allowed=readout.shape)
    x0, x1, y0, y1 = readout.window
    electrons = np.empty((y1 - y0, x1 - x0), np.float32)
    marks = np.empty(electrons.shape, np.uint8)
    bias = {}
    read_noise = {}
    for block in readout.blocks:
        n = block.channel
        factor = _gain_of(gain, block.channel)
        if readout.overscan or levels is None or n not in levels:
            overscan = frame[block.serial_overscan]
            if structure is not None:
                overscan = overscan - structure[block.serial_overscan] / factor
            bias[n], scatter = overscan_level(overscan, from_right=block.flip_x)
            read_noise[n] = scatter * factor
        else:
            bias[n], read_noise[n] = levels[n]
        charge = _charge_of_dn(bias[n] + (offset or {}).get(n, 0.0) / factor, factor)
        if nonlinearity and full_well:
            charge = _linearised(charge, nonlinearity, n, full_well)
        full = np.arange(DN) >= adc_max
        if full_well is not None:
            full |= charge >= full_well
        _look_up(frame[block.active], charge, FULL * full, electrons[block.image], marks[block.image])
        if structure is not None:
            electrons[block.image] -= structure[block.active]
    del frame  # 190 MB of a whole chip, to which the caller has no reference
    if correct is not None:
        correct(electrons)
    if response is not None:
        for rows, fraction in _by_rows(response, len(electrons)):
            electrons[rows] /= fraction
    if bad is not None:
        marks[bad] |= BAD
    return Calibrated(electrons, marks, bias, read_noise, readout, response)


def _gain_of(gain: Mapping[int, float], channel: int) -> float:
    factor = gain.get(channel)
    if factor is None or not 0 < factor < GAIN_MAX:
        raise InputError(
            "the gain is missing or out of range",
            key=f"GAIN{channel:02d}",
            value=factor,
            allowed=f"> 0, < {GAIN_MAX:g} e-/DN",
        )
    return factor


def _charge_of_dn(bias: float, gain: float) -> FloatArray:
    """Return the electrons (DN,) float32 of each DN of a channel; bias [DN], gain [electron/DN]."""
    return (np.arange(DN, dtype=np.uint16) - np.float32(bias)) * np.float32(gain)


def _linearised(
    charge: FloatArray, nonlinearity: Mapping[int, tuple[float, float]], channel: int, limit: float
) -> FloatArray:
    """Return `charge` with the channel's nonlinearity undone."""
    if channel not in nonlinearity:
        raise InputError("missing, though other channels have it", key=f"NLQ{channel:02d}, NLC")
    quadratic, cubic = nonlinearity[channel]
    return linearise(charge, quadratic, cubic, limit).astype(np.float32) if quadratic or cubic else charge


@numba.njit(cache=True)
def _look_up(frame: IntArray, charge: FloatArray, full: IntArray, electrons: FloatArray, marks: IntArray) -> None:
    """Fill electrons and marks (ny, nx) from tables (DN,) of the electrons and marks of each DN of `frame`."""
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            dn = frame[y, x]
            electrons[y, x], marks[y, x] = charge[dn], full[dn]


def overscan_level(
    overscan: IntArray | FloatArray, *, from_right: bool = False, clip: float = 4.0
) -> tuple[float, float]:
    """Return (level, scatter) of an overscan region in its own unit: clipped mean and standard deviation.

    The columns next to the active pixels are left out (the last ones when `from_right`). Clipping is at
    `clip` robust sigma about the median, which removes leaked charge and keeps the mean unbiased by the
    rounding to whole DN (a median would be off by up to half a DN).
    """
    skip = OVERSCAN_SKIP if overscan.shape[1] > 2 * OVERSCAN_SKIP else 0
    if not overscan.size:
        raise InputError("a channel without serial overscan has no bias level", key="overscan", value=0, allowed="> 0")
    pixels = overscan[:, : overscan.shape[1] - skip] if from_right else overscan[:, skip:]
    values, counts = _value_counts(pixels)
    deviation = np.abs(values - _median(values, counts))
    order = np.argsort(deviation)
    spread = max(SIGMA_PER_MAD * _median(deviation[order], counts[order]), 1.0)  # at least the rounding step
    inliers = deviation <= clip * spread
    mean = np.average(values[inliers], weights=counts[inliers])
    return float(mean), float(np.sqrt(np.average((values[inliers] - mean) ** 2, weights=counts[inliers])))


def _value_counts(pixels: IntArray | FloatArray) -> tuple[FloatArray, IntArray]:
    """Return (values, number of pixels with each), values rising; whole DN need no sorting of the pixels."""
    if pixels.dtype.kind != "u":
        return np.unique(pixels, return_counts=True)
    counts = np.bincount(pixels.ravel())
    values = np.flatnonzero(counts)
    return values.astype(float), counts[values]


def _median(values: FloatArray, counts: IntArray) -> float:
    """Return the median of rising values, each of which occurs `counts` times."""
    until = np.cumsum(counts)
    total = until[-1]
    middle = np.searchsorted(until, [(total - 1) // 2, total // 2], side="right")
    return values[middle].mean()
