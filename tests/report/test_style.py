"""Colours and markers of bands: told apart, whatever number of filters a camera has."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from support.csst import LOOKS

from csstsim.report.style import BLACK, BLUE, COLOURS, GREY, PURPLE, VERMILION, band_styles, snr_axis


def some(imaging, slitless=0):
    names = [f"B{k}" for k in range(imaging)], [f"G{k}" for k in range(slitless)]
    kinds = ("imaging", "slitless")
    filters = {name: SimpleNamespace(kind=kind) for kind, own in zip(kinds, names, strict=True) for name in own}
    return band_styles(filters)


def test_seven_bands_run_from_purple_to_black_and_gratings_are_grey():
    assert list(LOOKS) == ["nuv", "u", "g", "r", "i", "z", "y", "gu", "gv", "gi"]
    assert LOOKS["nuv"].label == "NUV" and LOOKS["gv"].label == "GV"
    assert [style.colour for style in LOOKS.values()] == [*COLOURS, GREY, GREY, GREY]
    assert (LOOKS["nuv"].colour, LOOKS["u"].colour, LOOKS["y"].colour) == (PURPLE, BLUE, BLACK)
    assert [style.marker for style in LOOKS.values()] == [*"osD^v<>", None, None, None]
    assert [LOOKS[name].line for name in ("r", "gu", "gv", "gi")] == ["-", ":", "--", "-."]


@pytest.mark.parametrize(("n", "places"), [(1, [3]), (2, [1, 5]), (3, [1, 3, 5])])
def test_few_bands_are_spread_over_the_colours(n, places):
    assert [style.colour for style in some(n).values()] == [COLOURS[k] for k in places]


def test_many_bands_differ_in_colour_or_marker_and_many_gratings_reuse_dashes():
    shown = some(20, 4)
    bands = [style for style in shown.values() if style.marker]
    assert len({(style.colour, style.marker) for style in bands}) == 20
    assert bands[7].colour == bands[0].colour and bands[13].colour == COLOURS[6] != VERMILION
    assert [shown[f"g{k}"].line for k in range(4)] == [":", "--", "-.", ":"]


def test_the_axis_of_snr_is_logarithmic_and_keeps_its_limits():
    axes = Figure().add_subplot()
    axes.plot([3.0, 70.0], [0, 1])
    axes.set_xlim(3.0, 70.0)
    snr_axis(axes)
    assert axes.get_xscale() == "log" and axes.get_xlim() == (3.0, 70.0) and axes.get_xlabel() == "true S/N"
    np.testing.assert_array_equal(axes.get_xticks(), [1, 5, 20, 100, 500])
    assert [text.get_text() for text in axes.get_xticklabels()][:4] == ["1", "5", "20", "100"]
