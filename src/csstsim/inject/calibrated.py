"""Light into a calibrated image (SCI, ERR, DQ): as `csstsim calibrate` would have found it.

An electron that a pixel counted stands for 1 / response electrons of light, in SCI. ERR gains the shot noise of the
electrons that were counted, which is its own convention. A pixel that reaches the full well or the converter's end gets
the bit "saturated" of DQ, and has no more charge than that. The detector is taken as corrected: blooming, and what is
left of charge transfer and of the brighter-fatter effect, are left out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.measure.calibration.bad_pixels import FULL

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from csstsim.base.types import FloatArray, IntArray, PathLike
    from csstsim.inject.light import Light
    from csstsim.instrument.chip import Window

UNIT = "electron/s"


class Planes(NamedTuple):
    """Planes (ny, nx) of a calibrated image: electrons/s and their error, float32, and the bits of DQ."""

    sci: FloatArray
    err: FloatArray
    dq: IntArray


def into_calibrated(
    planes: Planes,
    light: Light,
    exptime: float,
    *,
    background: float,
    limit: float,
    response: FloatArray | None = None,
) -> Planes:
    """Return copies of the planes, with a light.Light.

    exptime [s]; background [e-/s]: what was subtracted from SCI; limit: largest number of electrons of a pixel;
    response: (n,) float32 of the light's pixels by which the image was divided, or None: 1.
    """
    sci = np.array(planes.sci)
    err = np.array(planes.err)
    dq = np.array(planes.dq)
    at = light.pixel
    counted = np.float32(1.0) if response is None else response
    rate = light.electrons / (counted * np.float32(exptime))
    noise = np.maximum(light.electrons, 0) / (counted * np.float32(exptime)) ** 2
    flat = sci.reshape(-1)
    error = err.reshape(-1)
    bits = dq.reshape(-1)
    flat[at] += rate
    error[at] = np.sqrt(error[at].astype(float) ** 2 + noise)
    most = limit / (counted * exptime) - background
    full = flat[at] > most
    flat[at] = np.where(full, most, flat[at])
    bits[at[full]] |= FULL
    return Planes(sci, err, dq)


def check_planes(path: PathLike, planes: Planes, header: Mapping[str, Any], window: Window) -> None:
    """Raise InputError if (SCI, ERR, DQ) cannot be injected into: sizes, unit, errors that are no numbers."""
    err = planes.err
    if header.get("BUNIT") != UNIT:
        raise InputError("unknown unit of SCI", file=path, key="BUNIT", value=header.get("BUNIT"), allowed=UNIT)
    for name, plane in zip(("SCI", "ERR", "DQ"), planes, strict=True):
        if plane.shape != window.shape:
            raise InputError("not of the window's size", file=path, key=name, value=plane.shape, allowed=window.shape)
    wrong = int(np.count_nonzero(~(np.isfinite(err) & (err > 0))))
    if wrong:
        raise InputError(f"{wrong} of the errors are not above 0 or no numbers", file=path, key="ERR")
