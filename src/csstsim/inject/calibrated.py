"""Light added to a calibrated image (SCI, ERR, DQ), as it would be after `csstsim calibrate`.

SCI is corrected for the response, so a counted electron adds 1 / response electrons. ERR gains the shot noise of the
counted electrons only, as in any calibrated image. A pixel that reaches the full well or the converter's maximum gets
the bit "saturated" of DQ and is limited to that charge. The detector is assumed to be corrected: blooming, and the
residuals of charge transfer and of the brighter-fatter effect, are left out.
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
    """Return copies of the planes (ny, nx) with a light.Light added.

    exptime [s]; background [e-/s]: subtracted from SCI; limit: maximum electrons of a pixel; response: (n,) float32 of
    the light's pixels, by which the image was divided, or None: 1.
    """
    sci = np.array(planes.sci)
    err = np.array(planes.err)
    dq = np.array(planes.dq)
    pixel = light.pixel
    fraction_counted = np.float32(1.0) if response is None else response
    rate = light.electrons / (fraction_counted * np.float32(exptime))
    variance = np.maximum(light.electrons, 0) / (fraction_counted * np.float32(exptime)) ** 2
    sci_pixels = sci.reshape(-1)
    err_pixels = err.reshape(-1)
    dq_pixels = dq.reshape(-1)
    sci_pixels[pixel] += rate
    err_pixels[pixel] = np.sqrt(err_pixels[pixel].astype(float) ** 2 + variance)
    maximum = limit / (fraction_counted * exptime) - background
    saturated = sci_pixels[pixel] > maximum
    sci_pixels[pixel] = np.where(saturated, maximum, sci_pixels[pixel])
    dq_pixels[pixel[saturated]] |= FULL
    return Planes(sci, err, dq)


def check_planes(path: PathLike, planes: Planes, header: Mapping[str, Any], window: Window) -> None:
    """Raise InputError if nothing can be injected into (SCI, ERR, DQ): wrong sizes or unit, errors not above 0."""
    err = planes.err
    if header.get("BUNIT") != UNIT:
        raise InputError("unknown unit of SCI", file=path, key="BUNIT", value=header.get("BUNIT"), allowed=UNIT)
    for name, plane in zip(("SCI", "ERR", "DQ"), planes, strict=True):
        if plane.shape != window.shape:
            raise InputError("not the size of the window", file=path, key=name, value=plane.shape, allowed=window.shape)
    invalid = int(np.count_nonzero(~(np.isfinite(err) & (err > 0))))
    if invalid:
        raise InputError(f"{invalid} of the errors are not numbers above 0", file=path, key="ERR")
