"""Flag saturated objects: those with more light than the full well in a pixel at their position, from any source."""

import numpy as np
from scipy.ndimage import maximum_filter

from csstsim.catalog.flags import SATURATED


def flag_saturated(truth, image, counted, window, full_well):
    """Return the truth table with SATURATED where one of the 3 x 3 pixels at an object's place is above the full well.

    image, counted: electrons, (window.ny, window.nx), counted may be None; full_well: electrons. The light is that
    falling on the detector, before blooming and charge transfer.
    """
    if not len(truth):
        return truth
    light = image if counted is None else image + counted
    full = maximum_filter(light > full_well, size=3, mode="constant")
    x, y = (np.nan_to_num(np.round(truth[name]), nan=-1e9).astype(int) for name in ("x", "y"))
    on = (x >= window.x0) & (x < window.x1) & (y >= window.y0) & (y < window.y1)
    flags = truth["flags"].copy()
    flags[on] |= np.where(full[y[on] - window.y0, x[on] - window.x0], SATURATED, 0).astype(flags.dtype)
    return truth.with_columns(flags=flags)
