"""The report of a campaign: one self-contained HTML page with embedded figures, style and script."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.plural import number_of
from csstsim.bricks.validation import verdict as verdicts
from csstsim.report.band_table import KRON, band_numbers, band_table
from csstsim.report.parts import Details, Figure, Link, Pairs, Paragraph, Section, Table, Verdict, fill, mappings

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path
    from typing import Any

    from csstsim.report.mosaic import FocalPlane
    from csstsim.report.parts import Part

NAMED = 10  # failing gates named at the top
UNFOLDED = 4  # brick sections shown open
SKY = "Windows by filter, the NSIDE-256 bricks they touch, and the pointings"
GATE = {"name": "gate", "band": "band", "value": "value", "threshold": "threshold", "n": "sources"}


def write_report(
    path: Path,
    summary: Mapping[str, Any],
    results: Sequence[dict[str, Any]],
    *,
    sky: Iterable[Part] = (),
    exposures: Iterable[Mapping[str, Any]] = (),
    products: Iterable[tuple[str, int, str, tuple[Link, ...]]] = (),
    figures: Mapping[int, bytes] | None = None,
    sky_map: bytes | None = None,
    mosaic: FocalPlane | None = None,
    spectra: Sequence[tuple[str, bytes | None, *tuple[Link, ...]]] = (),
    stray_light: Iterable[Part] = (),
    gates: Sequence[dict[str, Any]] | None = None,
    links: Mapping[int, tuple[Link, ...]] | None = None,
    provenance: Mapping[str, Any] | None = None,
    layers: Iterable[tuple[str, str, str]] = (),
    times: Iterable[Mapping[str, Any]] = (),
    labels: Mapping[str, str] | None = None,
) -> None:
    """Write the report to `path`; all text is escaped.

    summary      {label: value} of the campaign; key 'name' is the title
    sky          parts shown first: pictures of the sky and of objects
    results      list of validate_brick results (JSON-like)
    gates        all gates with their bricks, as in the verdict; None: those of the results
    exposures    list of mappings: one row each; values may be parts.Link or tuples of them
    products     list of (kind of product, number of files, their size, tuple of parts.Link)
    figures      {brick: PNG bytes}; sky_map: PNG bytes
    mosaic       the focal plane (report.mosaic)
    stray_light  parts on the sky of each exposure
    spectra      list of (title, PNG bytes or None, *Links) of spectroscopic frames
    links        {brick: (Link, ...)}: its files
    provenance   {label: value}: version, date, host, hashes, seed
    layers       list of (exposure type, layer, its parameters)
    labels       {band: its name as the camera writes it}
    times        list of mappings (step, jobs, wall s, CPU s, ...): one row each
    """
    from csstsim.base.files.atomic import atomic_path

    name = summary.get("name", "campaign")
    judged = verdicts.judge(results) if gates is None else verdicts.verdict_on(gates)
    results = sorted(results, key=lambda result: -_counts(result)["fail"])  # stable: ties keep their order, by number
    links = links or {}
    labels = labels or {}
    sections = [
        Section("field", "The field", list(sky)),
        Section("summary", "Summary", [Pairs({key: value for key, value in summary.items() if key != "name"})]),
        Section("plane", "Focal plane", [mosaic] if mosaic else []),
        Section("spectra", "Spectra", _spectra(spectra)),
        Section("sky", "Where it lies", _figure(sky_map, SKY)),
        Section("straylight", "Zodiacal and stray light", list(stray_light)),
        Section("gates", "Gates", _gates(judged["gates"], labels)),
        Section("bricks", "Bricks", _brick_table(results, links, labels)),
        Section("validation", "Validation by brick", _bricks(results, figures or {}, links, labels)),
        Section("exposures", "Exposures and Level-0 files", [mappings(exposures, "exposures")]),
        Section("products", "Products", _products(products)),
        Section("times", "Run time by rule", [mappings(times)]),
        Section("provenance", "Provenance", _provenance(provenance or {}, layers)),
    ]
    failing = [gate for gate in judged["gates"] if gate["passed"] is False]
    named = [Link(verdicts.sentence(gate), _where(gate)) for gate in failing[:NAMED]]
    named += [Link(f"and {len(failing) - NAMED} more", "#gates")] if len(failing) > NAMED else []
    html = fill(
        "page.html",
        name=name,
        failing=named,
        sections=[one for one in sections if any(map(_holds, one.body))],
        headline=Paragraph(verdicts.headline(judged), f"verdict {Verdict(judged['passed']).style}"),
    )
    with atomic_path(path) as temporary:
        temporary.write_text(html, encoding="utf-8")


def _products(products: Iterable[tuple[str, int, str, tuple[Link, ...]]]) -> list[Details]:
    """Return a fold of links for each kind of product, with the number of files and their size."""
    return [
        Details(f"{kind}: {count} file{'s' * (count != 1)}, {size}", [Paragraph(links, "links")])
        for kind, count, size, links in products
    ]


def _provenance(values: Mapping[str, Any], layers: Iterable[tuple[str, str, str]]) -> list[Pairs | Details]:
    table = Table(("exposures", "layer", "parameters"), list(layers), "layers")
    return [Pairs(values), *([Details("layers in order, with their parameters", [table])] if layers else [])]


def _holds(part: Part) -> bool:
    """Whether a part has something to show."""
    return bool(part.rows if isinstance(part, Table) else part.values if isinstance(part, Pairs) else True)


def _figure(png: bytes | None, caption: str) -> list[Figure]:
    return [] if png is None else [Figure(png, caption)]


def _gates(gates: Sequence[dict[str, Any]], labels: Mapping[str, str]) -> list[Table | Paragraph]:
    """Return tables of counts by gate, of failing gates, of those that do not apply, and of those that pass.

    Gates may have keys beyond GATE.
    """
    if not gates:
        return []
    keys = dict(GATE) | {key: key for gate in gates for key in gate if key not in ("brick", "passed", *GATE)}
    counts = [(name, *counts.values()) for name, counts in verdicts.by_name(gates).items()]
    rows = [
        (Link(str(gate["brick"] or "-"), _where(gate)), Verdict(gate["passed"]), *(gate.get(key) for key in keys))
        for gate in gates
    ]
    head = ("brick", "verdict", *keys.values())
    passed = [gate["passed"] for gate in gates]
    failing, passing = ([row for row, p in zip(rows, passed, strict=True) if p is word] for word in (False, True))
    idle = [
        (name, ", ".join(f"{labels.get(band, band)} {n}" for band, n in bands.items()), why)
        for (name, why), bands in verdicts.without_judgement(gates).items()
    ]
    return [
        Table(("gate", *verdicts.NAMES.values()), counts),
        Table(head, failing, "gates that fail"),
        *([Paragraph("Gates that do not apply to this campaign, and are not judged:")] if idle else []),
        Table(("gate", "bands, and objects in each", "why"), idle, "gates that do not apply"),
        Table(head, passing, "gates that pass"),
    ]


def _where(gate: Mapping[str, Any]) -> str:
    """Return the link to what a gate is of: its brick, or the spectra."""
    return "#spectra" if gate["brick"] is None else f"#brick-{gate['brick']}"


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
            "gates pass / fail / not judged": " / ".join(map(str, counts.values())),
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


def _bricks(
    results: Iterable[dict[str, Any]],
    figures: Mapping[int, bytes],
    links: Mapping[int, tuple[Link, ...]],
    labels: Mapping[str, str],
) -> list[Section]:
    """Return one section per brick; the contents of all but the first UNFOLDED are folded."""
    parts = []
    for place, result in enumerate(results):
        pix = result["brick"]
        body = _brick(result, figures.get(pix), links.get(pix, ()), labels)
        if place >= UNFOLDED:
            body = [Details(verdicts.tally(_counts(result)), body)]
        parts.append(Section(f"brick-{pix}", f"Brick {pix}", body, level=3))
    return parts


def _residual(numbers: Mapping[str, Any]) -> str:
    scatter = "" if numbers["sigma"] is None else f" (scatter {numbers['sigma']:.1f})"
    return f"{numbers['median']:+.1f}{scatter}"


def _brick(
    result: Mapping[str, Any], png: bytes | None, links: tuple[Link, ...], labels: Mapping[str, str]
) -> list[Part]:
    residual = result["astrometry_mas"]
    if residual["east"]["n"]:
        east, north = (_residual(residual[k]) for k in ("east", "north"))
        place = f"Positions out - in: east {east}, north {north} mas from {residual['east']['n']} bright stars."
    else:
        place = "Positions: no bright star to judge by."
    counted = {"sources": "merged source", "truth": "true object", "frames": "frame"}
    sources, truth, frames = (number_of(result[name], word) for name, word in counted.items())
    return [
        Paragraph(f"{sources}; {truth} on {frames}. {place}"),
        Paragraph(links),
        band_table(result, labels),
        Paragraph(KRON),
        *_figure(png, f"Validation of brick {result['brick']}"),
        Details("all numbers by band", [band_numbers(result, labels)]),
    ]


def _spectra(spectra: Sequence[tuple[str, bytes | None, *tuple[Link, ...]]]) -> list[Part]:
    parts: list[Part] = []
    for title, png, *links in spectra:
        parts += [] if png is None else [Figure(png, title), Paragraph(tuple(links))]
    rest = [(title, tuple(links)) for title, png, *links in spectra if png is None]
    return [*parts, Table(("not shown here", "files"), rest, "more")]
