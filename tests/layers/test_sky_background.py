"""The sky layer with the constant and with the model: its light, its header, its refusals."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.coordinates import SkyCoord, get_sun
from astropy.time import Time
from support.readout_state import flat_state, plain_layers, run

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.instrument.orbit import orbit_after
from csstsim.io.level0_writing import write_level0
from csstsim.layers import sky_background
from csstsim.optics.scatter.halo import make_wing
from csstsim.optics.sky.background import COMPONENTS
from csstsim.optics.sky.background_spectra import band, blackbody_over_sun, magnitude_ratio
from csstsim.optics.sky.parameters import sky_numbers
from csstsim.optics.throughput.flat import FlatField
from csstsim.optics.throughput.response import response_map
from csstsim.simulation.exposure import Losses

HIGH = (2596.0, 4496.0, -4357.0)  # km; POINTING's field (60, -40) is in its zenith


STREAMS = Streams(5, "1", 9, "sky_background")


def lit(camera, model=True, **fields):
    state = flat_state(camera, **({"sat_position": HIGH, "sat_velocity": (6.0, 3.0, -2.1)} | fields))
    return sky_background.apply(state, sky_background.Param(enable_straylight_model=model), STREAMS)


@pytest.mark.parametrize("model", [False, True])
@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("shutter", [False, True])
def test_losses_multiply_the_sky_and_nothing_else(small, model, flat, shutter):
    whole = lit(small, model)
    state = lit(small, model, losses=Losses(flat, shutter))
    field = FlatField(small.leds, STREAMS.camera) if flat else None
    share = response_map(state.chip, state.window, state.filter, 150.0, flat=field, shutter=shutter)
    share = 1.0 if share is None else share
    np.testing.assert_allclose(state.image, whole.image * share, rtol=1e-6)
    assert state.header == whole.header


def test_off_is_the_constant(small):
    state = lit(small, model=False)
    assert (state.image == np.float32(0.207 * 150.0)).all()
    assert state.header["sky_rate"] == 0.207
    assert "sky_zodiacal" not in state.header


@pytest.mark.parametrize("chip", [9, 1, 12])  # r, GI, NUV
def test_on_adds_its_components(small, chip):
    state = lit(small, chip=chip)
    header = state.header
    assert header["sky_rate"] == pytest.approx(sum(header[f"sky_{name}"] for name in COMPONENTS))
    assert state.image.mean(dtype=float) == pytest.approx(150.0 * header["sky_rate"], rel=1e-4)
    assert 0.3 < header["sky_rate"] / state.filter.sky < 3
    assert header["sky_zodiacal"] > 0.5 * header["sky_rate"]
    assert np.ptp(state.image) > 0


def test_adds_to_what_is_there_in_proportion_to_time(small):
    once, twice = lit(small, exptime=1.0), lit(small, exptime=2.0)
    assert twice.image.mean(dtype=float) == pytest.approx(2 * once.image.mean(dtype=float), rel=1e-3)
    full = flat_state(small, 100.0, sat_position=HIGH, sat_velocity=(6.0, 3.0, -2.1), exptime=1.0)
    sky_background.apply(full, sky_background.Param(enable_straylight_model=True), STREAMS)
    assert np.allclose(full.image, 100.0 + once.image, atol=1e-5)


def test_a_window_sees_the_chips_sky(camera):
    """The same pixels in a window of their own: the grids' difference is below 1e-5 of the sky."""
    whole, part = lit(camera), lit(camera, window=(3000, 3100, 8000, 8050))
    assert np.allclose(whole.image[8000:8050, 3000:3100], part.image, rtol=1e-5)


def test_an_exposure_of_the_earth_is_refused_before_any_work(small):
    pointing = flat_state(small, sat_position=tuple(-x for x in HIGH)).pointing
    on, off = (sky_background.Param(enable_straylight_model=asked) for asked in (True, False))
    with pytest.raises(InputError, match=f"exposure of {pointing.time} looks at the Earth"):
        sky_background.check(on, small, pointing)
    sky_background.check(off, small, pointing)
    sky_background.check(on, small, flat_state(small, sat_position=HIGH).pointing)


def test_faults(small):
    with pytest.raises(InputError, match="looks at the Earth"):
        lit(small, sat_position=tuple(-x for x in HIGH))
    with pytest.raises(InputError, match="no sky parameters"):
        lit(replace(small, sky={}))


