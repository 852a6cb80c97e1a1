"""Strips on whole pixels: which belong to them, how many are needed, sky between blocks; the object's own light."""

import numpy as np
import pytest

from csstsim.measure.spectra.local_sky import Strips, _clipped, _deviation, _electrons

OFFSET = np.arange(-20, 21.0)


def strips_of(columns, data=None, good=None, fraction=None):
    shape = columns, len(OFFSET)
    offset = np.broadcast_to(OFFSET, shape).copy()
    return Strips.of(
        offset**2 if data is None else data, np.ones(shape, bool) if good is None else good, offset,
        np.zeros(shape) if fraction is None else fraction, 10.0, 6.0,
    )  # fmt: skip


def test_a_strip_has_its_inner_edge_and_not_its_outer_one():
    """10 to 15 px on either side: the mean and variance of these squares, of 2 x 48 pixels each."""
    squares = np.arange(10, 16.0) ** 2
    sky = strips_of(48, fraction=np.tile(abs(OFFSET), (48, 1))).by_block(np.zeros(48))
    assert sky.level == pytest.approx([squares.mean()]) and sky.fraction == pytest.approx([12.5])
    assert sky.variance == pytest.approx([squares.var() / (6 * 48) / 2])


@pytest.mark.parametrize(("usable", "sides"), [(72, 2), (71, 1)])
def test_a_side_needs_a_quarter_of_its_pixels(usable, sides):
    good = np.ones((48, len(OFFSET)), bool)
    right = good[:, 30:36]
    right[:] = (np.arange(right.size) < usable).reshape(right.shape)
    data = np.broadcast_to(np.where(OFFSET > 0, 30.0, 10.0), good.shape).copy()
    level = strips_of(48, data, good).by_block(np.zeros(48)).level
    assert level == pytest.approx([20.0 if sides == 2 else 10.0])


def test_the_sky_is_linear_between_blocks_and_held_at_the_ends():
    """Five blocks of 48 columns, the middle one lost; a fraction of the object's flux and an error of each, too."""
    data, fraction = np.zeros((2, 240, len(OFFSET)))
    for k, level in enumerate((10.0, 20.0, np.nan, 60.0, 50.0)):
        part = slice(48 * k, 48 * k + 48)
        data[part] = level + 0.1 * (k + 1) * (-1.0) ** np.arange(len(OFFSET))
        fraction[part] = 0.001 * (k + 1)
    found = strips_of(240, data, np.isfinite(data), fraction).sky(np.zeros(240))
    middle = np.array([23.5, 71.5, 167.5, 215.5])
    column = np.arange(240)
    assert found.level == pytest.approx(np.interp(column, middle, [10, 20, 60, 50]))
    assert found.fraction == pytest.approx(np.interp(column, middle, [0.001, 0.002, 0.004, 0.005]))
    variance = np.array([0.1, 0.2, 0.4, 0.5]) ** 2 / (6 * 48) / 2
    assert found.variance == pytest.approx(np.interp(column, middle, variance))


def test_an_objects_light_is_the_weighted_sum_of_good_pixels():
    data, good = np.array([[9.0, 25.0, 1e6], [7.0, 7.0, 7.0]]), np.array([[True, True, False], [False] * 3])
    fraction, overlap = np.array([[0.1, 0.4, 0.5], [0.2] * 3]), np.array([[0.5, 1.0, 1.0], [1.0] * 3])
    found = _electrons(data, good, fraction, overlap, np.array([5.0, 5.0]))
    assert found[0] == pytest.approx((0.5 * 4 + 20) / (0.05 + 0.4)) and np.isnan(found[1])


def test_columns_without_known_light_have_that_of_their_neighbours():
    """An object that fades along the trace, its wings in the strips: its sky is that without it."""
    shape = 48, len(OFFSET)
    fraction = np.exp(-0.5 * (OFFSET / 5.0) ** 2)[None] / (5 * np.sqrt(2 * np.pi)) * np.ones(shape)
    light = np.linspace(3000.0, 1000.0, 48)
    data = 20.0 + light[:, None] * fraction
    strips = strips_of(48, data, fraction=fraction)
    aperture, good = slice(13, 28), np.ones((48, 15), bool)
    known = np.ones(48, bool)
    known[20:30], good[20:30] = False, False
    aperture = data[:, aperture], good, fraction[:, aperture], np.ones((48, 15))
    assert strips.sky_without_object(*aperture, known).level == pytest.approx(np.full(48, 20.0), abs=0.15)
    assert strips.sky_without_object(*aperture, np.zeros(48, bool)).level[0] > 24


@pytest.mark.parametrize("values", [[3.0], [1.0, 4.0], [0.0, 1.0, 1.5, 9.0], [-5.0, 0.0, 1.0, 1.5, 9.0, 30.0, 31.0]])
def test_the_median_distance_is_numpys(values):
    for centre in (np.median(values), 1.2):
        assert _deviation.py_func(np.array(values), centre) == pytest.approx(
            np.median(np.abs(np.array(values) - centre))
        )


def test_values_beyond_four_robust_sigma_are_left_out_with_their_fractions():
    """Median 0, median distance 10: sigma 15.326, so 61.2 counts and 61.4 does not."""
    base = np.array([-10.0] * 20 + [0.0] + [10.0] * 20)
    for value, kept in ((61.2, True), (61.4, False), (-61.4, False), (-61.2, True)):
        values = np.append(base, value)
        values = np.append(values, -value if kept else 0.0)
        own = np.arange(len(values)) / 10
        used = np.ones(len(values), bool) if kept else values != value
        found = _clipped(values, np.sort(values), own)
        assert found == pytest.approx([values[used].mean(), values[used].var() / used.sum(), own[used].mean()])
