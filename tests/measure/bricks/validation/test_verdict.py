"""The verdict on hand-made gates: order, counts, every line that is printed, the file."""

import json

import numpy as np
import pytest

from csstsim.measure.bricks.validation.gates.record import MIN_SOURCES
from csstsim.measure.bricks.validation.verdict import (
    NO_BIN,
    NO_THRESHOLD,
    TOO_FEW,
    headline,
    lines,
    never_evaluated,
    reason_not_evaluated,
    sentence,
    verdict_of_gates,
    verdict_of_results,
    write_verdict,
)


def gate(name, passed, band="r", value=0.5, threshold=0.1, n=50, **where):
    return {"name": name, "band": band, "value": value, "threshold": threshold, "n": n, "passed": passed} | where


def results():
    """Two bricks: of six gates two pass, two fail, two are not evaluated."""
    first = [gate("depth", True), gate("noise", None, n=3), gate("bias", False, value=-0.25, exposure="7", chip=9)]
    second = [gate("noise", False, value=12345.678, channel=16), gate("depth", True, band="all")]
    return [{"brick": 5, "gates": first}, {"brick": 2, "gates": second}], [gate("width", None, threshold=None)]


def test_failing_gates_come_first_then_those_not_evaluated_each_in_its_order():
    verdict = verdict_of_results(*results())
    named = [(one["brick"], one["name"], one["passed"]) for one in verdict["gates"]]
    assert named == [
        (5, "bias", False), (2, "noise", False), (5, "noise", None), (None, "width", None), (5, "depth", True),
        (2, "depth", True),
    ]  # fmt: skip
    assert verdict["counts"] == {"pass": 2, "fail": 2, "not evaluated": 2} and verdict["passed"] is False


@pytest.mark.parametrize(
    ("passed", "verdict"), [([True, None], True), ([None, False], False), ([True, False], False), ([None], None)]
)
def test_one_failing_gate_fails_all_and_none_evaluated_is_no_verdict(passed, verdict):
    assert verdict_of_gates([gate("a", one) for one in passed])["passed"] is verdict
    assert verdict_of_gates([])["passed"] is None


def test_the_lines_that_are_printed():
    verdict = verdict_of_results(*results())
    verdict["gates"].append(gate("noise", False, brick=3))  # two of noise fail: it is named before the bias
    assert list(lines(verdict)) == [
        "FAIL brick 5, exposure 7, chip 9: bias in r is -0.25 against 0.1",
        "FAIL brick 2, channel 16: noise in r is 1.235e+04 against 0.1",
        "FAIL brick 3: noise in r is 0.5 against 0.1",
        "FAIL noise: 0 pass, 2 fail, 1 not evaluated",
        "FAIL bias: 0 pass, 1 fail, 0 not evaluated",
        "pass depth: 2 pass, 0 fail, 0 not evaluated",
        "not evaluated: width",
        f"FAIL: 2 of 4 evaluated gates pass; 2 could not be evaluated ({TOO_FEW}; {NO_THRESHOLD}).",
    ]


def test_headlines():
    assert headline(verdict_of_gates([gate("a", True), gate("b", True)])) == "PASS: 2 of 2 evaluated gates pass."
    assert (
        headline(verdict_of_gates([gate("a", None)]))
        == "No gate could be evaluated: too few sources, or no thresholds."
    )


def test_a_sentence_names_only_what_is_known():
    one = gate("width", False, band=None, value=1, threshold="0.9 to 1.2", brick=None, exposure=None, chip=0)
    assert sentence(one) == "chip 0: width is 1 against 0.9 to 1.2"


@pytest.mark.parametrize(
    ("threshold", "n", "why"),
    [
        (None, 3, NO_THRESHOLD),
        (0.1, MIN_SOURCES - 1, TOO_FEW),
        (0.1, 0, TOO_FEW),
        (0.1, MIN_SOURCES, NO_BIN),
        (0.1, None, NO_BIN),
    ],
)
def test_why_a_gate_was_not_evaluated(threshold, n, why):
    assert reason_not_evaluated(gate("a", None, threshold=threshold, n=n)) == why


def test_gates_evaluated_nowhere_have_the_most_objects_that_one_had():
    gates = [
        gate("a", None, n=3), gate("a", None, n=11), gate("a", None, n=7), gate("a", None, band="g", n=None),
        gate("b", None, n=2), gate("b", True), gate("b", None, band="g", n=2), gate("c", None, band=None, n=30),
    ]  # fmt: skip
    assert never_evaluated(gates) == {
        ("a", TOO_FEW): {"r": 11}, ("a", NO_BIN): {"g": 0}, ("b", TOO_FEW): {"g": 2}, ("c", NO_BIN): {"None": 30},
    }  # fmt: skip


def test_the_file_is_json_without_infinities(tmp_path):
    verdict = verdict_of_gates([gate("a", False, value=np.inf, threshold=0.25), gate("b", None, value=np.nan, n=4)])
    write_verdict(tmp_path / "verdict.json", verdict, name="mini", version="1")
    found = json.loads((tmp_path / "verdict.json").read_text())
    assert list(found) == ["name", "version", "passed", "counts", "gates"] and found["name"] == "mini"
    assert found["passed"] is False and found["counts"] == {"pass": 0, "fail": 1, "not evaluated": 1}
    assert [(one["name"], one["value"], one["threshold"], one["n"]) for one in found["gates"]] == [
        ("a", None, 0.25, 50), ("b", None, 0.1, 4),
    ]  # fmt: skip
