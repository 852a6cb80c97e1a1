"""The robust standard deviation: 1.4826 times the median absolute deviation, which equals sigma for a Gaussian.

Results are numpy numbers with the precision of the values.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray

SIGMA_PER_MAD = 1.4826  # 1 / (the 75% quantile of the standard normal distribution)


def robust_sigma(values: FloatArray | IntArray, centre: float | np.floating[Any] | None = None) -> float:
    """Return the robust sigma of values, of any shape, around `centre` (default: their median)."""
    return sigma_of_deviations(np.abs(values - (np.median(values) if centre is None else centre)))


def sigma_of_deviations(deviations: FloatArray) -> float:
    """Return the robust sigma of values from their absolute deviations from the centre."""
    return cast("float", SIGMA_PER_MAD * np.median(deviations))
