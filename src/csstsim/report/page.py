"""The report of a campaign: one self-contained HTML page with embedded figures, style and script."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from csstsim.base.plural import number_of
from csstsim.measure.bricks.validation import verdict as verdicts
from csstsim.report.band_table import KRON, band_numbers, band_table
from csstsim.report.gate_matrix import gate_matrix, margin_of, where
from csstsim.report.parts import Details, Figure, Link, Pairs, Paragraph, Section, Table, Verdict, fill, mappings

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path
    from typing import Any

    from csstsim.report.gate_matrix import GateMatrix
    from csstsim.report.mosaic import FocalPlane
    from csstsim.report.parts import Part

NAMED = 10  # failing gates named at the top
UNFOLDED = 4  # brick sections shown open
SKY = "Windows by filter, bricks (HEALPix, NSIDE 256) and pointings. North is up, east to the left"
GATE = {"name": "gate", "band": "band", "value": "value", "threshold": "threshold", "n": "sources"}


class KindOfFiles(NamedTuple):
    """Files of one kind of product: how many there are, their size as text, and links to them."""

    kind: str
    number: int
    size: str
    links: tuple[Link, ...]


class FrameSpectra(NamedTuple):
    """Spectra of one spectroscopic frame: title, figure (or None if it is not shown), links to files."""

    title: str
    figure: bytes | None
    links: tuple[Link, ...]


@dataclass(frozen=True, kw_only=True)
class ReportContent:
    """What a report shows besides the summary and the results of its bricks; what is left out is not shown."""

    sky: Iterable[Part] = ()  # shown first: pictures of the sky and of objects
    mosaic: FocalPlane | None = None
    spectra: Sequence[FrameSpectra] = ()
    sky_map: bytes | None = None
    stray_light: Iterable[Part] = ()  # on the sky of each exposure
    gates: Sequence[dict[str, Any]] | None = None  # all, with their bricks, as in the verdict; None: of the results
    figures: Mapping[int, bytes] = field(default_factory=dict)  # {brick: picture}
    links: Mapping[int, tuple[Link, ...]] = field(default_factory=dict)  # {brick: its files}
    exposures: Iterable[Mapping[str, Any]] = ()  # one row each; values may be parts.Link or tuples of them
    products: Iterable[KindOfFiles] = ()
    times: Iterable[Mapping[str, Any]] = ()  # one row each: step, jobs, wall s, CPU s, ...
    provenance: Mapping[str, Any] = field(default_factory=dict)  # {label: value}: version, date, host, hashes, seed
    layers: Iterable[tuple[str, str, str]] = ()  # exposure type, layer, its parameters
    labels: Mapping[str, str] = field(default_factory=dict)  # {band: its name as the camera writes it}


def write_report(
    path: Path, summary: Mapping[str, Any], results: Sequence[dict[str, Any]], content: ReportContent | None = None
) -> None:
    """Write the report to `path`; all text is escaped.

    summary: {label: value} of the campaign, whose key 'name' is the title; results: of validate_brick (JSON-like).
    """
    from csstsim.base.files.atomic import atomic_path

    content = content or ReportContent()
    labels = content.labels
    name = summary.get("name", "campaign")
    verdict = (
        verdicts.verdict_of_results(results) if content.gates is None else verdicts.verdict_of_gates(content.gates)
    )
    results = sorted(results, key=lambda result: -_counts(result)["fail"])  # stable: ties keep their order, by number
    sections = [
        Section("field", "The field", list(content.sky)),
        Section("summary", "Summary", [Pairs({key: value for key, value in summary.items() if key != "name"})]),
        Section("plane", "Focal plane", [content.mosaic] if content.mosaic else []),
        Section("spectra", "Spectra", _spectra(content.spectra)),
        Section("sky", "Sky map", _figure(content.sky_map, SKY)),
        Section("straylight", "Zodiacal and stray light", list(content.stray_light)),
        Section("gates", "Gates", _gates(verdict["gates"], labels)),
        Section("bricks", "Bricks", _brick_table(results, content.links, labels)),
        Section("validation", "Validation by brick", _bricks(results, content)),
        Section("exposures", "Exposures and Level-0 files", [mappings(content.exposures, "exposures")]),
        Section("products", "Products", _products(content.products)),
        Section("times", "Run time by rule", [mappings(content.times)]),
        Section("provenance", "Provenance", _provenance(content.provenance, content.layers)),
    ]
    failing = [gate for gate in verdict["gates"] if gate["passed"] is False]
    named = [_named(gate) for gate in failing[:NAMED]]
    named += [Link(f"and {len(failing) - NAMED} more", "#gates")] if len(failing) > NAMED else []
    html = fill(
        "page.html",
        name=name,
        failing=named,
        sections=[one for one in sections if any(map(_holds, one.body))],
        headline=Paragraph(verdicts.headline(verdict), f"verdict {Verdict(verdict['passed']).style}"),
    )
    with atomic_path(path) as temporary:
        temporary.write_text(html, encoding="utf-8")


def _products(products: Iterable[KindOfFiles]) -> list[Details]:
    """Return Details of links for each kind of product, with the number of files and their size."""
    return [
        Details(f"{one.kind}: {number_of(one.number, 'file')}, {one.size}", [Paragraph(one.links, "links")])
        for one in products
    ]


def _provenance(values: Mapping[str, Any], layers: Iterable[tuple[str, str, str]]) -> list[Pairs | Details]:
    table = Table(("exposures", "layer", "parameters"), list(layers), "layers")
    return [Pairs(values), *([Details("layers in order, with their parameters", [table])] if layers else [])]


def _holds(part: Part) -> bool:
    """Whether a part has something to show."""
    return bool(part.rows if isinstance(part, Table) else part.values if isinstance(part, Pairs) else True)


def _figure(image: bytes | None, caption: str) -> list[Figure]:
    return [] if image is None else [Figure(image, caption)]


def _gates(gates: Sequence[dict[str, Any]], labels: Mapping[str, str]) -> list[Paragraph | GateMatrix | Table]:
    """Return the matrix, tables of failing gates, of those that do not apply, and of those that pass.

    Gates may have keys beyond GATE.
    """
    if not gates:
        return []
    keys = dict(GATE) | {key: key for gate in gates for key in gate if key not in ("brick", "passed", *GATE)}
    rows = [
        (Link(str(gate["brick"] or "-"), where(gate)), Verdict(gate["passed"]), *(gate.get(key) for key in keys))
        for gate in gates
    ]
    head = ("brick", "verdict", *keys.values())
    passed = [gate["passed"] for gate in gates]
    failing, passing = ([row for row, p in zip(rows, passed, strict=True) if p is word] for word in (False, True))
    idle = [
        (name, ", ".join(f"{labels.get(band, band)} {n}" for band, n in bands.items()), why)
        for (name, why), bands in verdicts.never_evaluated(gates).items()
    ]
    return [
        *_closest(gates),
        gate_matrix(gates, labels),
        Table(head, failing, "gates that fail"),
        *([Paragraph("Gates that could not be evaluated in this campaign, and why:")] if idle else []),
        Table(("gate", "bands, and objects in each", "why"), idle, "gates that could not be evaluated"),
        Table(head, passing, "gates that pass"),
    ]


def _closest(gates: Sequence[dict[str, Any]]) -> list[Paragraph]:
    """Return a line on the gate that is closest to failing, if none fails."""
    closest = max(gates, key=margin_of)
    if not closest["passed"] or closest.get("margin") is None:
        return []
    return [Paragraph((f"Closest to failing: margin {closest['margin']:.2f},", _named(closest)))]


def _named(gate: Mapping[str, Any]) -> Link:
    return Link(verdicts.sentence(gate), where(gate))


def _counts(result: Mapping[str, Any]) -> dict[str, int]:
    return verdicts.count(result["gates"])


def _brick_table(
    results: Sequence[dict[str, Any]], links: Mapping[int, tuple[Link, ...]], labels: Mapping[str, str]
) -> list[Part]:
    """Return the table of bricks, one row each, failing ones first."""
    bands = list(dict.fromkeys(band for result in results for band in result["bands"]))
    rows = []
    for result in results:
        counts = _counts(result)
        pix = result["brick"]
        row = {
            "brick": Link(str(pix), f"#brick-{pix}"),
            "verdict": Verdict(False if counts["fail"] else True if counts["pass"] else None),
            "gates pass / fail / not evaluated": " / ".join(map(str, counts.values())),
            "frames": result["frames"],
            "sources": result["sources"],
            "true objects": result["truth"],
            "purity": result["purity"],
        }
        for band in bands:
            row[labels.get(band, band)] = result["bands"].get(band, {}).get("completeness")
        rows.append(row | ({"files": links[pix]} if pix in links else {}))
    note = Paragraph("The column of a band gives the completeness of point sources in that band.")
    return [note, mappings(rows, "bricks")] if rows else []


def _bricks(results: Iterable[dict[str, Any]], content: ReportContent) -> list[Section]:
    """Return one section per brick; the contents of all but the first UNFOLDED are folded."""
    parts = []
    for number, result in enumerate(results):
        pix = result["brick"]
        body = _brick(result, content.figures.get(pix), content.links.get(pix, ()), content.labels)
        if number >= UNFOLDED:
            body = [Details(verdicts.tally(_counts(result)), body)]
        parts.append(Section(f"brick-{pix}", f"Brick {pix}", body, level=3))
    return parts


def _residual(numbers: Mapping[str, Any]) -> str:
    scatter = "" if numbers["sigma"] is None else f" (scatter {numbers['sigma']:.1f})"
    return f"{numbers['median']:+.1f}{scatter}"


def _brick(
    result: Mapping[str, Any], figure: bytes | None, links: tuple[Link, ...], labels: Mapping[str, str]
) -> list[Part]:
    residual = result["astrometry_mas"]
    if residual["east"]["n"]:
        east, north = (_residual(residual[k]) for k in ("east", "north"))
        positions = f"Positions out - in: east {east}, north {north} mas from {residual['east']['n']} bright stars."
    else:
        positions = "Positions out - in: not measured, no bright star."
    counted = {"sources": "merged source", "truth": "true object", "frames": "frame"}
    sources, truth, frames = (number_of(result[name], word) for name, word in counted.items())
    return [
        Paragraph(f"{sources}; {truth} on {frames}. {positions}"),
        Paragraph(links),
        band_table(result, labels),
        Paragraph(KRON),
        *_figure(figure, f"Validation of brick {result['brick']}"),
        Details("all numbers by band", [band_numbers(result, labels)]),
    ]


def _spectra(spectra: Sequence[FrameSpectra]) -> list[Part]:
    """Return the figures with their links, and a table of links to those that are not shown."""
    parts: list[Part] = []
    for one in spectra:
        parts += [] if one.figure is None else [Figure(one.figure, one.title), Paragraph(one.links)]
    rest = [(one.title, one.links) for one in spectra if one.figure is None]
    return [*parts, Table(("not shown here", "files"), rest, "more")]
