"""Scientific objects exposure (paper, Appendix B item 1; sections 4.1, 5.3).

The layer renders the chip's objects with the campaign's `fidelity`: expected electrons into the image, photons into the
counted plane. The truth table lists the rendered electrons of each object. On slitless chips the two gratings disperse
the light (section 4.2), and there is also a truth table of orders. Omitted: ghosts of dispersed light.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from pydantic import Field

from csstsim.catalog.selection.row_order import back, canonical_order, orders_back
from csstsim.catalog.selection.select import Noise
from csstsim.layers.param import EXPTIME, LayerParam
from csstsim.optics.gratings.dispersion import Disperser
from csstsim.optics.scatter.scattered_light import Scattered, read_scattered, scattered_light
from csstsim.optics.throughput.flat import FlatField, check_flat
from csstsim.optics.throughput.response import response_maximum

if TYPE_CHECKING:
    from csstsim.base.rng import Streams
    from csstsim.base.types import IntArray
    from csstsim.catalog.table import ObjectTable
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.render.canvas import Canvas
    from csstsim.render.drawing import Drawing
    from csstsim.simulation.state import State

STAGE = "render"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
EXPOSURES = ("SCIE",)


class Param(LayerParam):
    """obs_param of `scie_obs`."""

    exptime: float | None = Field(None, gt=0, le=1e5, description=EXPTIME)
    flat_fielding: bool = Field(True, description="vignetting and internal flat: the reversal of the flat correction")
    shutter_effect: bool = Field(True, description="the shutter exposes columns for different times")
    # Applied in the WCS of the job (campaign.opened), so that selection, rendering and measuring use the same map
    field_dist: bool = Field(True, description="field distortion: moves objects and changes their shapes")
    wings: bool = Field(True, description="flux of bright objects beyond the stored PSF's box")
    ghosts: bool = Field(True, description="reflections of bright stars between filter and detector")


def check(param: Param, camera: Camera, pointing: Pointing) -> None:
    """Raise InputError if the camera's parameters of the flat, the scattered light or the ghosts are wrong."""
    if param.flat_fielding:
        check_flat(camera.leds)
    _check_scattered(camera)


@lru_cache(1)  # once a camera, not once an exposure
def _check_scattered(camera: Camera) -> None:
    for filter in camera.filters.values():
        scattered_light(camera, filter)


def apply(state: State, param: Param, rng: Streams) -> State:
    """Render state.catalog into state.image [e-], in place; state.truth becomes the table of objects, same rows.

    Objects are rendered in the order of their ids, so that the pixels do not depend on the order of the catalogue's
    rows. The electrons added to the planes go to the header, for comparison with the table.
    """
    assert state.catalog is not None
    before = state.electrons()
    order = canonical_order(state.catalog)
    canvas = _canvas(state, rng)
    drawing = _drawing(state, param, rng)
    truth, *orders = _rendered(state, canvas, order, drawing)
    state.counted = canvas.counted
    state.truth = truth.take(back(order))
    state.orders = orders_back(orders[0], order) if orders else None
    state.header["objects_electrons"] = state.electrons() - before
    return state


def _canvas(state: State, rng: Streams) -> Canvas:
    from csstsim.render.canvas import Canvas

    exposure = state.exposure
    flat = FlatField(exposure.camera.leds, rng.camera) if exposure.losses.flat else None
    maximum = response_maximum(exposure.chip, exposure.filter, flat)
    return Canvas(state.image, state.window, state.response(rng), maximum, state.counted)


def _drawing(state: State, param: Param, rng: Streams) -> Drawing:
    from csstsim.render.drawing import Drawing  # loads numba (seconds), which checking a campaign does not need

    assert state.psf is not None  # the stage render gives it
    exposure = state.exposure
    detector = state.chip.detector
    scattered = read_scattered(state.psf)
    noise = Noise(exposure.filter.sky, detector.dark, detector.read_noise)
    return Drawing(
        exposure.wcs,
        state.psf,
        exposure.exptime,
        Scattered(scattered.wing if param.wings else None, scattered.ghosts if param.ghosts else None),
        exposure.fidelity,
        noise.variance(exposure.exptime),
        rng.exposure_key("photons"),
        state.tables,
        exposure.spacecraft,
        exposure.interval,
    )


def _rendered(state: State, canvas: Canvas, order: IntArray, drawing: Drawing) -> tuple[ObjectTable, ...]:
    """Render the objects in this order; return (objects,), with gratings (objects, orders), as tables."""
    from csstsim.render.parts.trails import draw_trailed

    assert state.catalog is not None  # the stage select gives it
    exposure = state.exposure
    objects = state.catalog.take(order)
    reference = drawing.fidelity == "reference"
    if exposure.gratings is None:
        if reference:
            from csstsim.render.imaging.reference import draw_objects
        else:
            from csstsim.render.imaging.draw import draw_objects
        return draw_trailed(draw_objects, canvas, objects, drawing)
    if reference:
        from csstsim.render.slitless.reference_dispersed import draw_objects as draw_dispersed
    else:
        from csstsim.render.slitless.draw_dispersed import draw_dispersed
    assert state.spectra is not None  # the stage render gives them behind gratings
    disperser = Disperser(exposure.gratings, exposure.filter, exposure.telescope)
    return draw_trailed(draw_dispersed, canvas, objects, drawing, state.spectra.take(order), disperser)
