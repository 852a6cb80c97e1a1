"""The predicted error: properties of any such bound, whatever its coefficients."""

from dataclasses import replace

import numpy as np
import pytest

from csstsim.profiles.sersic import sersic_b
from csstsim.render.error_model import predicted
from csstsim.render.scene import Scene
from csstsim.render.settings import load_numbers

NUMBERS = load_numbers().error
PER_ARCSEC = 1 / 0.074  # px


def scene(index, radius, bulge=0.0):
    """n galaxies of a Sersic index and half-light radius [arcsec] and a share of n = 4; index 0: points."""
    index, radius = np.broadcast_arrays(np.atleast_1d(np.asarray(index, float)), np.asarray(radius, float))
    n = len(index)
    sersic = np.zeros((n, 2, 3))
    there = index > 0
    sersic[there, 0] = np.stack([index, sersic_b(np.maximum(index, 0.3)), radius], axis=1)[there]
    sersic[there, 1] = np.stack([np.full(n, 4.0), np.full(n, sersic_b(4.0)), radius], axis=1)[there]
    none, light = np.zeros(n), np.stack([np.full(n, 1 - bulge), np.full(n, bulge)], axis=1)
    matrix = np.broadcast_to(np.eye(2) * PER_ARCSEC, (n, 2, 2))
    return Scene(
        np.arange(n),
        none,
        none,
        np.ones((n, 4)),
        light,
        sersic,
        matrix,
        np.zeros((n, 1), int),
        np.ones((n, 1)),
        none > 0,
    )


def bound(method, objects, snr, reach=32, cells=4):
    n = len(objects)
    return predicted(method, objects, np.full(n, reach), np.broadcast_to(np.asarray(snr, float), n), NUMBERS, cells)


@pytest.mark.parametrize("method", ["photons", "stamp"])
@pytest.mark.parametrize("index", [0.0, 0.3, 1.0, 4.0, 6.2])
def test_rises_with_flux_from_nothing(method, index):
    snr = np.r_[0.0, np.geomspace(1e-3, 1e5, 50)]
    values = bound(method, scene(np.full(51, index), 0.3), snr)
    assert values[0] == 0
    assert (np.diff(values) > 0).all()


# Visible errors of stamps of bright galaxies against the reference renderer: `benchmarks/error_model.py --bright`
BRIGHT = [  # n, half-light radius [arcsec], S/N, smallest and largest of round and elongated
    (1.0, 0.1, 5477, 5.61, 6.50), (1.0, 0.1, 14142, 29.5, 31.8), (1.0, 0.3, 5476, 7.76, 7.80),
    (1.0, 0.3, 14142, 31.9, 32.0), (1.0, 0.6, 5474, 7.33, 10.9), (1.0, 0.6, 14141, 26.3, 34.7),
    (1.0, 1.0, 5468, 7.84, 11.6), (1.0, 1.0, 14139, 27.5, 38.5), (4.0, 0.1, 5477, 12.0, 14.5),
    (4.0, 0.1, 14142, 36.0, 45.4), (4.0, 0.3, 5476, 21.2, 31.2), (4.0, 0.3, 14142, 62.2, 85.3),
    (4.0, 0.6, 5474, 30.0, 32.7), (4.0, 0.6, 14141, 81.4, 88.8), (4.0, 1.0, 5468, 28.5, 30.8),
    (4.0, 1.0, 14139, 77.3, 83.3),
]  # fmt: skip


@pytest.mark.parametrize(("index", "radius", "snr", "least", "most"), BRIGHT)
def test_bright_galaxies_bound_is_what_is_seen_within_a_factor_of_three(index, radius, snr, least, most):
    value = bound("stamp", scene([index], radius), float(snr), reach=100)[0]
    assert most < value < 3.0 * least


@pytest.mark.parametrize(("cells", "most"), [(4, 2e4), (2, 7e3)])
@pytest.mark.parametrize("index", [1.0, 4.0])
def test_the_far_parts_end_decides_no_method(cells, most, index):
    """Without it each galaxy finds stamps good or not as with it: choices, and pixels, stay."""
    snr, radius = (v.ravel() for v in np.meshgrid(np.geomspace(0.1, most, 400), np.geomspace(0.01, 3.0, 60)))
    objects, reach = scene(np.full(snr.size, index), radius), np.full(snr.size, 64)
    least = predicted("photons", objects, reach, snr, NUMBERS, cells)
    good = [
        predicted("stamp", objects, reach, snr, numbers, cells) <= np.maximum(0.1, 3.0 * least)
        for numbers in (NUMBERS, NUMBERS.model_copy(update={"far": np.inf}))
    ]
    assert np.array_equal(*good) and (good[0].any() and (cells == 2 or not good[0].all()))


@pytest.mark.parametrize("method", ["photons", "stamp"])
def test_a_vanishing_galaxy_is_a_point_in_a_stamp_of_any_size(method):
    star = bound(method, scene([0.0], 0.0), 50.0, reach=10**9)
    assert bound(method, scene([1.0], 1e-9), 50.0) == pytest.approx(star, rel=1e-6)


def test_steeper_profiles_are_no_better():
    values = bound("stamp", scene([0.3, 1.0, 2.0, 3.0, 4.0, 5.0, 6.2], 1.0), 100.0)
    assert values[0] == values[1]
    assert (np.diff(values[1:]) > 0).all()


def test_components_count_by_their_light():
    disk, bulge, both = (bound("stamp", scene([1.0], 0.5, share), 80.0)[0] for share in (0.0, 1.0, 0.25))
    assert both == pytest.approx(0.75 * disk + 0.25 * bulge, rel=1e-12)


def test_smaller_stamps_of_points_are_worse_and_photons_have_none():
    points = scene([0.0], 0.0)
    assert bound("stamp", points, 10.0, reach=16) > bound("stamp", points, 10.0, reach=32)
    assert bound("photons", points, 10.0, reach=16) == bound("photons", points, 10.0, reach=32)


@pytest.mark.parametrize("method", ["photons", "stamp"])
def test_coarser_cells_are_worse(method):
    assert bound(method, scene([0.0], 0.0), 10.0, cells=2) > bound(method, scene([0.0], 0.0), 10.0, cells=4)


@pytest.mark.parametrize("radius", [0.02, 0.1, 0.2])
def test_sizes_are_in_pixels_of_the_area(radius):
    """A lens that doubles lengths makes of a galaxy one twice as large, stretched or not: the same bound."""
    small, large = scene([1.0, 4.0], radius), scene([1.0, 4.0], 2 * radius)
    doubled = replace(small, matrix=2 * small.matrix)
    stretched = replace(small, matrix=small.matrix @ np.diag([8.0, 0.5]))
    wanted = bound("stamp", large, 50.0)
    assert (wanted != bound("stamp", small, 50.0)).all()
    assert bound("stamp", doubled, 50.0) == pytest.approx(wanted, rel=1e-12)
    assert bound("stamp", stretched, 50.0) == pytest.approx(wanted, rel=1e-12)
