"""Parts of a picture: means of blocks, stretches, which true objects are marked."""

from pathlib import Path

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.catalog.table import ObjectTable
from csstsim.report.quicklook.blocks import block_max, block_mean
from csstsim.report.quicklook.figure import Page, _inches, _scale
from csstsim.report.quicklook.marks import STYLES, brightest, draw_marks, legend_title
from csstsim.report.quicklook.picture import Picture
from csstsim.report.quicklook.stretch import BELOW, STRETCHES, bit_ticks, make_norm, robust_limits, ticks


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


def sky(bright, share=0.002):
    """2000 values of 6, 8, 10, 12 and 14 in turn, a share of them `bright`: median 10, median deviation 2."""
    values = np.tile([6.0, 8.0, 10.0, 12.0, 14.0], 400)
    values[: int(share * 2000)] = bright
    return values


@pytest.mark.parametrize(
    ("stretch", "bright", "above"),  # white, in sigma or as a value
    [("linear", 1e6, 10.0), ("asinh", 12.0, 10.0), ("log", 12.0, 10.0), ("asinh", 1e6, 1000.0)],
)
def test_limits_are_two_sigma_below_and_so_many_above(stretch, bright, above):
    low, high, sigma = robust_limits(sky(bright), stretch)
    assert sigma == pytest.approx(2 * 1.4826) and low == pytest.approx(10 - 2 * sigma)
    assert high == pytest.approx(10 + above * sigma)


@pytest.mark.parametrize(("stretch", "bright"), [("asinh", 1500.0), ("log", 1500.0), ("log", 1e6)])
def test_white_is_the_brightest_thousandth(stretch, bright):
    assert robust_limits(sky(bright), stretch).high == pytest.approx(bright)
    assert robust_limits(sky(bright, 0.0004), stretch).high == pytest.approx(10 + 10 * 2 * 1.4826)


def test_scatter_where_most_pixels_are_alike():
    """No median deviation: the range of all but a thousandth at either end, else of all, else a hundredth of them."""
    values = np.full(10_000, 200.0)
    values[:100], values[100:200], values[200:203] = 190.0, 230.0, 9000.0
    assert robust_limits(values, "linear") == pytest.approx((200 - 80, 200 + 400, 40))
    values[:200] = 200.0
    assert robust_limits(values, "linear").sigma == pytest.approx(8800.0)
    assert (
        robust_limits(np.full(9, 200.0), "linear").sigma == 2.0
        and robust_limits(np.full(9, -300.0), "log").sigma == 3.0
    )


def test_greys_in_closed_form():
    """Up to three sigma both stretches are linear; sigma is 2 x 1.4826, limits 0 and 100."""
    soft = 3 * 2 * 1.4826 / 100
    for value in (5.0, 40.0):
        at = {stretch: float(make_norm(sky(12.0), stretch, (0.0, 100.0))(value)) for stretch in (*STRETCHES, None)}
        assert at["linear"] == pytest.approx(value / 100)
        assert at["asinh"] == pytest.approx(np.arcsinh(value / 100 / soft) / np.arcsinh(1 / soft)) == at[None]
        assert at["log"] == pytest.approx(np.log(1 + value / 100 / soft) / np.log(1 + 1 / soft))
    mask = make_norm(np.zeros((3, 3), np.uint8), None, bits=7)
    assert (mask.vmin, mask.vmax) == (0.0, 7.0) and float(mask(1)) == pytest.approx(np.log(2) / np.log(8))
    narrow = make_norm(np.zeros((3, 3), np.uint8), None, (1.0, 5.0), bits=63)
    assert (narrow.vmin, narrow.vmax) == (1.0, 5.0) and bit_ticks(narrow) == ([1, 2, 4], ["1", "2", "4"])


@pytest.mark.parametrize(
    ("high", "labels"),
    [(6.0, "0.0 1.0 2.0 3.0 4.0 5.0 6.0"), (0.3, "0.000 0.050 0.100 0.150 0.200 0.250 0.300"),
     (600.0, "0 100 200 300 400 500 600"), (6e-6, "0 1e-06 2e-06 3e-06 4e-06 5e-06 6e-06")],
)  # fmt: skip
def test_labels_of_the_bar(high, labels):
    assert ticks(make_norm(sky(12.0), "linear", (0.0, high)))[1] == labels.split()
    assert len(ticks(make_norm(sky(12.0), "linear"), 4)[0]) == 4


@pytest.mark.parametrize(("bounds", "side", "step", "zoom", "inches"), [
    ((0, 400, 0, 100), 200, 2, 1, (2.0, 0.5)), ((5, 35, 7, 27), 300, 1, 10, (3.0, 2.0)),
    ((0, 400, 0, 20), 200, 2, 1, (2.0, 0.5)), ((0, 100, 0, 401), 200, 3, 1, (0.5, 401 / 300)),
])  # fmt: skip
def test_sizes_of_the_image(bounds, side, step, zoom, inches):
    """Figure pixels of 0.01 inch; neither side is less than a quarter of the most."""
    assert _scale(bounds, side) == (step, zoom) and _inches(bounds, side) == pytest.approx(inches)
    assert Page(8.0, 5.0).part(2.0, 1.0, 4.0, 2.5) == [0.25, 0.2, 0.5, 0.5]


@pytest.mark.parametrize(("header", "first"), [
    ({}, "image"), ({"OBSID": "7", "DETECTOR": "09"}, "exposure 7, chip 09, image"),
    ({"CHIPID": 8, "DETECTOR": "09", "FILTER": "g", "EXPTIME": 0.5}, "chip 8, g, 0.5 s, image"),
    ({"CHIPID": 0, "EXPTIME": "long", "FILTER": ""}, "chip 0, image"),
])  # fmt: skip
def test_titles_say_what_is_known(header, first):
    picture = Picture(Path("some", "a.fits"), np.zeros((4, 6)), "image", "DN", header, (10, 20))
    assert picture.title == f"{first}\na.fits"
    assert picture.bounds == (10, 16, 20, 24)


def test_a_part_of_a_picture_is_counted_from_its_origin():
    picture = Picture(Path("a.fits"), np.arange(24).reshape(4, 6), "image", "DN", {}, (10, 20))
    assert picture.part((11, 14, 22, 24)).tolist() == [[13, 14, 15], [19, 20, 21]]


def test_marks_have_their_own_marker_and_colour_and_place():
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    kinds = np.array([4, 3, 2, 1, 0, 0])
    draw_marks(axes, ObjectTable({"x": np.arange(6.0), "y": 10.0 + np.arange(6), "obj_type": kinds}))
    found = {line.get_label(): (line.get_marker(), line.get_mec(), line.get_xydata().tolist()) for line in axes.lines}
    assert found == {
        "2 stars": (*STYLES["star"], [[4, 14], [5, 15]]), "1 galaxy": (*STYLES["galaxy"], [[3, 13]]),
        "1 quasar": (*STYLES["quasar"], [[2, 12]]), "1 asteroid": (*STYLES["asteroid"], [[1, 11]]),
        "1 satellite": (*STYLES["satellite"], [[0, 10]]),
    }  # fmt: skip
    assert len({marker for marker, _ in STYLES.values()}) == len({colour for _, colour in STYLES.values()}) == 5


def test_the_largest_bits_of_oblong_blocks():
    mask = np.arange(35, dtype=np.uint8).reshape(5, 7)
    assert block_max(mask, 3).tolist() == [[16, 19, 20], [30, 33, 34]]
