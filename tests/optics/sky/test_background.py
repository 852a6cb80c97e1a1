"""The sum: the reference sky of the bands, units by synphot, occultation, the expansion over the chip."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.coordinates import get_body_barycentric
from astropy.time import Time
from support.sky_geometry import AHEAD, PLACE, camera, numbers, sun_at, towards_limb
from synphot import Empirical1D, Observation, SourceSpectrum, SpectralElement, units

from csstsim.base.errors import InputError
from csstsim.base.sphere import angle, unit_vectors
from csstsim.instrument.chip import Window
from csstsim.instrument.pointing import mjd_utc
from csstsim.optics.sky import background
from csstsim.optics.sky.background import (
    COMPONENTS,
    FINE_NODES,
    NODES,
    add_grid,
    band_rates,
    grid_mean,
    in_band,
    lines_of_sight,
    refined,
    sky_components,
    sky_light,
    star_light,
)  # fmt: skip
from csstsim.optics.sky.background_spectra import (
    band,
    blackbody_over_sun,
    magnitude_ratio,
    photons,
    solar_continuum,
    sunlight,
)
from csstsim.optics.sky.bodies import bodies
from csstsim.optics.sky.directions import telescope_axes
from csstsim.optics.sky.earthshine import earthshine
from csstsim.optics.sky.starlight import faint_starlight
from csstsim.optics.sky.transmittance import angles, total, transmittance
from csstsim.optics.sky.zodiacal import spectrum

CAMERA, N = camera(), numbers()
PREDICTED = {
    "NUV": 0.003,
    "u": 0.021,
    "g": 0.169,
    "r": 0.232,
    "i": 0.228,
    "z": 0.129,
    "y": 0.041,
    "GU": 0.016,
    "GV": 0.18,
    "GI": 0.26,
}
MJD = mjd_utc("2027-06-26T20:35:58")
VELOCITY = (0.0, 7.668, 0.0)


def rates(name):
    return band_rates(CAMERA.filters[name], CAMERA.telescope, 10.0, N)


def v_level(spectrum_5500):
    """V mag / arcsec2 of photon / s / m2 / A / arcsec2 at 5500 A, by the Sun's V."""
    return N.bodies.sun_magnitude - 2.5 * np.log10(spectrum_5500 / photons(solar_continuum(5500.0, N), 5500.0))


@pytest.mark.parametrize("name", PREDICTED)
def test_reference_sky(name):
    """Zodiacal light of V = 22.7 and half of HST's high earthshine (2.58e-18 at 5500 A): 15%, NUV 0.001 e-/s/px."""
    rate, telescope = rates(name), CAMERA.telescope
    wave = np.array([5500.0])
    continuum = spectrum(wave, N)[1, 0] * photons(solar_continuum(5500.0, N), 5500.0) / sunlight(wave, N)[0]
    zodiacal = rate["zodiacal"][1] * 10 ** (-0.4 * (22.7 - v_level(continuum)))
    pixel = telescope.area_m2 * telescope.pixel_scale**2
    white = (
        pixel * photons(0.5 * 2.58e-17, 5500.0) / (1e-10 * photons(solar_continuum(5500.0, N), 5500.0) * N.earth.albedo)
    )
    tolerance = 0.001 if name == "NUV" else 0.15 * PREDICTED[name]
    assert zodiacal + white * rate["earth"] == pytest.approx(PREDICTED[name], abs=tolerance)


@pytest.mark.parametrize("name", ["NUV", "r", "GI"])
def test_units_by_synphot(name):
    """Zodiacal light at the ecliptic pole as flam through synphot's own integral: 0.1%."""
    filter_, telescope = CAMERA.filters[name], CAMERA.telescope
    wave, photon = filter_.wavelength, 77.0 * spectrum(filter_.wavelength, N)[1]
    flam = photon / photons(1.0, wave) * 0.1
    source = SourceSpectrum(Empirical1D, points=wave, lookup_table=flam * units.FLAM)
    response = SpectralElement(Empirical1D, points=wave, lookup_table=filter_.throughput)
    counts = Observation(source, response, binset=wave).countrate(area=1e4 * telescope.area_m2).value
    assert 77.0 * rates(name)["zodiacal"][1] == pytest.approx(counts * telescope.pixel_scale**2, rel=1e-3)


