"""The page of a campaign's variants: gates side by side, and each variant's measurements less those of the base."""

from typing import NamedTuple

from csstsim.base.files.atomic import atomic_path
from csstsim.bricks.validation import verdict as verdicts
from csstsim.bricks.validation.twins import CLIP, QUANTITIES, REAL, summary
from csstsim.report.parts import Figure, Pairs, Paragraph, Section, Table, Verdict, fill
from csstsim.report.twin_figure import twin_figure

ABOUT = (
    "Variant less base, of the same objects, matched by their number in the truth. Objects that only one of the two "
    f"has are in the counts alone. Errors are those of the mean; values beyond {CLIP:g} robust sigmas are counted as "
    "outliers and not averaged. Saturated sources give no magnitude and no place, blends no shape."
)


class Study(NamedTuple):
    """A variant's name, {key: value} of what it changes, differences of objects (validation.twins), and its counts."""

    name: str
    keys: dict
    objects: list
    counts: dict


def write_variants(path, name, verdicts_of, studies):
    """Write the page. verdicts_of: {"base" or a variant: its verdict (validation.verdict.judge)}; studies: [Study]."""
    passed = [verdict["passed"] for verdict in verdicts_of.values()]
    whole = False if False in passed else True if True in passed else None
    said = "; ".join(f"{one}: {verdicts.headline(verdict)}" for one, verdict in verdicts_of.items())
    sections = [
        Section("gates", "Gates side by side", _gates(verdicts_of)),
        *(Section(f"variant-{study.name}", study.name, _study(study)) for study in studies),
    ]
    html = fill(
        "page.html", name=f"{name}: variants", failing=[], sections=sections,
        headline=Paragraph(said, f"verdict {Verdict(whole).style}"),
    )  # fmt: skip
    with atomic_path(path) as temporary:
        temporary.write_text(html, encoding="utf-8")


def _gates(verdicts_of):
    """Return a table of gates that pass, fail and are not judged, by campaign, and one of the values of each gate."""
    count = {one: verdicts.count(verdict["gates"]) for one, verdict in verdicts_of.items()}
    names = list(next(iter(count.values())))
    counts = Table(("campaign", *names), [(one, *(held[name] for name in names)) for one, held in count.items()])
    held = {}
    for one, verdict in verdicts_of.items():
        for gate in verdict["gates"]:
            held.setdefault((gate["name"], gate.get("band") or "", gate.get("brick")), {})[one] = gate
    rows = [(*key, *(_value(gates.get(one)) for one in verdicts_of)) for key, gates in held.items()]
    judged = [row for row in rows if any(cell not in ("", "-") for cell in row[3:])]
    return [counts, Table(("gate", "band", "brick", *verdicts_of), judged, "gates")]


def _value(gate):
    """Return a gate's value with a word if it fails; "-" if it is not judged, "" if a campaign has no such gate."""
    if gate is None:
        return ""
    if gate["passed"] is None:
        return "-"
    value = gate.get("value")
    shown = f"{value:.4g}" if isinstance(value, int | float) else str(value)
    return shown if gate["passed"] else f"{shown} FAIL"


def _study(study):
    rows = [
        (kind, QUANTITIES[name][0], one.n, one.outliers, f"{one.mean:+.3g}", f"{one.error:.2g}", f"{one.scatter:.2g}",
         f"{one.mean / one.error:+.1f}" if one.error > 0 else "0" if one.mean == 0 else "")
        for kind, name, one in summary(study.objects)
    ]  # fmt: skip
    first, second = study.counts["base"], study.counts["variant"]
    head = "objects", "quantity", "n", "outliers", "variant - base", "error", "scatter", "in errors"
    counts = [(_COUNTS[name], first[name], second[name], second[name] - first[name]) for name in first]
    figure = twin_figure(study.objects)
    return [
        Pairs(study.keys), Table(("sources", "base", "variant", "variant - base"), counts), Paragraph(ABOUT),
        Table(head, rows), *([Figure(figure, f"{study.name}: variant less base, by magnitude")] if figure else []),
    ]  # fmt: skip


_COUNTS = {
    "sources": f"all of S/N above {REAL:g}",
    "matched": "of a true object",
    "other": "of no object well inside the frame",
}
