"""Compact evolution against the Sun, main-sequence dwarfs, clusters and white dwarfs."""

import numpy as np
import pytest

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.stars.stellar_evolution import living, stage_ends, white_dwarfs

NUMBERS = read_data(SHIPPED / "universe" / "stars.yaml")


def _at(mass, feh, age, deviate=0.5):
    """Teff, log g, radius, M_V and stage of one star at `age` [Gyr]."""
    ends = np.concatenate([[0.0], stage_ends(np.array([mass]), np.array([feh]), NUMBERS)[:, 0]])
    stage = np.interp(age, ends, np.arange(5.0))
    state = living(*(np.array([x], float) for x in (mass, feh, stage, deviate)), NUMBERS)
    return *(float(x[0]) for x in state), stage


def _isochrone(feh, age):
    """Main sequence of one age: Teff, log g, radius, M_V, mass."""
    mass = np.linspace(0.1, 7.0, 30000)
    stage = age / stage_ends(mass, np.full_like(mass, feh), NUMBERS)[0]
    on = stage < 1
    state = living(mass[on], np.full(on.sum(), feh), stage[on], np.zeros(on.sum()), NUMBERS)
    return *state, mass[on]


def test_the_sun_and_its_past():
    teff, logg, radius, m_v, stage = _at(1.0, 0.0, 4.57)
    assert teff == pytest.approx(5772, abs=40)
    assert (radius, logg, m_v) == (
        pytest.approx(1.0, abs=0.03),
        pytest.approx(4.438, abs=0.03),
        pytest.approx(4.82, abs=0.1),
    )
    assert 0 < stage < 1
    young = _at(1.0, 0.0, 0.0)
    assert 10 ** (-0.4 * (young[3] - m_v)) == pytest.approx(0.70, abs=0.05)  # the faint young Sun
    assert stage_ends(np.ones(1), np.zeros(1), NUMBERS)[2, 0] == pytest.approx(12.2, rel=0.05)  # red giant tip, Gyr


@pytest.mark.parametrize(
    ("feh", "age", "teff", "m_v"),
    [
        (0.0, 4.0, 6150, 3.6),  # M 67
        (-0.75, 11.5, 5950, 4.2),  # 47 Tuc
        (-1.5, 13.0, 6350, 4.1),  # M 3, M 13
        (-2.2, 13.0, 6600, 4.0),  # M 92
    ],
)
def test_turn_offs_of_clusters(feh, age, teff, m_v):
    temperature, _, _, absolute, _ = _isochrone(feh, age)
    hottest = temperature.argmax()
    assert temperature[hottest] == pytest.approx(teff, abs=150)
    assert absolute[hottest] == pytest.approx(m_v, abs=0.35)


def test_subdwarfs_lie_below_the_main_sequence():
    """Gmb 1830: Teff 5140 K, [Fe/H] -1.35, M_V 6.6; a dwarf like the Sun's neighbours has 6.0."""
    for feh, m_v in ((-1.35, 6.62), (0.0, 6.0)):
        teff, _, _, absolute, mass = _isochrone(feh, 8.0)
        low = mass < 0.85  # below the turn-off
        order = np.argsort(teff[low])
        assert np.interp(5140, teff[low][order], absolute[low][order]) == pytest.approx(m_v, abs=0.2)


def test_dwarfs_of_one_age_follow_the_table():
    table = np.array(NUMBERS["main_sequence"])
    low = table[:, 0] < 0.9
    mass = table[low, 0]
    stage = 5.0 / stage_ends(mass, np.zeros_like(mass), NUMBERS)[0]
    teff, _, radius, m_v = living(mass, np.zeros_like(mass), stage, np.zeros_like(mass), NUMBERS)
    np.testing.assert_allclose(teff, table[low, 1], rtol=0.005)
    np.testing.assert_allclose(m_v, table[low, 3], atol=0.1)
    assert radius[mass == 0.36][0] == pytest.approx(0.361, rel=0.01)  # M3V