def test_stray_light_by_hand():
    """A monochromatic band: Sun's photons in 1 angstrom on 100 um2, times its throughput."""

    class Line:
        wavelength, throughput = np.array([5999.5, 6000.0, 6000.5]), np.full(3, 0.5)

    found = band_rates(Line, CAMERA.telescope, 10.0, N)
    watts = np.interp(6000.0, *N.solar_spectrum.T) * 1e-4  # W m-2 A-1
    energy = 6.62607015e-34 * 2.99792458e8 / 6000e-10
    assert found["sun"] == pytest.approx(0.5 * watts / energy * 1e-10, rel=1e-3)


def test_stars_have_their_v_and_a_solar_one_the_suns_light():
    wave = np.array([4000.0, 5500.0, 8000.0])
    hot, cold, sun = (blackbody_over_sun(wave, kelvin, N) for kelvin in (20000.0, 3500.0, 5777.0))
    assert hot[1] == cold[1] == sun[1]
    assert hot[0] > sun[0] > cold[0] and hot[2] < sun[2] < cold[2]
    r = CAMERA.filters["r"]
    assert band(r, blackbody_over_sun(r.wavelength, 5777.0, N)) == pytest.approx(
        band(r, sunlight(r.wavelength, N)), rel=0.05
    )
    assert magnitude_ratio([N.bodies.sun_magnitude, N.bodies.sun_magnitude + 5], N) == pytest.approx([1.0, 0.01])


def sky_at(axes, name="r", place=PLACE, mjd=MJD, sights=None):
    sights = axes[2][None] if sights is None else sights
    parts = sky_components(rates(name), axes, sights, (mjd, tuple(place), VELOCITY), N)
    assert tuple(parts) == COMPONENTS
    return {key: value[0] for key, value in parts.items()}


def boresight(direction):
    return telescope_axes(np.degrees(np.arctan2(direction[1], direction[0])), np.degrees(np.arcsin(direction[2])), 0.0)


def over(direction):
    """A spacecraft over the point that has `direction` in its zenith."""
    return 6778.137 * direction / np.linalg.norm(direction)


SKY = bodies(MJD, PLACE, VELOCITY, N)
POLE = unit_vectors(270.0, 66.5607)  # of the ecliptic


def test_ecliptic_pole():
    parts = sky_at(boresight(POLE), place=over(POLE - SKY.sun))
    assert parts["zodiacal"] == pytest.approx(77.0 * rates("r")["zodiacal"][1], rel=1e-4)


def test_antisun_at_midnight():
    """Over the midnight point, looking out: gegenschein, no Earth, no Sun."""
    parts = sky_at(boresight(-SKY.sun), place=over(-SKY.sun))
    assert parts["zodiacal"] == pytest.approx(230.0 * rates("r")["zodiacal"][1], rel=1e-3)
    assert parts["earth"] == parts["sun"] == 0.0
    assert parts["stars"] < 0.01 * parts["zodiacal"]


def test_sun_in_and_out_of_the_doors_shade():
    """60 deg away: shaded. 25 deg away: a blaze, that of the law; behind the Earth: none."""
    across = np.cross(SKY.sun, POLE)
    across /= np.linalg.norm(across)

    def sun(away, place):
        a = np.radians(away)
        return sky_at(boresight(np.cos(a) * SKY.sun + np.sin(a) * across), place=place)["sun"]

    day, night = over(across), over(across - SKY.sun)
    assert angle(SKY.sun, -day) == pytest.approx(90.0) and angle(SKY.sun, -night) == pytest.approx(45.0)
    assert sun(60.0, day) == 0.0
    door = N.door
    turn, low = np.radians([door.opening_deg - 90.0, 25.0])
    shaded = door.length_m * (np.cos(turn) * np.tan(low) - np.sin(turn)) / (2 * door.tube_radius_m)
    open_ = sun(25.0, day) / (rates("r")["sun"] / SKY.sun_au**2) / (1 - shaded)
    (row,) = N.transmittance.matrix[N.transmittance.zenith == 25.0]
    assert row.min() <= open_ <= row.max()
    assert sun(35.0, night) == 0.0


