"""Asteroids: light time in closed form, and a search that says of each what its orbit says."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import kstest, spearmanr

from csstsim.base.shipped import SHIPPED
from csstsim.universe.changing import asteroids
from csstsim.universe.changing.numbers import numbers_of

LIGHT_AU_DAY = 299_792.458 * 86400 / 149_597_870.7
MJD, SUN = 61700.0, np.array([0.55, 0.75, 0.35])  # an observer 0.99 au from the Sun, on axes of the ICRS


@pytest.fixture(scope="module")
def numbers():
    return {**numbers_of(SHIPPED / "universe", "asteroids"), "faintest": 20.0}


@pytest.fixture(scope="module")
def everywhere(numbers):
    """All asteroids of the sky brighter than V = 17.5."""
    bright = {**numbers, "faintest": 17.5}
    return bright, asteroids.asteroids_near(3, MJD, SUN, np.array([1.0, 0.0, 0.0]), np.pi, bright)


@pytest.mark.parametrize("days", [-3000.0, 0.0, 12_345.6])
def test_circular_orbits_are_seen_as_they_were_when_the_light_left(days):
    """In the ecliptic, a^-1.5 turns of a Gaussian year; the observer 1 au from the Sun; to 1e-4 arcsec and 1e-8 mag."""
    a, start = np.array([2.2, 2.9, 4.0]), np.array([0.3, 2.0, 5.5])
    observer = np.array([np.cos(1.1), np.sin(1.1), 0.0])

    def position(k, time):
        angle = start[k] + 0.01720209895 * time / a[k] ** 1.5
        return a[k] * np.array([np.cos(angle), np.sin(angle), 0.0])

    orbit = np.stack([a, *np.zeros((4, 3)), start])
    seen, v = asteroids.observed(orbit, np.full(3, 15.0), 61545.0 + days, observer, 0.15)
    for k in range(3):
        delay = brentq(lambda t, k=k: np.linalg.norm(position(k, days - t) - observer) - LIGHT_AU_DAY * t, 0.0, 0.1)
        away = position(k, days - delay) - observer
        distance = np.linalg.norm(away)
        assert np.linalg.norm(seen[k] - away / distance) < np.radians(1e-4 / 3600)
        half = 0.5 * np.arccos(away @ position(k, days - delay) / distance / a[k])
        phase = 0.85 * np.exp(-3.33 * np.tan(half) ** 0.63) + 0.15 * np.exp(-1.87 * np.tan(half) ** 1.22)
        assert v[k] == pytest.approx(15.0 + 5 * np.log10(a[k] * distance) - 2.5 * np.log10(phase), abs=1e-8)


def test_what_is_found_is_what_its_orbit_says(everywhere):
    bright, found = everywhere
    assert len(found["id"]) > 1000 and np.unique(found["id"]).size == len(found["id"])
    seen, v = asteroids.seen_from(found["orbit"], found["H"], MJD, SUN, bright["phase_slope"])
    assert np.abs(seen - found["vector"]).max() < 1e-12 and np.abs(v - found["V"]).max() < 1e-9
    assert found["V"].max() <= 17.5 < found["V"].max() + 0.1
    for name, values in zip(("a", "e", "i"), found["orbit"], strict=False):
        assert np.array_equal(found[name], values)


def test_inclinations_have_the_width_of_their_zone(everywhere):
    """Rayleigh distributions, within 0.03, because the near are brighter, and twice the chance of the number found."""
    bright, found = everywhere
    for k, width in enumerate(np.radians(bright["zones"]["i"])):
        some = found["i"][found["zone"] == k]
        if len(some) > 100:
            gap = kstest(some, lambda i, width=width: -np.expm1(-0.5 * (i / width) ** 2)).statistic
            assert gap < 0.03 + 2 / np.sqrt(len(some)), k
    assert np.degrees(found["i"].max()) > 35


def test_those_at_the_edge_of_a_field_are_found(numbers):
    """Fields that end 0.02 arcsec beyond an asteroid have it and those nearer; light time moves it by 10 arcsec."""
    towards = SUN / np.linalg.norm(SUN)
    wide = asteroids.asteroids_near(1, MJD, SUN, towards, np.radians(2.0), numbers)
    apart = np.arctan2(np.linalg.norm(np.cross(wide["vector"], towards), axis=1), wide["vector"] @ towards)
    order = np.argsort(apart)
    assert len(order) > 100
    for rank in (39, 59, 79):
        radius = apart[order[rank]] + 1e-7
        found = asteroids.asteroids_near(1, MJD, SUN, towards, radius, numbers)
        assert found["id"].tolist() == wide["id"][apart <= radius].tolist()
        assert wide["id"][order[rank]] in found["id"]


def test_the_draws_of_an_orbit_know_nothing_of_each_other(everywhere):
    """Node, longitudes of perihelion and at the epoch, inclination, H, and a and e in their cell: no rank correlation.

    But the near are seen with fainter H, which relates H to longitudes by up to 0.26; nodes are uniform in the turn.
    """
    bright, found = everywhere
    a, e, i, node, peri, anomaly = found["orbit"]
    angles = np.stack([node, node + peri, node + peri + anomaly]) / (2 * np.pi) % 1.0
    first, last = np.array(bright["zones"]["a"])[found["zone"]].T
    cells = np.stack([6 * (a - first) / (last - first), 12 * e / bright["zones"]["e_max"]]) % 1.0
    draws = np.stack([*angles, *cells, i / np.radians(bright["zones"]["i"])[found["zone"]], found["H"]])
    assert np.abs(spearmanr(draws, axis=1).statistic - np.eye(len(draws))).max() < 0.4
    assert kstest(angles[0], "uniform").pvalue > 1e-4
