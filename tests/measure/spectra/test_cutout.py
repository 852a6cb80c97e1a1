"""Pixels about a trace and their sums by column, by hand: the window's edges, marks, light of others, flags."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.instrument.chip import Window
from csstsim.measure.calibration.bad_pixels import BAD, FULL
from csstsim.measure.spectra import column_sums, cutout
from csstsim.measure.spectra import spectrum_columns as bits
from csstsim.measure.spectra.cutout import GOOD, INSIDE, Cutout

WINDOW = Window(100, 108, 50, 56)


class Response:
    """Stands for optics.throughput.response.Response: 0.5, less by a hundredth a row and a thousandth a column."""

    def part(self, rows, columns):
        row, column = np.mgrid[rows, columns]
        return (0.5 - 0.01 * row - 0.001 * column).astype(np.float32)


@pytest.fixture(autouse=True)
def plain(monkeypatch):
    monkeypatch.setattr(cutout, "_fill", cutout._fill.py_func)


def frame_of(**changes):
    row, column = np.mgrid[0:6, 0:8]
    given = {
        "window": WINDOW, "electrons": (100.0 * row + column).astype(np.float32), "marks": np.zeros((6, 8), np.uint8),
        "others": (10.0 * row + 0.5 * column).astype(np.float32), "subtract": True, "response": None,
    }  # fmt: skip
    return SimpleNamespace(**(given | changes))


COLUMNS, ROWS, CENTRE = np.arange(102, 105), np.arange(52, 60), np.array([54.0, 54.25, 54.5])


def test_rows_of_a_cutout_are_columns_of_the_chip():
    """Columns 102 to 104, rows 52 to 59, of which the window has four: nothing beyond, offsets from the trace."""
    found = Cutout.of(frame_of(response=Response()), COLUMNS, ROWS, CENTRE, None)
    inside = ROWS < 56
    wanted = 100.0 * (ROWS - 50) + (COLUMNS - 100)[:, None]
    assert found.data.tolist() == np.where(inside, wanted, 0.0).tolist() and found.others is None
    assert found.status.tolist() == np.where(inside, INSIDE | GOOD, 0).repeat(3).reshape(8, 3).T.tolist()
    assert found.offset.tolist() == (ROWS - CENTRE[:, None]).tolist()
    response = 0.5 - 0.01 * (ROWS - 50) - 0.001 * (COLUMNS - 100)[:, None]
    assert found.response == pytest.approx(np.where(inside, response, 1.0), rel=1e-6)


def test_a_cutout_that_begins_below_the_window():
    found = Cutout.of(frame_of(), COLUMNS, np.arange(47, 53), CENTRE - 4, None)
    assert found.status[1].tolist() == [0, 0, 0] + [INSIDE | GOOD] * 3
    assert found.data[1].tolist() == [0, 0, 0, 3, 103, 203]
    beyond = Cutout.of(frame_of(), COLUMNS, np.arange(60, 64), CENTRE + 8, None)
    assert not beyond.status.any() and not beyond.data.any()


@pytest.mark.parametrize("subtract", [True, False])
def test_light_of_others_is_less_ones_own_and_subtracted_if_that_is_wanted(subtract):
    own = np.full((8, 3), 3.0, np.float32)
    own[:, 2] = 4.0
    found = Cutout.of(frame_of(subtract=subtract), COLUMNS, ROWS, CENTRE, own)
    others = 10.0 * (ROWS - 50) + 0.5 * (COLUMNS - 100)[:, None] - np.array([3.0, 3.0, 4.0])[:, None]
    inside = ROWS < 56
    assert found.others == pytest.approx(np.where(inside, others, 0.0))
    data = 100.0 * (ROWS - 50) + (COLUMNS - 100)[:, None] - subtract * others
    assert found.data == pytest.approx(np.where(inside, data, 0.0))


def test_marked_pixels_and_those_without_a_value_are_not_used():
    marks, electrons = np.zeros((6, 8), np.uint8), frame_of().electrons.copy()
    marks[2, 2], marks[3, 3], marks[4, 4] = FULL, BAD, FULL | BAD
    electrons[5, 2] = np.nan
    found = Cutout.of(frame_of(marks=marks, electrons=electrons), COLUMNS, ROWS, CENTRE, None)
    assert (
        found.status[0, 0] == found.status[2, 2] == INSIDE | FULL and found.status[1, 1] == found.status[0, 3] == INSIDE
    )
    assert found.data[0, 0] == found.data[1, 1] == found.data[2, 2] == found.data[0, 3] == 0.0
    assert (found.status == INSIDE | GOOD).sum() == 8


def test_an_aperture_has_the_rows_that_reach_into_it():
    """2 px about traces at 54 to 54.5: rows 52 to 56, and 57, whose lower edge is 2 px from the highest."""
    found = Cutout.of(frame_of(), COLUMNS, ROWS, CENTRE, np.zeros((8, 3), np.float32))
    fractions = np.arange(24.0).reshape(3, 8)
    for half, last in ((2.0, 56), (2.01, 57)):
        part, mine = found.within(half, fractions)
        assert part.offset[0].tolist() == (np.arange(52, last + 1) - 54.0).tolist()
        assert (
            mine.tolist() == fractions[:, : last - 51].tolist() and part.data.shape == part.others.shape == mine.shape
        )
    high, _ = found.within(0.4, fractions)
    assert high.offset[0].tolist() == [0.0, 1.0]


def test_parts_of_pixels_within_an_aperture():
    offset = np.array([[-3.0, -2.4, -1.6, 0.0, 2.0, 2.7, 2.9]])
    assert column_sums._overlap.py_func(offset, 2.3) == pytest.approx(np.array([[0.0, 0.4, 1.0, 1.0, 0.8, 0.1, 0.0]]))
    assert column_sums._overlap.py_func(np.array([[0.1]]), 0.25) == pytest.approx(np.array([[0.5]]))


def test_each_pixel_of_the_aperture_flags_its_column_by_its_worst_reason():
    within = np.array([[True, True, False]] * 6)
    good = INSIDE | GOOD
    status = np.array([[good, good, 0], [good, 0, good], [INSIDE | FULL, good, good], [good, INSIDE, good],
                     [good, good, INSIDE | FULL], [0, INSIDE | FULL, good]], np.uint8)  # fmt: skip
    used = np.array([[True, True, False], [True] * 3, [True] * 3, [True] * 3, [True, False, True], [True] * 3])
    wanted = [0, bits.EDGE, bits.SATURATED, bits.MASKED, bits.COSMIC, bits.EDGE | bits.SATURATED]
    assert column_sums._flags.py_func(status, within, used).tolist() == wanted


def test_sums_of_a_column_by_hand():
    """Box and optimal weights of three pixels, of which one is not used; what a pixel adds to the electrons."""
    overlap, fractions = np.array([[0.5, 1.0, 1.0]]), np.array([[0.2, 0.5, 0.3]])
    used, variance = np.array([[True, True, False]]), np.array([[4.0, 10.0, 1.0]])
    data, others = np.array([[30.0, 60.0, 1e6]]), np.array([[2.0, 4.0, 1e6]])
    box = np.array(column_sums._sums.py_func(overlap, fractions, used, variance, data, others, False))[:, 0]
    assert box == pytest.approx([0.1 + 0.5, 15.0 + 60.0, 1.0 + 4.0, 0.25 * 4 + 10, 1.5])
    w = np.array([0.05, 0.05])
    best = np.array(column_sums._sums.py_func(overlap, fractions, used, variance, data, others, True))[:, 0]
    assert best == pytest.approx([w @ [0.2, 0.5], w @ [30, 60], w @ [2, 4], w**2 @ [4, 10], w.sum()])
    weights = column_sums._weights.py_func(fractions, used, variance, best[:1])
    assert weights == pytest.approx(np.array([[0.05 / best[0], 0.05 / best[0], 0.0]]))
    fit, error = column_sums._fit.py_func(data[0], fractions[0], used[0], variance[0])
    assert (fit, error) == pytest.approx((best[1] / best[0], best[0] ** -0.5))
    assert column_sums._fit.py_func(data[0], fractions[0], ~used[0] & False, variance[0]) == (0.0, 0.0)
    assert column_sums._flux_fraction.py_func(overlap, fractions, used).tolist() == [0.6]
    assert not column_sums._weights.py_func(fractions, used, variance, np.array([np.nan])).any()


def test_a_columns_variance_is_of_the_electrons_around_it():
    """The median of at most 8 columns on each side that have an error; those beside it, or its own, in a line."""
    signal, fits, errors = column_sums._signal.py_func, np.arange(100.0), np.full(100, 20.0)
    assert signal(fits, errors, 50) == 50.0 and signal(fits, errors, 0) == 4.5 and signal(fits, errors, 99) == 94.5
    fits[50] = 109.0
    assert signal(fits, errors, 50) == 50.0
    fits[50] = 111.0
    assert signal(fits, errors, 50) == 111.0
    fits[50] = -11.0
    assert signal(fits, errors, 50) == -11.0
    fits[[49, 51]] = 100.0, 90.0  # 45 from the median, 3.2 sigma
    assert signal(fits, errors, 50) == -11.0
    fits[50] = 20.0  # 3.06 sigma from the mean of the two
    assert signal(fits, errors, 50) == 20.0
    fits[50] = 30.0
    assert signal(fits, errors, 50) == 95.0
    fits[[49, 50, 51]] = 49.0, -11.0, 51.0
    errors[52:] = 0.0  # columns without usable pixels
    assert signal(fits, errors, 51) == np.median([43, 44, 45, 46, 47, 48, 49, -11])
    assert signal(np.array([7.0]), np.array([1.0]), 0) == 7.0


def test_outliers_leave_one_by_one_and_the_variance_is_that_of_light_sky_and_readout(monkeypatch):
    """A ray of 9 sigma in a column of 1000 e-; sky 20, others 5, read noise 4, response 0.5."""
    for name in ("_fit", "_signal"):
        monkeypatch.setattr(column_sums, name, getattr(column_sums, name).py_func)
    fractions = np.array([[0.1, 0.2, 0.4, 0.2, 0.1], [0.1, 0.2, 0.4, 0.2, 0.1]])
    data, used, variance = 1000.0 * fractions, np.ones((2, 5), bool), np.ones((2, 5))
    data[1, 4] += 500.0
    level, others, response = np.array([20.0, -60.0]), np.full((2, 5), 5.0), np.full((2, 5), 0.5)
    column_sums._reject_outliers.py_func(data, fractions, used, variance, level, others, response, 4.0)
    assert used.tolist() == [[True] * 5, [True] * 4 + [False]]
    base = [(25 + 16 / 0.5) / 0.5, (0 + 16 / 0.5) / 0.5]  # a sky below 0 has no noise
    assert variance[0] == pytest.approx(base[0] + 1000 * fractions[0] / 0.5)
    assert variance[1, :4] == pytest.approx(base[1] + 1000 * fractions[1, :4] / 0.5, rel=1e-6)
    dark = np.zeros((2, 5))
    column_sums._reject_outliers.py_func(dark, fractions, used, variance, dark[:, 0], dark, np.ones((2, 5)), 0.0)
    assert variance[0] == pytest.approx(np.ones(5))  # FLOOR
