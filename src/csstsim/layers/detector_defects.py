"""Hot pixels, dead pixels and invalid columns (paper, Appendix B item 7; sections 5.5.7 and 5.5.8).

Their positions are fixed for each chip, random or from a laboratory map (instrument.maps). They are in exposures of all
kinds. Their charge depends on the background of the image. csstsim.detector.defects states what is omitted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydantic import Field

from csstsim.base.errors import InputError
from csstsim.layers.param import LayerParam

if TYPE_CHECKING:
    from typing import Any

    from csstsim.base.rng import Streams
    from csstsim.base.types import AnyArray, IntArray
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.state import State

STAGE = "readout"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
AFTER = ("poisson_and_dark",)


class Param(LayerParam):
    """obs_param of `detector_defects`."""

    hot_pixels: bool = Field(True, description="pixels whose dark current is above 0.1 e-/s")
    dead_pixels: bool = Field(True, description="pixels with at most 70% of the background")
    bad_columns: bool = Field(True, description="columns brighter and noisier than the background")


def check(param: Param, camera: Camera, pointing: Pointing) -> None:
    """Raise InputError if the camera has no parameters of defects."""
    if camera.detector.defects is None:
        raise InputError("the layer detector_defects needs this file", file=camera.folder / "defects.yaml")


def apply(state: State, param: Param, rng: Streams) -> State:
    """Put the defects into state.image, in place; their numbers in the window go to the header.

    Raises ValueError if counted electrons were not merged, or if the image has values that are not finite.
    """
    from csstsim.detector.defects import background

    if state.counted is not None:
        raise ValueError("counted electrons were not merged: poisson_and_dark must come before detector_defects")
    before = state.electrons()
    level = background(state.image, before)
    state.header |= {"hot_pixels": 0, "dead_pixels": 0, "bad_columns": 0, "defects_level": level}
    if state.chip.maps.bad_pixels:
        _mapped(state, param, level, rng)
    else:
        if param.hot_pixels or param.dead_pixels:
            _pixels(state, param, level, rng)
        if param.bad_columns:
            _columns(state, level, rng)
    state.header["defects_electrons"] = state.electrons() - before
    return state


def _pixels(state: State, param: Param, level: float, rng: Streams) -> None:
    from csstsim.detector import defects, mask

    detector = state.chip.detector
    numbers = state.chip.detector.defects
    charge: AnyArray
    hot, dead = defects.defective_pixels((detector.ny, detector.nx), numbers, rng.chip("defective pixels"))
    if param.hot_pixels:
        draws = rng.chip("hot pixels"), rng.exposure("hot pixels")
        charge = defects.hot_charge(len(hot), state.pointing.exptime, numbers, *draws)
        which, y, x = defects.in_window(hot, detector.nx, state.window)
        state.image[y, x] += charge[which]
        _mark(state, (y, x), mask.HOT)
        state.header["hot_pixels"] = len(y)
    if param.dead_pixels:
        draws = rng.chip("dead pixels"), rng.exposure("dead pixels")
        charge = defects.dead_charge(len(dead), level, numbers, *draws)
        which, y, x = defects.in_window(dead, detector.nx, state.window)
        state.image[y, x] = charge[which]
        _mark(state, (y, x), mask.DEAD)
        state.header["dead_pixels"] = len(y)


def _columns(state: State, level: float, rng: Streams) -> None:
    from csstsim.detector import defects, mask

    detector = state.chip.detector
    numbers = state.chip.detector.defects
    window = state.window
    noise = rng.exposure("bad columns")
    for column, first, end, u in defects.bad_columns(
        detector.channel_ny, detector.nx, numbers, rng.chip("bad columns")
    ):
        charge = defects.column_charge(end - first, u, level, detector.read_noise, numbers, noise)
        low = max(first, window.y0)
        high = min(end, window.y1)
        if window.x0 <= column < window.x1 and low < high:
            pixels = slice(low - window.y0, high - window.y0), column - window.x0
            state.image[pixels] = charge[low - first : high - first]
            _mark(state, pixels, mask.BAD_COLUMN)
            state.header["bad_columns"] += 1


def _mapped(state: State, param: Param, level: float, rng: Streams) -> None:
    """Put the defects of the laboratory map into the window, in the order of random ones."""
    from csstsim.detector import mapped_defects as defects
    from csstsim.detector import mask

    detector = state.chip.detector
    window = state.window
    numbers = state.chip.detector.defects
    bits = state.chip.maps.bad_pixels.part(*window.slices)

    def marked(bit: int, name: str) -> _Defects:
        y, x = np.nonzero(bits & bit)
        _mark(state, (y, x), bit)
        return _Defects((y, x), x + window.x0, y + window.y0, (rng.chip_key(name), rng.exposure_key(name)))

    if param.hot_pixels:
        hot = marked(mask.HOT, "hot pixels")
        state.image[hot.pixels] += defects.hot_charge(hot.x, hot.y, state.pointing.exptime, numbers, *hot.keys)
        state.header["hot_pixels"] = len(hot.x)
    if param.dead_pixels:
        dead = marked(mask.DEAD, "dead pixels")
        state.image[dead.pixels] = defects.dead_charge(dead.x, dead.y, level, numbers, *dead.keys)
        state.header["dead_pixels"] = len(dead.x)
    if param.bad_columns:
        bad = marked(mask.BAD_COLUMN, "bad columns")
        half = detector.channel_ny
        noise = detector.read_noise
        state.image[bad.pixels] = defects.column_charge(bad.x, bad.y, half, level, noise, numbers, *bad.keys)
        state.header["bad_columns"] = len(np.unique(2 * bad.x + bad.y // half))


class _Defects(NamedTuple):
    """Defects (n,) of one kind in a window: its pixels (y, x), x and y on the chip, keys of the chip and exposure."""

    pixels: tuple[IntArray, IntArray]
    x: IntArray
    y: IntArray
    keys: tuple[np.uint64, np.uint64]


def _mark(state: State, pixels: tuple[Any, Any], bit: int) -> None:
    if state.mask is not None:
        state.mask[pixels] |= bit
