"""Sky background (paper, section 5.5.1): one constant per band, or the sum of the model's components.

The model's components [e-/s/px] are computed on a coarse grid of lines of sight and interpolated bilinearly:

    zodiacal                          of the field itself (csstsim.optics.sky.zodiacal)
    earth, sun, moon, planets, stars  stray light from where nothing is rendered: point-source transmittance and
                                      aperture door; sources behind the Earth give none; stars: optics.sky.starlight

Left out: scattered light and ghosts of objects that are rendered, which are not background; zodiacal light from outside
the field (0.1% of the diffuse sky scatters in); airglow, which above the orbit has only lines shortward of the bands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.resampling import read_at
from csstsim.base.sphere import angle, unit_vectors
from csstsim.optics.sky import zodiacal
from csstsim.optics.sky.background_spectra import band, blackbody_over_sun, magnitude_ratio, pixel_etendue, sunlight
from csstsim.optics.sky.bodies import bodies, earth_radius
from csstsim.optics.sky.directions import helioecliptic, in_telescope
from csstsim.optics.sky.earthshine import earthshine
from csstsim.optics.sky.starlight import FAINT_MAGNITUDE, faint_starlight, star_directions
from csstsim.optics.sky.transmittance import angles, total

if TYPE_CHECKING:
    from collections.abc import Mapping

    from csstsim.base.types import BoolArray, FloatArray, Floats
    from csstsim.instrument.chip import Window
    from csstsim.instrument.filter import Filter
    from csstsim.instrument.telescope import Telescope
    from csstsim.optics.geometry.wcs import ChipWCS
    from csstsim.optics.sky.parameters import SkyNumbers

COMPONENTS = ("zodiacal", "earth", "sun", "moon", "planets", "stars")
NODES = 5  # per side; bilinear interpolation errs by 2% for a star 0.4 deg off the chip
FINE_NODES = 65  # of stars that are nearer: 1% for one whose wings just end before the frame

Moment: TypeAlias = tuple[float, tuple[float, float, float], tuple[float, float, float]]  # MJD, position, velocity


def sky_electrons(filter_: Filter, exptime: float) -> float:
    """Return the expected nominal sky in one pixel [e-] for an exposure of `exptime` seconds."""
    return filter_.sky * exptime


def band_rates(filter_: Filter, telescope: Telescope, pixel_um: float, numbers: SkyNumbers) -> dict[str, FloatArray]:
    """Return what each kind of `sky_light` gives in a band [e-/s/px], {name: float or array}, for `in_band`.

    zodiacal (2,): for I = 1 in the law's two colours. The others are for transmittance 1. sun: at 1 au; earth: the
    same sunlight times the Earth's albedo; stars (kinds,), starlight: a star as bright in V as the Sun.
    """
    wave = filter_.wavelength
    pixel = (1e-6 * pixel_um) ** 2
    sun = sunlight(wave, numbers)
    earth = numbers.earth.albedo * read_at(wave, *numbers.earth.spectrum.T)
    kelvins = [*np.unique(numbers.stars[:, 3]), numbers.starlight.temperature]
    shapes = pixel * np.array([band(filter_, blackbody_over_sun(wave, kelvin, numbers)) for kelvin in kelvins])
    return {
        "zodiacal": pixel_etendue(telescope) * band(filter_, zodiacal.spectrum(wave, numbers)),
        "sun": pixel * band(filter_, sun),
        "earth": pixel * band(filter_, sun * earth),
        "stars": shapes[:-1],
        "starlight": shapes[-1],
    }


def sky_light(
    axes: FloatArray, sights: FloatArray, moment: Moment, numbers: SkyNumbers, stars: BoolArray | None = None
) -> dict[str, FloatArray]:
    """Return the light of every source along lines of sight (m, 3), of no band yet: `in_band` makes components of it.

    axes: sky.directions.telescope_axes; sights: unit vectors on GCRS axes; moment: (UTC MJD, position [km], velocity
    [km/s]) of the spacecraft, geocentric GCRS; numbers: SkyNumbers; stars: which of the list shine, bool (n,) or
    (m, n); None: all. Raises InputError if the Earth is in the way, or the Sun is closer than the table of zodiacal
    light reaches.
    """
    spacecraft = np.asarray(moment[1], dtype=float)
    limb = float(angle(axes[2], -spacecraft) - np.degrees(earth_radius(spacecraft)))
    if limb < 0:
        raise InputError(
            "the telescope looks at the Earth", key="limb angle [deg]", value=round(limb, 2), allowed="> 0"
        )
    sky = bodies(*moment, numbers)
    longitude, latitude = helioecliptic(sights, sky.sun)
    level = zodiacal.intensity(longitude, latitude, numbers)
    colours = zodiacal.mixture(zodiacal.elongation(longitude, latitude), numbers)
    door_azimuth = angles(axes @ sky.sun)[1]
    local_sights = in_telescope(axes, sights)
    planets = magnitude_ratio(sky.planet_magnitudes, numbers)
    sources = np.array([sky.sun, sky.moon, *sky.planets])
    transmitted = seen_past_the_earth(sources, axes, local_sights, spacecraft, door_azimuth, numbers)
    return {
        "zodiacal": colours * level,
        "earth": earthshine(spacecraft, sky.sun, axes, local_sights, door_azimuth, numbers) / sky.sun_au**2,
        "sun": transmitted[:, 0] / sky.sun_au**2,
        "moon": transmitted[:, 1] * magnitude_ratio(sky.moon_magnitude, numbers),
        "planets": np.einsum("mn,n->m", transmitted[:, 2:], planets),
        "stars": star_light(axes, sights, moment, numbers, stars),
        "starlight": magnitude_ratio(FAINT_MAGNITUDE, numbers)
        * faint_starlight(axes, spacecraft, door_azimuth, numbers),
    }


def star_light(
    axes: FloatArray, sights: FloatArray, moment: Moment, numbers: SkyNumbers, stars: BoolArray | None = None
) -> FloatArray:
    """Return (kinds, m): light of the stars of the list by temperature, over that of the Sun at 1 au (`sky_light`)."""
    directions = star_directions(numbers)
    kinds = np.unique(numbers.stars[:, 3], return_inverse=True)[1]
    shine = np.ones(len(kinds), bool) if stars is None else stars
    rows = np.flatnonzero(shine.any(axis=0) if shine.ndim > 1 else shine)
    door_azimuth = angles(axes @ bodies(*moment, numbers).sun)[1]
    local_sights = in_telescope(axes, sights)
    light = seen_past_the_earth(
        directions[rows], axes, local_sights, np.asarray(moment[1], float), door_azimuth, numbers
    )
    light *= magnitude_ratio(numbers.stars[rows, 2], numbers) * shine[..., rows]
    summed = np.zeros((kinds.max(initial=-1) + 1, len(sights)))
    np.add.at(summed, kinds[rows], light.T)
    return summed


def seen_past_the_earth(
    directions: FloatArray,
    axes: FloatArray,
    local_sights: FloatArray,
    spacecraft: FloatArray,
    door_azimuth: Floats,
    numbers: SkyNumbers,
) -> FloatArray:
    """Return (m, n): the transmittance of sources to lines of sight; 0 for sources behind the Earth.

    directions: (n, 3), GCRS; local_sights: (m, 3), in the telescope's frame; spacecraft: its position (3,) [km].
    """
    light = total(in_telescope(axes, directions), local_sights, door_azimuth, numbers)
    return light * (angle(directions, -spacecraft) > np.degrees(earth_radius(spacecraft)))


def in_band(light: Mapping[str, FloatArray], rates: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return {component: (m,) e-/s/px} of a `sky_light` in the band of `rates` (`band_rates`)."""
    parts = {name: rates["sun"] * light[name] for name in ("sun", "moon", "planets")}
    return {
        "zodiacal": np.einsum("k,km->m", rates["zodiacal"], light["zodiacal"]),
        "earth": rates["earth"] * light["earth"],
        **parts,
        "stars": np.einsum("k,km->m", rates["stars"], light["stars"]) + rates["starlight"] * light["starlight"],
    }


