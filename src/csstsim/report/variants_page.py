"""The page of a campaign's variants: gates side by side, and each variant's measurements minus those of the base."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.measure.bricks.validation import verdict as verdicts
from csstsim.measure.bricks.validation.twins import CLIP, QUANTITIES, SNR_COUNTED, summary
from csstsim.report.parts import Figure, Pairs, Paragraph, Section, Table, Verdict, fill
from csstsim.report.pictures import chart
from csstsim.report.twin_figure import twin_figure

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path
    from typing import Any

    from csstsim.report.parts import Part

ABOUT = (
    "Variant minus base, for the same objects, matched by their number in the truth. Objects that only one of the two "
    f"has are in the counts alone. The counts are of sources of S/N above {SNR_COUNTED:g}. The differences are of all "
    "matched sources, fainter ones too. Saturated sources give no magnitude and no position, blends no shape. The mean "
    f"is of all n objects, with its error. Far are those beyond {CLIP:g} robust sigmas of the median. The mean of the "
    "others is next to it. If most objects hardly differ, the far ones are the effect itself: read the mean of all. If "
    "all scatter by noise, the far ones are mostly mismatches: read the mean without them."
)
GATES = (
    "A gate counts once for each brick and band: of several exposures the worst counts. In brackets is the part "
    "that it takes of what is allowed: the threshold and an allowance for chance. Above 1 the gate fails."
)


class Study(NamedTuple):
    """A variant's name, {key: value} of what it changes, differences of objects (validation.twins), and its counts."""

    name: str
    keys: dict[str, Any]
    objects: list[dict[str, Any]]
    counts: dict[str, dict[str, int]]


def write_variants(path: Path, name: str, verdicts_of: Mapping[str, dict[str, Any]], studies: Iterable[Study]) -> None:
    """Write the page. verdicts_of: {"base" or a variant: its verdict (validation.verdict)}; studies: [Study]."""
    passed = [verdict["passed"] for verdict in verdicts_of.values()]
    whole = False if False in passed else True if True in passed else None
    headlines = " ".join(f"{one}: {verdicts.headline(verdict)}" for one, verdict in verdicts_of.items())
    sections = [
        Section("gates", "Gates side by side", _gates(verdicts_of)),
        *(Section(f"variant-{study.name}", study.name, _study(study)) for study in studies),
    ]
    html = fill(
        "page.html",
        name=f"{name}: variants",
        failing=[],
        sections=sections,
        headline=Paragraph(headlines, f"verdict {Verdict(whole).style}"),
    )
    with atomic_path(path) as temporary:
        temporary.write_text(html, encoding="utf-8")


def _of_rows(verdict: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return a verdict's gates, one for each row of the page's table: the worst of those of its exposures."""
    by_row: dict[_Row, list[dict[str, Any]]] = {}
    for gate in verdict["gates"]:
        by_row.setdefault(_row(gate), []).append(gate)
    return [max(row, key=lambda gate: -1.0 if gate["margin"] is None else gate["margin"]) for row in by_row.values()]


class _Row(NamedTuple):
    """What a row of the table is of."""

    gate: str
    band: str
    brick: int | None


def _row(gate: Mapping[str, Any]) -> _Row:
    return _Row(gate["name"], gate.get("band") or "", gate.get("brick"))


def _gates(verdicts_of: Mapping[str, Mapping[str, Any]]) -> list[Table | Paragraph]:
    """Return a table of the numbers of gates by verdict and campaign, and one of the values of each gate."""
    count = {one: verdict["counts"] for one, verdict in verdicts_of.items()}
    names = list(next(iter(count.values())))
    counts = Table(("campaign", *names), [(one, *(numbers[name] for name in names)) for one, numbers in count.items()])
    by_row: dict[_Row, dict[str, dict[str, Any]]] = {}
    for one, verdict in verdicts_of.items():
        for gate in _of_rows(verdict):
            by_row.setdefault(_row(gate), {})[one] = gate
    rows = [
        (*row, _thresholds(gates.values()), *(_value(gates.get(one)) for one in verdicts_of))
        for row, gates in by_row.items()
        if any(gate["passed"] is not None for gate in gates.values())
    ]
    return [counts, Paragraph(GATES), Table(("gate", "band", "brick", "threshold", *verdicts_of), rows, "gates")]


def _thresholds(gates: Iterable[Mapping[str, Any]]) -> str:
    """Return the threshold of a row's gates; several if the variants have their own."""
    return " / ".join(dict.fromkeys(_figure(gate["threshold"]) for gate in gates if gate["threshold"] is not None))


def _value(gate: Mapping[str, Any] | None) -> str:
    """Return a gate's value and margin, a word if it fails; "-" if it is not evaluated, "" if there is no such gate."""
    if gate is None:
        return ""
    if gate["passed"] is None:
        return "-"
    shown = f"{_figure(gate['value'])} ({gate['margin']:.2f})"
    return shown if gate["passed"] else f"{shown} FAIL"


def _figure(value: float | str) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else str(value)


def _known(value: float, form: str) -> str:
    """Return a number in a form; "-" for NaN, the mean of too few objects."""
    return "-" if np.isnan(value) else format(value, form)


def _study(study: Study) -> list[Part]:
    rows = [
        (kind, QUANTITIES[name][0], one.n, one.changed, _known(one.mean, "+.3g"), _known(one.error, ".2g"),
         f"{one.mean / one.error:+.1f}" if one.error > 0 else "0" if one.mean == 0 else "", _known(one.scatter, ".2g"),
         one.outliers, _known(one.clipped_mean, "+.3g"), _known(one.clipped_error, ".2g"))
        for kind, name, one in summary(study.objects)
    ]  # fmt: skip
    first = study.counts["base"]
    second = study.counts["variant"]
    head = (
        "objects", "quantity", "n", "of these differ", "mean of variant - base", "error", "in errors", "scatter", "far",
        "mean without far", "its error",
    )  # fmt: skip
    counts = [(_COUNTS[name], first[name], second[name], second[name] - first[name]) for name in first]
    figure = twin_figure(study.objects)
    return [
        Pairs(study.keys),
        Table(("sources", "base", "variant", "variant - base"), counts),
        Paragraph(ABOUT),
        Table(head, rows),
        *([Figure(chart(figure), f"{study.name}: variant minus base, by magnitude")] if figure else []),
    ]


_COUNTS = {
    "sources": f"all of S/N above {SNR_COUNTED:g}",
    "matched": f"of a true object, S/N above {SNR_COUNTED:g}",
    "other": f"of no object well inside the frame, S/N above {SNR_COUNTED:g}",
}