@pytest.mark.parametrize("model", [True, False])
def test_level0_header(small, tmp_path, model):
    from astropy.io import fits

    state = lit(small, model=model)
    header = state.header
    state = run(replace(state), plain_layers())
    write_level0(tmp_path / "x.fits", state, small.keywords, {})
    found = fits.getheader(tmp_path / "x.fits")
    assert found["SKYRATE"] == pytest.approx(header["sky_rate"])
    assert ("SKYZODI" in found) is model and ("SKYEARTH" in found) is model


@pytest.mark.thorough
@pytest.mark.parametrize("start", [-500.0, 700.0, 800.0])
def test_the_sky_is_the_mean_over_the_exposure(small, start):
    """300 s, 20 deg of an orbit on which the Earth's limb comes nearer or goes: within 1% of thirty short ones."""

    def rate(after, exptime):
        place, velocity = orbit_after(HIGH, (6.0, 3.0, -2.1), abs(after))
        if after < 0:  # back along the orbit
            place, velocity = orbit_after(HIGH, (-6.0, -3.0, 2.1), -after)
            velocity = tuple(-v for v in velocity)
        return lit(small, exptime=exptime, sat_position=place, sat_velocity=velocity).header["sky_rate"]

    short = [rate(start + 10.0 * (k + 0.5), 0.01) for k in range(30)]
    assert rate(start, 300.0) == pytest.approx(np.mean(short), rel=0.01)


def test_a_dispersed_sky_says_the_rate_that_is_in_the_image(camera):
    state = flat_state(
        camera, chip=1, window=(3000, 3200, 4000, 4100), sat_position=HIGH, sat_velocity=(6.0, 3.0, -2.1)
    )
    for model in (False, True):
        state.image[:] = 0.0
        param = sky_background.Param(enable_straylight_model=model)
        header = sky_background.apply(state, param, STREAMS).header
        assert header["sky_rate"] * 150.0 == pytest.approx(state.image.mean(dtype=float), rel=1e-5)
        assert header["sky_rate"] != pytest.approx(state.filter.sky, rel=0.01)
    assert header["sky_rate"] == pytest.approx(sum(header[f"sky_{name}"] for name in COMPONENTS), rel=1e-5)


def test_a_star_beside_the_frame_shines_on_it(camera):
    """A star V 0 some 3000 px from the right edge: its wing in the header's starlight and, steep, on the pixels."""
    state = flat_state(camera, sat_position=HIGH, sat_velocity=(6.0, 3.0, -2.1), exptime=1.0)
    ra, dec = state.exposure.wcs.pixel_to_world(np.array([9216 + 3000.0]), np.array([4616.0]))
    star = f"{ra[0]} {dec[0]} 0.0 6000"
    light = {}
    for name, stars in (("none", "0 89 4.9 6000"), ("one", star)):
        lit_camera = replace(camera, sky=camera.sky | {"stars": stars})
        parts = sky_background._components(replace(state.exposure, camera=lit_camera))["stars"]
        light[name] = parts.reshape(round(len(parts) ** 0.5), -1)
    assert light["none"].shape == (5, 5) and light["one"].shape == (65, 65)
    wing = light["one"] - light["none"].mean()
    row = wing[32]  # of the star
    away = 3000.0 + 9215.0 - np.linspace(0, 9215, 65)
    near = (away > 3100) & (away < 4800)  # where the transmittance is that of the wing
    slope = np.polyfit(np.log(away[near]), np.log(row[near]), 1)[0]
    assert -3.3 < slope < -2.9
    scattered = make_wing(camera.scatter, state.filter.psf_wavelength, camera.telescope).profile(4000.0).mean()
    numbers = sky_numbers(camera.sky)
    wave = state.filter.wavelength
    electrons = band(state.filter, blackbody_over_sun(wave, 6000.0, numbers)) * magnitude_ratio(0.0, numbers)
    expected = electrons * camera.telescope.area_m2 * scattered
    assert np.interp(4000.0, away[::-1], row[::-1]) == pytest.approx(expected, rel=0.25)  # azimuths differ by 20%


def test_parts_and_weights_are_of_gauss_and_legendre():
    nodes, weights = np.polynomial.legendre.leggauss(3)
    assert pytest.approx(0.5 + nodes / 2) == sky_background.PARTS
    assert pytest.approx(weights / 2) == sky_background.WEIGHTS


