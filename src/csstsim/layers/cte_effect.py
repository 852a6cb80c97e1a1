"""Charge transfer inefficiency (paper, Appendix B item 10; section 5.5.4): traps hold back electrons on their way.

Each half of the chip is transferred along its columns to its own amplifiers (csstsim.detector.cti); what trails behind
its last row goes to state.trailed, which prescan_overscan lays into the parallel overscan. A window's columns are
transferred as whole ones: rows of the half that are not simulated hold the median charge of those that are.
Left out: serial transfer, the rise of trap density over the mission (`density_scale` stands for it).
"""

import numpy as np
from pydantic import Field

from csstsim.errors import InputError
from csstsim.layers.param import LayerParam

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "active")


class Param(LayerParam):
    """obs_param of `CTE_effect`."""

    density_scale: float = Field(
        1.0, ge=0, le=1000, description="density of traps over that of cti.yaml, an irradiated device; 0: none"
    )


def check(param, camera, pointing):
    """Raise InputError if the camera has no traps."""
    if camera.detector.traps is None:
        raise InputError("the instrument folder has no cti.yaml", key="density_scale")


def apply(state, param, rng):
    """Move the charge of state.image, in place, and set state.trailed; electrons left in traps go to the header.

    Raises ValueError if electrons are still in state.counted, or for values that are not finite.
    """
    from csstsim.detector.cti import transfer  # numba: half a second that checking a campaign need not pay

    if state.counted is not None:
        raise ValueError("counted electrons were not merged: poisson_and_dark must come before CTE_effect")
    detector, window = state.chip.detector, state.window
    traps, n_rows = detector.traps, detector.channel_ny
    density = np.array(traps.density) * param.density_scale
    trailed, trapped = [], 0
    for half in range(2):
        low, high = (min(max(y, half * n_rows), (half + 1) * n_rows) for y in (window.y0, window.y1))
        trail, left = transfer(
            state.image[low - window.y0 : high - window.y0] if low < high else state.image[:0],
            density, traps.timescale, (traps.beta, traps.full_well, traps.notch),
            (rng.chip_key(f"traps {half}"), rng.exposure_key(f"release {half}")),
            flip=bool(half), lead=detector.ny - high if half else low, n_rows=n_rows,
            overscan=detector.parallel_overscan, x0=window.x0,
        )  # fmt: skip
        trailed.append(trail)
        trapped += left
    state.trailed = tuple(trailed)
    state.header |= {"cti_density": param.density_scale, "cti_trapped": trapped}
    return state
