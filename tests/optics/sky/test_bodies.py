"""Sun, Moon and planets at events listed in almanacs, and against astropy."""

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, CartesianRepresentation, SkyCoord, get_body, get_body_barycentric
from astropy.time import Time
from support.sky_geometry import numbers

from csstsim.base.sphere import angle, unit_vectors
from csstsim.instrument.orbit import orbit_after
from csstsim.instrument.pointing import mjd_utc
from csstsim.optics.sky.bodies import angles_at_ends, bodies, exposure_angles
from csstsim.optics.sky.directions import helioecliptic, telescope_axes

PLACE, VELOCITY = (1200.0, -5300.0, 3980.0), (5.1, 3.7, 3.4)


def at(time):
    return bodies(mjd_utc(time), PLACE, VELOCITY, numbers())


def test_new_moon_at_an_eclipse_and_full_moon_at_another():
    """Total eclipses of 2027-08-02 10:07 UTC (Sun) and 2025-03-14 06:59 UTC (Moon); the Moon's parallax is 1 deg."""
    new, full = at("2027-08-02T10:07:00"), at("2025-03-14T06:59:00")
    assert angle(new.sun, new.moon) < 1.5
    assert new.moon_magnitude > -5
    assert angle(full.sun, -full.moon) < 1.5
    assert full.moon_magnitude == pytest.approx(-12.7, abs=0.2)


def test_equinox():
    """2025-03-20 09:01 UTC: the Sun in the equator of date, 0.14 deg from J2000's at most; longitude 0 to 0.4 deg."""
    sun = at("2025-03-20T09:01:00").sun
    assert np.degrees(np.arcsin(sun[2])) == pytest.approx(0.0, abs=0.15)
    assert helioecliptic(np.array([1.0, 0.0, 0.0]), sun)[0] == pytest.approx(0.0, abs=0.4)


@pytest.mark.parametrize(
    ("time", "row", "away", "magnitude"),
    [
        ("2025-01-10T05:00:00", 0, 47.2, -4.6),  # Venus, greatest elongation east
        ("2025-01-16T02:00:00", 1, 176.0, -1.4),  # Mars in opposition
        ("2026-01-10T08:00:00", 2, 179.7, -2.7),  # Jupiter in opposition
        ("2017-06-15T10:00:00", 3, 178.8, 0.0),  # Saturn in opposition, rings open
    ],
)
def test_planets(time, row, away, magnitude):
    """Almanac elongations to 0.5 deg and magnitudes to 0.25 (Saturn 0.5: its rings' tilt is a mean)."""
    sky = at(time)
    assert angle(sky.sun, sky.planets[row]) == pytest.approx(away, abs=0.5)
    assert sky.planet_magnitudes[row] == pytest.approx(magnitude, abs=0.5 if row == 3 else 0.25)


@pytest.mark.parametrize("time", ["2025-06-01T00:00:00", "2027-11-17T13:20:00"])
def test_directions_against_astropy(time):
    """To 0.02 deg: light time, aberration and planetary series are left out."""
    when = Time(time, scale="utc")
    frame = GCRS(
        obstime=when, obsgeoloc=CartesianRepresentation(PLACE, unit=u.km),
        obsgeovel=CartesianRepresentation(VELOCITY, unit=u.km / u.s),
    )  # fmt: skip
    sky = at(time)
    found = {"sun": sky.sun, "moon": sky.moon}
    found |= dict(zip(("venus", "mars", "jupiter", "saturn"), sky.planets, strict=True))
    for name, direction in found.items():
        position = get_body(name, when, ephemeris="builtin").transform_to(frame)
        assert angle(direction, unit_vectors(position.ra.deg, position.dec.deg)) < 0.02, name


