"""The orbit model against Kepler's laws and the published rate of the node; times against astropy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from support.mini import INSTRUMENT

from csstsim.base.errors import InputError
from csstsim.base.model import validate
from csstsim.instrument.camera import load_camera
from csstsim.instrument.orbit import Orbit, orbit_after
from csstsim.instrument.pointing import Pointing, mjd_utc, parse_utc

TIME = "2027-10-10T01:08:00"


@pytest.fixture(scope="module")
def orbit():
    return load_camera(INSTRUMENT).orbit


def _states(orbit, times):
    return (np.array(part) for part in zip(*(orbit.state(t) for t in times), strict=True))


def test_circle_speed_and_inclination(orbit):
    """400 km up (1 m), 7.67 km/s (10 m/s: the node's turn is 8), r.v = 0, inclination 41.5 deg (0.05), over a day."""
    position, velocity = _states(orbit, mjd_utc(TIME) + np.linspace(0, 1, 500))
    assert np.linalg.norm(position, axis=1) == pytest.approx(6778.137, abs=1e-3)
    assert np.linalg.norm(velocity, axis=1) == pytest.approx(7.669, abs=0.010)
    assert abs((position * velocity).sum(axis=1)).max() < 1e-8
    pole = np.cross(position, velocity)
    assert np.degrees(np.arccos(pole[:, 2] / np.linalg.norm(pole, axis=1))) == pytest.approx(41.5, abs=0.05)
    assert abs(position[:, 2]).max() == pytest.approx(6778.137 * math.sin(math.radians(41.5)), rel=1e-3)


def test_period(orbit):
    """92.6 min (3 s); after it the spacecraft is back but for the node's precession, under 0.4 deg."""
    period = 2 * math.pi / orbit.mean_motion  # s
    assert period / 60 == pytest.approx(92.6, abs=0.05)
    mjd = mjd_utc(TIME)
    first, again = (np.array(orbit.state(mjd + k * period / 86400)[0]) for k in (0, 1))
    assert np.linalg.norm(again - first) / orbit.radius_km < math.radians(0.41)


def test_velocity_is_the_derivative_of_position(orbit):
    """Central difference over 2 s; the sagitta of the circle is 1.3e-6 of the speed, tolerance 2 cm/s."""
    step = 1 / 86400
    mjd = mjd_utc(TIME)
    for t in mjd + np.linspace(0, 0.07, 7):
        before, after = (np.array(orbit.state(t + s * step)[0]) for s in (-1, 1))
        assert (after - before) / 2 == pytest.approx(np.array(orbit.state(t)[1]), abs=2e-5)


def test_node_precession(orbit):
    """-6.0 deg a day (2%), read off the motion of the orbit's pole; a full turn takes two months."""
    mjd = mjd_utc(TIME)

    def node(t):
        position, velocity = (np.array(v) for v in orbit.state(t))
        pole = np.cross(position, velocity)
        return math.degrees(math.atan2(pole[0], -pole[1]))

    rate = (node(mjd + 1) - node(mjd) + 180) % 360 - 180
    assert rate == pytest.approx(-6.0, rel=0.02)
    assert math.degrees(orbit.node_rate) * 86400 == pytest.approx(rate, abs=0.1)


def test_state_depends_on_time_only(orbit):
    assert orbit.state(TIME) == orbit.state(TIME + "Z") == orbit.state(mjd_utc(TIME))
    assert orbit.state(orbit.epoch)[0] == pytest.approx((orbit.radius_km, 0.0, 0.0), abs=1e-9)


def test_mjd_against_astropy():
    """To 1 microsecond of a day's fraction, across a year, leap days included."""
    from astropy.time import Time

    for text in ("2027-01-01T00:00:00", "2028-02-29T23:59:59.999999", "2000-01-01T12:00:00", "1999-12-31 23:59:59"):
        assert mjd_utc(text) == pytest.approx(Time(text, scale="utc").mjd, abs=2e-11)


NOT_TIMES = ["", "2027-01-01", "2027-02-29T00:00:00", "2027-01-01T24:00:00", "61000", "2027-01-01T00:00:00+08:00"]


@pytest.mark.parametrize("text", NOT_TIMES)
def test_not_a_time(text):
    with pytest.raises(ValueError):
        parse_utc(text)


def test_pointing_times():
    p = Pointing("SCIE", 0.0, 0.0, 0.0, "2027-12-31T23:59:00", 150.0, (0, 0, 0), (0, 0, 0))
    assert p.end.isoformat() == "2028-01-01T00:01:30+00:00"
    assert (p.end - p.start).total_seconds() == 150.0
    assert p.mjd == mjd_utc(p.time)


@pytest.mark.parametrize("seconds", [1.0, 150.0, 600.0])
def test_the_state_after_an_exposure_is_that_of_two_bodies(orbit, seconds):
    """DOP853 by scipy; a millimetre, and a thousandth of a millimetre a second."""
    position, velocity = orbit.state("2027-11-20T01:08:00")

    def motion(_, y):
        return np.concatenate([y[3:], -398600.4418 * y[:3] / np.linalg.norm(y[:3]) ** 3])

    expected = solve_ivp(motion, (0, seconds), [*position, *velocity], method="DOP853", rtol=1e-13, atol=1e-12).y[:, -1]
    found = orbit_after(position, velocity, seconds)
    assert found[0] == pytest.approx(expected[:3], abs=1e-6) and found[1] == pytest.approx(expected[3:], abs=1e-9)


def test_node_and_phase_turn_the_orbit_as_rotations_do():
    """At the epoch: R_z(node) R_x(inclination) R_z(phase) of the x axis; velocity a quarter turn ahead, and J2's."""
    orbit = Orbit(700.0, 98.0, 30.0, 50.0, "2026-03-01T12:00:00")
    turn = Rotation.from_euler("ZXZ", [30.0, 98.0, 50.0], degrees=True).as_matrix()
    position, velocity = orbit.state(orbit.epoch)
    assert position == pytest.approx(7078.137 * turn[:, 0], abs=2e-3)
    drift = np.cross([0, 0, orbit.node_rate], position)
    assert np.array(velocity) - drift == pytest.approx(np.sqrt(398600.4418 / 7078.137) * turn[:, 1], abs=1e-5)
    yearly = np.degrees(replace(orbit, inclination=98.19).node_rate) * 365.2422 * 86400
    assert yearly == pytest.approx(360, rel=3e-3)  # sun-synchronous
    # a sixth of a day later: by its mean motion and the node's rate
    seconds = 4 * 3600.0
    u, node = 50.0 + np.degrees(orbit.mean_motion) * seconds, 30.0 + np.degrees(orbit.node_rate) * seconds
    later = Rotation.from_euler("ZXZ", [node, 98.0, u], degrees=True).as_matrix()
    assert orbit.state("2026-03-01T16:00:00")[0] == pytest.approx(7078.137 * later[:, 0], abs=2e-3)


def test_an_orbit_needs_a_time():
    numbers = {"altitude_km": 400.0, "inclination": 41.5, "node": 0.0, "phase": 0.0}
    assert validate(Orbit, numbers | {"epoch": "2025-01-01T00:00:00"}, "a.yaml").altitude_km == 400.0
    with pytest.raises(InputError, match=r"a.yaml: epoch"):
        validate(Orbit, numbers | {"epoch": "61000"}, "a.yaml")


def test_fractions_of_a_second_and_the_z_of_utc():
    assert parse_utc("2027-12-31T23:59:00.25Z").isoformat() == "2027-12-31T23:59:00.250000+00:00"
    assert Pointing("SCIE", 0, 0, 0, TIME, 1.0, (0, 0, 0), (0, 0, 0)).survey == "WIDE"
