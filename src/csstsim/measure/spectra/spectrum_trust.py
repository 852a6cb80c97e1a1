"""Columns of a spectrum whose electrons are less certain than their stated error."""

from collections.abc import Mapping

import numpy as np

from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray
from csstsim.measure.spectra.line_profile import OFFSETS
from csstsim.measure.spectra.spectrum_columns import BESIDE, LOST, SATURATED, UNEVEN

CORE = 3  # px along a trace within which the flux counts as that of the column
WING_ERROR = 0.5  # of the net flux in wings: possible error of its part in the aperture
LEAK = 3  # columns: reach of charge that blooms along a row
REACH = int(OFFSETS[-1]) - 1  # px: reach of the wings


def untrusted(found: Mapping[str, AnyArray], along: FloatArray) -> IntArray:
    """Return (n,): the flags BESIDE and UNEVEN of columns; along: profile of a column's flux (4, len(OFFSETS)).

    Flux spread from a column to others, and from others to it, has a profile across that differs from P. In an even
    spectrum the two balance, and P is right.
    """
    saturated = (found["flags"] & SATURATED) > 0
    lost = (found["flags"] & LOST) > 0
    column = np.arange(len(lost))
    near_saturated = _near(saturated, LEAK) | _near(saturated & lost, REACH)
    electrons = np.pad(np.interp(column, column[~lost], found["electrons"][~lost]), REACH, mode="edge")
    steps = np.arange(-REACH, REACH + 1)
    profile = along.mean(axis=0)
    wing = np.interp(steps + 0.5, OFFSETS, profile) - np.interp(steps - 0.5, OFFSETS, profile)
    wing[np.abs(steps) <= CORE] = 0.0
    net_wing = np.convolve(electrons, wing, "valid") - wing.sum() * electrons[REACH:-REACH]
    uneven = WING_ERROR * np.abs(net_wing) > found["electrons_err"]
    bits: IntArray = np.where(near_saturated & ~saturated, BESIDE, 0)
    return bits | np.where(uneven, UNEVEN, 0)


def _near(marked: BoolArray, reach: int) -> BoolArray:
    """Return (n,) bool: the columns within `reach` of a marked one."""
    count = np.cumsum(np.pad(marked, (reach + 1, reach)))
    return count[2 * reach + 1 :] > count[: len(marked)]
