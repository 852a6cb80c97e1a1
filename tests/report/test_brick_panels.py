"""The panels of a brick's figure against the numbers put in."""

import math

import numpy as np
import pytest
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from support.csst import LOOKS

from csstsim.base.rng import stream
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.validation.trials import COLUMNS
from csstsim.report import colour_panel, figures, psf_panels
from csstsim.report.style import legend


def colours_of(n, galaxies=0):
    rng = stream(61, "colours")
    points = rng.normal([[1.2], [0.6]], 0.25, (2, n))
    return {"bands": ("u", "g", "r"), "input": points, "output": points + 0.02, "galaxy": np.arange(n) < galaxies}


def test_contours_enclose_their_fractions_of_a_gaussian_cloud():
    """Radius sigma sqrt(-2 ln(1 - fraction)); smoothing adds BLUR cells to sigma in quadrature; 0.02 mag is chance."""
    axes = Figure().add_subplot()
    colour_panel.colours(axes, colours_of(20_000), LOOKS)
    (contours,) = (child for child in axes.get_children() if isinstance(child, QuadContourSet))
    sigma = math.hypot(0.25, colour_panel.BLUR * colour_panel.CELL)
    for lines, fraction in zip(contours.allsegs, colour_panel.FRACTIONS, strict=True):
        (line,) = lines
        radius = np.hypot(*(line - [1.2, 0.6]).T)
        assert radius.mean() == pytest.approx(sigma * math.sqrt(-2 * math.log(1 - fraction)), abs=0.02)


@pytest.mark.parametrize("galaxies", [0, 200])
def test_contours_are_of_true_colours_and_points_of_measured_ones(galaxies):
    """Measured colours are off by (1, -0.5) mag; those of the other kind lie elsewhere. Of 200: 0.1 mag is 5 sigma."""
    colour = colours_of(400, galaxies)
    colour["input"][:, ~colour["galaxy"]] += [[-1.0], [0.5]]
    colour["output"] = colour["input"] + [[1.0], [-0.5]]
    axes = Figure().add_subplot()
    colour_panel.colours(axes, colour, LOOKS)
    middles = ([0.2, 1.1], [1.2, 0.6]) if galaxies else ([0.2, 1.1],)
    drawn = [child for child in axes.get_children() if isinstance(child, QuadContourSet)]
    points = [line for line in axes.lines if line.get_marker() in "os"]
    for contours, line, middle in zip(drawn, points, middles, strict=True):
        around = np.concatenate([path for level in contours.allsegs for path in level])
        low, high = np.quantile(around, [0, 1], axis=0)
        assert 0.5 * (low + high) == pytest.approx(middle, abs=0.2)
        assert np.mean(line.get_xydata(), axis=0) == pytest.approx(np.add(middle, [1.0, -0.5]), abs=0.1)
        assert line.get_label().endswith("(200), measured" if galaxies else "(400), measured")
    named = {line.get_label(): line.get_linestyle() for line in axes.lines if "true" in line.get_label()}
    wanted = {"star or quasar, true: 30, 60, 90%": "--"} | ({"galaxy, true: 30, 60, 90%": "-"} if galaxies else {})
    assert named == wanted
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("u - g [AB mag]", "g - r [AB mag]")


def test_true_colours_of_few_are_open_points_beside_the_measured_ones():
    colour = colours_of(30, 12)
    colour["output"] = colour["input"] + [[1.0], [-0.5]]
    axes = Figure().add_subplot()
    colour_panel.colours(axes, colour, LOOKS)
    found = {line.get_label(): line for line in axes.lines}
    for kind, mine in (("star or quasar", ~colour["galaxy"]), ("galaxy", colour["galaxy"])):
        measured, true = found[f"{kind} ({mine.sum()}), measured"], found[f"{kind}, true"]
        assert np.array_equal(true.get_xydata().T, colour["input"][:, mine])
        assert np.array_equal(measured.get_xydata().T, colour["output"][:, mine])
        assert true.get_markerfacecolor() == "none" != measured.get_markerfacecolor()


@pytest.mark.parametrize(("n", "galaxies"), [(0, 0), (1, 0), (49, 20), (120, 60), (120, 119)])
def test_colours_of_few_are_points_of_many_contours(n, galaxies):
    axes = Figure().add_subplot()
    colour_panel.colours(axes, colours_of(n, galaxies), LOOKS)
    drawn = [child for child in axes.get_children() if isinstance(child, QuadContourSet)]
    assert len(drawn) == sum(k >= colour_panel.CONTOURS_FROM for k in (galaxies, n - galaxies))
    shown = sum(len(line.get_xdata()) for line in axes.lines if line.get_marker() in "os")
    assert shown == n + sum(k for k in (galaxies, n - galaxies) if k < colour_panel.CONTOURS_FROM)


