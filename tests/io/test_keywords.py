"""Header values of the orbit and of the channels, against closed forms and by name."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.units import EARTH_GM_KM3_S2, EARTH_RADIUS_KM
from csstsim.io.keywords import _exposure, _readout_speed, header_values
from csstsim.io.level0 import Level0
from csstsim.sky.directions import telescope_axes


@pytest.mark.parametrize("exptime", [0.0, 150.0, 1500.0])
def test_a_circular_orbit_goes_on_during_the_exposure(make_pointing, exptime):
    """By its mean motion: place, velocity and height at the end, to a metre."""
    radius = EARTH_RADIUS_KM + 400.0
    speed = np.sqrt(EARTH_GM_KM3_S2 / radius)
    pointing = make_pointing(
        exptime=exptime, sat_position=(radius, 0.0, 0.0), sat_velocity=(0.0, 0.6 * speed, 0.8 * speed)
    )
    values = _exposure(pointing)
    turn = speed / radius * exptime
    place = radius * np.array([np.cos(turn), 0.6 * np.sin(turn), 0.8 * np.sin(turn)])
    velocity = speed * np.array([-np.sin(turn), 0.6 * np.cos(turn), 0.8 * np.cos(turn)])
    for k, axis in enumerate("xyz"):
        assert values[f"position_end_{axis}"] == pytest.approx(place[k], abs=1e-3)
        assert values[f"velocity_end_{axis}"] == pytest.approx(velocity[k], abs=1e-6)
        assert values[f"position_start_{axis}"] == pointing.sat_position[k]
    assert values["altitude_start"] == pytest.approx(400.0) and values["altitude_end"] == pytest.approx(400.0, abs=1e-3)
    assert (values["mjd_end"] - values["mjd_start"]) * 86400 == pytest.approx(exptime, abs=1e-4)


def test_a_bias_in_electrons_is_said_in_dn(camera, make_pointing):
    state = SimpleNamespace(
        header={"bias": [500.0, 480.0], "gain": [1.1, 1.2]}, pointing=make_pointing(), chip=camera.chips[9],
        window=SimpleNamespace(x0=0, x1=10, y0=5, y1=20), mask=None, telescope=camera.telescope,
        wcs=SimpleNamespace(distortion=None),
    )  # fmt: skip
    values = header_values(state, {}, "channels")
    assert values["bias_adu"] == pytest.approx([500 / 1.1, 400.0])
    assert [values[f"window_{end}"] for end in ("x_first", "x_last", "y_first", "y_last")] == [1, 10, 6, 20]


def test_the_terms_of_the_nonlinearity_are_told_apart():
    header = {"NLQ01": -1e-7, "NLC01": 2e-13, "NLQ02": -3e-7, "NLC02": 4e-13, "NLQ03": 1.0, "GAIN01": 1.1}
    file = Level0(Path("x.fits"), {}, header, SimpleNamespace(n_channels=3), "channels", None)
    assert file.nonlinearity == {1: (-1e-7, 2e-13), 2: (-3e-7, 4e-13)}
    assert file.gain == {1: 1.1}


PLACES = [(0.0, 0.0), (359.9999999, -89.99), (60.0, -40.0), (244.98765, 12.00001), (0.0, 90.0), (15.0, -0.001)]


@pytest.mark.parametrize(("ra", "dec"), PLACES)
def test_the_target_is_the_designation_of_the_place(make_pointing, ra, dec):
    """Truncated, as the IAU wants it: against astropy, whose digits are rounded, within one of the last."""
    from astropy import units as u
    from astropy.coordinates import SkyCoord

    found = _exposure(make_pointing(ra=ra, dec=dec))["target"]
    parts = found[1:3], found[3:5], found[5:9], found[9:12], found[12:14], found[14:]
    place = SkyCoord("{} {} {} {} {} {}".format(*parts), unit=(u.hourangle, u.deg))
    assert found[0] == "J" and len(found) == 16
    assert 0 <= ra - place.ra.deg < 0.1 / 240 + 1e-7
    assert 0 <= abs(dec) - abs(place.dec.deg) < 1 / 3600 + 1e-7
    assert (found[9] == "-") is (dec < 0)


@pytest.mark.parametrize(("ra", "dec"), PLACES)
@pytest.mark.parametrize("pa", [0.0, -113.4333, 180.0])
def test_the_attitude_turns_the_axes_onto_the_telescope(make_pointing, ra, dec, pa):
    """By scipy's rotations: x to the boresight, y to mosaic +x, z to mosaic +y."""
    from scipy.spatial.transform import Rotation

    values = _exposure(make_pointing(ra=ra, dec=dec, pa=pa))
    turn = Rotation.from_euler("ZYX", [values[f"euler_{k}"] for k in (1, 2, 3)], degrees=True).as_matrix()
    np.testing.assert_allclose(turn.T[[1, 2, 0]], telescope_axes(ra, dec, pa), atol=1e-12)


def test_a_channel_is_read_in_the_readout_time(camera):
    detector = camera.detector
    assert _readout_speed(detector) * detector.readout_time == pytest.approx(1250 * 4700 / 1e6)


@pytest.mark.parametrize("kind", ["SCIE", "BIAS", "DARK", "FLAT"])
def test_the_shutter_opens_to_the_sky_alone(make_pointing, kind):
    assert _exposure(make_pointing(type=kind))["shutter"] is (kind == "SCIE")