def test_moon_hidden_by_the_earth_and_falling_with_angle():
    """Full Moon of 2027-07-18: brighter nearer, gone when the Earth stands before it."""
    mjd = mjd_utc("2027-07-18T15:45:00")
    moon = bodies(mjd, PLACE, VELOCITY, N).moon
    across = np.cross(moon, POLE)
    across /= np.linalg.norm(across)
    at = [boresight(np.cos(a) * moon + np.sin(a) * across) for a in np.radians([20.0, 30.0, 40.0, 60.0])]
    levels = [sky_at(axes, place=over(across + moon), mjd=mjd)["moon"] for axes in at]
    assert (np.diff(levels) < 0).all() and levels[-1] > 0
    behind = over(across - moon)
    assert angle(moon, -behind) < 70
    assert sky_at(boresight(across), place=behind, mjd=mjd)["moon"] == 0.0


def test_a_star_of_the_list_by_hand():
    """Vega (ra 279.23, dec 38.78, V 0.03, of 9500 to 10000 K) 1 deg off the axis, alone; left out: nothing but it."""
    vega = int(np.argmin(angle(unit_vectors(*N.stars[:, :2].T), unit_vectors(279.23, 38.78))))
    assert N.stars[vega, 2] == pytest.approx(0.03, abs=0.01)
    axes = telescope_axes(279.23, 39.78, 0.0)
    moment = MJD, tuple(over(axes[2])), VELOCITY
    alone = np.arange(len(N.stars)) == vega
    found = rates("r")["stars"] @ star_light(axes, axes[2][None], moment, N, alone)
    light = band(CAMERA.filters["r"], blackbody_over_sun(CAMERA.filters["r"].wavelength, N.stars[vega, 3], N))
    assert found == pytest.approx(1e-3 * 1e-10 * light * magnitude_ratio(0.03, N), rel=0.2)  # azimuths differ by 20%
    nuv = CAMERA.filters["NUV"]
    blue = band(nuv, blackbody_over_sun(nuv.wavelength, N.stars[vega, 3], N))
    found_blue = rates("NUV")["stars"] @ star_light(axes, axes[2][None], moment, N, alone)
    assert found_blue / found == pytest.approx(blue / light, rel=1e-9)
    every, others = (
        sky_components(rates("r"), axes, axes[2][None], moment, N, some)["stars"] for some in (None, ~alone)
    )
    assert every - others == pytest.approx(found, rel=1e-9)


def test_faint_stars_without_the_list():
    """No star of the list shines: what is left is the mean of the fainter ones, in their own colour."""
    axes = telescope_axes(60.0, -40.0, 0.0)
    position = over(axes[2])
    light = sky_light(axes, axes[2][None], (MJD, tuple(position), VELOCITY), N, np.zeros(len(N.stars), bool))
    wave = CAMERA.filters["r"].wavelength
    one = band(CAMERA.filters["r"], blackbody_over_sun(wave, N.starlight.temperature, N)) * magnitude_ratio(10.0, N)
    azimuth = angles(axes @ bodies(MJD, position, VELOCITY, N).sun)[1]
    expected = 1e-10 * one * faint_starlight(axes, position, azimuth, N)
    assert in_band(light, rates("r"))["stars"] == pytest.approx(expected, rel=1e-9) and expected > 1e-5


def test_stars_by_line_of_sight():
    """A mask of lines of sight and stars: each line sees its own."""
    axes = telescope_axes(60.0, -40.0, 0.0)
    moment = MJD, tuple(over(axes[2])), VELOCITY
    sights = np.array([axes[2], unit_vectors(60.2, -40.1)])
    shine = np.random.default_rng(4).random((2, len(N.stars))) < 0.5
    both = star_light(axes, sights, moment, N, shine)
    assert both.shape == (len(set(N.stars[:, 3])), 2)
    for k in range(2):
        assert both[:, k] == pytest.approx(
            star_light(axes, sights[k : k + 1], moment, N, shine[k])[:, 0], rel=1e-12, abs=0
        )
    assert (star_light(axes, sights, moment, N, np.zeros(len(N.stars), bool)) == 0).all()