def shapes_of(n):
    """Trials of stars whose size residual grows with x, and whose ellipticity is along y above the middle, x below."""
    rng = stream(62, "shapes")
    x, y = rng.uniform(0, 9000, (2, n))
    table = {name: np.ones(n) for name in COLUMNS} | {"galaxy": np.zeros(n), "snr": np.full(n, 100.0), "x": x, "y": y}
    table |= {"psf_size": 0.01 * (x / 9000 - 0.5), "psf_e1": np.where(y > 4500, -0.004, 0.004), "psf_e2": np.zeros(n)}
    return {"trials": {"r": ObjectTable(table)}}


def test_maps_of_shapes_show_what_was_put_in():
    figure = Figure()
    left, right = figure.subplots(1, 2)
    arrays = shapes_of(5000)
    psf_panels.size(left, arrays)
    psf_panels.ellipticity(right, arrays)
    values = left.collections[0].get_array().reshape(psf_panels.CELLS, psf_panels.CELLS)  # rows are y
    middle = (np.arange(psf_panels.CELLS) + 0.5) / psf_panels.CELLS - 0.5
    assert np.abs(values - middle).max() < 0.03  # %; of chance of the median place in a cell
    (whiskers,) = (child for child in right.get_children() if isinstance(child, Quiver))
    u, v = (part.reshape(psf_panels.CELLS, psf_panels.CELLS) for part in (whiskers.U, whiskers.V))  # rows are x
    half = psf_panels.CELLS // 2
    assert np.abs(u[:, :half] - 0.004).max() < 1e-12 and np.abs(v[:, :half]).max() < 1e-12
    assert np.abs(v[:, half:] - 0.004).max() < 1e-12 and np.abs(u[:, half:]).max() < 1e-12


@pytest.mark.parametrize(("n", "drawn"), [(0, False), (2, False), (6, False), (200, True)])
def test_maps_of_a_few_stars(n, drawn):
    """Without MIN_SOURCES stars in any of 64 cells there is nothing to draw."""
    figure = Figure()
    for axes, draw in zip(figure.subplots(1, 2), (psf_panels.size, psf_panels.ellipticity), strict=True):
        assert draw(axes, shapes_of(n)) is drawn


def test_without_a_label_there_is_no_legend(recwarn):
    """Bands there are, but too few sources in each for a line."""
    axes = Figure().add_subplot()
    assert not legend(axes) and axes.get_legend() is None and not recwarn.list
    axes.plot([0, 1], label="r")
    assert legend(axes) and axes.get_legend() is not None


def full(axes, band=None):
    axes.plot([0, 1], label=str(band))
    axes.set(xlabel="x", ylabel="y")
    return legend(axes)


def nothing(axes, band=None):
    return False


def test_panels_without_data_are_left_out():
    """Of two rows of two, one panel and the whole second row have nothing to show."""
    figure = figures.new_figure((1.0, 1.0))
    first = figures._block(figure, 2, 3.0, [nothing, full])
    figures._arrange(figure, [first, figures._block(figure, 2, 1.0, [nothing]), figures._block(figure, 3, 6.0, [full])])
    assert len(figure.axes) == 2
    assert figure.get_figheight() == pytest.approx(9.4)
    one, two = (axes.get_subplotspec().get_topmost_subplotspec() for axes in figure.axes)
    assert (one.rowspan.start, two.rowspan.start) == (0, 1)
    assert first.rows[0][0].get_subplotspec().colspan.start == 0


def test_small_panels_are_a_column_for_each_band_and_name_their_axes_once():
    """A row without any data is left out; in a row with some, the others say that they have too few sources."""
    figure = figures.new_figure((1.0, 1.0))

    def some(axes, band):
        return full(axes, band) if band != "u" else False

    block = figures._trellis(figure, ["u", "g", "r"], [nothing, some, full], LOOKS)
    figures._arrange(figure, [block])
    assert [len(row) for row in block.rows] == [3, 3] and len(figure.axes) == 6
    upper, lower = block.rows
    assert [axes.get_title() for axes in upper] == ["u", "g", "r"] and not lower[0].get_title()
    assert [axes.yaxis.label.get_visible() for axes in upper] == [True, False, False]
    assert [axes.xaxis.label.get_visible() for axes in upper] == [False, True, False]
    assert [[text.get_text() for text in axes.texts] for axes in upper] == [["too few sources"], [], []]
    assert [bool(axes.get_legend()) for axes in (*upper, *lower)] == [False, True, False, True, False, False]
    spots = [axes.get_subplotspec() for axes in (*upper, *lower)]
    assert [(spot.rowspan.start, spot.colspan.start) for spot in spots] == [(i, j) for i in (0, 1) for j in (0, 1, 2)]


