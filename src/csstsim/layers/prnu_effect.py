"""Pixel response non-uniformity (paper, Appendix B item 3).

The layer only switches the effect on and records it in the header. It is applied during rendering, like flat field and
shutter (optics.throughput.response): photons are accepted or lost one by one, so that the variance equals the mean, and
the truth counts the accepted ones. The map is fixed for each chip: that of the laboratory, if the camera's folder has
one (instrument.maps), else a random one (detector.prnu) with the detector's rms. Omitted: colour of the response.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.detector.prnu import CLIP
from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.state import State

STAGE = "render"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
EXPOSURES = ("SCIE", "FLAT")
AFTER = ("scie_obs", "sky_background", "led_calib_model")


class Param(LayerParam):
    """obs_param of `PRNU_effect`: none; the rms is the detector's."""


def check(param: Param, camera: Camera, pointing: Pointing) -> None:
    """Raise InputError if the detector's rms makes a pixel's response negative."""
    rms = camera.detector.prnu
    if not 0 <= rms < 1 / CLIP:
        raise InputError("out of range", file="detector.yaml", key="prnu", value=rms, allowed=f"0 to 1 / {CLIP}")


def apply(state: State, param: Param, rng: Streams) -> State:
    """Record the rms in the header, of a laboratory map that of the window's pixels.

    Raises ValueError if objects and sky were rendered without PRNU.
    """
    if not state.exposure.losses.prnu:
        raise ValueError("objects were rendered without PRNU: the exposure's losses do not include it")
    measured = state.chip.maps.prnu
    rms = float(measured.part(*state.window.slices).std(dtype=float)) if measured else state.chip.detector.prnu
    state.header["prnu_rms"] = rms
    return state