def test_faults():
    with pytest.raises(InputError, match="looks at the Earth"):
        sky_at(towards_limb(-1.0))
    with pytest.raises(InputError, match="too close to the Sun"):
        sky_at(boresight(SKY.sun), place=over(SKY.sun))


def test_gradient_points_at_the_sun():
    """Zodiacal light at 45 deg in the ecliptic: brighter on the Sun's side of a 0.2 deg chip, by percents."""
    across = np.cross(POLE, SKY.sun)
    across -= (across @ POLE) * POLE
    sights = np.array(
        [
            np.cos(np.radians(a)) * SKY.sun + np.sin(np.radians(a)) * across / np.linalg.norm(across)
            for a in (44.9, 45.1)
        ]
    )
    axes = boresight(sights.mean(axis=0) / np.linalg.norm(sights.mean(axis=0)))
    parts = sky_components(rates("r"), axes, sights, (MJD, tuple(over(sights[0])), VELOCITY), N)["zodiacal"]
    assert 1.003 < parts[0] / parts[1] < 1.03


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (3, 4), (64, 256), (100, 33)])
def test_expansion(shape):
    """Against numpy's linear interpolation along one axis and then the other; float32 of 1e-6."""
    values = np.random.default_rng(8).uniform(1, 2, NODES**2)
    image = np.full(shape, 10.0, np.float32)
    add_grid(image, values)
    nodes = np.linspace(0, 1, NODES)
    y, x = (np.linspace(0, 1, n) if n > 1 else np.zeros(1) for n in shape)
    along = np.array([np.interp(x, nodes, row) for row in values.reshape(NODES, NODES)])
    expected = 10.0 + np.array([np.interp(y, nodes, column) for column in along.T]).T
    assert np.allclose(image, expected, rtol=1e-6)


def test_mean_of_the_grid():
    values = np.random.default_rng(9).uniform(1, 2, NODES**2)
    image = np.zeros((NODES * 40, NODES * 40), np.float32)
    add_grid(image, values)
    assert grid_mean(values) == pytest.approx(image.mean(dtype=float), rel=2e-3)
    assert grid_mean(np.full(NODES**2, 0.7)) == pytest.approx(0.7)


def test_uniform_grid_is_uniform():
    image = np.zeros((50, 70), np.float32)
    add_grid(image, np.full(NODES**2, 0.3))
    assert (image == np.float32(0.3)).all()
    assert background.sky_electrons(CAMERA.filters["g"], 150.0) == pytest.approx(24.6)
    assert AHEAD.shape == (1, 3) and sun_at(0.0)[0] == 1.0


@pytest.mark.parametrize("date", ["2027-01-03T12:00:00", "2027-04-03T12:00:00", "2027-07-05T12:00:00"])
def test_sunlight_falls_with_the_square_of_the_suns_distance(date):
    """Earthshine and the Sun's own stray light over the year (7% in all), by astropy's distance of the Earth."""
    mjd = mjd_utc(date)
    sun = bodies(mjd, PLACE, VELOCITY, N).sun
    au = np.linalg.norm(get_body_barycentric("earth", Time(mjd, format="mjd")).xyz.to_value("au")
                        - get_body_barycentric("sun", Time(mjd, format="mjd")).xyz.to_value("au"))  # fmt: skip
    place = over(sun)
    across = np.cross(sun, POLE)
    across /= np.linalg.norm(across)
    axes = boresight(np.cos(np.radians(80.0)) * place / np.linalg.norm(place) + np.sin(np.radians(80.0)) * across)
    parts = sky_at(axes, place=place, mjd=mjd)
    azimuth = angles(axes @ sun)[1]
    ahead = np.array([[0.0, 0.0, 1.0]])
    earth = rates("r")["earth"] * earthshine(place, sun, axes, ahead, azimuth, N)[0]
    assert earth > 1e-3
    assert parts["earth"] == pytest.approx(earth / au**2, rel=1e-4)
    towards = np.cos(np.radians(25.0)) * sun + np.sin(np.radians(25.0)) * across
    axes = boresight(towards)
    direct = rates("r")["sun"] * total((axes @ sun)[None], ahead, angles(axes @ sun)[1], N)[0, 0]
    assert direct > 1.0
    assert sky_at(axes, place=over(towards), mjd=mjd)["sun"] == pytest.approx(direct / au**2, rel=1e-3)


