"""The response to light from the sky: flat field x shutter x pixel response (PRNU), the same for all sources."""

import numpy as np

from csstsim.detector import prnu as pixels
from csstsim.optics.throughput.flat import FlatField, check_flat
from csstsim.optics.throughput.shutter import exposed

_ROUNDING = 1e-6


def response_maximum(chip, filter, leds, camera, *, flat, shutter):
    """Return an upper limit of `response_map` for a chip, for all pixels in any window.

    Photons are drawn for this times the flux and then thinned (detector.noise.thin). The maximum of the shutter is 1.
    The maximum of the pixel response is always included, so that the random numbers of photons do not depend on PRNU.
    """
    highest = pixels.highest(chip.detector.prnu) * (1 + _ROUNDING)  # rounding of float32
    if not flat:
        return highest
    check_flat(leds)
    return highest * float(FlatField(leds, camera).external_grid(chip, filter).max())  # bilinear: its nodes are highest


def response_map(chip, window, filter, exptime, leds, camera, *, flat, shutter, prnu=None):
    """Return (ny, nx) float32, the fraction of nominal light that is detected; None if all losses are off.

    leds: Camera.leds; camera: function of a name that returns a Generator, the same in all exposures
    (rng.Streams.camera); prnu: uint64, the chip's key (rng.Streams.chip_key) of the pixel response, or None: no PRNU.
    Raises InputError.
    """
    if not (flat or shutter) and prnu is None:
        return None
    if flat:
        check_flat(leds)
        out = FlatField(leds, camera).external_map(chip, window, filter)
    else:
        out = np.ones(window.shape, np.float32)
    if shutter:
        out *= exposed(chip, window, exptime).astype(np.float32)
    if prnu is not None:
        pixels.multiply(out, window.x0, window.y0, chip.detector.prnu, prnu)
    return out
