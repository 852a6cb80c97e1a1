"""The gates of a campaign as a matrix: a row for each gate, a column for each band, a cell with its worst result."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from csstsim.base.plural import number_of
from csstsim.measure.bricks.validation import verdict as verdicts
from csstsim.measure.bricks.validation.gates.register import all_gates

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

STEPS = (0.25, 0.5, 0.75, 1.0)  # upper limits of the margin in each colour
FAIL = "\u2715"  # marks, so that the colour is not alone
NOT_EVALUATED = "\u2013"


class Cell(NamedTuple):
    """The worst result of a gate in a band: its CSS class, its text, all of it in words, and the link to it."""

    style: str
    text: str
    title: str
    href: str


class GateMatrix(NamedTuple):
    """A part of the page: `bands` are the columns, `rows` (gate, cells), with None where there is no result.

    about: {gate: what it tests}.
    """

    bands: list[str]
    rows: list[tuple[str, list[Cell | None]]]
    about: dict[str, str]

    @property
    def key(self) -> list[Cell]:
        """One Cell of each kind, whose title says what it means."""
        passing = [
            Cell(f"margin{k}", f"{step:g}", f"passes, margin up to {step:g}", "") for k, step in enumerate(STEPS)
        ]
        return [
            *passing,
            Cell("over", FAIL, "fails, margin above 1", ""),
            Cell("unevaluated", NOT_EVALUATED, "not evaluated", ""),
        ]


def gate_matrix(gates: Sequence[dict[str, Any]], labels: Mapping[str, str]) -> GateMatrix:
    """Return the GateMatrix of gates with their bricks (validation.verdict), those that fail most often first.

    labels: {band: its name as the camera writes it}, in the order of the columns; others follow in order of appearance.
    A colour is in the column of its first band.
    """
    results: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for gate in gates:
        results.setdefault(gate["name"], {}).setdefault(_column(gate), []).append(gate)
    present = dict.fromkeys(column for row in results.values() for column in row)
    columns = [*(band for band in labels if band in present), *(band for band in present if band not in labels)]
    known = all_gates()
    order = {gate.name: number for number, gate in enumerate(known)}
    failing = {name: counts["fail"] for name, counts in verdicts.counts_by_name(gates).items()}
    names = sorted(results, key=lambda name: (-failing[name], order.get(name, len(order))))
    rows = [(name, [_cell(results[name][c]) if c in results[name] else None for c in columns]) for name in names]
    about = {gate.name: gate.tests for gate in known if gate.name in results}
    return GateMatrix([labels.get(column, column) for column in columns], rows, about)


def where(gate: Mapping[str, Any]) -> str:
    """Return the link to what a gate is of: its brick, or the spectra."""
    return "#spectra" if gate["brick"] is None else f"#brick-{gate['brick']}"


def margin_of(gate: Mapping[str, Any]) -> float:
    """Return the margin of a gate, for an order: negative if it was not evaluated."""
    if gate["passed"] is None:
        return -1.0
    margin = gate.get("margin")
    return float(not gate["passed"]) if margin is None else margin


def _column(gate: Mapping[str, Any]) -> str:
    return str(gate.get("band") or "").split(" - ")[0]


def _cell(results: Sequence[dict[str, Any]]) -> Cell:
    """Return the cell of the results of a gate in a band: of several bricks and exposures the worst."""
    worst = max(results, key=margin_of)
    margin = worst.get("margin")
    number = "" if margin is None else f"{margin:.2f}" if margin < 9.995 else f"{margin:.0f}"
    title = f"{verdicts.sentence(worst)}, "
    if worst["passed"] is None:
        title += f"not evaluated: {verdicts.reason_not_evaluated(worst)}"
        style, text = "unevaluated", NOT_EVALUATED
    else:
        title += f"margin {number or 'not known'}"
        passed = worst["passed"]
        step = next((k for k, limit in enumerate(STEPS) if (margin or 0.0) <= limit), len(STEPS) - 1)
        style, text = (f"margin{step}", number or "pass") if passed else ("over", f"{FAIL} {number}".strip())
    if worst.get("n") is not None:
        title += f"; {number_of(worst['n'], 'source')}"
    if len(results) > 1:
        title += f"; {verdicts.tally(verdicts.count(results))}"
    return Cell(style, text, title, where(worst))
