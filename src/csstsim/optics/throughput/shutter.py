"""The shutter: two leaves that turn on hinges like a double door, and the exposure time of each column.

A leaf turns from 0 to 90 deg in t_s with a sinusoidal acceleration (paper, equation 14); integrated twice,

    A(t) = pi / (2 t_s) (t - t_s / (2 pi) sin(2 pi t / t_s)).

The bearings of the leaves are 2 L apart in x. The leaves meet in the middle when closed and cover positions nearer to
their bearing than L cos A. So the middle is exposed during the whole exposure, and the position of a bearing only while
the leaves are at rest. The exposure counts from the start of the opening to the end of the closing. A position at
distance d from its bearing loses 2 t(d), with L cos A(t) = d. With tau = 2 pi t / t_s, tau - sin tau = 4 arccos(d / L).

Left out: the height of the leaves above the detectors; the edge of the shadow is wide but moves alike for all columns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.types import AnyArray, FloatArray
from csstsim.base.units import DAY_S
from csstsim.optics.geometry.wcs import chip_plane

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip, Window
    from csstsim.instrument.telescope import Telescope

_HALVINGS = 60


def deficit(x_mm: ArrayLike, telescope: Telescope) -> FloatArray:
    """Return the exposure time lost [s] at x [mm from the middle]: 0 in the middle, 2 t_s at a bearing."""
    half = telescope.shutter_span_mm / 2
    angle = np.arccos(np.clip(1 - np.abs(np.asarray(x_mm, float)) / half, 0.0, 1.0))
    low = np.zeros_like(angle)
    high = np.full_like(angle, 2 * np.pi)
    for _ in range(_HALVINGS):  # tau - sin tau rises, but is flat at both ends
        middle = 0.5 * (low + high)
        below = middle - np.sin(middle) < 4 * angle
        low = np.where(below, middle, low)
        high = np.where(below, high, middle)
    return telescope.shutter_time * (low + high) / (2 * np.pi)


def moments(start: float, exptime: float, telescope: Telescope) -> dict[str, float]:
    """Return the times at which the shutter starts to open, is open, starts to close and is closed, {name: MJD UTC}.

    start: MJD; exptime [s]: from the first to the last of these, the exposure time of the middle of the focal plane.
    """
    opening = telescope.shutter_time / DAY_S
    end = start + exptime / DAY_S
    return {
        "shutter_open_0": start,
        "shutter_open_1": start + opening,
        "shutter_close_0": end - opening,
        "shutter_close_1": end,
    }


def exposed(chip: Chip, window: Window, exptime: float) -> FloatArray:
    """Return (window.nx,) float64: the fraction of `exptime` [s] for which each column of a chip's window is exposed.

    Grating chips are turned by 1 deg; their columns are evaluated at the chip's middle row, an error of up to 2e-5 of
    150 s. Raises InputError for an exposure shorter than opening plus closing.
    """
    check(chip, exptime)
    return 1 - deficit(_across_mm(chip, np.arange(window.x0, window.x1)), chip.telescope) / exptime


def lost(chip: Chip, x: ArrayLike) -> FloatArray:
    """Return the exposure time lost [s] at columns x (n,) [px] of a chip, half of it at either end of the exposure."""
    return deficit(_across_mm(chip, np.asarray(x, float)), chip.telescope)


def check(chip: Chip, exptime: float) -> None:
    """Raise InputError for an exposure [s] shorter than opening plus closing, or leaves that do not cover the chip."""
    shortest = 2 * chip.telescope.shutter_time
    span = chip.telescope.shutter_span_mm
    if exptime < shortest:
        raise InputError("too short for the shutter", key="exptime", value=exptime, allowed=f">= {shortest} s")
    needed = 2 * np.abs(_across_mm(chip, np.array([0, chip.detector.nx - 1]))).max()
    if span < needed:
        message = f"the leaves do not cover chip {chip.id}"
        allowed = f">= {needed:.1f}"
        raise InputError(message, file="telescope.yaml", key="shutter_span_mm", value=span, allowed=allowed)


def _across_mm(chip: Chip, columns: AnyArray) -> FloatArray:
    """Return mosaic x [mm] of a chip's columns, where they cross its middle row."""
    rotation, origin = chip_plane(chip)
    row = (chip.detector.ny - 1) / 2 - origin[1]
    return (rotation[0, 0] * (columns - origin[0]) + rotation[0, 1] * row) * chip.detector.pixel_um * 1e-3
