"""What a sweep comes to: a line for each method and kind of object, against both standards; files and goals."""

import csv

import numpy as np

from csstsim.atomic import atomic_path

GOALS = {"flux": 1e-3, "x_mas": 1.0, "y_mas": 1.0, "size2": 1e-3, "e1": 1e-4, "e2": 1e-4}
SHOWN = ("flux", "x_mas", "size2", "e1")


def write(path, rows):
    """Write a list of dicts of the same keys as CSV."""
    with atomic_path(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()})


def summarise(rows):
    """Return [{column: value}]; for each of GOALS its mean over the objects and that mean's error.

    `against`: the reference renderer on the same PSF set; direct optics, objects on a node of it; direct optics, all
    others, where the set's own interpolation counts. Means of random methods are weighted by electrons drawn.
    """
    lines = []
    for method in dict.fromkeys(row["method"] for row in rows):
        for kind in ("star", "galaxy"):
            mine = [row for row in rows if (row["method"], row["kind"]) == (method, kind) and row["drawn"] > 0]
            node = [row for row in mine if row["at_node"]]
            rest = [row for row in mine if not row["at_node"]]
            for against, some, which in (
                ("reference", mine, "standard"),
                ("direct optics, on nodes", node, "direct"),
                ("direct optics, between nodes", rest, "direct"),
            ):
                if some:
                    lines.append(_line(method, kind, against, some, which))
    return lines


def _line(method, kind, against, rows, which):
    def column(name):
        return np.array([row[name] for row in rows])

    drawn = column("drawn")
    weight = np.where(np.isinf(drawn), 1.0, drawn)
    visible, chance = column(f"visible_{which}"), column("visible_chance")
    seen = np.maximum(visible, chance)
    line = {
        "method": method, "kind": kind, "against": against, "objects": len(rows),
        "cpu_us": 1e6 * float(np.median(column("cpu_s"))), "visible_median": float(np.median(seen)),
        "visible_95": float(np.percentile(seen, 95)), "limit": bool(np.median(visible) < 2 * np.median(chance)),
        "pixel_median": float(np.median(column(f"pixel_{which}"))),
    }  # fmt: skip
    for name in GOALS:
        values = column(f"{name}_{which}")
        mean = np.average(values, weights=weight)
        # Few objects may agree by accident: no less than the electrons' own
        parts = weight * np.stack([values - mean, column(f"{name}_chance")])
        error = np.sqrt((parts**2).sum(axis=1).max()) / weight.sum()
        line |= {name: float(mean), f"{name}_error": float(error)}
    return line


def text(lines):
    """Return the summary as lines to print; a bias beyond its goal by more than two of its errors is marked with !."""
    out = [
        "bias +- its error: flux, size^2 relative; x in mas; e1; ! where it is beyond its goal by two errors.",
        "visible: error in units of the object's noise, median and 95%; < where chance alone would show as much.",
        f"{'method':20s} {'kind':7s} {'against':13s} {'n':>3s} {'CPU us':>9s} {'visible':>8s} {'95%':>8s}"
        + "".join(f"{name:>18s} " for name in SHOWN),
    ]
    for line in lines:
        if "between" in line["against"]:
            continue  # in the file
        cells = []
        for name in SHOWN:
            bias, error = line[name], line[f"{name}_error"]
            cells.append(f" {bias:+8.1e}+-{error:7.1e}{'!' if abs(bias) - 2 * error > GOALS[name] else ' '}")
        out.append(
            f"{line['method']:20s} {line['kind']:7s} {line['against'][:13]:13s} {line['objects']:3d} "
            f"{line['cpu_us']:9.3g} {'<' if line['limit'] else ' '}{line['visible_median']:7.2g} "
            f"{line['visible_95']:8.2g}" + "".join(cells)
        )
    return out