def test_the_grid_lies_between_the_middles_of_the_outer_pixels():
    asked = []

    class Recorder:
        def pixel_to_world(self, x, y):
            asked.append((x, y))
            return np.zeros(x.shape), np.zeros(x.shape)

    lines_of_sight(Recorder(), Window(100, 301, 50, 451))
    ((x, y),) = asked
    assert (x.min(), x.max(), y.min(), y.max()) == (100, 300, 50, 450)
    assert len(x) == NODES**2 and np.diff(np.unique(x)) == pytest.approx(200 / (NODES - 1))


def test_a_finer_grid_is_the_same_image():
    values = np.random.default_rng(10).uniform(1, 2, NODES**2)
    fine = refined(values, FINE_NODES)
    coarse_image, fine_image = np.zeros((2, 300, 211), np.float32)
    add_grid(coarse_image, values)
    add_grid(fine_image, fine)
    assert np.allclose(coarse_image, fine_image, rtol=1e-6)
    step = (FINE_NODES - 1) // (NODES - 1)
    assert (fine.reshape(FINE_NODES, -1)[::step, ::step].ravel() == values).all()
    assert grid_mean(fine) == pytest.approx(grid_mean(values), rel=1e-12)


def test_moonlight_and_planets_by_their_magnitudes():
    """25 deg from the Moon, on the side away from the door: its V, of sunlight, as the transmittance lets it in.

    Planets add up, each by its own magnitude and place; the door takes no light and sends none.
    """
    open_ = replace(N, door=replace(N.door, albedo=0.0, half_width_deg=1e-6))
    mjd = mjd_utc("2027-07-18T15:45:00")
    moon = bodies(mjd, PLACE, VELOCITY, N).moon
    across = np.cross(moon, POLE)
    across /= np.linalg.norm(across)
    axes = boresight(np.cos(np.radians(25.0)) * moon + np.sin(np.radians(25.0)) * across)
    position = 9 * over(axes[2])  # so high that the Earth hides little
    sky = bodies(mjd, position, VELOCITY, N)
    parts = sky_components(rates("r"), axes, axes[2][None], (mjd, tuple(position), VELOCITY), open_)

    def seen(direction, magnitude):
        if angle(direction, -position) < np.degrees(np.arcsin(6378.137 / np.linalg.norm(position))):
            return 0.0
        zenith, azimuth = angles(axes @ direction)
        light = transmittance(zenith, azimuth, N)
        return float(rates("r")["sun"] * light * 10 ** (-0.4 * (magnitude - N.bodies.sun_magnitude)))

    assert parts["moon"][0] == pytest.approx(seen(sky.moon, sky.moon_magnitude), rel=1e-9) and parts["moon"][0] > 1e-5
    planets = [seen(*one) for one in zip(sky.planets, sky.planet_magnitudes, strict=True)]
    assert parts["planets"][0] == pytest.approx(sum(planets), rel=1e-9, abs=0) and sum(planets) > 0


def test_some_rows_of_the_expansion_are_those_of_the_whole_window():
    values = np.random.default_rng(11).uniform(1, 2, NODES**2)
    whole, part = np.zeros((60, 37), np.float32), np.full((13, 37), 2.0, np.float32)
    add_grid(whole, values)
    add_grid(part, values, slice(21, 34), 60)
    assert np.allclose(part, whole[21:34] + 2.0, rtol=1e-6)


