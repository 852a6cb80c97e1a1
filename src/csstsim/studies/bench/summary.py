"""Summary of a sweep: one line for each method, kind of object and standard; CSV files and text."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.base.files.text_file import read_text
from csstsim.base.types import FloatArray, PathLike

if TYPE_CHECKING:
    from csstsim.studies.bench.sweep import Bench

# Kinds of objects, in this order, and their plurals
KINDS = {"star": "stars", "galaxy": "galaxies", "free n": "any Sersic index", "knots": "with knots", "image": "images"}


def write(path: PathLike, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write a list of dicts of the same keys as CSV."""
    with atomic_path(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()})


def read(path: PathLike) -> list[dict[str, Any]]:
    """Return the list of dicts that `write` wrote, numbers as numbers."""
    lines = read_text(path).splitlines()
    return [{name: _value(text) for name, text in row.items()} for row in csv.DictReader(lines)]


def _value(text: str) -> bool | float | str:
    if text in ("True", "False"):
        return text == "True"
    try:
        return float(text)
    except ValueError:
        return text


def summarise(rows: Sequence[Mapping[str, Any]], bench: Bench[Any], band: str) -> list[dict[str, Any]]:
    """Return [{column: value}], with the mean over the objects of each of the Bench's goals, and its error.

    `against` is the reference renderer with the same PSF set; direct optics, for objects on a node of the set; direct
    optics for the others, whose errors include the set's interpolation. Means of random methods are weighted by
    electrons drawn.
    """
    lines = []
    for method in dict.fromkeys(row["method"] for row in rows):
        for kind in dict.fromkeys(sorted((row["kind"] for row in rows), key=list(KINDS).index)):
            rows_of_kind = [row for row in rows if (row["method"], row["kind"]) == (method, kind) and row["drawn"] > 0]
            on_nodes = [row for row in rows_of_kind if row["at_node"]]
            between = [row for row in rows_of_kind if not row["at_node"]]
            for against, selected, standard in (
                ("reference", rows_of_kind, "standard"),
                ("direct optics, on nodes", on_nodes, "direct"),
                ("direct optics, between nodes", between, "direct"),
            ):
                if selected:
                    lines.append(_line(bench, band, method, kind, against, selected, standard))
    return lines


def _line(
    bench: Bench[Any], band: str, method: str, kind: str, against: str, rows: Sequence[Mapping[str, Any]], standard: str
) -> dict[str, Any]:
    def column(name: str) -> FloatArray:
        return np.array([row[name] for row in rows])

    drawn = column("drawn")
    weight = np.where(np.isinf(drawn), 1.0, drawn)
    visible = column(f"visible_{standard}")
    chance = column("visible_chance")
    detectable = np.maximum(visible, chance)
    line = {
        "filter": band,
        "method": method,
        "kind": kind,
        "against": against,
        "objects": len(rows),
        "cpu_us": 1e6 * float(np.median(column("cpu_s"))),
        "visible_median": float(np.median(detectable)),
        "visible_95": float(np.percentile(detectable, 95)),
        "limit": bool(np.median(visible) < 2 * np.median(chance)),
        "pixel_median": float(np.median(column(f"pixel_{standard}"))),
    }
    for name in bench.goals:
        values = column(f"{name}_{standard}")
        finite = np.isfinite(values)  # only some spectra have lines
        values = values[finite]
        weights = weight[finite]
        mean = np.average(values, weights=weights) if finite.any() else np.nan
        # Few objects may agree by chance, so the error is at least that of the electrons drawn
        deviations = weights * np.stack([values - mean, column(f"{name}_chance")[finite]])
        error = np.sqrt((deviations**2).sum(axis=1).max()) / weights.sum() if finite.any() else np.nan
        line |= {name: float(mean), f"{name}_error": float(error)}
    return line


def text(lines: Iterable[Mapping[str, Any]], bench: Bench[Any]) -> list[str]:
    """Return the summary as lines to print; a bias beyond its goal by more than two of its errors is marked with !."""
    text_lines = [
        f"bias +- its error of {', '.join(bench.shown)}; ! marks one that exceeds its goal by two errors.",
        "visible: error in units of the object's noise, median and 95%; < marks what chance alone could show.",
        f"{'method':20s} {'kind':7s} {'against':13s} {'n':>3s} {'CPU us':>9s} {'visible':>8s} {'95%':>8s}"
        + "".join(f"{name:>18s} " for name in bench.shown),
    ]
    for line in lines:
        if "between" in line["against"]:
            continue  # only in the file
        cells = []
        for name in bench.shown:
            bias = line[name]
            error = line[f"{name}_error"]
            cells.append(f" {bias:+8.1e}+-{error:7.1e}{'!' if abs(bias) - 2 * error > bench.goals[name] else ' '}")
        text_lines.append(
            f"{line['method']:20s} {line['kind']:7s} {line['against'][:13]:13s} {line['objects']:3d} "
            f"{line['cpu_us']:9.3g} {'<' if line['limit'] else ' '}{line['visible_median']:7.2g} "
            f"{line['visible_95']:8.2g}" + "".join(cells)
        )
    return text_lines
