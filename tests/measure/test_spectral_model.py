"""Electrons of a binned spectrum through a throughput between any two wavelengths, against numpy's integral."""

import numpy as np
import pytest

from csstsim.catalog.table import ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.line_profile import ACROSS, ALONG, Shapes
from csstsim.measure.spectra.spectral_model import _counted, _share

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