@pytest.mark.parametrize("kelvin", [3500.0, 9700.0])
def test_a_black_body_has_the_photons_of_astropys(kelvin):
    """Over a wide range of wavelengths, scaled to the mean of the Sun's spectrum from 5250 to 5750 angstrom."""
    from astropy import units as u
    from astropy.modeling.models import BlackBody

    wave = np.array([2600.0, 4000.0, 5500.0, 7300.0, 9900.0])
    energy = BlackBody(kelvin * u.K, scale=1 * u.erg / (u.cm**2 * u.s * u.AA * u.sr))(wave * u.AA).value
    light = energy * wave  # in photons, to a constant
    fine = np.linspace(5250.0, 5750.0, 5001)
    sun = np.interp(fine, *N.solar_spectrum.T).mean() * 1e-4 * 5500e-10 / (6.62607015e-34 * 2.99792458e8)
    assert blackbody_over_sun(wave, kelvin, N) == pytest.approx(sun * light / light[2], rel=2e-3)


def test_rates_of_kinds_of_light_are_their_spectra_in_the_band():
    """Sunlight off the Earth by its albedo and colour; stars by temperature, rising; the faint ones' last."""
    filter_ = CAMERA.filters["g"]
    wave, found, area = filter_.wavelength, rates("g"), (10e-6) ** 2
    sun = np.interp(wave, *N.solar_spectrum.T) * 1e-4 * wave * 1e-10 / (6.62607015e-34 * 2.99792458e8)
    step = np.trapezoid(filter_.throughput * sun, wave)
    earth = np.trapezoid(filter_.throughput * sun * np.interp(wave, *N.earth.spectrum.T), wave)
    assert found["sun"] == pytest.approx(area * step, rel=1e-2)
    assert found["earth"] / found["sun"] == pytest.approx(N.earth.albedo * earth / step, rel=1e-3)
    kelvins = np.unique(N.stars[:, 3])
    assert len(found["stars"]) == len(kelvins)
    for k in (0, len(kelvins) - 1):
        wanted = area * band(filter_, blackbody_over_sun(wave, kelvins[k], N))
        assert found["stars"][k] == pytest.approx(wanted)
    wanted = area * band(filter_, blackbody_over_sun(wave, N.starlight.temperature, N))
    assert found["starlight"] == pytest.approx(wanted)
    assert band_rates(filter_, CAMERA.telescope, 20.0, N)["sun"] == pytest.approx(4 * found["sun"])


def test_light_becomes_components_each_by_its_own_rate():
    own = {
        "zodiacal": np.array([2.0, 3.0]), "sun": 5.0, "earth": 7.0, "stars": np.array([11.0, 13.0]), "starlight": 17.0,
    }  # fmt: skip
    light = {
        "zodiacal": np.array([[1.0, 2.0], [0.5, 0.0]]), "earth": np.array([1.0, 3.0]), "sun": np.array([0.1, 0.2]),
        "moon": np.array([0.3, 0.4]), "planets": np.array([0.5, 0.6]), "stars": np.array([[1.0, 0.0], [0.0, 2.0]]),
        "starlight": 0.5,
    }  # fmt: skip
    found = in_band(light, own)
    wanted = {"zodiacal": [3.5, 4.0], "earth": [7.0, 21.0], "sun": [0.5, 1.0], "moon": [1.5, 2.0],
              "planets": [2.5, 3.0], "stars": [19.5, 34.5]}  # fmt: skip
    assert set(found) == set(wanted) == set(COMPONENTS)
    for name, values in wanted.items():
        assert found[name] == pytest.approx(np.array(values)), name


def test_the_faults_name_the_limb_angle():
    with pytest.raises(InputError) as raised:
        sky_at(towards_limb(-1.5))
    assert "limb angle [deg]" in str(raised.value) and "-1.5" in str(raised.value) and "> 0" in str(raised.value)


def test_zodiacal_light_of_a_pixel_goes_with_its_solid_angle_and_the_area():
    """Stray light, an irradiance of the focal plane, does not."""
    filter_, found = CAMERA.filters["r"], rates("r")
    for change, factor in (({"pixel_scale": 0.148}, 4.0), ({"diameter_m": 4.0}, 4.0), ({"diameter_m": 1.0}, 0.25)):
        other = band_rates(filter_, replace(CAMERA.telescope, **change), 10.0, N)
        assert other["zodiacal"] == pytest.approx(factor * found["zodiacal"])
        assert other["sun"] == found["sun"] and (other["stars"] == found["stars"]).all()
