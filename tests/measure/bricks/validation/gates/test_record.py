"""The gates' comparisons, by hand: the sign of the tolerance, errors, margins, and which of several values counts."""

from types import SimpleNamespace

import numpy as np
import pytest
from measure.bricks.gate_results import at_least, at_most, between, fraction_at_most

from csstsim.measure.bricks.validation.gates.record import (
    MAX_MARGIN,
    MIN_SOURCES,
    SIGMAS,
    SIGMAS_OF_MANY,
    AtMost,
    Measured,
)


@pytest.mark.parametrize(
    ("gate", "value", "passed"),
    [
        (at_most, 0.02, True), (at_most, -0.02, True), (at_most, 0.021, False), (at_most, -0.021, False),
        (at_least, 0.95, True), (at_least, 0.95 - SIGMAS * np.sqrt(0.95 * 0.05 / 100) + 1e-9, True),
        (at_least, 0.95 - SIGMAS * np.sqrt(0.95 * 0.05 / 100) - 1e-9, False), (at_least, 1.0, True),
    ],
)  # fmt: skip
def test_a_number_is_tested_on_both_sides_and_chance_is_allowed(gate, value, passed):
    threshold = 0.02 if gate is at_most else 0.95
    assert gate("a gate", "r", value, threshold, 100)["passed"] is passed
    assert gate("a gate", "r", value, threshold, MIN_SOURCES - 1)["passed"] is None
    assert gate("a gate", "r", None, threshold, 100)["passed"] is None


def test_a_width_is_tested_at_both_ends():
    chance = SIGMAS_OF_MANY * 1.17 / 10
    for width, passed in ((0.9 * (1 - chance) + 1e-9, True), (0.9 * (1 - chance) - 1e-9, False),
                          (1.2 * (1 + chance) - 1e-9, True), (1.2 * (1 + chance) + 1e-9, False)):  # fmt: skip
        assert between("a width", "r", width, (0.9, 1.2), 100)["passed"] is passed


def test_results_state_their_error_and_threshold():
    assert at_most("a", "r", -0.03, 0.1, 50, 0.03)["error"] == 0.03
    assert at_most("a", "r", -0.03, 0.1, 50, 0.015, SIGMAS_OF_MANY, chip=9)["error"] == 0.015
    assert at_most("a", "r", 0.0, 0.1, None)["margin"] == 0.0
    assert at_most("a", "r", 0.05, 0.1, MIN_SOURCES)["passed"] is True
    assert at_most("a", "r", 0.1, None, 50)["passed"] is None
    fraction = at_least("a", "r", 0.8, 0.9, 100, exposure="1")
    assert fraction["error"] == pytest.approx(0.04) and fraction["exposure"] == "1"
    # 0.2 missing of 0.1 and two errors of sqrt(0.9 x 0.1 / 100)
    assert fraction["margin"] == pytest.approx(0.2 / 0.16)
    assert at_least("a", "r", 1.0, 0.9, 100)["error"] == pytest.approx(0.01)
    width = between("a", "r", 2.0, (0.9, 1.25), 100)
    assert width["threshold"] == "0.9 to 1.25" and width["error"] == pytest.approx(2 * 1.17 / 10)
    assert width["margin"] == pytest.approx(2.0 / (1.25 * (1 + SIGMAS_OF_MANY * 0.117)))
    assert between("a", "r", 1.0, None, 100)["passed"] is None


def test_margins():
    assert at_most("a", "r", -0.3, 0.1, 50, 0.025)["margin"] == pytest.approx(2.0)
    assert at_least("a", "r", 0.8, 0.9, 10**8)["margin"] == pytest.approx(2.0, abs=2e-3)
    assert between("a", "r", 2.4, (0.9, 1.2), 10**8)["margin"] == pytest.approx(2.0, abs=2e-3)
    assert between("a", "r", 0.45, (0.9, 1.2), 10**8)["margin"] == pytest.approx(2.0, abs=2e-3)
    assert at_least("a", "r", 0.9, 1.0, 50)["margin"] == MAX_MARGIN and at_least("a", "r", 1.0, 1.0, 50)["passed"]
    assert at_most("a", "r", 0.3, 0.1, MIN_SOURCES - 1) == {
        "name": "a", "band": "r", "value": 0.3, "threshold": 0.1, "n": MIN_SOURCES - 1, "error": None, "margin": None,
        "passed": None,
    }  # fmt: skip


def test_the_error_of_a_fraction_is_that_at_the_threshold():
    assert fraction_at_most("a", 0.08, 100, 0.04)["margin"] == pytest.approx(0.08 / (0.04 + SIGMAS * 0.02))
    assert fraction_at_most("a", 0.0, 0, 0.04)["passed"] is None
    assert fraction_at_most("a", 0.1, 50, None)["error"] is None


def test_of_several_channels_the_one_closest_to_failing_counts():
    values = [Measured(0.3, None, 0.1, 5), Measured(-0.29, None, 0.01, 6), Measured(0.0)]
    gate = AtMost("a", scope="frame", threshold=0.1, tests="", measure=iter, sigmas=SIGMAS_OF_MANY)
    (result,) = gate.evaluate(values, None, "r", exposure="3", chip=9)
    assert result["channel"] == 6 and result["margin"] == pytest.approx(0.29 / 0.14) and result["error"] == 0.01
    assert (result["exposure"], result["chip"], result["band"], result["n"]) == ("3", 9, "r", None)
    (result,) = gate.evaluate(values[2:], None, "r")
    assert "channel" not in result and gate.evaluate([], None, "r") == []


@pytest.mark.parametrize(("key", "bin_", "threshold"), [
    ("one_max", None, 0.1), ("bins_max", 1, 0.3), ("none_max", None, None), ("none_max", 1, None), (7.0, None, 7.0),
])  # fmt: skip
def test_a_threshold_is_that_of_its_key_or_a_number_of_the_record(key, bin_, threshold):
    thresholds = SimpleNamespace(one_max=0.1, bins_max=(0.2, 0.3), none_max=None)
    gate = AtMost("a", scope="frame", threshold=key, tests="", measure=iter, bin=bin_)
    assert gate.threshold_in(thresholds) == threshold