def test_exposure_angles():
    """Looking at the zenith, at the limb, at the nadir, at the Sun; the lowest sunlit limb is a right angle away."""
    mjd = mjd_utc("2027-06-26T20:35:58")
    radius = np.degrees(np.arcsin(6378.137 / np.linalg.norm(PLACE)))
    x, y, z = PLACE
    ra, dec = np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z / np.linalg.norm(PLACE)))
    up, down = (exposure_angles(*position, mjd, PLACE, VELOCITY) for position in ((ra, dec), (ra + 180, -dec)))
    assert up["limb"] == pytest.approx(180 - radius) and down["limb"] == pytest.approx(-radius)
    sky = bodies(mjd, PLACE, VELOCITY, numbers())
    sun = np.degrees([np.arctan2(sky.sun[1], sky.sun[0]), np.arcsin(sky.sun[2])])
    here = exposure_angles(*sun, mjd, PLACE, VELOCITY)
    assert here["sun"] == pytest.approx(0.0, abs=1e-5)
    assert here["moon"] == pytest.approx(float(angle(sky.sun, sky.moon)))
    # towards the Sun the nearest limb is where it rises: its height there is what the Sun stands over that limb
    assert here["limb_sun"] == pytest.approx(here["limb"], abs=1e-6)


def test_ecliptic_frame_and_telescope_axes_against_astropy():
    rng = np.random.default_rng(2)
    ra, dec = rng.uniform(0, 360, 50), np.degrees(np.arcsin(rng.uniform(-1, 1, 50)))
    theirs = SkyCoord(ra * u.deg, dec * u.deg).barycentricmeanecliptic
    longitude, latitude = helioecliptic(unit_vectors(ra, dec), np.array([1.0, 0.0, 0.0]))
    assert np.abs((longitude - theirs.lon.deg + 180) % 360 - 180).max() < 1e-3
    assert np.abs(latitude - theirs.lat.deg).max() < 1e-3
    for here in ((60.0, -40.0, -113.4), (0.0, 90.0, 20.0), (359.99, -90.0, 0.0)):
        for parity in (1, -1):
            axes = telescope_axes(*here, parity)
            assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-15)
            assert np.linalg.det(axes) == pytest.approx(parity)  # east, north, outward


@pytest.mark.parametrize("pa", [0.0, 77.0, -113.4])
def test_telescope_axes_against_the_wcs(pa):
    """A step along a chip's column and row goes where the projection says."""
    from support.readout_state import POINTING
    from support.sky_geometry import camera

    from csstsim.instrument.pointing import Pointing
    from csstsim.optics.geometry.wcs import ChipWCS

    wcs = ChipWCS(camera().chips[9], Pointing(**(POINTING | {"pa": pa})))
    x0, y0 = wcs.crpix - 1
    for axis, step in ((0, (100.0, 0.0)), (1, (0.0, 100.0))):
        moved = unit_vectors(*wcs.pixel_to_world(x0 + step[0], y0 + step[1]))
        own = telescope_axes(POINTING["ra"], POINTING["dec"], pa, camera().telescope.parity) @ moved
        assert own[axis] * 206264.806 / 0.074 == pytest.approx(100.0, rel=1e-6)
        assert abs(own[1 - axis]) < 1e-9


@pytest.mark.parametrize("time", ["2027-01-05T00:00:00", "2027-03-15T00:00:00", "2027-07-12T00:00:00"])
def test_the_moon_is_lit_by_the_sun_at_its_distance(time):
    """The law of sky.yaml on astropy's distances and phase: 0.005 mag, where the Sun's distance makes 0.04."""
    moment = Time(time)
    found = at(time)
    sun, moon, earth = (get_body_barycentric(name, moment).xyz.to_value("km") for name in ("sun", "moon", "earth"))
    here = earth + np.array(PLACE)
    near = np.linalg.norm(moon - here)
    phase = angle(here - moon, sun - moon)
    au = np.linalg.norm(sun - here) / 149_597_870.7
    law = numbers().bodies.moon
    wanted = law.magnitude + sum(c * phase ** (k + 1) for k, c in enumerate(law.phase))
    wanted += 5 * np.log10(near / law.distance_km) + 5 * np.log10(au)
    assert found.moon_magnitude == pytest.approx(wanted, abs=0.005)


