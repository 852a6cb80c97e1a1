"""The calibration LEDs: narrow-band lamps that illuminate the focal plane through the filters (paper, section 5.5.5).

A lamp's line is a Gaussian; a chip receives the part that its filter transmits. The flat of a lamp is that of its
wavelength. For a lamp without its own flat (880 nm) it is interpolated between the neighbours, which the header states.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.types import FloatArray, PathLike
from csstsim.instrument.filter import GRID

_FWHM = 2 * np.sqrt(2 * np.log(2))


@dataclass(frozen=True)
class Led:
    """One lamp: name (nm), width of its line [nm FWHM], photons / s / pixel at flat 1."""

    name: str
    fwhm: float
    rate: float

    @property
    def line(self) -> FloatArray:
        """(18001,) the line on the paper's grid of 1 A steps, of integral 1 if all of it lies on the grid."""
        sigma = 10 * self.fwhm / _FWHM
        return np.exp(-0.5 * ((GRID - 10 * float(self.name)) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))


def load_leds(numbers: Mapping[str, Any], file: PathLike = "leds.yaml") -> dict[str, Led]:
    """Return {name: Led} of Camera.leds. Raises InputError."""
    found = {}
    for row in numbers.get("leds") or ():
        try:
            led = Led(str(row[0]), float(row[1]), float(row[2]))
            good = len(row) == 3 and 200 < float(led.name) < 1100 and led.fwhm > 0 and 0 <= led.rate < np.inf
        except (IndexError, TypeError, ValueError):
            good = False
        if not good:
            raise InputError("bad row", file=file, key="leds", value=row, allowed="name [nm], width > 0, rate >= 0")
        found[led.name] = led
    return found
