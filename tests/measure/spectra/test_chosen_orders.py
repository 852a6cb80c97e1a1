"""Which spectra are extracted: S/N in closed form, one of two gratings, cut ranges, reasons."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.catalog.table import ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra.chosen_orders import Choice, chosen_orders, line_snr, predicted_snr, shortened
from csstsim.measure.spectra.line_profile import ACROSS, ALONG, Shapes


def shapes_of(radius_along, radius_across, light=(0.25, 0.75)):
    """Shapes of objects of two components of these radii."""
    n = len(radius_along)
    radius = np.zeros((n, 2, 2))
    radius[:, ALONG], radius[:, ACROSS] = radius_along, radius_across
    return Shapes(np.tile(light, (n, 1)), radius, np.zeros(n), np.zeros(n, bool))


def orders_of(**columns):
    n = len(columns["row"])
    full = {
        "id": 100 + np.asarray(columns["row"]), "order": np.ones(n, int), "q": np.full(n, 0.25),
        "drawn": np.full(n, 1e6), "wave_min": np.full(n, 4000.0), "wave_max": np.full(n, 6000.0),
    }  # fmt: skip
    return ObjectTable({name: np.asarray(values) for name, values in (full | columns).items()})


SHAPES = shapes_of([(9.0, 9.0), (9.0, 9.0)], [(0.0, 0.0), (4.0, 2.0)])


def test_the_predicted_snr_is_that_of_three_columns():
    """500 columns; a point lies on 6 rows, a galaxy on 6 + 2 x (0.25 x 4 + 0.75 x 2) = 11; noise of 5."""
    orders = orders_of(row=[0, 1, 1, 0, 1], drawn=[1e5, 1e5, 2e5, np.nan, -1e5], q=[0.25, -0.25, 0.25, 0.25, 0.25])
    signal = 3 * np.array([200.0, 200.0, 400.0, 0.0, -200.0])
    rows = np.array([6, 11, 11, 6, 11])
    expected = signal / np.sqrt(np.maximum(signal, 0) + 3 * rows * 25)
    assert predicted_snr(orders, SHAPES, 5.0) == pytest.approx(expected)
    dot = orders_of(row=[0], q=[0.0], drawn=[90.0])  # a zeroth order is one column
    assert predicted_snr(dot, SHAPES, 5.0) == pytest.approx(270 / np.sqrt(270 + 18 * 25))


def test_a_spectrum_that_lacks_more_than_three_columns_is_shortened():
    model = SimpleNamespace(limits=np.array([(3990.0, 6000.0), (4000.0, 6000.0)]), pairs=lambda orders: orders["row"])
    lost = [0.0, 1.0, 3.0, 11.9, 12.1, 12.1]  # angstrom, a quarter of a pixel each
    orders = orders_of(row=[0, 0, 0, 1, 1, 1], wave_max=6000.0 - np.array(lost), q=[0.25] * 5 + [-0.25])
    assert shortened(orders, model).tolist() == [False, False, True, False, True, True]


def model_of():
    """Throughput even in wavelength; of one grating and order."""
    return SimpleNamespace(cumulative=np.array([GRID - GRID[0]]), pairs=lambda orders: np.zeros(len(orders), int))


def sources_of(spectra, shapes, edges):
    rows = {k: np.asarray(spectrum, float) for k, spectrum in enumerate(spectra)}
    each = lambda wanted: [(k, rows[int(row)]) for k, row in enumerate(wanted)]  # noqa: E731
    return SimpleNamespace(edges=edges, shapes=shapes, spectra=True, each_spectrum=each)


def test_the_snr_of_a_line_is_that_of_its_element():
    """All light in a bin of 4 angstrom, one column: of a point in 3 x 6 px, of a galaxy in (3 + 5) x 11 px."""
    edges = np.arange(4000.0, 6001.0, 4.0)
    line = np.where(np.arange(500) == 250, 7.0, 0.0)
    shapes = shapes_of([(0.0, 0.0), (4.0, 2.0)], [(0.0, 0.0), (4.0, 2.0)])
    sources = sources_of([line, line], shapes, edges)
    orders = orders_of(row=[0, 1, 0, 0], drawn=[400.0, 400.0, 400.0, 400.0], wave_max=[6000.0, 6000.0, 4900.0, 6000.0])
    found = line_snr(orders, sources, model_of(), 5.0)
    point = 400 / np.sqrt(400 + 3 * 6 * 25)
    assert found == pytest.approx([point, 400 / np.sqrt(400 + 8 * 11 * 25), 0.0, point])
    flat = sources_of([np.ones(500)], shapes, edges)
    even = 400 * 3 / 500
    assert line_snr(orders.take([0]), flat, model_of(), 5.0) == pytest.approx(even / np.sqrt(even + 450), rel=1e-6)
    assert line_snr(orders.take([0]), sources_of([0 * line], shapes, edges), model_of(), 5.0).tolist() == [0.0]


def test_of_two_gratings_the_one_with_more_light_counts_and_reasons_are_counted():
    orders = orders_of(
        row=[0, 0, 0, 1, 1, 1, 0], order=[1, 1, 2, 1, 1, 2, 0],
        drawn=[2e5, 3e5, 1e5, 0.0, 1000.0, 9e5, 5e5], wave_min=[4000.0] * 6 + [np.nan],
    )  # fmt: skip
    sources = SimpleNamespace(shapes=SHAPES, spectra=None)
    frame = SimpleNamespace(noise=5.0)
    chosen, left = chosen_orders(frame, orders, sources, None)
    assert chosen.tolist() == [False, True, False, False, False, False, False]
    assert left == {"off": 1, "second": 1, "faint": 1}
    chosen, left = chosen_orders(frame, orders, sources, None, Choice((2, 0), snr_min=20.0))
    assert chosen.tolist() == [False, False, False, False, False, True, False]
    assert left == {"off": 1, "second": 0, "faint": 1}
    chosen, left = chosen_orders(frame, orders, sources, None, Choice((1, 2), ids=[101]))
    assert chosen.tolist() == [False] * 5 + [True, False] and left == {"off": 1, "second": 0, "faint": 1}
