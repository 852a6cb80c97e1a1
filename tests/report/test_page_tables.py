"""Tables and figures of the pages, cell by cell: bricks, gates, variants, twins, the sky by exposure."""

import numpy as np
import pytest
from support.csst import LOOKS

from csstsim.measure.bricks.validation import verdict as verdicts
from csstsim.report import page, stray_panel, twin_figure, variants_page
from csstsim.report.parts import Details, Figure, Link, Pairs, Paragraph, Table, Verdict
from csstsim.report.variants_page import Study


def gate(name, passed, **more):
    return {"name": name, "band": "g", "value": 0.5, "threshold": 0.9, "n": 30, "passed": passed, "margin": 0.25} | more


def part(n, median, sigma):
    return {"n": n, "median": median, "sigma": sigma, "error": 0.1}


def result(brick, gates, **more):
    numbers = {"frames": 2, "zeropoint": 26.0, "depth_5sigma": 26.1, "point_sources": 40, "star": part(5, 0.1, 0.2)}
    numbers |= {"galaxy": part(5, 0.1, 0.2), "galaxy_kron": part(5, 0.1, 0.2)}
    given = {
        "brick": brick, "sources": 50, "purity": 0.96, "truth": 1, "frames": 3, "gates": gates,
        "bands": {"g": numbers | {"completeness": 0.875}, "nuv": numbers | {"completeness": 0.5}},
        "astrometry_mas": {"east": part(7, 1.26, 2.04), "north": part(7, -0.31, None)},
    }  # fmt: skip
    return given | more


def test_the_table_of_bricks_has_each_bricks_numbers():
    fails, passes, idle = gate("a", False), gate("a", True), gate("a", None)
    results = [result(12, [fails, passes, passes, idle]), result(11, [passes], bands={}), result(13, [idle])]
    note, table = page._brick_table(results, {11: (Link("x", "y"),)}, {"nuv": "NUV"})
    assert "completeness of point sources" in note.words and table.name == "bricks"
    assert list(table.head) == [
        "brick", "verdict", "gates pass / fail / not evaluated", "frames", "sources", "true objects", "purity", "g",
        "NUV", "files",
    ]  # fmt: skip
    same = 3, 50, 1, 0.96
    assert table.rows == [
        [Link("12", "#brick-12"), Verdict(False), "2 / 1 / 1", *same, 0.875, 0.5, None],
        [Link("11", "#brick-11"), Verdict(True), "1 / 0 / 0", *same, None, None, (Link("x", "y"),)],
        [Link("13", "#brick-13"), Verdict(None), "0 / 0 / 1", *same, 0.875, 0.5, None],
    ]
    assert page._brick_table([], {}, {}) == []


def test_a_brick_says_what_there_is_and_how_far_off():
    words, links, table, _, figure, fold = page._brick(result(7, []), b"png", (Link("x", "y"),), {"g": "G"})
    assert words.words == (
        "50 merged sources; 1 true object on 3 frames. Positions out - in: east +1.3 (scatter 2.0), north -0.3 mas "
        "from 7 bright stars."
    )
    assert links.words == (Link("x", "y"),) and [row[0] for row in table.rows] == ["G", "nuv"]
    assert figure == Figure(b"png", "Validation of brick 7") and fold.summary == "all numbers by band"
    assert fold.body[0].head == ("number", "G", "nuv")
    none = {name: part(0, None, None) for name in ("east", "north")}
    bare = page._brick(result(7, [], astrometry_mas=none, frames=1), None, (), {})
    assert (
        bare[0].words
        == "50 merged sources; 1 true object on 1 frame. Positions out - in: not measured, no bright star."
    )
    assert not any(isinstance(one, Figure) for one in bare)


def test_bricks_beyond_the_fourth_are_folded():
    results = [result(k, [gate("a", True), gate("b", None)]) for k in range(6)]
    sections = page._bricks(results, page.ReportContent(figures={5: b"png"}))
    assert [(one.name, one.title, one.level) for one in sections[:2]] == [
        ("brick-0", "Brick 0", 3), ("brick-1", "Brick 1", 3),
    ]  # fmt: skip
    assert [len(one.body) == 1 and isinstance(one.body[0], Details) for one in sections] == [False] * 4 + [True] * 2
    assert sections[5].body[0].summary == "1 pass, 0 fail, 1 not evaluated"
    assert [any(isinstance(p, Figure) for p in one.body[0].body) for one in sections[4:]] == [False, True]