def test_the_angles_of_sun_and_moon_at_both_ends(make_pointing):
    """Against astropy's ephemerides, to 0.01 deg: geometric here, with light time there."""
    from astropy.utils import iers

    pointing = make_pointing(exptime=1500.0)
    values = angles_at_ends(pointing)
    first = pointing.sat_position, pointing.sat_velocity
    last = orbit_after(*first, pointing.exptime)
    for end, after, (position, velocity) in (("start", 0.0, first), ("end", pointing.exptime, last)):
        with iers.conf.set_temp("auto_download", False), iers.conf.set_temp("iers_degraded_accuracy", "ignore"):
            time = Time(pointing.mjd, format="mjd", scale="utc") + after * u.s
            frame = GCRS(
                obstime=time, obsgeoloc=CartesianRepresentation(*position, unit=u.km),
                obsgeovel=CartesianRepresentation(*velocity, unit=u.km / u.s),
            )  # fmt: skip
            boresight = SkyCoord(pointing.ra * u.deg, pointing.dec * u.deg, frame=frame)
            for body in ("sun", "moon"):
                seen = SkyCoord(get_body(body, time).transform_to(frame))
                assert values[f"{body}_angle_{end}"] == pytest.approx(boresight.separation(seen).deg, abs=0.01)
    # The Moon moves by 0.55 deg an hour, the spacecraft's parallax by much more
    assert 0.05 < abs(values["moon_angle_end"] - values["moon_angle_start"]) < 3


def test_the_sun_at_the_limb_is_its_height_over_the_nearest_ground_on_the_horizon():
    """A boresight anywhere: the ground point where the line of sight's plane touches the Earth, found by search."""
    mjd = mjd_utc("2027-06-26T20:35:58")
    sun = bodies(mjd, PLACE, VELOCITY, numbers()).sun
    position = np.array(PLACE)
    zenith, reach = position / np.linalg.norm(position), np.linalg.norm(position)
    horizon = np.arccos(6378.137 / reach)  # of the ground, from the sub-satellite point
    side = np.cross(zenith, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    turn = np.linspace(0, 2 * np.pi, 100_001)[:, None]
    ring = np.cos(horizon) * zenith + np.sin(horizon) * (np.cos(turn) * side + np.sin(turn) * np.cross(zenith, side))
    for ra, dec in ((200.0, 35.0), (310.0, -62.0), (80.0, 10.0)):
        boresight = unit_vectors(ra, dec)
        seen = ring * 6378.137 - position
        nearest = ring[np.argmax(seen @ boresight / np.linalg.norm(seen, axis=1))]
        found = exposure_angles(ra, dec, mjd, PLACE, VELOCITY)
        assert found["limb_sun"] == pytest.approx(np.degrees(np.arcsin(nearest @ sun)), abs=0.02)
        along = (nearest * 6378.137 - position) / np.linalg.norm(nearest * 6378.137 - position)
        assert abs(found["limb"]) == pytest.approx(float(angle(boresight, along)), abs=0.01)


def test_planets_by_the_law_of_their_phase():
    """Astropy's distances and phase angles, magnitudes by sky.yaml's numbers, to 0.02; Venus is held at its largest."""
    for time in ("2025-03-23T00:00:00", "2026-04-20T00:00:00"):  # Venus before the Sun, and 40 deg from it
        moment, sky = Time(time), at(time)
        sun, earth = (get_body_barycentric(name, moment).xyz.to_value("au") for name in ("sun", "earth"))
        here = earth + np.array(PLACE) / 149_597_870.7
        for k, name in enumerate(("venus", "mars", "jupiter", "saturn")):
            planet = get_body_barycentric(name, moment).xyz.to_value("au")
            _, bright, *law, largest = numbers().bodies.planets[k]
            phase = min(angle(here - planet, sun - planet), largest)
            wanted = bright + sum(c * phase ** (n + 1) for n, c in enumerate(law))
            wanted += 5 * np.log10(np.linalg.norm(planet - here) * np.linalg.norm(planet - sun))
            assert sky.planet_magnitudes[k] == pytest.approx(wanted, abs=0.02), name
