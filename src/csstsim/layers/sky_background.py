"""Sky background and stray light (paper, Appendix B item 2).

Adds the expected sky of the band to every pixel. Left out so far: the stray-light model, flat field and shutter.
"""

from pydantic import Field

from csstsim.layers.param import LayerParam
from csstsim.sky.background import sky_electrons

STAGE = "render"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
EXPOSURES = ("SCIE",)


class Param(LayerParam):
    """obs_param of `sky_background`."""

    exptime: float | None = Field(None, gt=0, le=1e5, description="exposure time [s]; null = the pointing's")


def apply(state, param, rng):
    """Add the sky [e-] to state.image, in place; the rate goes to the header."""
    exptime = state.pointing.exptime if param.exptime is None else param.exptime
    state.image += sky_electrons(state.filter, exptime)
    state.header["sky_rate"] = state.filter.sky
    return state
