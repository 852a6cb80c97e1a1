"""Trails are one source each, and pairs of points are not trails."""

import numpy as np
import pytest

from csstsim.base.rng import stream

N, STEP = 640, 80


def scene(fabricate, seed, add):
    """(x, y, number of sources within 15 px, distance of the nearest) of 64 objects that `add` puts on an image."""
    rng = stream(seed, "scene")
    line = np.arange(40, N - 30, STEP)
    x, y = (one.ravel() + rng.uniform(-0.5, 0.5, line.size**2) for one in np.meshgrid(line, line))
    image = np.zeros((N, N))
    for column, row, angle in zip(x, y, rng.uniform(0.0, np.pi, x.size), strict=True):
        along, flux = add()
        points = column + np.cos(angle) * along, row + np.sin(angle) * along
        fabricate.add_stars(image, *points, flux)
    table = fabricate.measure(fabricate.add_noise(image, seed))
    distance = np.hypot(table["x"] - x[:, None], table["y"] - y[:, None])
    return (distance < 15.0).sum(axis=1), distance.min(axis=1)


def error(fabricate):
    return np.sqrt(fabricate.VARIANCE * 4.0 * np.pi) * fabricate.SIGMA


@pytest.mark.parametrize("length", [17.0, 30.0])
def test_a_bright_trail_is_one_source_at_its_middle(fabricate, length):
    """S/N 100 as a point; three of four, as background and noise cut some; positions far better than the length."""
    along = (np.arange(4 * length) + 0.5) / 4.0 - length / 2.0
    flux = np.full(along.size, 100.0 * error(fabricate) / along.size)
    sources, distance = scene(fabricate, 3, lambda: (along, flux))
    assert (sources == 1).mean() > 0.75
    assert np.median(distance[sources == 1]) < 0.05 * length


@pytest.mark.parametrize("depth", [0.6, 0.8, 1.0, 1.2])
def test_a_trail_beside_a_dark_place_stays_where_it_is(fabricate, depth):
    """The window of its position has next to no light in sum, and would go anywhere."""
    image, dark = np.zeros((2, N, N))
    along = (np.arange(120) + 0.5) / 4.0 - 15.0
    flux = 200.0 * error(fabricate) / along.size
    for row in range(40, N - 30, STEP):
        fabricate.add_stars(image, 300.3 + along, np.full(along.size, float(row)), np.full(along.size, flux))
        fabricate.add_stars(dark, 300.3 + along, np.full(along.size, row + 9.0), np.full(along.size, depth * flux))
    table = fabricate.measure(fabricate.add_noise(image, 3) - dark.astype(np.float32))
    y = np.arange(40, N - 30, STEP)
    distance = np.hypot(table["x"] - 300.3, table["y"] - y[:, None])[:, table["a"] > 5.0]
    assert (distance.min(axis=1) < 5.0).all()


@pytest.mark.parametrize("separation", [5.0, 8.0, 10.0, 12.0])
@pytest.mark.parametrize("ratio", [1.0, 0.4])
def test_a_pair_is_not_a_trail(fabricate, separation, ratio):
    along = separation * np.array([-0.5, 0.5])
    flux = 200.0 * error(fabricate) * np.array([1.0, ratio]) / (1.0 + ratio)
    sources, _ = scene(fabricate, 3, lambda: (along, flux))
    assert (sources >= 2).mean() > 0.95