def sky_components(
    rates: Mapping[str, FloatArray],
    axes: FloatArray,
    sights: FloatArray,
    moment: Moment,
    numbers: SkyNumbers,
    stars: BoolArray | None = None,
) -> dict[str, FloatArray]:
    """Return {component: (m,) e-/s/px} for lines of sight (m, 3): `in_band` of `sky_light`."""
    return in_band(sky_light(axes, sights, moment, numbers, stars), rates)


def lines_of_sight(wcs: ChipWCS, window: Window, nodes: int = NODES) -> FloatArray:
    """Return (nodes^2, 3): unit vectors of the grid over the window's pixel centres, rows along x."""
    x, y = np.meshgrid(np.linspace(window.x0, window.x1 - 1, nodes), np.linspace(window.y0, window.y1 - 1, nodes))
    return unit_vectors(*wcs.pixel_to_world(x.ravel(), y.ravel()))


def grid_mean(values: FloatArray) -> float:
    """Return the mean of the bilinear image that `add_grid` makes from the values at `lines_of_sight`."""
    nodes = _side(values)
    end = np.ones(nodes)
    end[[0, -1]] = 0.5
    return float(np.einsum("i,j,ij->", end, end, values.reshape(nodes, nodes)) / (nodes - 1) ** 2)


def refined(values: FloatArray, nodes: int) -> FloatArray:
    """Return (nodes^2,): the bilinear image of `values` at the nodes of a finer grid, which has those of `values`."""
    side = _side(values)
    old = np.linspace(0.0, 1.0, side)
    new = np.linspace(0.0, 1.0, nodes)
    along = np.array([np.interp(new, old, row) for row in values.reshape(side, side)])
    return np.array([np.interp(new, old, column) for column in along.T]).T.ravel()


def _side(values: FloatArray) -> int:
    return round(len(values) ** 0.5)


def add_grid(image: FloatArray, values: FloatArray, rows: slice = slice(None), height: int | None = None) -> None:
    """Add to `image` (float32), in place, the bilinear expansion of values at `lines_of_sight`.

    image may be some `rows`, a slice, of a window of this height.
    """
    from csstsim.optics.sky.frames import expand

    nodes = _side(values)
    v, u = (
        np.linspace(0.0, nodes - 1, n) if n > 1 else np.zeros(1) for n in (height or image.shape[0], image.shape[1])
    )
    v = v[rows]
    lower, columns = (np.minimum(node.astype(int), nodes - 2) for node in (v, u))
    starts = np.searchsorted(columns, np.arange(nodes))
    expand(image, values.reshape(nodes, nodes), lower, v - lower, starts, (u - columns).astype(np.float32))