def test_tables_of_gates_are_by_verdict_with_all_their_keys():
    gates = [
        gate("bias", False, brick=5, chip=9), gate("bias", True, brick=6, value=0.1), gate("lines", False, brick=None),
        gate("flag", None, brick=5, n=3), gate("flag", None, brick=6, n=4, band="r"),
    ]  # fmt: skip
    matrix, failing, idle_words, idle, passing = page._gates(gates, {"g": "G"})
    assert matrix.bands == ["G", "r"] and sorted(name for name, _ in matrix.rows) == ["bias", "flag", "lines"]
    assert failing.head == ("brick", "verdict", "gate", "band", "value", "threshold", "sources", "margin", "chip")
    assert failing.rows == [
        (Link("5", "#brick-5"), Verdict(False), "bias", "g", 0.5, 0.9, 30, 0.25, 9),
        (Link("-", "#spectra"), Verdict(False), "lines", "g", 0.5, 0.9, 30, 0.25, None),
    ]
    assert "could not be evaluated" in idle_words.words
    assert idle.rows == [("flag", "G 3, r 4", "fewer than 20 such objects in the field")]
    assert passing.rows == [(Link("6", "#brick-6"), Verdict(True), "bias", "g", 0.1, 0.9, 30, 0.25, None)]
    assert len(page._gates(gates[:2], {})) == 4 and page._gates([], {}) == []


def test_spectra_without_a_picture_are_linked_in_a_table():
    links = Link("a", "b"), Link("c", "d")
    figure, words, rest = page._spectra(
        [page.FrameSpectra("one", b"png", links), page.FrameSpectra("two", None, links[1:])]
    )
    assert figure == Figure(b"png", "one") and words.words == links
    assert rest == Table(("not shown here", "files"), [("two", links[1:])], "more")
    frames = page.KindOfFiles("frames", 1, "2 kB", ())
    tables = page.KindOfFiles("tables", 2, "3 MB", links)
    assert [one.summary for one in page._products([frames, tables])] == [
        "frames: 1 file, 2 kB",
        "tables: 2 files, 3 MB",
    ]


def test_the_sections_of_a_report_are_in_order_and_failing_bricks_first(monkeypatch, tmp_path):
    """Of eleven gates that fail ten are named; all gates may be given apart from the bricks' results."""
    filled = {}
    monkeypatch.setattr(page, "fill", lambda template, **values: filled.update(values) or "text")
    gates = [gate("a", False, brick=3)] * 11 + [gate("b", True, brick=4)]
    content = page.ReportContent(
        sky=[Paragraph("sky")], mosaic=Paragraph("plane"), sky_map=b"png", gates=gates, times=[{"step": "x"}],
        layers=[("SCIE", "Bias", "{}")], provenance={"host": "h"}, stray_light=[Paragraph("stray")],
        exposures=[{"obsid": 1}], products=[page.KindOfFiles("frames", 1, "2 kB", (Link("a", "b"),))],
        spectra=[page.FrameSpectra("one", b"png", ())], links={3: (Link("x", "y"),)},
    )  # fmt: skip
    results = [result(4, []), result(3, [gate("a", False)] * 2)]
    page.write_report(tmp_path / "index.html", {"name": "mine", "chips": 3}, results, content)
    sections = {one.name: one.body for one in filled["sections"]}
    assert list(sections) == [
        "field", "summary", "plane", "spectra", "sky", "straylight", "gates", "bricks", "validation", "exposures",
        "products", "times", "provenance",
    ]  # fmt: skip
    assert sections["summary"] == [Pairs({"chips": 3})] and filled["name"] == "mine"
    assert sections["sky"] == [Figure(b"png", page.SKY)] and sections["field"] == [Paragraph("sky")]
    assert [one.name for one in sections["validation"]] == ["brick-3", "brick-4"]
    assert len(filled["failing"]) == 11 and filled["failing"][-1] == Link("and 1 more", "#gates")
    assert filled["failing"][0] == Link("brick 3: a in g is 0.5 against 0.9", "#brick-3")
    assert filled["headline"].style == "verdict fail" and filled["headline"].words.startswith("FAIL: 1 of 12")
    pairs, fold = sections["provenance"]
    assert pairs == Pairs({"host": "h"}) and fold.body[0].rows == [("SCIE", "Bias", "{}")]
    page.write_report(tmp_path / "index.html", {}, [], page.ReportContent(gates=gates[:10]))
    assert filled["name"] == "campaign" and len(filled["failing"]) == 10
    assert "bricks" not in [one.name for one in filled["sections"]]


# --- variants


