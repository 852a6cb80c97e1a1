"""Cosmic ray accumulation (paper, Appendix B item 4; section 5.5.6).

Rays hit during the exposure and half of the readout, the mean time until a row is read. So a bias frame has rays, too.
Their electrons are added to the counted ones, which poisson_and_dark must then merge. csstsim.detector.cosmic_ray
states what is omitted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from csstsim.base.errors import InputError
from csstsim.layers.param import EXPTIME, LayerParam

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
BEFORE = ("poisson_and_dark",)


class Param(LayerParam):
    """obs_param of `cosmic_rays`."""

    exptime: float | None = Field(None, ge=0, le=1e5, description=EXPTIME)
    save_cosmic_image: bool = Field(
        False, description="true: write the rays' electrons to a file next to the Level-0 file"
    )


def check(param: Param, camera: Camera, pointing: Pointing) -> None:
    """Raise InputError if the camera has no parameters of cosmic rays."""
    if camera.detector.cosmic_rays is None:
        raise InputError("the layer cosmic_rays needs this file", file=camera.folder / "cosmic_rays.yaml")


def apply(state: State, param: Param, rng: Streams) -> State:
    """Add the rays' electrons to state.counted, in place (made if it is None), and set bits of state.mask.

    Statistics go to the header.

    Raises ValueError if the image does not have the shape of the active pixels.
    """
    from csstsim.detector import mask
    from csstsim.detector.cosmic_ray import deposit, draw_tracks

    detector = state.chip.detector
    shape = state.window.shape
    if state.image.shape != shape:
        raise ValueError(f"an image of shape {state.image.shape}; the window's is {shape}")
    rays = detector.cosmic_rays
    exptime = state.exposure.exptime
    tracks = draw_tracks(shape, exptime + detector.readout_time / 2, rays, rng.exposure("tracks"))
    pixel, electrons, hits = deposit(shape, tracks, rays.diffusion, rng.exposure_key("diffusion"))
    state.add_counted(pixel, electrons)
    marked = pixel[electrons >= rays.marked_from]
    if state.mask is not None:
        state.mask.reshape(-1)[marked] |= mask.COSMIC_RAY
    if param.save_cosmic_image:
        state.cosmic_rays = pixel, electrons
    state.header |= {
        "cosmic_tracks": hits,
        "cosmic_pixels": len(marked),
        "cosmic_electrons": int(electrons.sum(dtype="int64")),
    }
    return state
