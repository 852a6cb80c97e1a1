"""Light far from extended objects: wings and tails against sums over an object's points, and photons against stamps."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import gammaincc, gammaincinv

from csstsim.render.extended import POINT, WIDE_PX, Part, beyond_stamp, parts_at, parts_of, spread
from csstsim.render.wing_tables import RADII, RadialProfile, light_of


def fall(places):
    """A wing with a hole in it, at complex positions from its object."""
    square = np.maximum(places.real**2 + places.imag**2, 20.0**2)
    return (square > 20.0**2) / (square * np.sqrt(square))


FALL = fall(RADII)
WING = RadialProfile(np.tile(FALL, (4, 1)), light_of(np.tile(FALL, (4, 1))))


def points(index, size, count=400_000):
    """Complex positions of electrons of a circular Sersic profile."""
    rng = np.random.default_rng(4)
    x = rng.gamma(2 * index, size=count)
    return size * (x / gammaincinv(2 * index, 0.5)) ** index * np.exp(2j * np.pi * rng.random(count))


@pytest.mark.parametrize(
    ("size", "index"),
    [(8.0, 1.0), (32.0, 4.0), (256.0, 1.0)]
    + [pytest.param(*key, marks=pytest.mark.slow) for key in ((8.0, 4.0), (32.0, 1.0), (256.0, 4.0))],
)
def test_a_wing_spread_is_that_of_all_points(index, size):
    """Against 4e5 points seen from 40 positions on a circle: to 5 sigma of their scatter, and 0.5%."""
    made = spread(WING, Part(1.0, index, size)).profile[2]
    positions = points(index, size)
    for r in (60.0, 150.0, 500.0, 2000.0):
        around = r * np.exp(2j * np.pi * np.arange(40) / 40)
        seen = np.array([fall(position - positions).mean() for position in around])
        error = 5 * seen.std() / np.sqrt(len(seen)) + 0.005 * seen.mean()
        assert error < 0.3 * seen.mean()
        assert abs(np.interp(r, RADII, made) - seen.mean()) < error, r


@pytest.mark.parametrize("ratio", [pytest.param(0.5, marks=pytest.mark.slow), 0.125])
def test_an_ellipse_has_its_mean_over_all_directions(ratio):
    """As above, the points of a disc of 64 px drawn out and pressed, and what lies beyond a stamp of 80 px, to 3%."""
    part = Part(1.0, 1.0, 64.0, ratio)
    positions = points(1.0, 64.0)
    positions = positions.real / np.sqrt(ratio) + 1j * positions.imag * np.sqrt(ratio)
    made = spread(WING, part).profile[0]
    for r in (20.0, 100.0, 300.0):
        around = r * np.exp(2j * np.pi * (np.arange(40) + 0.5) / 40)
        seen = np.mean([fall(position - positions).mean() for position in around])
        assert np.interp(r, RADII, made) == pytest.approx(seen, rel=0.03), r
    [(_, tail)] = beyond_stamp((part,), 80)
    held = np.cumsum(2 * np.pi * RADII * tail.profile[0] * np.gradient(RADII))
    inner, outer = np.diff(np.interp([150.0, 220.0, 400.0], RADII, held))
    counts, _ = np.histogram(np.abs(positions), [150.0, 220.0, 400.0])
    assert outer / inner == pytest.approx(counts[1] / counts[0], rel=0.03)


@pytest.mark.parametrize("part", [Part(1.0, 1.0, 8.0), Part(0.3, 4.0, 100.0), Part(1.0, 4.0, 2000.0)])
def test_no_light_is_lost_in_spreading(part):
    made = spread(WING, part)
    assert light_of(made.profile) == pytest.approx(light_of(WING.profile), rel=1e-9)
    assert made.light is WING.light and (made.profile >= 0).all() and np.isfinite(made.profile).all()


def test_a_point_and_a_small_galaxy_have_the_wing_of_a_point():
    assert spread(WING, POINT[0]) is WING
    assert spread(WING, Part(1.0, 4.0, 0.99 * WIDE_PX)) is WING


@pytest.mark.parametrize("reach", [40, 150, 1000])
@pytest.mark.parametrize("index", [1.0, 4.0])
def test_the_tail_is_the_profile_beyond_the_stamp(reach, index):
    """Beyond the seam it falls as the profile does, and it holds what the profile has there."""
    part = Part(1.0, index, 64.0)
    tails = beyond_stamp((part,), reach)
    b = gammaincinv(2 * index, 0.5)
    left = gammaincc(2 * index, b * (1.13 * reach / part.size) ** (1 / index))
    if not tails:
        assert left < 1.5e-4
        return
    assert left > 0.7e-4
    [(fraction, tail)] = tails
    assert fraction == 1.0 and light_of(tail.profile) == pytest.approx(np.ones(4), rel=1e-9)
    level = np.interp(np.array([1.6, 2.5]) * reach, RADII, tail.profile[0])
    expected = np.exp(-b * ((2.5 * reach / 64) ** (1 / index) - (1.6 * reach / 64) ** (1 / index)))
    assert level[1] / level[0] == pytest.approx(expected, rel=0.02)
    assert np.interp(0.8 * reach, RADII, tail.profile[0]) == 0


def test_two_components_divide_what_is_missing_by_what_they_have_beyond():
    parts = Part(0.9, 1.0, 32.0), Part(0.1, 4.0, 64.0)
    fractions = [tail.fraction for tail in beyond_stamp(parts, 200)]
    assert sum(fractions) == pytest.approx(1.0) and fractions[1] > 0.9
    assert beyond_stamp(POINT, 10) == []


def test_parts_of_an_object():
    """Sizes are those of the circle of the area; large ones have an axis ratio; what has no light has no part."""
    matrix = np.diag([20.0, 5.0])
    sersic = np.array([[1.0, 1.68, 0.8], [4.0, 7.67, 1.6]])
    disk, bulge = parts_of(np.array([0.75, 0.25]), sersic, matrix)
    assert disk == Part(0.75, 1.0, 8.0) and bulge == Part(0.25, 4.0, 16.0, 0.25)
    assert parts_of(np.array([0.0, 1.0]), sersic, matrix) == (bulge._replace(fraction=1.0),)
    assert parts_of(np.array([1.0, 0.0]), np.zeros((2, 3)), matrix) == POINT


def test_knots_and_images_count_as_a_disk_of_their_size():
    """The first object of a scene is a galaxy of two components, the second knots of 0.8 arcsec."""
    sersic = np.array([[[2.0, 3.67, 0.4], [4.0, 7.67, 1.6]], [[0.0, 0.0, 0.8], [4.0, 7.67, 1.6]]])
    light, matrix = np.array([[0.75, 0.25], [1.0, 0.0]]), np.stack([np.diag([20.0, 5.0])] * 2)
    scene = SimpleNamespace(
        component_fractions=light, sersic=sersic, matrix=matrix, spots=object(), spot=np.array([-1, 0])
    )
    assert parts_at(scene, 0) == (Part(0.75, 2.0, 4.0), Part(0.25, 4.0, 16.0, 0.25))
    assert parts_at(scene, 1) == (Part(1.0, 1.0, 8.0),)
    scene.spots = scene.spot = None
    assert parts_at(scene, 1) == POINT


def test_an_ellipse_thinner_than_tables_are_made_for_keeps_its_long_axis():
    """64 x 0.25 px is a circle of 4 px; an ellipse of ratio 1 / 64 with the same long axis is one of 8 px."""
    for matrix in (np.diag([64.0, 0.25]), np.diag([0.25, 64.0]), np.array([[0.0, 64.0], [0.25, 0.0]])):
        [part] = parts_of(np.array([1.0, 0.0]), np.array([[1.0, 1.68, 1.0], [0.0, 0.0, 0.0]]), matrix)
        assert part == Part(1.0, 1.0, 8.0, 1 / 64)
    turned = np.array([[0.8, -0.6], [0.6, 0.8]])
    [part] = parts_of(
        np.array([1.0, 0.0]), np.array([[1.0, 1.68, 1.0], [0.0, 0.0, 0.0]]), turned @ np.diag([64.0, 16.0])
    )
    assert part == Part(1.0, 1.0, 32.0, 0.25)


def test_sizes_are_rounded_to_the_nearest_of_four_or_of_thirty_two_in_an_octave():
    def size(px):
        return parts_of(np.array([1.0, 0.0]), np.array([[1.0, 1.68, px], [0.0, 0.0, 0.0]]), np.eye(2))[0].size

    assert [size(px) for px in (5.0, 5.2, 6.0, 15.9)] == pytest.approx(2.0 ** np.array([2.25, 2.5, 2.5, 4.0]))
    assert size(20.0) == pytest.approx(2 ** (138 / 32)) and size(1e-9) == 2.0**-10