def test_gates_of_variants_stand_side_by_side_the_worst_of_exposures():
    def verdict(*gates):
        return {"gates": list(gates), "passed": None, "counts": verdicts.count(gates)}

    base = verdict(
        gate("bias", True, brick=5, margin=0.25, value=0.01), gate("bias", False, brick=5, margin=1.5, value=0.06),
        gate("bias", None, brick=5, margin=None), gate("depth", None, brick=5, margin=None),
        gate("bias", True, brick=6),
    )  # fmt: skip
    other = verdict(
        gate("bias", True, brick=5, threshold=0.95, value=12345.678), gate("new", True, brick=None, band=None)
    )
    assert len(variants_page._of_rows(base)) == 3
    counts, _, table = variants_page._gates({"base": base, "worse": other})
    assert counts.head == ("campaign", "pass", "fail", "not evaluated")
    assert counts.rows == [("base", 2, 1, 2), ("worse", 2, 0, 0)]  # of exposures, as in the report
    assert table.head == ("gate", "band", "brick", "threshold", "base", "worse")
    assert table.rows == [
        ("bias", "g", 5, "0.9 / 0.95", "0.06 (1.50) FAIL", "1.235e+04 (0.25)"),
        ("bias", "g", 6, "0.9", "0.5 (0.25)", ""), ("new", "", None, "0.9", "", "0.5 (0.25)"),
    ]  # fmt: skip
    assert variants_page._value(gate("a", None)) == "-" and variants_page._figure("words") == "words"
    assert variants_page._thresholds([gate("a", True, threshold=None)]) == ""


@pytest.mark.parametrize(("passed", "style"), [((True, False), "fail"), ((True, None), "pass"), ((None, None), "none")])
def test_the_headline_of_variants_has_each_campaigns_verdict(monkeypatch, tmp_path, passed, style):
    filled = {}
    monkeypatch.setattr(variants_page, "fill", lambda template, **values: filled.update(values) or "text")
    given = {
        name: {"gates": [gate("a", p, brick=1)], "passed": p, "counts": verdicts.count([gate("a", p, brick=1)])}
        for name, p in zip(("base", "other"), passed, strict=True)
    }
    counts = {"base": {"sources": 9, "matched": 8, "other": 1}, "variant": {"sources": 7, "matched": 7, "other": 0}}
    variants_page.write_variants(tmp_path / "a.html", "mini", given, [Study("worse", {"k": 3}, [], counts)])
    assert filled["headline"].style == f"verdict {style}" and filled["name"] == "mini: variants"
    assert filled["headline"].words.startswith("base: ") and ". other: " in filled["headline"].words
    assert [(one.name, one.title) for one in filled["sections"]] == [
        ("gates", "Gates side by side"), ("variant-worse", "worse"),
    ]  # fmt: skip
    keys, table, _, means = filled["sections"][1].body
    assert keys == Pairs({"k": 3}) and means.rows == []
    assert [row[1:] for row in table.rows] == [(9, 7, -2), (8, 7, -1), (1, 0, -1)]
    assert table.rows[1][0] == "of a true object, S/N above 5" and table.head[1:] == (
        "base",
        "variant",
        "variant - base",
    )


def star(true, mag, **more):
    return {"kind": "star", "true": true, "mag": mag} | more


def test_the_means_of_a_variant_have_their_errors_and_those_without_the_far(monkeypatch):
    """Of 1, 2, 3, 4, 5 and 100: the last is far; a quantity that does not change has no number of errors."""
    objects = [star(20.0, v, x=0.0) for v in (1.0, 2.0, 3.0, 4.0, 5.0, 100.0)] + [star(20.0, np.nan, x=0.0)]
    counts = {"base": {}, "variant": {}}
    monkeypatch.setattr(variants_page, "twin_figure", lambda objects: b"png" * (len(objects) == 7))
    monkeypatch.setattr(variants_page, "chart", lambda png: png)
    *_, table, figure = variants_page._study(Study("worse", {}, objects, counts))
    values = np.array([1, 2, 3, 4, 5, 100.0])
    error, scatter = values.std(ddof=1) / 6**0.5, values.std(ddof=1)
    near = np.std([1, 2, 3, 4, 5.0], ddof=1) / 5**0.5
    assert table.head[2:4] == ("n", "of these differ") and table.head[-1] == "its error"
    assert table.rows == [
        ("star", "magnitude", 6, 6, f"{115 / 6:+.3g}", f"{error:.2g}", f"{115 / 6 / error:+.1f}", f"{scatter:.2g}", 1,
         "+3", f"{near:.2g}"),
        ("star", "position x [px]", 7, 0, "+0", "0", "0", "0", 0, "+0", "0"),
    ]  # fmt: skip
    assert figure.caption == "worse: variant minus base, by magnitude"


