"""Sky background (paper, section 5.5.1): one constant per band, or the sum of the model's components.

The model's components [e-/s/px] are computed on a coarse grid of lines of sight and interpolated bilinearly:

    zodiacal                          of the field itself (csstsim.sky.zodiacal)
    earth, sun, moon, planets, stars  stray light from outside the field: point-source transmittance and aperture door;
                                      sources behind the Earth give none

Left out: scattered light and ghosts of objects in the field, which are not background; stars fainter than the star
list and zodiacal light from outside the field (0.1% of the diffuse sky scatters in); airglow, which above the orbit has
only lines shortward of the bands.
"""

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.sphere import angle, unit_vectors
from csstsim.sky import zodiacal
from csstsim.sky.background_spectra import band, blackbody_over_sun, magnitude_ratio, pixel_etendue, sunlight
from csstsim.sky.bodies import bodies, earth_radius
from csstsim.sky.directions import helioecliptic
from csstsim.sky.earthshine import earthshine
from csstsim.sky.transmittance import angles, total

COMPONENTS = ("zodiacal", "earth", "sun", "moon", "planets", "stars")
NODES = 5  # per side; bilinear interpolation errs by 2% for a star 0.3 deg off the chip


def sky_electrons(filter_, exptime):
    """Return the expected nominal sky in one pixel [e-] for an exposure of `exptime` seconds."""
    return filter_.sky * exptime


def band_rates(filter_, telescope, pixel_um, numbers):
    """Return the rate of each source in a band [e-/s/px], {name: float or array}, for `sky_components`.

    zodiacal (2,): for I = 1 in the law's two colours. The others are for transmittance 1. sun: at 1 au; earth: the
    same sunlight times the Earth's albedo, to be multiplied by `earthshine`; stars (n,).
    """
    wave, pixel = filter_.wavelength, (1e-6 * pixel_um) ** 2
    sun = sunlight(wave, numbers)
    earth = numbers.earth.albedo * np.interp(wave, *numbers.earth.spectrum.T)
    shapes = [band(filter_, blackbody_over_sun(wave, kelvin, numbers)) for kelvin in numbers.stars[:, 3]]
    return {
        "zodiacal": pixel_etendue(telescope) * band(filter_, zodiacal.spectrum(wave, numbers)),
        "sun": pixel * band(filter_, sun),
        "earth": pixel * band(filter_, sun * earth),
        "stars": pixel * np.array(shapes) * magnitude_ratio(numbers.stars[:, 2], numbers),
    }


def sky_components(rates, axes, sights, moment, numbers):
    """Return {component: (m,) e-/s/px} for lines of sight (m, 3), unit vectors on GCRS axes.

    rates: from `band_rates`; axes: sky.directions.telescope_axes; moment: (UTC MJD, position [km], velocity [km/s]) of
    the spacecraft, geocentric GCRS; numbers: SkyNumbers. Raises InputError if the Earth is in the way, or the Sun is
    closer than the table of zodiacal light reaches.
    """
    place = np.asarray(moment[1], dtype=float)
    radius = np.degrees(earth_radius(place))
    limb = float(angle(axes[2], -place) - radius)
    if limb < 0:
        raise InputError(
            "the telescope looks at the Earth", key="limb angle [deg]", value=round(limb, 2), allowed="> 0"
        )
    sky = bodies(*moment, numbers)
    longitude, latitude = helioecliptic(sights, sky.sun)
    level = zodiacal.intensity(longitude, latitude, numbers)
    share = zodiacal.mixture(zodiacal.elongation(longitude, latitude), numbers)

    own, sights = (np.einsum("ij,nj->ni", axes, v) for v in (np.array([sky.sun]), sights))
    door_azimuth = angles(own)[1][0]

    def stray(directions, weights, field=True):
        """Light of point sources: those behind the Earth, and those in the field if `field`, are left out."""
        seen = np.einsum("ij,nj->ni", axes, directions)
        weights = np.where(angle(directions, -place) > radius, weights, 0.0)
        if field:
            weights = np.where(_in_field(seen, numbers.field), 0.0, weights)
        return np.einsum("mn,n->m", total(seen, sights, door_azimuth, numbers), weights)

    planets = rates["sun"] * magnitude_ratio(sky.planet_magnitudes, numbers)
    moon = rates["sun"] * magnitude_ratio([sky.moon_magnitude], numbers)
    return {
        "zodiacal": np.einsum("k,km,m->m", rates["zodiacal"], share, level),
        "earth": rates["earth"] / sky.sun_au**2 * earthshine(place, sky.sun, axes, sights, door_azimuth, numbers),
        "sun": stray(sky.sun[None], np.array([rates["sun"] / sky.sun_au**2]), field=False),
        "moon": stray(sky.moon[None], moon, field=False),
        "planets": stray(sky.planets, planets),
        "stars": stray(unit_vectors(*numbers.stars[:, :2].T), rates["stars"]),
    }


def _in_field(seen, field):
    x, y, z = seen.T
    tangent = np.tan(np.radians(field))
    return (z > 0) & (np.abs(x) < tangent[0] * z) & (np.abs(y) < tangent[1] * z)


def lines_of_sight(wcs, window):
    """Return (NODES^2, 3): unit vectors of the grid over the window's pixel centres, rows along x."""
    x, y = np.meshgrid(np.linspace(window.x0, window.x1 - 1, NODES), np.linspace(window.y0, window.y1 - 1, NODES))
    return unit_vectors(*wcs.pixel_to_world(x.ravel(), y.ravel()))


def grid_mean(values):
    """Return the mean of the bilinear image that `add_grid` makes from the values at `lines_of_sight`."""
    end = np.ones(NODES)
    end[[0, -1]] = 0.5
    return float(np.einsum("i,j,ij->", end, end, values.reshape(NODES, NODES)) / (NODES - 1) ** 2)


def add_grid(image, values, rows=slice(None), height=None):
    """Add to `image` (float32), in place, the bilinear expansion of values at `lines_of_sight`.

    image may be some `rows`, a slice, of a window of this height.
    """
    from csstsim.sky.frames import expand

    v, u = (
        np.linspace(0.0, NODES - 1, n) if n > 1 else np.zeros(1) for n in (height or image.shape[0], image.shape[1])
    )
    v = v[rows]
    lower, columns = (np.minimum(place.astype(int), NODES - 2) for place in (v, u))
    starts = np.searchsorted(columns, np.arange(NODES))
    expand(image, values.reshape(NODES, NODES), lower, v - lower, starts, (u - columns).astype(np.float32))
