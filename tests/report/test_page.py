"""The report's page: its first lines, escaping and closed tags, and its size when lists are long."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure
from report_page import Reader

from csstsim.measure.bricks.validation import verdict
from csstsim.measure.bricks.validation.compare import spread
from csstsim.report.figures import png
from csstsim.report.page import FrameSpectra, KindOfFiles, ReportContent, write_report
from csstsim.report.parts import MAX_OPEN_ROWS, Gallery, Link, Table, draw
from csstsim.report.parts import Figure as Picture
from csstsim.report.pictures import chart, photograph

EVIL = '<script>alert("x")</script>'
PNG = b"\x89PNG not looked into"


def gate(name, band, passed, **more):
    return {"name": name, "band": band, "value": 0.03125, "threshold": 0.02, "n": 25, "passed": passed} | more


def result(brick, gates, bands=("g",)):
    """A result of validate_brick with these gates."""
    star = {"n": 25, "median": 0.03125, "sigma": 0.01, "error": 0.002}
    numbers = {
        "frames": 2, "zeropoint": 26.0, "depth_5sigma": 26.1, "completeness": 0.875, "point_sources": 40, "star": star,
        "galaxy": star, "galaxy_kron": star, "completeness_curve": {"snr": [1, 2]}, "deep": {"pull": {"width": 1.125}},
    }  # fmt: skip
    part = {"n": 5, "median": 0.5, "sigma": 1.0}
    return {
        "brick": brick, "sources": 50, "purity": 0.96, "truth": 48, "frames": 2, "bands": dict.fromkeys(bands, numbers),
        "astrometry_mas": {"east": part, "north": part}, "gates": gates,
    }  # fmt: skip


def page(path, results, **more):
    write_report(path / "index.html", {"name": "trial", "seed": 3}, results, ReportContent(**more))
    return (path / "index.html").read_text(encoding="utf-8")


def test_one_star_has_a_residual_and_no_scatter(tmp_path):
    alone = result(11, [gate("purity", None, None)])
    part = spread([0.5])
    assert part == {"median": 0.5, "error": None, "sigma": None, "n": 1}
    alone["astrometry_mas"] = {"east": part, "north": part}
    for numbers in alone["bands"].values():
        numbers["star"] = part
    text = page(tmp_path, [alone])
    assert "east +0.5, north +0.5 mas from 1 bright stars" in text and "no bin of these objects has 20" in text


def test_failing_gates_are_named_first_and_the_failing_brick_is_the_first_row(tmp_path):
    good, bad = result(11, [gate("completeness", "g", True)]), result(12, [gate("purity", None, False)])
    text = page(tmp_path, [good, bad])
    reader = Reader(text)
    words = " ".join(reader.text)
    assert "FAIL: 1 of 2 evaluated gates pass." in words
    top = words[words.index("csstsim report: trial") :]
    assert top.index("brick 12: purity is 0.03125 against 0.02") < top.index("Summary")
    assert top.index("Brick 12") < top.index("Brick 11")
    assert "deep: pull: width" in words and "completeness_curve" not in words  # numbers it has not heard of
    hashes = {href[1:] for href in reader.values("a", "href") if href.startswith("#")}
    ids = [attrs["id"] for _, attrs in reader.tags if "id" in attrs]
    assert hashes <= set(ids) and len(ids) == len(set(ids))
    assert {"gates", "bricks", "brick-11", "brick-12"} <= hashes


def test_all_text_is_escaped_and_everything_is_in_the_page(tmp_path):
    wicked = result(1, [gate(EVIL, EVIL, False, extra=EVIL)])
    text = page(
        tmp_path, [wicked], figures={1: PNG}, sky_map=PNG, exposures=[{EVIL: EVIL, "chips": (Link(EVIL, EVIL),)}],
        products=[KindOfFiles(EVIL, 1, "2 kB", (Link(EVIL, f"../level0/{EVIL}.fits"),))],
        layers=[(EVIL, EVIL, EVIL)], links={1: (Link(EVIL, "a.json"),)},
        spectra=[FrameSpectra(EVIL, PNG, ()), FrameSpectra(EVIL, None, ())], provenance={EVIL: EVIL},
        times=[{"step": EVIL, "wall": 1.0}],
    )  # fmt: skip
    reader = Reader(text)
    assert text.count("<script") == 1 and [tag for tag, _ in reader.tags].count("script") == 1  # the page's own
    assert " ".join(reader.text).count(EVIL) >= 12  # as text, where it was put
    images = reader.values("img", "src")
    assert len(images) == 3 and all(src.startswith("data:image/png;base64,") for src in images)
    assert f"../level0/{EVIL}.fits" in reader.values("a", "href")
    assert not reader.values("script", "src") and not reader.values("link", "href")
    assert "url(" not in text and "@import" not in text and "http:" not in text and "https:" not in text


def test_the_contents_beside_the_page_lead_to_all_its_sections(tmp_path):
    """They come before the page, and stay; no id is twice."""
    reader = Reader(
        page(tmp_path, [result(1, [gate("purity", "all", True, margin=0.5)])], layers=[("SCIE", "a", "{}")])
    )
    tags = [tag for tag, _ in reader.tags]
    first = tags[tags.index("nav") : tags.index("main")]
    hrefs = reader.values("a", "href")[: first.count("a")]
    ids = [attrs["id"] for _, attrs in reader.tags if "id" in attrs]
    sections = [name for name in ids if not name.startswith("brick-")]
    assert hrefs == [f"#{name}" for name in sections] and len(hrefs) >= 4 and len(ids) == len(set(ids))


def test_the_gate_closest_to_failing_is_named_if_none_fails(tmp_path):
    near, far = gate("bias", "g", True, margin=0.875), gate("purity", "g", True, margin=0.25)
    said = "Closest to failing: margin 0.88,"
    words = " ".join(Reader(page(tmp_path, [result(1, [far, near, gate("idle", "g", None)])])).text)
    assert said in words and words.index(said) < words.index("brick 1: bias in g is 0.03125 against 0.02")
    failing = gate("counts", "g", False, margin=2.0)
    assert "Closest to failing" not in page(tmp_path, [result(1, [near, failing])])


def test_a_page_of_figures_is_small(tmp_path):
    """A brick's figure and 20 thumbnails of noise, as in the demo; the page itself has less than 60 kB."""
    rng = np.random.default_rng(2)
    plot = Figure(figsize=(13, 25), dpi=100)
    for axes in plot.subplots(8, 4).flat:
        axes.plot(rng.normal(size=300), ".", rasterized=True)
    noise = [Picture(photograph(rng.normal(60, 20, (384, 384)).astype(np.uint8)), "noise", "photo") for _ in range(20)]
    alone = page(tmp_path, [result(1, [gate("purity", "all", True)])])
    text = page(tmp_path, [result(1, [])], figures={1: chart(png(plot))}, sky=[Gallery(noise)])
    assert len(alone) < 60_000
    assert len(text) < 2_000_000


