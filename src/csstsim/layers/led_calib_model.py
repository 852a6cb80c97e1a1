"""LED illuminations (paper, Appendix B item 16; section 5.5.5): flat exposures with the calibration lamps.

The lamps are inside, behind the closed shutter. So the exposure is the time for which they are lit, and their light has
the internal flat, but not the shutter effect or vignetting, which the paper applies to exposures with the shutter open.
It has the pixel response if the list has PRNU_effect. The flux of several lamps is added; a chip receives the fraction
that its filter transmits. Omitted: warming up and ageing of the lamps, fringes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from csstsim.base.errors import InputError
from csstsim.instrument.filter import GRID
from csstsim.layers.param import LayerParam
from csstsim.optics.throughput.flat import FlatField, check_flat
from csstsim.optics.throughput.led import load_leds
from csstsim.optics.throughput.response import pixel_response

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any, Self

    from csstsim.base.rng import Streams
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.optics.throughput.led import Led
    from csstsim.simulation.state import State

STAGE = "render"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
EXPOSURES = ("FLAT",)


class Param(LayerParam):
    """obs_param of `led_calib_model`."""

    model_config = ConfigDict(coerce_numbers_to_str=True)  # a lamp's name need not be quoted

    LED_TYPE: list[str] = Field(["670"], min_length=1, description="lamps in the order they are lit: wavelengths in nm")
    LED_TIME: list[float] = Field([10.0], min_length=1, description="seconds for which each lamp is lit")

    @model_validator(mode="after")
    def _a_time_for_each(self) -> Self:
        if len(self.LED_TYPE) != len(self.LED_TIME):
            raise ValueError(f"LED_TYPE has {len(self.LED_TYPE)} lamps, LED_TIME {len(self.LED_TIME)} times")
        if len(set(self.LED_TYPE)) != len(self.LED_TYPE):
            raise ValueError("LED_TYPE names a lamp twice")
        if not all(0 <= time <= 1e5 for time in self.LED_TIME):
            raise ValueError("LED_TIME must be within 0 and 1e5 s")
        return self


def check(param: Param, camera: Camera, pointing: Pointing) -> None:
    """Raise InputError for invalid parameters of the flat, an unknown lamp, or lamps lit longer than the exposure."""
    check_flat(camera.leds)
    _lamps(param, camera.leds, pointing)


def _lamps(param: Param, numbers: Mapping[str, Any], pointing: Pointing) -> list[Led]:
    """Return the Led of each entry of LED_TYPE, checked."""
    known = load_leds(numbers)
    seconds = sum(param.LED_TIME)
    if seconds > pointing.exptime:
        message = f"longer than the exposure of {pointing.time}"
        allowed = f"<= {pointing.exptime} s in all"
        raise InputError(message, key="LED_TIME", value=seconds, allowed=allowed)
    for name in param.LED_TYPE:
        if name not in known:
            raise InputError("unknown lamp", key="LED_TYPE", value=name, allowed=", ".join(known))
    return [known[name] for name in param.LED_TYPE]


def apply(state: State, param: Param, rng: Streams) -> State:
    """Add the electrons of the lamps to state.image, in place; lamps and times go to the header.

    Raises InputError as `check` does.
    """
    leds = state.exposure.camera.leds
    lit = _lamps(param, leds, state.pointing)
    flats = FlatField(leds, rng.camera)
    spectrum = sum(seconds * led.rate * led.line for led, seconds in zip(lit, param.LED_TIME, strict=True))
    spectrum = spectrum * state.filter.at(GRID)  # electron / pixel / angstrom at flat 1
    electrons = np.trapezoid(spectrum, GRID)
    if electrons > 0:
        flat = flats.led_map(state.chip, state.window, GRID, spectrum)
        flat *= np.float32(electrons)
        if state.exposure.losses.prnu:
            pixel_response(flat, state.chip, state.window, rng.chip_key("prnu"))
        state.image += flat
    state.header |= {
        "led_flag": True,
        "led_type": list(param.LED_TYPE),
        "led_time": list(param.LED_TIME),
        "led_guessed": ",".join(led.name for led in lit if float(led.name) not in flats.wavelengths) or "none",
    }
    return state
