"""The page of the budget: one HTML file that contains its figures, and the table as ECSV."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from csstsim.base.files.atomic import atomic_path
from csstsim.studies.budget.shear.printed import PRINTED, of_row
from csstsim.studies.budget.shear.response import NAMES
from csstsim.studies.budget.shear.volume import report

if TYPE_CHECKING:
    from csstsim.studies.budget.shear.plan import ShearPlan

_STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:78em;margin:2em auto;padding:0 1em}img{max-width:100%}"
    "table{border-collapse:collapse;font-size:13px}td,th{padding:.15em .7em;text-align:right}"
    "td:first-child,th:first-child,td:nth-child(2),td:nth-child(3){text-align:left}tr:nth-child(even){background:#f4f4f4}"
)

_HEADS = tuple(f"{name} [{PRINTED[name]:.0e}]" for name in NAMES)


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]], plan: ShearPlan) -> None:
    """Write the rows of bars as an ECSV table, with the plan in its metadata."""
    from astropy.table import Table

    table = Table(rows=rows)
    table.meta["plan"] = plan.model_dump(mode="json")
    with atomic_path(path) as temporary:
        table.write(temporary, format="ascii.ecsv", overwrite=True)


def write_page(path: Path, rows: Sequence[Mapping[str, Any]], plan: ShearPlan, command: str) -> None:
    """Write the page; the figures waterfall_SAMPLE.png and chart_SAMPLE.png are in its folder."""
    parts = [
        "<h1>A budget of shear</h1>",
        f"<p>Made by <code>{html.escape(command)}</code>: arms of shear &plusmn;{plan.shear:g} in each component "
        "that share all noise; rings of four turned galaxies. A bar is the bias with an effect less the bias "
        "without it.</p>",
    ]
    for sample in plan.samples:
        of_sample = [row for row in rows if row["sample"] == sample]
        if not of_sample:
            continue
        parts.append(f"<h2>Sample {html.escape(sample)}</h2>")
        for kind in ("waterfall", "chart"):
            data = base64.b64encode((path.parent / f"{kind}_{sample}.png").read_bytes()).decode()
            parts.append(f'<img alt="{kind} of {html.escape(sample)}" src="data:image/png;base64,{data}">')
        parts.append(_table(of_sample))
        parts.append(f"<pre>{html.escape(chr(10).join(report(of_sample)))}</pre>")
    text = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>A budget of shear</title>'
        f"<style>{_STYLE}</style>{''.join(parts)}</html>\n"
    )
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    heads = "".join(f"<th>{name}</th>" for name in ("estimator", "effect", "what", *_HEADS, "windows", "galaxies"))
    lines = []
    for row in rows:
        numbers = "".join(f"<td>{of_row(row, name, '&plusmn;')}</td>" for name in NAMES)
        texts = "".join(f"<td>{html.escape(str(row[key]))}</td>" for key in ("estimator", "effect", "about"))
        lines.append(f"<tr>{texts}{numbers}<td>{row['windows']}</td><td>{row['galaxies']}</td></tr>")
    return f"<table><tr>{heads}</tr>{''.join(lines)}</table>"
