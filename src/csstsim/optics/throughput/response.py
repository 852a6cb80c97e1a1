"""What light from the sky loses before it is counted: flat field x shutter x pixel response (PRNU), the same for all
that brings light."""

import numpy as np

from csstsim.detector import prnu as pixels
from csstsim.optics.throughput.flat import FlatField, check_flat
from csstsim.optics.throughput.shutter import exposed

_ROUNDING = 1e-6


def response_maximum(chip, filter, leds, camera, *, flat, shutter):
    """Return the maximum that `response_map` declares for a chip: no pixel of it, in any window, is above.

    Light to be thinned (detector.noise.thin) is counted with this times its flux. The shutter's own is 1; that of the
    pixels is always in it, so that photons have the same random numbers with PRNU and without.
    """
    highest = pixels.highest(chip.detector.prnu) * (1 + _ROUNDING)  # of float32
    if not flat:
        return highest
    check_flat(leds)
    return highest * float(FlatField(leds, camera).external_grid(chip, filter).max())  # bilinear: its nodes are highest


def response_map(chip, window, filter, exptime, leds, camera, *, flat, shutter, prnu=None):
    """Return (ny, nx) float32, the share of nominal light that is counted; None if no loss is asked for.

    leds: Camera.leds; camera: name -> Generator that lasts for the camera (rng.Streams.camera); prnu: uint64, the
    chip's key (rng.Streams.chip_key) of the pixels' response, or None to leave it out. Raises InputError.
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
