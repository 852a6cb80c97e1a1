"""Panels of stars' sizes and shapes: each cell of the chip shows its own stars."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.quiver import Quiver

from csstsim.measure.bricks.validation.trials import SHAPES
from csstsim.report.psf_panels import CELLS, WHISKER, ellipticity, size
from csstsim.report.style import MIN_SOURCES


@pytest.fixture
def axes():
    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


def stars(column, row):
    """Return trials of stars in a cell of a chip of 800 x 1600 px, and in two corners; the shapes tell the cell."""
    at = np.repeat([(0, 0), (CELLS - 1, CELLS - 1), (column, row)], [1, 1, MIN_SOURCES], axis=0)
    x, y = 100.0 * at[:, 0] + 50.0, 200.0 * at[:, 1] + 100.0
    x[:2], y[:2] = (0.0, 799.0), (0.0, 1599.0)
    count = len(at)
    table = {"x": x, "y": y, "snr": np.full(count, 100.0), "psf_size": np.full(count, 0.07)}
    table |= {"sound": np.ones(count), "lonely": np.ones(count), "galaxy": np.zeros(count, int)}
    values = 1e-3 * at[:, 0], 1e-4 * at[:, 1], -2e-4 * at[:, 0]
    return {"trials": {"r": table | dict(zip(SHAPES, values, strict=True))}}


CELL = 6, 1  # column and row


def test_a_cell_of_the_map_has_the_median_of_its_stars(axes):
    assert size(axes, stars(*CELL))
    [mesh] = [found for found in axes.collections if hasattr(found, "get_coordinates")]
    shown = np.ma.filled(mesh.get_array().astype(float), np.nan).reshape(CELLS, CELLS)  # (row, column)
    assert np.argwhere(np.isfinite(shown)).tolist() == [[CELL[1], CELL[0]]]
    assert shown[CELL[1], CELL[0]] == pytest.approx(100 * 1e-3 * CELL[0])
    assert mesh.get_coordinates()[CELL[1], CELL[0]].tolist() == pytest.approx([600.0, 200.0])


def test_a_whisker_is_in_the_middle_of_its_cell_along_the_distortion(axes):
    assert ellipticity(axes, stars(*CELL))
    [quiver] = [found for found in axes.collections if isinstance(found, Quiver)]
    [drawn] = np.flatnonzero(~np.broadcast_to(quiver.Umask, quiver.U.shape))
    assert quiver.XY[drawn].tolist() == pytest.approx([650.0, 300.0])
    e1, e2 = 1e-4 * CELL[1], -2e-4 * CELL[0]
    u, v = quiver.U[drawn], quiver.V[drawn]
    assert np.hypot(u, v) == pytest.approx(np.hypot(e1, e2))
    assert [(u**2 - v**2) / np.hypot(u, v), 2 * u * v / np.hypot(u, v)] == pytest.approx([e1, e2])
    assert quiver.scale == pytest.approx(WHISKER / 100.0)
