"""The electrons of a raw frame in any layout: stored channels, a mosaic of them, or the assembled chip.

The bias level of a channel is that of its overscan; without overscan, that of the header or of the camera. Gains are
those of the header (GAINnn, GAIN1, GAIN) or of the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.detector.channels import LAYOUTS, ReadoutFrame
from csstsim.io.fits import open_fits, read_pixels
from csstsim.studies.recreate.frame import image_number

if TYPE_CHECKING:
    from csstsim.base.types import BoolArray, FloatArray, IntArray
    from csstsim.instrument.chip import Detector
    from csstsim.studies.recreate.frame import FrameHeader

TRAILED = 4  # columns of overscan, next to the active ones, that have deferred charge
_CLIPS = 8
_SIGMAS = 3.0


@dataclass(frozen=True, eq=False)
class Pixels:
    """Electrons (ny, nx) of the window (x0, x1, y0, y1) of a chip; saturated (ny, nx): at the converter's maximum."""

    electrons: FloatArray
    saturated: BoolArray
    window: tuple[int, int, int, int]


class Level(NamedTuple):
    """The mean and the standard deviation of clipped values."""

    mean: float
    sigma: float


def read_electrons(frame: FrameHeader, detector: Detector) -> Pixels:
    """Return the Pixels of a frame.FrameHeader. Raises InputError for a shape that the detector does not have."""
    with open_fits(frame.path) as file:
        stored = read_pixels(file[image_number(file, frame.path)], frame.path)
    try:
        readout = ReadoutFrame.of(detector, frame.window(detector))
    except ValueError as exc:
        raise InputError(str(exc), file=frame.path, key="READX0..READY1") from None
    shapes = {readout.stored_shape(name): name for name in LAYOUTS} | {(detector.ny, detector.nx): "chip"}
    layout = shapes.get(stored.shape)
    if layout is None:
        allowed = ", ".join(f"{shape[1]} x {shape[0]} ({name})" for shape, name in shapes.items())
        value = f"{stored.shape[1]} x {stored.shape[0]}" if stored.ndim == 2 else stored.shape
        raise InputError("not the pixels of this camera", file=frame.path, key="NAXIS", value=value, allowed=allowed)
    x0, x1, y0, y1 = readout.window
    if layout == "chip":
        dn = stored[y0:y1, x0:x1].astype(np.float32)
        levels = _stated_levels(frame, detector)
    else:
        frame_dn = readout.from_stored(stored, layout)
        dn = readout.active(frame_dn).astype(np.float32)
        levels = _overscan_levels(frame_dn, readout)
    saturated = dn >= min(detector.adc_max, frame.number("SATURATE") or detector.adc_max)
    for block in readout.blocks:
        key = f"GAIN{block.channel:02d}"
        gain = frame.number(key, "GAIN1", "GAIN")
        gain = detector.gain if gain is None else gain
        if gain <= 0:
            raise InputError("impossible", file=frame.path, key=key, value=gain, allowed="above 0 e-/DN")
        dn[block.image] = (dn[block.image] - levels[block.channel]) * gain
    return Pixels(dn, saturated, readout.window)


def _overscan_levels(frame_dn: IntArray, readout: ReadoutFrame) -> dict[int, float]:
    levels: dict[int, float] = {}
    for block in readout.blocks:
        overscan = frame_dn[block.serial_overscan].astype(np.float32)
        clean = overscan[:, : overscan.shape[1] - TRAILED] if block.flip_x else overscan[:, TRAILED:]
        levels[block.channel] = clipped(clean if clean.shape[1] >= TRAILED else overscan).mean
    return levels


def _stated_levels(frame: FrameHeader, detector: Detector) -> dict[int, float]:
    default = detector.bias / detector.gain
    if frame.number("DETBIA01", "BIAS") is None:
        frame.notes.append(f"DETBIA01: no overscan; the level is the camera's, {default:.1f} DN")
    channels = range(1, detector.channels_x * detector.channels_y + 1)
    stated = {channel: frame.number(f"DETBIA{channel:02d}", "BIAS") for channel in channels}
    return {channel: default if level is None else level for channel, level in stated.items()}


def clipped(values: FloatArray) -> Level:
    """Return the Level of values within 3 sigma of the median, clipped repeatedly."""
    remaining = np.asarray(values, dtype=np.float64).ravel()
    for _ in range(_CLIPS):
        middle = np.median(remaining)
        sigma = remaining.std()
        inside = np.abs(remaining - middle) <= _SIGMAS * sigma
        if inside.all():
            break
        remaining = remaining[inside]
    return Level(float(remaining.mean()), float(remaining.std()))
