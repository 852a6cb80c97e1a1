"""What light from the sky loses before it is counted: flat field x shutter, the same for all that brings light."""

import numpy as np

from csstsim.optics.flat import FlatField, check_flat
from csstsim.optics.shutter import exposed

_ROUNDING = 1e-6


def response_maximum(chip, filter, leds, camera, *, flat, shutter):
    """Return the maximum that `response_map` declares for a chip: no pixel of it, in any window, is above.

    Light to be thinned (detector.noise.thin) is counted with this times its flux. The shutter's own is 1.
    """
    if not flat:
        return 1.0
    check_flat(leds)
    highest = FlatField(leds, camera).external_grid(chip, filter).max()  # bilinear: never above its nodes ...
    return float(highest) * (1 + _ROUNDING)  # ... but for float32


def response_map(chip, window, filter, exptime, leds, camera, *, flat, shutter):
    """Return (ny, nx) float32, the share of nominal light that is counted; None if neither `flat` nor `shutter`.

    leds: Camera.leds; camera: name -> Generator that lasts for the camera (rng.Streams.camera). Raises InputError.
    """
    if not (flat or shutter):
        return None
    if flat:
        check_flat(leds)
        out = FlatField(leds, camera).external_map(chip, window, filter)
    else:
        out = np.ones(window.shape, np.float32)
    if shutter:
        out *= exposed(chip, window, exptime).astype(np.float32)
    return out