def test_only_lonely_sound_stars_of_the_asked_snr_are_in_the_maps_of_shapes():
    """One reason to be left out at a time; a whisker of e2 alone lies at 45 deg, a cell's width for 0.01."""
    table = {name: values[:3000] for name, values in shapes_of(3000)["trials"]["r"].items()}
    table |= {"psf_size": np.full(3000, 0.005), "psf_e1": np.zeros(3000), "psf_e2": np.full(3000, 0.006)}
    changes = {"sound": 0.0, "galaxy": 1.0, "lonely": 0.0, "snr": 50.0, "psf_size": np.nan}
    odd = [table | {"psf_e2": np.full(3000, -0.5)} | {name: np.full(3000, v)} for name, v in changes.items()]
    odd.append(table | {"snr": np.full(3000, 500.0), "psf_e2": np.full(3000, -0.5)})
    arrays = {"trials": {str(k): ObjectTable(one) for k, one in enumerate([table, *odd])}}
    left, right = Figure().subplots(1, 2)
    assert psf_panels.size(left, arrays) and psf_panels.ellipticity(right, arrays)
    np.testing.assert_allclose(left.collections[0].get_array(), 0.5)
    (whiskers,) = (child for child in right.get_children() if isinstance(child, Quiver))
    np.testing.assert_allclose(whiskers.U, 0.006 * math.sqrt(0.5))
    np.testing.assert_allclose(whiskers.V, 0.006 * math.sqrt(0.5))
    cell = (table["x"].max() + 1 - table["x"].min()) / 8
    assert whiskers.scale == pytest.approx(0.01 / cell)
    assert whiskers.XY[:, 0].min() == pytest.approx(table["x"].min() + cell / 2)
    assert right.get_xlim() == pytest.approx((table["x"].min(), table["x"].max() + 1))


def test_a_cell_of_two_stars_is_empty_and_the_others_are_not():
    table = {name: np.ones(11) for name in COLUMNS} | {"galaxy": np.zeros(11), "snr": np.full(11, 100.0)}
    table |= {"x": np.r_[np.zeros(4), np.full(5, 799.0), 799.0, 799.0], "y": np.r_[np.zeros(9), 79.0, 79.0]}
    table |= {"psf_size": np.r_[np.full(4, 0.01), [0.0, 0.0, 0.002, 0.9, 0.9], -0.01, -0.01]}
    axes = Figure().add_subplot()
    assert psf_panels.size(axes, {"trials": {"r": ObjectTable(table)}})
    values = axes.collections[0].get_array().reshape(8, 8)  # rows are y
    assert values[0, 0] == pytest.approx(1.0) and values[0, 7] == pytest.approx(0.2)
    assert np.ma.count(np.ma.masked_invalid(values)) == 2


def test_colours_measured_and_true_are_told_apart():
    """Measured colours are filled, true ones open; u - g to the right, g - r upward."""
    axes, colour = Figure().add_subplot(), colours_of(6, galaxies=2)
    assert colour_panel.colours(axes, colour, LOOKS)
    lines = {line.get_label(): np.array(line.get_data()) for line in axes.lines}
    for kind, mine in (("galaxy", slice(0, 2)), ("star or quasar", slice(2, 6))):
        n = mine.stop - mine.start
        np.testing.assert_allclose(lines[f"{kind} ({n}), measured"], colour["output"][:, mine])
        np.testing.assert_allclose(lines[f"{kind}, true"], colour["input"][:, mine])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("u - g [AB mag]", "g - r [AB mag]")
    assert axes.get_title().endswith("at S/N > 10 in u, g, r")
    many = Figure().add_subplot()
    colour_panel.colours(many, colours_of(7000), LOOKS)
    assert len(many.lines[0].get_xdata()) == 2334  # every third of 7000
    assert not colour_panel.colours(Figure().add_subplot(), {"bands": ()}, LOOKS)