def test_a_mean_of_too_few_objects_is_a_dash(monkeypatch):
    monkeypatch.setattr(variants_page, "twin_figure", lambda objects: b"")
    objects = [star(20.0, v, x=np.nan) for v in (1.0, 2.0)]
    parts = variants_page._study(Study("worse", {}, objects, {"base": {}, "variant": {}}))
    [table] = [part for part in parts if getattr(part, "head", ("",))[0] == "objects"]
    assert table.rows[0] == ("star", "magnitude", 2, 2, "-", "-", "", "-", 0, "-", "-")


def test_the_figure_of_a_variant_has_objects_means_and_errors(monkeypatch):
    monkeypatch.setattr(twin_figure, "png", lambda figure: figure)
    mags = np.array([20.1, 20.3, 20.5, 20.7, 20.9])
    off = np.array([0.01, 0.02, 0.03, 0.04, 0.05])
    objects = [star(m, o, x=-o, y=2 * o) for m, o in zip(mags, off, strict=True)]
    objects += [{"kind": "galaxy", "true": 22.0, "mag": -0.2}, {"kind": "spectrum", "true": -8.0, "spectrum": 0.1}]
    figure = twin_figure.twin_figure(objects)
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_ylabel() for axes in shown] == [
        f"{name}, variant - base" for name in ("magnitude [mag]", "position [px]", "electrons of spectra")
    ]
    assert [axes.get_xlabel() for axes in shown] == ["true magnitude [AB]"] * 2 + ["-2.5 lg electrons"]
    magnitude, place, spectra = shown
    (bar,) = magnitude.containers
    data, _, (segments,) = bar.lines
    error = off.std(ddof=1) / 5**0.5
    np.testing.assert_allclose(data.get_data(), [[20.5 - 0.03], [0.03]])
    np.testing.assert_allclose(np.sort(segments.get_segments()[0][:, 1]), [0.03 - error, 0.03 + error])
    dots = [line.get_xydata().tolist() for line in magnitude.lines if line.get_marker() == "."]
    np.testing.assert_allclose(dots[0], np.transpose([mags, off]))
    assert dots[1] == [[22.0, -0.2]] and magnitude.get_ylim()[1] == pytest.approx(0.24)
    assert [text.get_text() for text in place.get_legend().get_texts()] == ["star x", "star y"]
    np.testing.assert_allclose([c.lines[0].get_ydata()[0] for c in place.containers], [-0.03, 0.06])
    np.testing.assert_allclose([c.lines[0].get_xdata()[0] for c in place.containers], [20.47, 20.53])
    assert [text.get_text() for text in spectra.get_legend().get_texts()] == ["spectrum"]
    assert twin_figure.twin_figure([star(20.0, np.nan)]) is None


# --- the sky by exposure


def test_the_sky_is_of_the_brightest_band_and_earthshine_of_all(monkeypatch):
    monkeypatch.setattr("csstsim.report.figures.png", lambda figure: figure)
    none = np.zeros(3)
    parts = dict.fromkeys(("sun", "moon", "planets", "stars"), none)
    levels = {
        "g": parts | {"zodiacal": np.array([0.1, 0.2, 0.1]), "earth": np.array([0.0, 0.01, 0.2])},
        "r": parts | {"zodiacal": np.array([0.2, 0.4, 0.2]), "earth": np.array([0.1, 0.0, 0.01])},
    }
    levels["r"]["moon"] = np.array([0.0, 1e-10, 0.03])
    limbs = {"g": np.array([80.0, 60.0, 30.0]), "r": np.array([20.0, 85.0, 40.0])}
    by_time, by_limb = stray_panel.sky_by_exposure(levels, limbs, LOOKS).axes
    assert by_time.get_ylabel() == "r [e-/s/px]" and by_time.get_yscale() == "log" == by_limb.get_yscale()
    drawn = {line.get_label(): line.get_xydata().tolist() for line in by_time.lines}
    assert drawn == {"zodiacal": [[1, 0.2], [2, 0.4], [3, 0.2]], "earth": [[1, 0.1], [3, 0.01]], "moon": [[3, 0.03]]}
    green, red, share = by_limb.lines
    np.testing.assert_allclose(green.get_xydata(), [[60, 0.05], [30, 2.0]])
    np.testing.assert_allclose(red.get_xydata(), [[20, 0.5], [40, 0.05]])
    assert (green.get_label(), red.get_label()) == ("g: 33% above 10%", "r: 33% above 10%")
    assert green.get_color() == LOOKS["g"].colour and set(share.get_ydata()) == {0.1}
    assert by_limb.get_ylim()[0] == pytest.approx(1e-7)
