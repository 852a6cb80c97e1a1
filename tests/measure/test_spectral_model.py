"""Electrons of a spectrum in bins through a throughput, between any two wavelengths, by numpy's integral."""

import numpy as np
import pytest

from csstsim.instrument.filter import GRID
from csstsim.measure.spectral_model import _counted

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
    assert _counted(low, high, cumulative, EDGES, spectrum) == pytest.approx(wanted, rel=1e-9)