def test_a_report_of_nothing(tmp_path):
    text = page(tmp_path, [])
    Reader(text)
    assert "No gate could be evaluated" in text


def test_gates_that_do_not_apply_are_apart_with_one_of_three_reasons(tmp_path):
    gates = [
        gate("flag", "g", None, n=3), gate("flag", "r", None, n=7), gate("purity", "all", None, threshold=None),
        gate("bias", "r", None, n=40), gate("completeness", "r", True),
    ]  # fmt: skip
    text = page(tmp_path, [result(1, gates)], labels={"g": "G"})
    words = " ".join(Reader(text).text)
    assert "4 could not be evaluated (fewer than 20 such objects in the field; no threshold is given; no bin" in words
    rows = verdict.never_evaluated(gates)
    assert rows == {
        ("flag", verdict.TOO_FEW): {"g": 3, "r": 7}, ("purity", verdict.NO_THRESHOLD): {"all": 25},
        ("bias", verdict.NO_BIN): {"r": 40},
    }  # fmt: skip
    assert "G 3, r 7" in words and "could not be evaluated in this campaign, and why" in words
    assert text.count('class="none">not evaluated') == 0 and text.count('class="pass">pass') >= 1


def test_gates_may_miss_or_add_keys_and_figures(tmp_path):
    odd = {"name": "shear", "passed": None, "why": "no twin"}
    words = " ".join(Reader(page(tmp_path, [result(3, [odd], bands=())])).text)
    assert "shear" in words and "no threshold is given" in words and "not evaluated" in words


