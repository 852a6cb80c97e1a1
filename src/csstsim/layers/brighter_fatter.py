"""Brighter-fatter effect (paper, Appendix B item 6; section 5.5.3): a 5 x 5 kernel from the covariances of flats.

Charge moves between neighbouring pixels without loss (csstsim.detector.brighter_fatter). The effect acts on counted
electrons, so the layer must follow poisson_and_dark. Omitted: differences between chips and wavelengths.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.detector.bfe_kernel import detector_kernel
from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
AFTER = ("poisson_and_dark",)


class Param(LayerParam):
    """obs_param of `brighter_fatter`: none; the areas are those of the detector (brighter_fatter.yaml)."""


def check(param: Param, camera: Camera, pointing: Pointing) -> None:
    """Raise InputError if the camera has no areas, or if charge at full well could move a boundary by 0.25 pixel."""
    detector_kernel(camera.detector)


def apply(state: State, param: Param, rng: Streams) -> State:
    """Move the charge of state.image, in place; the change of a pixel's own area [per e-] goes to the header.

    Raises ValueError if counted electrons were not merged, or a pixel is negative or not finite.
    """
    from csstsim.detector.brighter_fatter import move_charge  # loads numba (0.5 s), which checking does not need

    if state.counted is not None:
        raise ValueError("counted electrons were not merged: poisson_and_dark must come before brighter_fatter")
    detector = state.chip.detector
    move_charge(state.image, *detector_kernel(detector), detector.full_well)
    state.header["bfe_area"] = float(detector.brighter_fatter["scale"] * detector.brighter_fatter["areas"][0][0])
    return state
