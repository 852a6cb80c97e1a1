"""Columns of a spectrum whose electrons are measured, but are less certain than their error says."""

from collections.abc import Mapping

import numpy as np

from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.measure.spectra.line_profile import OFFSETS
from csstsim.measure.spectra.spectrum_columns import BESIDE, LOST, SATURATED, UNEVEN

CORE = 3  # px along a trace within which light is a column's own
UNKNOWN = 0.5  # share of the net far light by which the aperture's part of it may be off
LEAK = 3  # columns: charge that blooms along a row
REACH = int(OFFSETS[-1]) - 1  # px: how far wings are followed


def untrusted(found: Mapping[str, AnyArray], along: FloatArray) -> IntArray:
    """Return the bits BESIDE and UNEVEN of (n,) columns; along: profile of a column's light (4, len(OFFSETS)).

    Light spread from a column to others, and from them to it, has another profile across than P. In an even spectrum
    the two balance, and P holds.
    """
    saturated = (found["flags"] & SATURATED) > 0
    lost = (found["flags"] & LOST) > 0
    column = np.arange(len(lost))
    beside = _near(saturated, LEAK) | _near(saturated & lost, REACH)
    light = np.pad(np.interp(column, column[~lost], found["electrons"][~lost]), REACH, mode="edge")
    steps = np.arange(-REACH, REACH + 1)
    line = along.mean(axis=0)
    far = np.interp(steps + 0.5, OFFSETS, line) - np.interp(steps - 0.5, OFFSETS, line)
    far[np.abs(steps) <= CORE] = 0.0
    off = np.convolve(light, far, "valid") - far.sum() * light[REACH:-REACH]
    uneven = UNKNOWN * np.abs(off) > found["electrons_err"]
    bits: IntArray = np.where(beside & ~saturated, BESIDE, 0)
    return bits | np.where(uneven, UNEVEN, 0)


def _near(marked: BoolArray, reach: int) -> BoolArray:
    """Return (n,) bool: the columns within `reach` of a marked one."""
    count = np.cumsum(np.pad(marked, (reach + 1, reach)))
    return count[2 * reach + 1 :] > count[: len(marked)]