@pytest.mark.thorough
def test_500_bricks_and_3000_files_make_a_small_page_that_folds(tmp_path):
    bands = ("nuv", "u", "g", "r", "i", "z", "y")
    some = (("bias", None), ("depth", False)), (("bias", None), ("depth", True))
    gates = [[gate(name, b, passed) for name, passed in pair for b in bands] for pair in some]
    results = [result(k, gates[k % 100 != 7], bands) for k in range(500)]
    files = tuple(Link(f"{k % 30:02d} r", f"../level0/101/CSST_MSC_MS_WIDE_{k:030d}_L0_V01.fits") for k in range(30))
    text = page(tmp_path, results, exposures=[{"obsid": k, "Level-0 of chip": files} for k in range(100)])
    reader = Reader(text)
    assert len(text) < 10_000_000
    assert len([href for href in reader.values("a", "href") if href.endswith(".fits")]) == 3000
    words = " ".join(reader.text)
    assert "and 25 more" in words and "500 bricks" in words and "100 exposures" in words
    assert text.count("<details") > 500


def test_long_tables_fold_and_columns_of_numbers_are_set_right():
    assert "<details>" not in draw(Table(("a",), [(1,)] * MAX_OPEN_ROWS))
    assert f"<summary>{MAX_OPEN_ROWS + 1} things" in draw(Table(("a",), [(1,)] * (MAX_OPEN_ROWS + 1), "things"))
    cells = draw(Table(("a", "b"), [(1.5, "x"), (None, 2)]))
    assert '<td class="n" data-label="a">1.5</td><td data-label="b">x</td>' in cells
    assert '<td class="n" data-label="a">-</td><td data-label="b">2</td>' in cells


@pytest.mark.parametrize(
    "passes, whole", [([True, None], True), ([None], None), ([], None), ([True, False, None], False)]
)
def test_the_verdict_and_its_file(tmp_path, passes, whole):
    gates = [gate(f"gate {k}", "r", passed) for k, passed in enumerate(passes)]
    found = verdict.verdict_of_results([result(5, gates)])
    assert found["passed"] is whole
    assert found["counts"] == {name: passes.count(value) for value, name in verdict.NAMES.items()}
    assert [g["passed"] for g in found["gates"]] == sorted(passes, key=verdict.ORDER.index)
    found["gates"] = [g | {"value": float("nan")} for g in found["gates"]]
    verdict.write_verdict(tmp_path / "verdict.json", found, campaign="trial")
    read = json.loads((tmp_path / "verdict.json").read_text(), parse_constant=pytest.fail)
    assert read["passed"] is whole and read["campaign"] == "trial"
    assert [g["value"] for g in read["gates"]] == [None] * len(passes)


def test_printed_are_failing_gates_in_full_and_counts_of_the_others():
    some = [gate("bias", "g", True), gate("bias", "r", False), gate("completeness", "g", True)]
    printed = [
        "FAIL brick 5: bias in r is 0.03125 against 0.02",
        "FAIL bias: 1 pass, 1 fail, 0 not evaluated",
        "pass completeness: 1 pass, 0 fail, 0 not evaluated",
    ]
    assert list(verdict.lines(verdict.verdict_of_results([result(5, some)]))) == [
        *printed,
        "FAIL: 2 of 3 evaluated gates pass.",
    ]
    idle = [gate("pulls", "g", None), gate("purity", "all", None)]
    *lines, names, last = verdict.lines(verdict.verdict_of_results([result(5, some + idle)]))
    assert lines == printed and names == "not evaluated: pulls, purity"
    assert last.startswith("FAIL: 2 of 3 evaluated gates pass; 2 could not be evaluated (")
