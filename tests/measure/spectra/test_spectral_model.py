"""Electrons of a binned spectrum through a throughput between any two wavelengths, against numpy's integral."""

import numpy as np
import pytest

from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra import near_orders
from csstsim.measure.spectra.line_profile import ACROSS, ALONG, HALF, OFFSETS, Shapes
from csstsim.measure.spectra.spectral_model import (
    ImageCorner,
    ModelArrays,
    ObjectLight,
    SpectralModel,
    TracedOrders,
    _fraction_through,
    _integral,
    _render,
)

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
        found, start = _integral(low, high, cumulative, EDGES, spectrum, near)
        assert found == pytest.approx(wanted, rel=1e-9) and start == np.searchsorted(EDGES, low, side="right") - 1


def test_only_what_a_pieces_edge_cuts_is_less_than_all():
    """Losses, the window's edge and chance make fewer electrons of an order, too: they are not the grating's."""
    orders = ObjectTable({
        "electrons": np.full(4, 1000.0), "drawn": np.array([900.0, 900.0, 0.0, 1100.0]),
        "cut": np.array([False, True, True, True]),
    })  # fmt: skip
    assert _fraction_through(orders).tolist() == [1.0, 0.9, 0.0, 1.0]


@pytest.mark.parametrize("matrix", [[[3.0, 0.0], [0.0, 1.0]], [[2.0, 1.5], [0.0, 1.0]], [[0.3, 1.0], [2.0, -0.4]]])
def test_sizes_along_and_across_are_those_of_the_turned_galaxy(matrix):
    """A round profile under the matrix, collapsed on x and y: its rms by 200,000 points, 1%."""
    points = np.random.default_rng(10).normal(0.0, 1.0, (2, 200_000))
    rms = (np.array(matrix) @ points).std(axis=1)
    shapes = Shapes.of(np.array([matrix]), np.array([[1.0, 0.0]]), np.array([[1.0, 1.0]]))
    assert shapes.radius[0, ALONG, 0] == pytest.approx(rms[0], rel=0.01)
    assert shapes.radius[0, ACROSS, 0] == pytest.approx(rms[1], rel=0.01)
    assert not shapes.radius[0, :, 1].any()  # a component without light


@pytest.mark.parametrize("position", [0.0, 0.4, 1.7, 2.0])
@pytest.mark.parametrize("light", [(1.0, 0.0), (0.3, 0.7)])
def test_light_between_classes_of_size_is_all_rendered(position, light):
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
    one = np.zeros(1, int)
    at, middle, slope = np.array([-1500.0]), np.array([HALF + 20.0]), np.zeros(1)
    lit = np.clip(cumulative, cumulative[:, [5000]], cumulative[:, [9000]])
    _render(
        image,
        ImageCorner(0, 1200, 0),
        TracedOrders(one, one, at, np.array([per]), middle, slope, np.ones(1)),
        ObjectLight(spectrum, EDGES, np.array([light]), np.full((1, 2, 2), position)),
        ModelArrays(tables, kernels, lit, limits, bands),
        0.0,
    )
    bins = np.clip(np.minimum(EDGES[1:], 6500.0) - np.maximum(EDGES[:-1], 4500.0), 0, None)
    assert image.sum() == pytest.approx(0.5 * (spectrum[0] * bins).sum(), rel=1e-3) and image.min() >= 0


def test_orders_fainter_than_a_pixel_s_least_are_left_out():
    """1000 angstrom at a quarter of a pixel each: 250 px, times 1 + 0.25 x 4 + 0.75 x 8 px of a galaxy; a dot is 1."""
    radius = np.zeros((2, 2, 2))
    radius[1, ACROSS], radius[1, ALONG] = (4.0, 8.0), (90.0, 90.0)
    shapes = Shapes(np.array([[1.0, 0.0], [0.25, 0.75]]), radius, np.zeros(2), np.zeros(2, bool))
    model = SpectralModel(1.0, {}, None, np.array([[4000.0, 5000.0], [4000.0, 4800.0]]), None, None, None)
    orders = ObjectTable({
        "row": np.array([0, 0, 1, 1, 0, 0]), "q": np.array([0.25, -0.25, 0.25, 0.25, 0.0, 0.0]),
        "electrons": np.array([500.0, 499.9, 4000.0, 3200.0, 2.0, 1.9]),
    })  # fmt: skip
    seen = model._bright_enough(orders, np.array([0, 0, 0, 1, 0, 0]), shapes, 2.0)
    assert seen.tolist() == [True, False, True, True, True, False]
    assert not model._bright_enough(orders, np.array([0, 0, 0, 0, 0, 0]), shapes, 2.0)[3]


def test_pairs_are_those_of_the_grating_and_the_order():
    names = {("GU", 0): 0, ("GU", 1): 1, ("GV", 1): 2}
    model = SpectralModel(1.0, names, None, None, None, None, None)
    orders = ObjectTable({"grating": np.array(["GV", "GU", "GU"]), "order": np.array([1, 1, 0])})
    assert model.pairs(orders).tolist() == [2, 1, 0]
    assert [model.pair(orders.take([k])) for k in range(3)] == [2, 1, 0]


def test_tiles_that_boxes_touch_and_orders_cross():
    """Tiles of a window that begins off 0: counts of touched ones below and left of each corner."""
    tile = near_orders.TILE
    window = Window(100, 100 + 3 * tile, 50, 50 + 2 * tile)
    box = np.array([[100 + tile - 1, 100 + tile + 1, 50, 50 + tile]])  # two tiles of the lower row
    assert near_orders._marked(box, window).tolist() == [[0, 0, 0, 0], [0, 1, 2, 2], [0, 1, 2, 2]]
    exact = np.array([[100 + tile, 100 + 2 * tile, 50 + tile, 50 + 2 * tile]])
    assert near_orders._marked(exact, window).tolist() == [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 1, 1]]
    first, after = near_orders._tiles([-500.0, 100.0, 99 + tile], [99.0, 100.0 + tile, 1e9], 100, 3)
    assert first.tolist() == [0, 0, 0] and after.tolist() == [0, 2, 3]
