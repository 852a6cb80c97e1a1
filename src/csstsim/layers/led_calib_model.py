"""LED illuminations (paper, Appendix B item 16; section 5.5.5): flat exposures with the calibration lamps.

The lamps are inside: their light meets the internal flat, neither vignetting nor shutter. Light of several lamps adds.
Left out: warming up and ageing of the lamps, fringes.
"""

import numpy as np
from pydantic import Field, model_validator

from csstsim.errors import InputError
from csstsim.instrument.filter import GRID
from csstsim.layers.param import LayerParam
from csstsim.optics.flat import FlatField, check_flat
from csstsim.optics.led import load_leds

STAGE = "render"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
EXPOSURES = ("FLAT",)


class Param(LayerParam):
    """obs_param of `led_calib_model`."""

    LED_TYPE: list[str] = Field(["670"], min_length=1, description="lamps in the order they are lit: wavelengths in nm")
    LED_TIME: list[float] = Field([10.0], min_length=1, description="seconds each of them is lit")

    @model_validator(mode="after")
    def _a_time_for_each(self):
        if len(self.LED_TYPE) != len(self.LED_TIME):
            raise ValueError(f"LED_TYPE has {len(self.LED_TYPE)} lamps, LED_TIME {len(self.LED_TIME)} times")
        if len(set(self.LED_TYPE)) != len(self.LED_TYPE):
            raise ValueError("LED_TYPE names a lamp twice")
        if not all(0 <= time <= 1e5 for time in self.LED_TIME):
            raise ValueError("LED_TIME must lie within 0 and 1e5 s")
        return self


def apply(state, param, rng):
    """Add the lamps' light [e-] to state.image, in place; lamps and times go to the header.

    Raises InputError for an unknown lamp, or lamps lit for longer than the exposure.
    """
    leds, exptime = load_leds(state.leds), state.pointing.exptime
    if sum(param.LED_TIME) > exptime:
        raise InputError(
            "longer than the exposure", key="LED_TIME", value=sum(param.LED_TIME), allowed=f"<= {exptime} s"
        )
    check_flat(state.leds)
    flats = FlatField(state.leds, rng.camera)
    for name, seconds in zip(param.LED_TYPE, param.LED_TIME, strict=True):
        if name not in leds:
            raise InputError("unknown lamp", key="LED_TYPE", value=name, allowed=", ".join(leds))
        electrons = seconds * leds[name].electrons(state.filter)
        if electrons > 0:
            seen = leds[name].line * state.filter.at(GRID)
            state.image += np.float32(electrons) * flats.led_map(state.chip, state.window, GRID, seen)
    guessed = [name for name in param.LED_TYPE if not np.isin(float(name), flats.wavelengths)]
    state.header |= {
        "led_type": ",".join(param.LED_TYPE),
        "led_time": ",".join(f"{seconds:g}" for seconds in param.LED_TIME),
        "led_guessed": ",".join(guessed) or "none",
    }
    return state
