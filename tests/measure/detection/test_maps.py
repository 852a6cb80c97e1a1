"""measure.detection.maps against numpy and scipy, at odd and tiny shapes."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import binary_dilation, correlate

from csstsim.base.rng import stream
from csstsim.measure.detection.maps import add_interpolated, binned, flux_within, full_size, grown, interpolated, solid

SHAPES = [(1, 1), (1, 5), (4, 1), (2, 2), (7, 9), (30, 41)]


@pytest.mark.parametrize("shape", SHAPES)
def test_binned_and_back(shape):
    rng = stream(53, "maps", *shape)
    image = rng.integers(-50, 1000, shape).astype(np.float32)
    twice = np.repeat(np.repeat(image, 2 if shape[0] == 1 else 1, 0), 2 if shape[1] == 1 else 1, 1)
    ny, nx = (n // 2 * 2 for n in twice.shape)
    sums = sum(twice[j:ny:2, i:nx:2] for j in (0, 1) for i in (0, 1))
    small = binned(image)
    assert small.dtype == np.float32 and np.array_equal(small, sums)
    wide = np.repeat(np.repeat(small, 2, 0), 2, 1)
    wide = np.pad(wide, [(0, max(n - m, 0)) for n, m in zip(shape, wide.shape, strict=True)], mode="edge")
    assert np.array_equal(full_size(small, shape), wide[: shape[0], : shape[1]])


@pytest.mark.parametrize("reach", [1, 2, 3])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("fraction", [0.0, 0.03, 0.5, 0.9, 1.0])
def test_grown_is_scipys_dilation(shape, reach, fraction):
    rng = stream(54, "grown", *shape)
    mask = rng.random(shape) < fraction
    assert np.array_equal(grown(mask, reach), binary_dilation(mask, iterations=reach))


@pytest.mark.parametrize("meshes", [(1, 1), (1, 4), (3, 1), (4, 5)])
def test_interpolated_is_bilinear_and_held_beyond(meshes):
    shape, mesh = (40, 60), stream(55, "meshes", *meshes).normal(100.0, 5.0, meshes)
    middle = [np.linspace(0.1, 0.9, n) * size for n, size in zip(meshes, shape, strict=True)]
    # scipy wants two points an axis: a single mesh is the same on both
    points = [np.array([v[0], v[0] + 1.0]) if v.size == 1 else v for v in middle]
    values = np.repeat(np.repeat(mesh, 2 if meshes[0] == 1 else 1, 0), 2 if meshes[1] == 1 else 1, 1)
    rows, columns = (np.clip(np.arange(n), p[0], p[-1]) for n, p in zip(shape, points, strict=True))
    wanted = RegularGridInterpolator(points, values)(np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1))
    found = interpolated(mesh, middle, shape)
    assert found.dtype == np.float32 and found == pytest.approx(wanted, abs=1e-4)


def test_solid_pixels_are_in_groups():
    """By scipy's count of the pixels above the threshold in 3 x 3; single pixels and lines are not solid."""
    image = stream(72, "solid").normal(0.0, 1.0, (60, 70)).astype(np.float32)
    image[20:30, 10:25] += 5.0
    above = image > 0.5
    count = correlate(above.astype(int), np.ones((3, 3), int), mode="constant")
    assert (solid(image, 0.5, 1.0) == (above & (count > 5))).all()
    assert (solid(-image, 0.5, -1.0) == solid(image, 0.5, 1.0)).all()
    assert not solid(image[20:30, 10:25], 0.5, -1.0).any()
    image[:] = 0.0
    image[10] = image[:, 5] = 9.0
    assert not solid(image, 1.0, 1.0).any()
    assert not solid(np.full((3, 3), np.nan, np.float32), 1.0, 1.0).any()


def test_a_mesh_is_added_times_its_factor():
    """To an image that is not zero, with meshes whose middles lie unevenly: bilinear at three positions by hand."""
    image = np.full((9, 12), 5.0, np.float32)
    mesh, middle = np.array([[1.0, 3.0], [5.0, 11.0]]), (np.array([2.0, 6.0]), np.array([1.0, 9.0]))
    add_interpolated(image, mesh, middle, -2.0)
    assert image[2, 1] == 5 - 2 * 1.0 and image[6, 9] == 5 - 2 * 11.0 and image[8, 0] == 5 - 2 * 5.0
    assert image[3, 5] == pytest.approx(5 - 2 * (0.75 * 2.0 + 0.25 * 8.0)) and image[0, 11] == 5 - 2 * 3.0


def test_light_is_summed_by_the_number_of_its_segment():
    segments = np.array([[0, 1, 1], [3, 3, 0]], np.int32)
    image = np.array([[100.0, 2.0, 3.0], [7.0, -1.0, 50.0]], np.float32)
    assert flux_within.py_func(image, segments, 4).tolist() == [5.0, 0.0, 6.0, 0.0]