def test_giants():
    clump = living(*np.array([[1.2], [0.0], [3.5], [0.5]]), NUMBERS)
    assert clump[0][0] == pytest.approx(4780, abs=100)
    assert clump[1][0] == pytest.approx(2.45, abs=0.15)
    assert clump[3][0] == pytest.approx(0.8, abs=0.2)
    branch = living(np.full(50, 1.1), np.zeros(50), np.linspace(2.001, 2.999, 50), np.zeros(50), NUMBERS)
    assert (np.diff(branch[0]) < 0).all() and (np.diff(branch[2]) > 0).all()
    assert branch[1][0] == pytest.approx(3.75, abs=0.15) and branch[1][-1] < 0.7
    blue = living(np.full(3, 0.8), np.full(3, -1.5), np.full(3, 3.5), np.array([0.0, 0.5, 1.0]), NUMBERS)
    assert 5000 < blue[0][0] < 5500 and blue[0][2] > 6500
    np.testing.assert_allclose(blue[3], 0.58, atol=0.25)  # M_V of the horizontal branch


def test_a_star_moves_without_jumps_until_the_clump():
    stage = np.linspace(0, 2.999, 3000)
    for mass, feh in ((0.8, -1.5), (1.0, 0.0), (1.6, 0.2), (4.0, 0.0)):
        teff, _, radius, _ = living(np.full(3000, mass), np.full(3000, feh), stage, np.zeros(3000), NUMBERS)
        assert np.abs(np.diff(np.log10(teff)))[:2900].max() < 0.005
        assert np.abs(np.diff(np.log10(radius)))[:2900].max() < 0.02


def test_lifetimes_fall_with_mass():
    mass = np.geomspace(0.3, 8, 200)
    for feh in (-2.5, -1.0, 0.0, 0.4):
        ends = stage_ends(mass, np.full(200, feh), NUMBERS)
        assert (np.diff(ends, axis=1) < 0).all()
        assert (np.diff(ends, axis=0) > 0).all()
    assert stage_ends(np.array([8.0]), np.zeros(1), NUMBERS)[0, 0] == pytest.approx(0.037, rel=0.15)


def test_white_dwarfs():
    """0.6 Msun of pure hydrogen: M_V about 11.3 at 15000 K, 12.2 at 10000 K, 15.1 at 5000 K (Bergeron et al. 1995)."""
    first = (0.6 - 0.394) / 0.109
    for gyr, hot, bright in ((0.204, 15000, 11.3), (0.603, 10000, 12.2), (5.13, 5000, 15.1)):
        teff, logg, radius, m_v, mass = (float(x[0]) for x in white_dwarfs(np.array([first]), np.array([gyr]), NUMBERS))
        assert mass == pytest.approx(0.6)
        assert teff == pytest.approx(hot, rel=0.02)
        assert logg == pytest.approx(8.0, abs=0.05)
        assert m_v == pytest.approx(bright, abs=0.2)
        assert radius == pytest.approx(0.0127, rel=0.02)
    newborn = white_dwarfs(np.array([2.0]), np.array([0.0]), NUMBERS)
    assert newborn[0][0] == pytest.approx(60000)


def test_stars_that_burn_helium_in_closed_form():
    """Luminosity by mass above 2.2, temperature by metals and position; poor ones reach far to the blue."""
    mass, feh = np.array([1.0, 1.0, 1.0, 4.4, 1.0]), np.array([0.0, 0.0, 0.3, 0.0, -1.4])
    position = np.array([0.5, 1.0, 0.0, 0.5, 1.0])
    teff, logg, radius, m_v = living(mass, feh, np.full(5, 3.5), position, NUMBERS)
    wanted = 3.679 + np.array([0.0, 0.008, -0.03 * 0.3 - 0.008, 0.0, 0.03 * 1.4 + 0.008 + 0.22 * 0.5])
    np.testing.assert_allclose(np.log10(teff), wanted, atol=1e-9)
    log_l = np.array([1.7, 1.7, 1.7, 1.7 + 3.4 * np.log10(2.0), 1.7])
    np.testing.assert_allclose(radius, 10 ** (0.5 * log_l) * (5772.0 / teff) ** 2, rtol=1e-9)
    np.testing.assert_allclose(logg, 4.438 + np.log10(mass) - 2 * np.log10(radius), atol=1e-9)
    assert m_v[1] < m_v[0] + 0.1 and m_v[3] == pytest.approx(m_v[0] - 2.5 * 3.4 * np.log10(2.0), abs=1e-9)


