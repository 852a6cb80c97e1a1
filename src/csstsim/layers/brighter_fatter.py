"""Brighter-fatter effect (paper, Appendix B item 6; section 5.5.3): a 5 x 5 kernel from the covariances of flats.

Electrons move between neighbouring pixels, none is lost (csstsim.detector.brighter_fatter). It acts on counted
electrons, so it belongs after poisson_and_dark. Left out: differences between chips and wavelengths.
"""

from csstsim.detector.bfe_kernel import detector_kernel
from csstsim.layers.param import LayerParam

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
AFTER = ("poisson_and_dark",)


class Param(LayerParam):
    """obs_param of `brighter_fatter`: none; the covariances are the detector's (brighter_fatter.yaml)."""


def check(param, camera, pointing):
    """Raise InputError if the camera has no areas, or charge at full well could move a boundary by a quarter pixel."""
    detector_kernel(camera.detector)


def apply(state, param, rng):
    """Move the charge of state.image, in place; the change of a pixel's own area [per e-] goes to the header.

    Raises ValueError if counted electrons were not merged, or a pixel is negative or not finite.
    """
    from csstsim.detector.brighter_fatter import move_charge  # numba: half a second that checking need not pay

    if state.counted is not None:
        raise ValueError("counted electrons were not merged: poisson_and_dark must come before brighter_fatter")
    detector = state.chip.detector
    move_charge(state.image, *detector_kernel(detector), detector.full_well)
    state.header["bfe_area"] = float(detector.brighter_fatter["scale"] * detector.brighter_fatter["areas"][0][0])
    return state
