"""Charge transfer inefficiency (paper, Appendix B item 10; section 5.5.4): traps delay electrons during transfer.

Charge is transferred to the registers and, with `serial`, along them to the amplifiers
(csstsim.detector.charge_transfer.transfer). Charge released after the last row or column goes to state.trailed, and
prescan_overscan puts it into the overscan. Omitted: the rise of trap density over the mission (use `density_scale`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from csstsim.base.errors import InputError
from csstsim.detector.charge_transfer.transfer import transfer
from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
AFTER = ("poisson_and_dark",)


class Param(LayerParam):
    """obs_param of `CTE_effect`."""

    density_scale: float = Field(
        1.0, ge=0, le=1000, description="density of traps over that in cti.yaml (an irradiated device); 0: no traps"
    )
    serial: bool = Field(False, description="true: traps of the serial registers act, too (cti.yaml: serial)")


def check(param: Param, camera: Camera, pointing: Pointing) -> None:
    """Raise InputError if the camera has no traps, or no serial traps although `serial` is set."""
    traps = camera.detector.traps
    if traps is None:
        raise InputError("the instrument folder has no cti.yaml", key="density_scale")
    if param.serial and traps.serial is None:
        raise InputError("the instrument's cti.yaml has no `serial` traps", key="serial", value=True, allowed="false")


def apply(state: State, param: Param, rng: Streams) -> State:
    """Move the charge of state.image, in place, and set state.trailed; electrons left in traps go to the header.

    Raises ValueError if counted electrons were not merged, or for values that are not finite.
    """
    if state.counted is not None:
        raise ValueError("counted electrons were not merged: poisson_and_dark must come before CTE_effect")
    state.trailed, header = transfer(
        state.image, state.chip.detector, state.window, rng, density=param.density_scale, serial=param.serial
    )
    state.header |= {"cti_density": param.density_scale} | header
    return state
