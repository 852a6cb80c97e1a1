"""Sky background and stray light (paper, Appendix B item 2).

Adds the expected sky of the band to every pixel: the filter's constant, or the model of csstsim.optics.sky.background,
averaged over three moments of the exposure (Gauss and Legendre). Behind gratings this is the sky of a complete first
order; csstsim.optics.sky.dispersed replaces it by all orders with their edges. The sky has the same flat field and
shutter effect as the objects. Omitted: change of the sky during the motion of the shutter, which differs between
columns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from pydantic import Field

from csstsim.base.errors import BlockedError
from csstsim.base.units import DAY_S
from csstsim.instrument.orbit import orbit_after
from csstsim.layers.param import EXPTIME, LayerParam
from csstsim.optics.sky import background
from csstsim.optics.sky.bodies import exposure_angles
from csstsim.optics.sky.directions import telescope_axes
from csstsim.optics.sky.near_stars import stars_about
from csstsim.optics.sky.parameters import sky_numbers
from csstsim.optics.throughput.flat import check_flat
from csstsim.simulation.state import State

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Any

    from csstsim.base.rng import Streams
    from csstsim.base.types import FloatArray, Floats
    from csstsim.instrument.camera import Camera
    from csstsim.instrument.pointing import Pointing
    from csstsim.simulation.exposure import Exposure

STAGE = "render"
UNITS = ("electron", "electron")
FRAME = ("active", "active")
EXPOSURES = ("SCIE",)
# Moments of an exposure, as fractions of it, and their weights: right to 0.1% while the limb moves by 10 deg
PARTS = 0.5 + np.array([-0.5, 0.0, 0.5]) * np.sqrt(0.6)
WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18


class Param(LayerParam):
    """obs_param of `sky_background`."""

    exptime: float | None = Field(None, gt=0, le=1e5, description=EXPTIME)
    flat_fielding: bool = Field(True, description="vignetting and internal flat: the reversal of the flat correction")
    shutter_effect: bool = Field(True, description="the shutter exposes columns for different times")
    enable_straylight_model: bool = Field(
        False,
        description="true = zodiacal light, earthshine, Sun, Moon, planets and stars that are not rendered, at "
        "the exposure's time and position; false = the filter's constant `sky`",
    )


def check(param: Param, camera: Camera, pointing: Pointing) -> None:
    """Raise InputError if parameters of the flat or the model are wrong, BlockedError if the Earth is in the way."""
    if param.flat_fielding:
        check_flat(camera.leds)
    if not param.enable_straylight_model:
        return
    sky_numbers(camera.sky)
    spacecraft = pointing.mjd, pointing.sat_position, pointing.sat_velocity
    limb = exposure_angles(pointing.ra, pointing.dec, *spacecraft)["limb"]
    if limb < 0:
        raise BlockedError(f"the exposure of {pointing.time} looks at the Earth: limb angle {limb:.2f} deg")


def apply(state: State, param: Param, rng: Streams) -> State:
    """Add the sky [e-] to state.image (of the window's shape), in place; rates go to the header.

    Raises InputError if the model is enabled and the telescope looks at the Earth or close to the Sun.
    """
    pointing = state.pointing
    exptime = state.exposure.exptime
    gratings = state.exposure.gratings
    sky = _model(state) if param.enable_straylight_model else _constant(state)
    rate = sky.rate
    means = sky.means
    response = state.response(rng)
    if gratings is not None:
        rate = _disperse(state, sky, _sun_angle(pointing), response) / exptime
        means = {name: mean * rate / sky.rate for name, mean in means.items()}
    else:
        _add(state.image, sky.electrons, response)
    state.header |= {"sky_rate": rate} | {f"sky_{name}": mean for name, mean in means.items()}
    return state


def mean_rate(exposure: Exposure, param: Param) -> float:
    """Return the mean sky of an imaging chip's window [e-/s/px] before all losses; exposure: an Exposure."""
    if not param.enable_straylight_model:
        return exposure.filter.sky
    return sum(background.grid_mean(part) for part in _components(exposure).values())


def dispersed_sky(exposure: Exposure, param: Param) -> FloatArray:
    """Return the sky [e-] of a slitless chip's window before all losses, (ny, nx) float32; exposure: Exposure."""
    state = State.blank(exposure)
    sky = _model(state) if param.enable_straylight_model else _constant(state)
    _disperse(state, sky, _sun_angle(state.pointing), None)
    return state.image


def _sun_angle(pointing: Pointing) -> float:
    return exposure_angles(pointing.ra, pointing.dec, pointing.mjd, pointing.sat_position, pointing.sat_velocity)["sun"]


class _Sky(NamedTuple):
    """The sky of an exposure before losses.

    electrons [e-/px]: a number, or an array at the nodes of a grid; rate: its mean [e-/s/px]; means: {component: mean
    rate [e-/s/px]}, empty for the filter's constant.
    """

    electrons: Floats
    rate: float
    means: dict[str, float]


def _constant(state: State) -> _Sky:
    """Return the filter's constant sky."""
    return _Sky(background.sky_electrons(state.filter, state.exposure.exptime), state.filter.sky, {})


def _model(state: State) -> _Sky:
    """Return the sky of the model."""
    parts = _components(state.exposure)
    rate: Any = sum(parts.values())
    means = {name: background.grid_mean(part) for name, part in parts.items()}
    return _Sky(state.exposure.exptime * rate, background.grid_mean(rate), means)


def _rows(sky: Floats, shape: tuple[int, int]) -> Callable[[slice], FloatArray]:
    """Return the function that csstsim.optics.sky.dispersed.disperse takes: slice of rows -> (rows, nx) float32."""
    if not isinstance(sky, np.ndarray):
        even = np.broadcast_to(np.float32(sky), shape)
        return lambda rows: np.ascontiguousarray(even[rows])

    def model(rows: slice) -> FloatArray:
        part = np.zeros((rows.stop - rows.start, shape[1]), np.float32)
        background.add_grid(part, sky, rows, shape[0])
        return part

    return model


def _disperse(state: State, sky: _Sky, sun_angle: float, response: FloatArray | None) -> float:
    """Add a sky through the gratings; return its mean before losses [e-/px]."""
    from csstsim.optics.sky.dispersed import disperse, nominal_spectrum, sky_spectrum

    numbers = sky_numbers(state.exposure.camera.sky)
    filter_ = state.filter
    if sky.means:
        spectrum = sky_spectrum(filter_, sky.means, sun_angle, numbers)
    else:
        spectrum = nominal_spectrum(filter_, numbers)
    rows = _rows(sky.electrons, state.image.shape)
    assert state.exposure.gratings is not None
    return disperse(state.image, rows, state.exposure.gratings, state.window, spectrum, response)


def _add(image: FloatArray, sky: Floats, response: FloatArray | None) -> None:
    """Add the sky of an imaging chip, a number or the values at a grid's nodes, in place."""
    if isinstance(sky, np.ndarray):
        values = sky
        sky = np.zeros_like(image)
        background.add_grid(sky, values)
    if response is None:
        image += sky
        return
    from csstsim.optics.sky.frames import add_product

    add_product(image, np.broadcast_to(np.asarray(sky, np.float32), image.shape), response)


def _components(exposure: Exposure) -> dict[str, FloatArray]:
    """Return {component: e-/s/px at the nodes of a grid}, averaged in time; the grid is fine near a bright star."""
    pointing = exposure.pointing
    telescope = exposure.telescope
    numbers = sky_numbers(exposure.camera.sky)
    rates = background.band_rates(exposure.filter, telescope, exposure.chip.detector.pixel_um, numbers)
    axes = telescope_axes(pointing.ra, pointing.dec, pointing.pa, telescope.parity)
    distant, adjacent = stars_about(exposure, numbers)
    sights = background.lines_of_sight(exposure.wcs, exposure.window)
    times = moments(pointing, exposure.exptime)
    skies = [background.sky_components(rates, axes, sights, moment, numbers, distant) for moment in times]
    parts = {name: _mean([sky[name] for sky in skies]) for name in background.COMPONENTS}
    if adjacent.any():
        parts = {name: background.refined(part, background.FINE_NODES) for name, part in parts.items()}
        fine = background.lines_of_sight(exposure.wcs, exposure.window, background.FINE_NODES)
        light = [background.star_light(axes, fine, moment, numbers, adjacent) for moment in times]
        parts["stars"] += np.einsum("k,km->m", rates["stars"], _mean(light))
    return parts


class Moment(NamedTuple):
    """The spacecraft at one time: MJD (UTC), geocentric position [km] and velocity [km / s]."""

    mjd: float
    position: tuple[float, float, float]
    velocity: tuple[float, float, float]


def moments(pointing: Pointing, exptime: float) -> list[Moment]:
    """Return the spacecraft at PARTS of an exposure of `exptime` seconds."""
    state = pointing.sat_position, pointing.sat_velocity
    return [Moment(pointing.mjd + after / DAY_S, *orbit_after(*state, after)) for after in exptime * PARTS]


def _mean(values: Sequence[FloatArray]) -> FloatArray:
    """Return the mean over the exposure of values at PARTS."""
    return sum(weight * value for weight, value in zip(WEIGHTS, values, strict=True))
