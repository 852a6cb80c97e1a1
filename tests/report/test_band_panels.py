"""Small panels of a brick's figure, one for each band: every point and error bar against numbers by hand."""

import numpy as np
import pytest
from astropy.stats import binom_conf_interval
from matplotlib.figure import Figure
from support.csst import LOOKS

from csstsim.catalog.table import ObjectTable
from csstsim.report import band_panels


def axes_of():
    return Figure().add_subplot()


def bars(axes):
    """(x, y, error downward, error upward, colour) of the error bars in axes."""
    (bar,) = axes.containers
    data, _, (lines,) = bar.lines
    x, y = (np.array(values, float) for values in data.get_data())
    ends = np.array(lines.get_segments())[:, :, 1]
    return x, y, y - ends[:, 0], ends[:, 1] - y, data.get_color()


def stars(mag, found, galaxy=0.0):
    n = len(mag)
    return {"mag": np.asarray(mag, float), "found": np.asarray(found, float), "galaxy": np.full(n, galaxy)}


def joined(*tables):
    return ObjectTable({name: np.concatenate([table[name] for table in tables]) for name in tables[0]})


def test_completeness_has_wilsons_interval_in_each_bin_of_three_or_more():
    """Edges 10-15 and 20-50 and 100-500, at the bins' geometric means."""
    n, found = np.zeros(13, int), np.zeros(13, int)
    n[[1, 8, 10]], found[[1, 8, 10]] = (2, 20, 3), (1, 15, 3)
    axes = axes_of()
    arrays = {"styles": LOOKS, "completeness": {"g": (n, found), "r": (np.full(13, 2), np.ones(13))}}
    assert band_panels.completeness(axes, "g", {}, arrays, threshold=0.9, snr_min=12.0)
    x, y, down, up, colour = bars(axes)
    np.testing.assert_allclose([x, y], [np.sqrt([150.0, 1000.0]), [15 / 20, 1.0]])
    interval = binom_conf_interval([15, 3], [20, 3], 0.682689492137, "wilson")
    np.testing.assert_allclose([y - down, y + up], interval, atol=1e-9)
    assert colour == LOOKS["g"].colour
    level, gate = (line for line in axes.lines if line.get_color() == "#666666")
    assert set(level.get_ydata()) == {0.9} and set(gate.get_xdata()) == {12.0}
    assert axes.get_xlim() == (1.0, 500.0) and axes.get_xscale() == "log" and axes.get_xlabel() == "true S/N"
    assert not band_panels.completeness(axes_of(), "r", {}, arrays)


def test_found_by_magnitude_is_a_share_for_each_kind_in_half_magnitudes():
    table = joined(
        stars([22.2] * 10, [1] * 7 + [0] * 3), stars([25.3] * 2, [1, 1]), stars([np.nan, 22.2, 22.4], [1, 0, 0]),
        stars([23.6] * 4, [1, 0, 0, 0], galaxy=1.0), stars([22.1] * 3, [1] * 3, galaxy=1.0),
    )  # fmt: skip
    axes = axes_of()
    assert band_panels.found_by_magnitude(axes, "i", {}, {"trials": {"i": table}})
    point, extended = axes.lines[:2]
    assert point.get_linestyle() == "-" and extended.get_linestyle() == "--"
    assert point.get_color() != extended.get_color() and point.get_marker() != extended.get_marker()
    np.testing.assert_allclose(point.get_data(), ([22.25], [7 / 12]))
    np.testing.assert_allclose(extended.get_data(), ([22.25, 23.75], [1.0, 0.25]))
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["star, quasar", "galaxy"]
    few = stars([22.0] * 2, [1, 1])
    assert not band_panels.found_by_magnitude(axes_of(), "i", {}, {"trials": {"i": few}})


@pytest.mark.parametrize(("galaxy", "label"), [(0.0, "star, quasar"), (1.0, "galaxy")])
def test_a_band_of_one_kind_is_drawn(galaxy, label):
    """A small field may have galaxies enough to draw, and no stars."""
    axes = axes_of()
    table = stars([22.2] * 20, [1] * 20, galaxy)
    assert band_panels.found_by_magnitude(axes, "r", {}, {"trials": {"r": table}})
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [label]


def test_counts_are_measured_over_true_against_the_depth():
    part = {"edges": [20, 21, 22, 24], "in": [100, 19, 20], "out": [80, 19, 25]}
    axes = axes_of()
    result = {"bands": {"g": {"counts": part, "depth_5sigma": 25.5}}}
    assert band_panels.counts(axes, "g", result, {"styles": LOOKS})
    x, y, down, up, colour = bars(axes)
    assert x.tolist() == [-5.0, -2.5] and y.tolist() == [0.8, 1.25]  # 19 true objects are too few
    np.testing.assert_allclose([down, up], [[0.0894427, 0.25]] * 2, rtol=1e-6)
    assert colour == LOOKS["g"].colour
    few = {"bands": {"g": {"counts": part | {"in": [19, 19, 19]}, "depth_5sigma": 25.5}}}
    assert not band_panels.counts(axes_of(), "g", few, {"styles": LOOKS})


def transfer(snr, n, mas, light):
    return {
        "snr": snr, "deferred_mas": {"n": n, "median": mas, "error": 0.5},
        "light": {"n": n + 1, "median": light, "error": 0.25},
    }  # fmt: skip


def test_effects_of_charge_transfer_are_in_mas_and_percent_at_the_middle_of_their_bins():
    """Two stars are too few, three are not."""
    parts = [transfer((10, 40), 5, 2.0, -0.04), transfer((40, 90), 2, 9.0, 0.01)]
    result = {"bands": {"u": {"transfer": parts}, "g": {"transfer": []}}}
    found = {}
    for draw in (band_panels.positions, band_panels.fluxes):
        axes = axes_of()
        assert draw(axes, "u", result, {"styles": LOOKS})
        found[draw.__name__] = bars(axes)
        assert not draw(axes_of(), "g", result, {"styles": LOOKS})
    x, y, down, up, colour = found["positions"]
    np.testing.assert_allclose((*x, *y, *down, *up), (20.0, 2.0, 0.5, 0.5))
    assert colour == LOOKS["u"].colour
    x, y, down, up, _ = found["fluxes"]
    np.testing.assert_allclose(x, [20.0, 60.0])
    np.testing.assert_allclose((*y, *down), (-4.0, 1.0, 25.0, 25.0))