def test_giants_are_cooler_if_rich_and_hotter_if_massive():
    """At one luminosity: 0.028 dex per dex of metals, 0.1 per dex of mass; the tip is that of the course."""
    law = NUMBERS["giant"]
    mass, feh = np.array([1.0, 1.0, 2.0]), np.array([0.0, -0.5, 0.0])
    for stage in (2.3, 2.999999):
        teff, _, radius, _ = living(mass, feh, np.full(3, stage), np.zeros(3), NUMBERS)
        log_l = 2 * np.log10(radius) + 4 * np.log10(teff / 5772.0)
        usual = np.interp(log_l, law["log_l"], law["log_teff"])
        np.testing.assert_allclose(np.log10(teff) - usual, [0.0, 0.014, 0.1 * np.log10(2)], atol=1e-9)
    course = NUMBERS["course"]
    tip = np.interp(np.log(mass), np.log(course["mass"]), course["tip"])
    np.testing.assert_allclose(log_l, tip, atol=1e-3)


def test_metals_change_colours_below_the_sun_s():
    """Main-sequence stars of one mass and stage: luminosity and temperature per dex, up to the limits of metals."""
    full, stage = np.full(4, 0.5), np.full(4, 0.3)
    feh = np.array([0.0, -1.0, -1.9, -4.0])
    teff, _, radius, _ = living(full, feh, stage, np.zeros(4), NUMBERS)
    log_l = 2 * np.log10(radius) + 4 * np.log10(teff / 5772.0)
    np.testing.assert_allclose(log_l - log_l[0], [0.0, 0.17, 0.323, 0.323], atol=1e-9)
    np.testing.assert_allclose(np.log10(teff / teff[0]), [0.0, 0.048, 0.0912, 0.0912], atol=1e-9)
    from csstsim.universe.stars.stellar_evolution import correction

    cool = np.array([3400.0, 3400.0, 3400.0, 6000.0])
    bc = correction(cool, np.array([0.0, -1.0, -3.0, -1.0]), NUMBERS)
    assert bc[1] - bc[0] == pytest.approx(0.32) and bc[2] - bc[0] == pytest.approx(0.32 * 1.5)
    assert bc[3] - correction(cool[3:], np.zeros(1), NUMBERS)[0] == pytest.approx(-0.07)
    assert bc[0] == pytest.approx(4.74 - 2.5 * np.log10(10 ** log_at(3400.0)) - v_at(3400.0))


def log_at(teff):
    """log L of the main sequence at a temperature, from the table's columns."""
    table = np.array(NUMBERS["main_sequence"]).T
    return np.interp(np.log(teff), np.log(table[1]), table[2])


def v_at(teff):
    table = np.array(NUMBERS["main_sequence"]).T
    return np.interp(np.log(teff), np.log(table[1]), table[3])


def test_white_dwarfs_cool_later_if_light():
    """The age of 0.6 Msun counts times 0.6 over the mass; radius by Nauenberg; older ones than the table stay."""
    first = (np.array([0.6, 0.9]) - 0.394) / 0.109
    teff, logg, radius, _, mass = white_dwarfs(first, np.array([2.0, 3.0]), NUMBERS)
    assert teff[0] == pytest.approx(teff[1]) and mass == pytest.approx([0.6, 0.9])
    x = (np.array([0.6, 0.9]) / 1.44) ** (1 / 3)
    np.testing.assert_allclose(radius, 0.0114 * np.sqrt(x**-2 - x**2), rtol=1e-9)
    np.testing.assert_allclose(logg, 4.438 + np.log10(mass) - 2 * np.log10(radius), atol=1e-9)
    assert white_dwarfs(first[:1], np.array([40.0]), NUMBERS)[0][0] == pytest.approx(3000.0)
