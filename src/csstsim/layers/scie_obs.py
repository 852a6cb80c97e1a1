"""Scientific objects exposure (paper, Appendix B item 1; sections 4.1, 5.3).

Draws the chip's objects, as the campaign's `fidelity` asks: expected electrons into the image, electrons drawn one by
one into the counted plane; what was drawn of each is kept as truth. On spectroscopic chips their light goes through the
two gratings (section 4.2), and truth is kept order by order besides. Left out: ghosts of dispersed light.
"""

from functools import cache

from pydantic import Field

from csstsim.catalog.selection.row_order import back, canonical_order, orders_back
from csstsim.catalog.selection.select import Noise
from csstsim.layers.param import EXPTIME, LayerParam
from csstsim.optics.gratings.dispersion import Disperser
from csstsim.optics.scatter.outside_box import Beyond, beyond_box, read_beyond
from csstsim.optics.throughput.flat import check_flat
from csstsim.optics.throughput.response import response_maximum

STAGE = "render"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
EXPOSURES = ("SCIE",)


class Param(LayerParam):
    """obs_param of `scie_obs`."""

    exptime: float | None = Field(None, gt=0, le=1e5, description=EXPTIME)
    flat_fielding: bool = Field(True, description="vignetting and internal flat: the reversal of the flat correction")
    shutter_effect: bool = Field(True, description="columns far from the middle miss the shutter's opening and closing")
    # The WCS of the job (campaign.opened) has it: selection, rendering and measuring share one map.
    field_dist: bool = Field(True, description="field distortion: moves objects and changes their shapes")
    wings: bool = Field(True, description="light of bright objects beyond the stored PSF's box")
    ghosts: bool = Field(True, description="reflections of bright stars between filter and detector")


def check(param, camera, pointing):
    """Raise InputError if the camera's numbers for the flat, the scattered light or the ghosts are wrong."""
    if param.flat_fielding:
        check_flat(camera.leds)
    _check_beyond(camera)


@cache
def _check_beyond(camera):
    for filter in camera.filters.values():
        beyond_box(camera, filter)


def apply(state, param, rng):
    """Draw state.catalog into state.image [e-], in place; state.truth becomes the table of drawn objects, row by row.

    Objects are drawn by id: the catalogue's rows may be in any order, the pixels are the same.
    What the planes gained goes to the header, so that the table can be held against it.
    """
    before, given = state.electrons(), (state.catalog, state.spectra)
    order = canonical_order(state.catalog)
    state.catalog = state.catalog.take(order)
    state.spectra = None if state.spectra is None else state.spectra.take(order)
    _draw(state, param, rng)
    state.catalog, state.spectra = given
    state.truth = state.truth.take(back(order))
    state.orders = None if state.orders is None else orders_back(state.orders, order)
    state.header["objects_electrons"] = state.electrons() - before
    return state


def _draw(state, param, rng):
    exptime = state.pointing.exptime if param.exptime is None else param.exptime
    there = read_beyond(state.psf)
    beyond = Beyond(there.wing if param.wings else None, there.ghosts if param.ghosts else None)
    losses = {"flat": param.flat_fielding, "shutter": param.shutter_effect}
    response = state.response(exptime, rng, **losses)
    if state.fidelity == "reference":
        _reference(state, exptime, beyond, response)
        return
    detector = state.chip.detector
    how = {
        "tables": state.tables, "beyond": beyond, "response": response,
        "maximum": response_maximum(state.chip, state.filter, state.leds, rng.camera, **losses),
        "variance": Noise(state.filter.sky, detector.dark, detector.read_noise).variance(exptime),
        "key": rng.exposure_key("photons"), "fidelity": state.fidelity,
    }  # fmt: skip
    place = state.wcs, state.psf, exptime
    # numba: seconds that checking a campaign need not pay
    if state.gratings is None:
        from csstsim.render.imaging.draw import draw_objects

        state.truth, state.counted = draw_objects(state.image, state.window, state.catalog, *place, **how)
    else:
        from csstsim.render.slitless.draw_dispersed import draw_dispersed

        disperser = Disperser(state.gratings, state.filter, state.telescope)
        state.truth, state.orders, state.counted = draw_dispersed(
            state.image, state.window, state.catalog, state.spectra, disperser, *place, **how
        )


def _reference(state, exptime, beyond, response):
    """Draw by the reference renderer, tables of what was drawn included."""
    place = state.wcs, state.psf, exptime, beyond, response
    if state.gratings is None:
        from csstsim.render.imaging.reference import draw_objects

        state.truth = draw_objects(state.image, state.window, state.catalog, *place)
    else:
        from csstsim.render.slitless.reference_dispersed import draw_objects

        disperser = Disperser(state.gratings, state.filter, state.telescope)
        scene = state.image, state.window, state.catalog, state.spectra, disperser
        state.truth, state.orders = draw_objects(*scene, *place)
