"""The matrix of gates: columns, order, the worst of several results, marks beside the colours."""

import pytest
from report_page import Reader

from csstsim.report.gate_matrix import FAIL, NOT_EVALUATED, gate_matrix
from csstsim.report.parts import draw

BANDS = {"nuv": "NUV", "g": "g", "r": "r", "gv": "GV"}


def gate(name, band, passed, margin=None, **more):
    found = {"name": name, "band": band, "passed": passed, "margin": margin, "value": 0.5, "threshold": 0.9, "n": 30}
    return {"brick": 7} | found | more


def cells_of(matrix, name):
    return dict(zip(matrix.bands, dict(matrix.rows)[name], strict=True))


def test_a_failing_a_passing_and_an_idle_gate_differ_in_colour_mark_and_words():
    gates = [
        gate("bias", "r", False, 1.72, exposure="101", chip=9), gate("bias", "nuv", True, 0.874),
        gate("bias", "g", None, n=3),
    ]  # fmt: skip
    cells = cells_of(gate_matrix(gates, BANDS), "bias")
    assert [cell.style for cell in cells.values()] == ["margin3", "unevaluated", "over"]
    assert [cell.text for cell in cells.values()] == ["0.87", NOT_EVALUATED, f"{FAIL} 1.72"]
    assert cells["r"].title == "brick 7, exposure 101, chip 9: bias in r is 0.5 against 0.9, margin 1.72; 30 sources"
    assert cells["NUV"].title.endswith("bias in nuv is 0.5 against 0.9, margin 0.87; 30 sources")
    assert cells["g"].title.endswith("not evaluated: fewer than 20 such objects in the field; 3 sources")
    assert {cell.href for cell in cells.values()} == {"#brick-7"}


@pytest.mark.parametrize(("margin", "style", "text"), [
    (0.0, "margin0", "0.00"), (0.25, "margin0", "0.25"), (0.251, "margin1", "0.25"), (0.5, "margin1", "0.50"),
    (0.75, "margin2", "0.75"), (1.0, "margin3", "1.00"), (None, "margin0", "pass"),
])  # fmt: skip
def test_the_colour_of_a_passing_gate_is_that_of_its_margin(margin, style, text):
    (cell,) = cells_of(gate_matrix([gate("bias", "r", True, margin)], BANDS), "bias").values()
    assert (cell.style, cell.text) == (style, text)


def test_of_several_results_the_worst_is_shown_and_all_are_counted():
    gates = [
        gate("bias", "r", True, 0.9, brick=1), gate("bias", "r", None, brick=2),
        gate("bias", "r", False, 199.6, brick=3), gate("bias", "r", False, 1.1, brick=4),
        gate("idle", "r", None, brick=5), gate("idle", "r", True, 0.0, brick=6),
    ]  # fmt: skip
    matrix = gate_matrix(gates, BANDS)
    worst, idle = cells_of(matrix, "bias")["r"], cells_of(matrix, "idle")["r"]
    assert worst.text == f"{FAIL} 200" and worst.href == "#brick-3"
    assert worst.title.endswith("; 1 pass, 2 fail, 1 not evaluated")
    assert idle.text == "0.00" and idle.href == "#brick-6"


def test_columns_are_in_the_cameras_order_and_rows_begin_with_those_that_fail():
    """A colour is in the column of its first band; what no filter of the camera has comes last."""
    gates = [
        gate("purity", "all", True, 0.1), gate("completeness", "r", True, 0.1), gate("my own", "r", True, 0.1),
        gate("colour", "g - r", True, 0.2),
        gate("sky near spectra over the campaign's, less 1", "gv", True, brick=None),
        gate("purity", "all", True, 0.1), gate("width of stars' pulls", "nuv", False, 2.0),
    ]  # fmt: skip
    matrix = gate_matrix(gates, BANDS)
    assert matrix.bands == ["NUV", "g", "r", "GV", "all"]
    names = [name for name, _ in matrix.rows]
    assert names[0] == "width of stars' pulls" and names[-2:] == ["my own", "colour"]
    assert names[1:4] == ["completeness", "sky near spectra over the campaign's, less 1", "purity"]
    cells = cells_of(matrix, "colour")
    assert "colour in g - r is" in cells["g"].title and [band for band, cell in cells.items() if cell] == ["g"]
    assert cells_of(matrix, names[2])["GV"].href == "#spectra"


def test_the_html_has_a_title_for_each_cell_and_a_key_of_all_kinds():
    text = draw(gate_matrix([gate("a<b", "r", False, 2.0), gate("c", "g", None)], BANDS))
    reader = Reader(text)
    titles = reader.values("td", "title")
    assert len(titles) == 2 and any("a<b in r" in title for title in titles) and "a&lt;b" in text
    words = " ".join(reader.text)
    for meaning in ("margin up to 0.25", "margin up to 1", "fails, margin above 1", "not evaluated"):
        assert meaning in words
    assert reader.values("table", "style") == ["--columns: 2"]
