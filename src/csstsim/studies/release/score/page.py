"""The page of a score: one self-contained HTML file of numbers and figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

from csstsim.base.files.atomic import atomic_path
from csstsim.report.parts import Figure, Paragraph, Section, Table, fill, mappings
from csstsim.report.pictures import chart
from csstsim.studies.release.score.figures import figures
from csstsim.studies.release.score.statistics import SNR_BRIGHT

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path
    from typing import Any


def write_page(path: Path, result: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write the page of a result (score.evaluate) and its arrays; all text is escaped."""
    html = fill("score.html", title=_title(result), sections=list(_sections(result, arrays)))
    with atomic_path(path) as temporary:
        temporary.write_text(html, encoding="utf-8")


def _title(result: Mapping[str, Any]) -> str:
    return f"{result['catalogue']} against the truth of {result['pack']}"


def _sections(result: Mapping[str, Any], arrays: Mapping[str, Any]) -> Iterator[Section]:
    counts = f"{result['sources']} sources, {result['objects']} true objects in the frames"
    matching = (
        f"Objects and sources are matched by position within {result['radius_arcsec']:g} arcsec, or half a "
        "galaxy's radius"
    )
    matching += f", and by magnitude in {result['band']}." if result["band"] else "."
    notes = [Paragraph(note) for note in result["notes"]]
    yield Section("summary", "Summary", [Paragraph(f"{counts}. {matching}"), *_headline(result), *notes])
    for figure in figures(result, arrays):
        name = figure.title.lower().replace(" ", "-")
        yield Section(name, figure.title, [Figure(chart(figure.png), figure.caption), *_tables(figure.title, result)])


def _headline(result: Mapping[str, Any]) -> list[Table]:
    kinds = result["completeness"]
    half = result["half_found"]
    pure = result["purity"]
    rows = [
        {
            "objects": name,
            f"of S/N above {SNR_BRIGHT:g}": row["n"],
            "completeness": row["completeness"],
            "68% from": row["low"],
            "to": row["high"],
            "merged": row["merged"],
            "lost": row["lost"],
            "half found at [mag]": half[name],
        }
        for name, row in kinds.items()
    ]
    purity = {
        "purity": pure["purity"],
        "real by chance": pure["chance"],
        "purity without chance": pure["corrected"],
        "second sources": pure["second"],
    }
    return [mappings([_cells(row) for row in rows], "objects"), mappings([_cells(purity)])]


def _tables(title: str, result: Mapping[str, Any]) -> list[Table]:
    """Return the tables under a figure."""
    if title.startswith("Photometry"):
        kinds = result["photometry"][title.rpartition(" ")[2]]
        return [mappings([{"objects": kind, "unit": "mag"} | _cells(row) for kind, row in kinds.items()])]
    if title == "Positions":
        rows = [
            {"objects": kind, "axis": axis, "unit": "mas"} | _cells(row)
            for kind, axes in result["astrometry_mas"].items()
            for axis, row in axes.items()
        ]
        return [mappings(rows)]
    if title == "Shapes":
        return [mappings([{"axis": axis} | _cells(row) for axis, row in result["shapes"].items()])]
    if title == "Redshifts":
        return [Table(tuple(result["redshifts"]), [tuple(_cells(result["redshifts"]).values())])]
    return []


def _cells(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the cells of a row: NaN becomes None, which is shown as a dash."""
    return {
        key.replace("_", " "): None if isinstance(value, float) and value != value else value
        for key, value in row.items()
    }
