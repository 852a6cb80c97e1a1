"""Parts of a picture: means of blocks, stretches, which true objects are marked."""

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.catalog.table import ObjectTable
from csstsim.quicklook.blocks import block_max, block_mean
from csstsim.quicklook.marks import brightest, draw_marks, legend_title
from csstsim.quicklook.stretch import BELOW, STRETCHES, make_norm, robust_limits, ticks


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (12, 9), (3, 40)])
@pytest.mark.parametrize("step", [1, 3, 4, 50])
def test_blocks_are_means_of_their_finite_pixels(shape, step):
    image = np.random.default_rng(3).normal(100.0, 5.0, shape).astype(">f4")
    image[0, 0] = np.nan
    image[-1, -1] = np.inf
    means = block_mean(image, step)
    assert means.shape == (-(-shape[0] // step), -(-shape[1] // step))
    for (row, column), mean in np.ndenumerate(means):
        block = image[row * step : (row + 1) * step, column * step : (column + 1) * step].astype(float)
        finite = block[np.isfinite(block)]
        assert np.isclose(mean, finite.mean(), rtol=1e-6) if finite.size else np.isnan(mean)


def test_blocks_of_integers_do_not_overflow():
    assert (block_mean(np.full((30, 30), 65535, np.uint16), 10) == 65535).all()


def test_the_largest_of_a_block_is_kept():
    mask = np.zeros((7, 10), np.uint8)
    mask[6, 9], mask[0, 0], mask[0, 1] = 32, 8, 16
    assert block_max(mask, 4).tolist() == [[16, 0, 0], [0, 0, 32]] and (block_max(mask, 1) == mask).all()


def noisy(size=200):
    """A background of 500 with noise of 5 and a thousandth of the pixels very bright."""
    image = np.random.default_rng(5).normal(500.0, 5.0, (size, size))
    image.reshape(-1)[::1000] = 60000.0
    return image


@pytest.mark.parametrize("stretch", STRETCHES)
def test_a_stretch_rises_from_black_below_the_background_to_white(stretch):
    norm = make_norm(noisy(), stretch)
    assert abs(norm.vmin - (500 - BELOW * 5)) < 1  # the scatter of 40,000 pixels is known to 0.5%
    grey = norm(np.linspace(norm.vmin, norm.vmax, 300))
    assert (np.diff(grey) > 0).all() and np.allclose(grey[[0, -1]], [0, 1], atol=1e-9)
    values, labels = ticks(norm)
    assert len(set(labels)) == len(labels) and np.allclose(np.diff(norm(values)), 1 / 6, atol=1e-6)


def test_faint_light_is_seen_better_under_asinh_and_log_than_linearly():
    limits = (0.0, 10_000.0)
    image = np.random.default_rng(6).normal(100.0, 10.0, (100, 100))
    at = {stretch: float(make_norm(image, stretch, limits)(300.0)) for stretch in STRETCHES}
    assert at["linear"] == pytest.approx(0.03) and min(at["asinh"], at["log"]) > 0.3


@pytest.mark.parametrize("stretch", STRETCHES)
@pytest.mark.parametrize("value", [0.0, 500.0, -3.0, 1e-20, 1e30])
def test_a_constant_frame_has_limits(stretch, value):
    norm = make_norm(np.full((4, 4), value), stretch)
    assert norm.vmin < value < norm.vmax and 0 < float(norm(value)) < 1
    assert len(ticks(norm)[1]) == 7


def test_a_frame_constant_but_for_one_pixel_shows_it():
    """More than half of the pixels alike: the scatter about the median is zero, that of all is not."""
    image = np.zeros((10, 10))
    image[3, 3] = 50.0
    low, high, sigma = robust_limits(image, "asinh")
    assert low < 0 < high and sigma > 0


@pytest.mark.parametrize("limits", [(2.0, 2.0), (3.0, 1.0), (np.nan, 1.0), (0.0, np.inf), (-1e308, 1e308)])
def test_limits_that_are_no_range(limits):
    with pytest.raises(InputError, match="LOW < HIGH"):
        make_norm(noisy(20), "log", limits)


def test_nothing_finite_to_show():
    with pytest.raises(InputError, match=r"frame\.fits.*finite"):
        make_norm(np.full((3, 3), np.nan), "asinh", file="frame.fits")


def truth(**changes):
    columns = {
        "x": [5.0, 50.0, 9.4, 9.6, -0.5, 3.0, 4.0],
        "y": [5.0, 5.0, 5.0, 5.0, -0.5, 3.0, 4.0],
        "electrons": [10.0, 1e9, 30.0, 1e9, 20.0, 0.0, np.nan],
        "mag": [20.0, 5.0, 19.0, 5.0, np.nan, 30.0, 30.0],
        "obj_type": [0, 0, 1, 1, 2, 0, 0],
    }
    return ObjectTable({name: np.array(values) for name, values in (columns | changes).items()})


def test_the_brightest_of_those_inside_are_marked():
    """x 9.6 is pixel 10, outside; light of 0 or NaN is none; magnitudes are not what counts."""
    chosen = brightest(truth(), (0, 10, 0, 10), 9)
    assert chosen["electrons"].tolist() == [30.0, 20.0, 10.0]
    assert brightest(truth(), (0, 10, 0, 10), 2)["electrons"].tolist() == [30.0, 20.0]
    assert legend_title(chosen) == "truth, brightest 3, to 20.0 mag"
    assert "without the grating" in legend_title(chosen.with_columns(catalog_row=np.zeros(3, int)))


@pytest.mark.parametrize(("axis", "other"), [("x", "y"), ("y", "x")])
def test_marks_end_half_a_pixel_beyond_the_last_pixel_of_each_edge(axis, other):
    places = {axis: np.array([1.4, 1.6, 9.4, 9.6]), other: np.full(4, 5.0)}
    table = ObjectTable(places | {"electrons": np.arange(1.0, 5.0)})
    assert brightest(table, (2, 10, 2, 10), 9)["electrons"].tolist() == [3.0, 2.0]


def test_each_kind_that_is_there_is_marked_where_it_is_and_stars_and_galaxies_are_always_named():
    """obj_type: 0 star, 1 galaxy, 2 quasar, 3 asteroid, 4 satellite."""
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    kinds = {name: np.array([4.0, 5.0, 6.0]) for name in "xy"} | {"obj_type": np.array([1, 3, 1])}
    draw_marks(axes, ObjectTable(kinds))
    lines = {line.get_label(): line.get_xdata() for line in axes.lines}
    assert {name: list(x) for name, x in lines.items()} == {
        "0 stars": [], "2 galaxies": [4.0, 6.0], "1 asteroid": [5.0]
    }  # fmt: skip
    empty = Figure().subplots()
    draw_marks(empty, ObjectTable({}))
    assert [line.get_label() for line in empty.lines] == ["0 stars", "0 galaxies"]


def test_no_object_to_mark():
    assert len(brightest(truth(), (100, 101, 0, 1), 5)) == 0
    empty = ObjectTable({})
    assert "no object" in legend_title(brightest(empty, (0, 1, 0, 1), 5))
