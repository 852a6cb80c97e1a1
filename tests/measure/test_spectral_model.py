"""Electrons of a binned spectrum through a throughput between any two wavelengths, against numpy's integral."""

import numpy as np
import pytest

from csstsim.catalog.table import ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.line_profile import ACROSS, ALONG, HALF, OFFSETS, Shapes
from csstsim.measure.spectra.spectral_model import _counted, _draw, _share

EDGES = np.arange(3000.0, 9000.0, 37.0)
STEP = GRID[1] - GRID[0]


@pytest.mark.parametrize(("low", "high"), [(4000.0, 4000.4), (4001.3, 4090.7), (3100.0, 8800.0), (2500.0, 3200.0)])
def test_a_columns_electrons_are_the_integral(low, high):
    """Spectrum constant in its bins, throughput constant between samples: each piece by hand."""
    rng = np.random.default_rng(9)
    spectrum, throughput = rng.uniform(0.0, 5.0, len(EDGES) - 1), rng.uniform(0.1, 0.9, len(GRID) - 1)
    cumulative = np.concatenate([[0.0], np.cumsum(throughput * STEP)])
    ends = np.unique(np.concatenate([GRID, EDGES, [low, high]]))
    ends = ends[(ends >= low) & (ends <= high)]
    middle = 0.5 * (ends[1:] + ends[:-1])
    bins = np.searchsorted(EDGES, middle) - 1
    lit = np.where((bins >= 0) & (bins < len(spectrum)), spectrum[np.clip(bins, 0, len(spectrum) - 1)], 0.0)
    wanted = (lit * throughput[np.searchsorted(GRID, middle) - 1] * np.diff(ends)).sum()
    for near in (-1, 0, 70, len(EDGES) - 1):  # bins from which the search begins
        found, start = _counted(low, high, cumulative, EDGES, spectrum, near)
        assert found == pytest.approx(wanted, rel=1e-9) and start == np.searchsorted(EDGES, low, side="right") - 1


def test_only_what_a_pieces_edge_cuts_is_less_than_all():
    """Losses, the window's edge and chance make fewer electrons of an order, too: they are not the grating's."""
    orders = ObjectTable({
        "electrons": np.full(4, 1000.0), "drawn": np.array([900.0, 900.0, 0.0, 1100.0]),
        "cut": np.array([False, True, True, True]),
    })  # fmt: skip
    assert _share(orders).tolist() == [1.0, 0.9, 0.0, 1.0]


@pytest.mark.parametrize("matrix", [[[3.0, 0.0], [0.0, 1.0]], [[2.0, 1.5], [0.0, 1.0]], [[0.3, 1.0], [2.0, -0.4]]])
def test_sizes_along_and_across_are_those_of_the_turned_galaxy(matrix):
    """A round profile under the matrix, collapsed on x and y: its rms by 200,000 points, 1%."""
    points = np.random.default_rng(10).normal(0.0, 1.0, (2, 200_000))
    rms = (np.array(matrix) @ points).std(axis=1)
    shapes = Shapes.of(np.array([matrix]), np.array([[1.0, 0.0]]), np.array([[1.0, 1.0]]))
    assert shapes.radius[0, ALONG, 0] == pytest.approx(rms[0], rel=0.01)
    assert shapes.radius[0, ACROSS, 0] == pytest.approx(rms[1], rel=0.01)
    assert not shapes.radius[0, :, 1].any()  # a component without light


@pytest.mark.parametrize("place", [0.0, 0.4, 1.7, 2.0])
@pytest.mark.parametrize("light", [(1.0, 0.0), (0.3, 0.7)])
def test_light_between_classes_of_size_is_all_drawn(place, light):
    """Profiles and kernels of sum 1: an order has the electrons of its spectrum, whatever lies between the classes."""
    classes, bands, reach = 3, np.array([4000.0, 5000.0, 6000.0, 7000.0]), 10
    rng = np.random.default_rng(11)
    near = np.abs(OFFSETS) < 20  # px
    tables = np.cumsum(rng.uniform(0, 1, (classes, 2, 4, len(OFFSETS))) * near, axis=3)
    tables = (tables - tables[..., :1]) / (tables[..., -1:] - tables[..., :1])
    kernels = np.zeros((classes, 2, 4, 2, 81))
    kernels[..., 40 - reach : 41 + reach] = rng.uniform(0, 1, (classes, 2, 4, 2, 2 * reach + 1))
    kernels /= kernels.sum(axis=4, keepdims=True)
    cumulative = 0.5 * np.arange(len(GRID))[None] * STEP  # a throughput of a half
    spectrum, image = rng.uniform(1.0, 5.0, (1, len(EDGES) - 1)), np.zeros((2 * HALF + 40, 1200), np.float64)
    limits, per = np.array([[4500.0, 6500.0]]), 0.4
    _draw(
        image, np.array([0, 1200, 0]), np.zeros(1, int), np.zeros(1, int),
        np.array([[-1500.0, per, HALF + 20.0, 0.0]]), np.ones(1), spectrum, EDGES, np.array([light]),
        np.full((1, 2, 2), place), tables, kernels, np.clip(cumulative, cumulative[:, [5000]], cumulative[:, [9000]]),
        limits, bands, 0.0,
    )  # fmt: skip
    bins = np.clip(np.minimum(EDGES[1:], 6500.0) - np.maximum(EDGES[:-1], 4500.0), 0, None)
    assert image.sum() == pytest.approx(0.5 * (spectrum[0] * bins).sum(), rel=1e-3) and image.min() >= 0
