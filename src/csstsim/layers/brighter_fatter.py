"""Brighter-fatter effect (paper, Appendix B item 6; section 5.5.3): a 5 x 5 kernel from the covariances of flats.

Electrons move between neighbouring pixels, none is lost (csstsim.detector.brighter_fatter). It acts on counted
electrons, so it belongs after poisson_and_dark. Left out: differences between chips and wavelengths.
"""

import numpy as np

from csstsim.base.errors import InputError
from csstsim.detector import bfe_kernel
from csstsim.layers.param import LayerParam

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
AFTER = ("poisson_and_dark",)
_STABLE = 0.25  # of a pixel: boundaries that move more are no small shift, and the kernel's limiter would act on them


class Param(LayerParam):
    """obs_param of `brighter_fatter`: none; the covariances are the detector's (brighter_fatter.yaml)."""


def check(param, camera, pointing):
    """Raise InputError if the camera has no areas, or charge at full well could move a boundary by a quarter pixel."""
    _kernel(camera.detector)


def _kernel(detector):
    """Return (kernel (3, 3), skew) [per e-]. Raises InputError as `check`."""
    numbers = detector.brighter_fatter
    try:
        kernel, skew = bfe_kernel.kernel(float(numbers["scale"]) * np.array(numbers["areas"], float))
    except (KeyError, TypeError, ValueError):
        allowed = "areas (3 x 3 numbers) and scale"
        raise InputError("not usable", key="brighter_fatter.yaml", value=numbers or None, allowed=allowed) from None
    shift = detector.full_well * (np.abs(bfe_kernel.unfold(kernel)).sum() + abs(skew))
    if not shift < _STABLE:
        message, allowed = "boundaries move too far at full well", f"less than {_STABLE} pixels"
        raise InputError(message, key="brighter_fatter.yaml", value=shift, allowed=allowed)
    return kernel, skew


def apply(state, param, rng):
    """Move the charge of state.image, in place; the change of a pixel's own area [per e-] goes to the header.

    Raises ValueError if counted electrons were not merged, or a pixel is negative or not finite.
    """
    if state.counted is not None:
        raise ValueError("counted electrons were not merged: poisson_and_dark must come before brighter_fatter")
    detector = state.chip.detector
    push(state.image, detector)
    state.header["bfe_area"] = float(detector.brighter_fatter["scale"] * detector.brighter_fatter["areas"][0][0])
    return state


def push(image, detector):
    """Move the charge of an image (ny, nx), electrons, in place. Raises ValueError as `apply`."""
    from csstsim.detector.brighter_fatter import move_charge  # numba: half a second that checking need not pay

    move_charge(image, *_kernel(detector), detector.full_well)