def test_moments_are_dates_and_places_of_the_spacecraft(small):
    """Of 400 s: 45.1, 200 and 354.9 s after the beginning, some 7.7 km/s on."""
    pointing = flat_state(small, sat_position=HIGH, sat_velocity=(6.0, 3.0, -2.1)).pointing
    seconds = 200 + 200 * np.sqrt(0.6) * np.array([-1, 0, 1])
    found = sky_background.moments(pointing, 400.0)
    assert [(mjd - pointing.mjd) * 86400 for mjd, *_ in found] == pytest.approx(seconds, abs=1e-3)
    for (_, place, velocity), after in zip(found, seconds, strict=True):
        there = orbit_after(HIGH, (6.0, 3.0, -2.1), after)
        assert np.allclose(place, there[0]) and np.allclose(velocity, there[1])


@pytest.mark.parametrize("model", [False, True])
def test_the_mean_rate_and_the_dispersed_sky_are_those_of_the_layer(small, camera, model):
    param = sky_background.Param(enable_straylight_model=model)
    state = lit(small, model)
    rate = sky_background.mean_rate(state.exposure, param)
    assert rate == pytest.approx(state.header["sky_rate"], rel=1e-6)
    assert rate * 150.0 == pytest.approx(state.image.mean(dtype=float), rel=1e-4)
    where = {"chip": 1, "window": (3000, 3060, 4000, 4031)}
    spectral = lit(camera, model, **where)
    np.testing.assert_allclose(sky_background.dispersed_sky(spectral.exposure, param), spectral.image, rtol=1e-6)


def test_a_dispersed_sky_loses_what_the_map_says(camera):
    where = {"chip": 1, "window": (3000, 3060, 4000, 4031)}
    whole, state = (lit(camera, False, losses=Losses(flat=on, shutter=on), **where) for on in (False, True))
    flat = FlatField(camera.leds, STREAMS.camera)
    share = response_map(state.chip, state.window, state.filter, 150.0, flat=flat, shutter=True)
    np.testing.assert_allclose(state.image, whole.image * share, rtol=1e-5)
    assert np.ptp(share) > 0 and not np.allclose(share, 1, rtol=1e-3)


def test_numbers_are_checked_as_far_as_they_are_needed(small):
    high = flat_state(small, sat_position=HIGH).pointing
    flat, sky = replace(small, leds=small.leds | {"flat": {}}), replace(small, sky={})
    with pytest.raises(InputError, match=r"leds\.yaml"):
        sky_background.check(sky_background.Param(), flat, high)
    sky_background.check(sky_background.Param(flat_fielding=False), flat, high)
    sky_background.check(sky_background.Param(), sky, high)
    with pytest.raises(InputError, match="no sky parameters"):
        sky_background.check(sky_background.Param(enable_straylight_model=True), sky, high)


def test_what_a_list_leaves_out():
    assert sky_background.Param().model_dump() == {
        "exptime": None, "flat_fielding": True, "shutter_effect": True, "enable_straylight_model": False,
    }  # fmt: skip


@pytest.mark.parametrize(("ra", "dec"), [(60.0, -40.0), (95.0, 23.0), (200.0, 70.0), (274.0, -23.0)])
def test_the_sun_is_as_far_as_astropy_has_it(small, ra, dec):
    """Within 0.1 deg; the colour of the zodiacal light follows this angle."""
    pointing = flat_state(small, ra=ra, dec=dec).pointing
    sun = get_sun(Time(pointing.mjd, format="mjd", scale="utc"))
    expected = sun.separation(SkyCoord(ra, dec, unit="deg", frame=sun.frame)).deg
    assert sky_background._sun_angle(pointing) == pytest.approx(expected, abs=0.1)


def test_a_dispersed_sky_of_the_model_has_the_spectrum_of_its_components(camera):
    """Other spectra than the filter's constant of the same rate: in columns where an order begins, by per cents."""
    where = {"chip": 1, "window": (0, 2000, 4000, 4004)}
    model, constant = (lit(camera, on, **where).image.mean(axis=0) for on in (True, False))
    ratio = model / constant
    assert np.ptp(ratio) > 0.005 * ratio.mean()
