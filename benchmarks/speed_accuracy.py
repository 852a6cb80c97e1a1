"""Speed against accuracy of every way to draw an object: tables and charts of `csstsim bench`.

    python benchmarks/speed_accuracy.py              # imaging, r: an hour
    python benchmarks/speed_accuracy.py GV           # light through a grating: six minutes
    python benchmarks/speed_accuracy.py shapes       # galaxies of any index, with knots, of images: twelve minutes

Each writes docs/speed_accuracy.csv (_GV, _shapes), as `csstsim bench` does, and draws docs/figures/speed_accuracy.png
(r and GV, each from the newest table of both) or speed_accuracy_shapes.png. UFig draws too if it is installed.
Recorded are medians and 95th percentiles of the visible error against direct optics of objects on nodes of the PSF
set, and biases against their goals.
"""

import argparse
import shutil
from pathlib import Path

from evidence.record import Record

import numpy as np
from bench_setting import small

from csstsim.studies.bench import command
from csstsim.studies.bench.chart import ON_NODES, draw_chart
from csstsim.studies.bench.summary import KINDS, read

PARTS = {"r": "", "GV": "_GV", "shapes": "_shapes"}  # what is measured: the end of its files' names
TOGETHER = "", "_GV"  # share a chart
TOY_OBJECTS = {"r": 4, "GV": 2, "shapes": 3}
TOY_METHODS = {
    "r": "reference, photons, stamps, standard, noise_free, GalSim",
    "GV": "reference, photons, slabs 4, standard", "shapes": "reference, photons, standard, GalSim FFT",
}  # fmt: skip
REFERENCE = "reference"
OWN = "photons", "stamps", "slabs 4", "standard", "noise_free"  # whose 95th percentiles the pages name
TRUTHS = {"flux": ("flux",), "size2": ("size2",), "e": ("e1", "e2")}  # in which the truths are compared


def folder_of(record: Record) -> Path:
    """Return the folder of the benchmark's own output."""
    return record.results / f"bench{PARTS[record.options.part]}"


def measured(record: Record) -> tuple[list[dict], list[dict]]:
    """Run the benchmark; return its summary and the rows of all objects."""
    part, toy, folder = record.options.part, record.toy, folder_of(record)
    if toy:
        small()
    band, objects = ("GV" if part == "GV" else "r"), TOY_OBJECTS[part] if toy else None
    command.bench(folder, band, TOY_METHODS[part] if toy else None, toy, objects, 1, print, part == "shapes")
    return read(folder / "speed_accuracy.csv"), read(folder / "cases.csv")


def chart(record: Record) -> None:
    """Store the table and draw the chart, of r and GV together."""
    end = PARTS[record.options.part]
    name = "speed_accuracy.png" if end in TOGETHER else f"speed_accuracy{end}.png"
    picture = record.figure(name)
    folder = picture.parents[1]
    shutil.copyfile(folder_of(record) / "speed_accuracy.csv", folder / f"speed_accuracy{end}.csv")
    paths = [folder / f"speed_accuracy{one}.csv" for one in (TOGETHER if end in TOGETHER else (end,))]
    draw_chart(picture, [read(path) for path in paths if path.exists()])


def tables(record: Record, lines: list[dict]) -> None:
    """Record cost and visible error of each method and kind, and the 95th percentiles of our methods."""
    kinds = [kind for kind in KINDS if any(line["kind"] == kind for line in lines)]
    methods = dict.fromkeys(line["method"] for line in lines)
    found = {(line["method"], line["kind"]): line for line in lines if line["against"] == ON_NODES}
    rows = []
    for method in methods:
        cells = [method]
        for kind in kinds:
            line = found.get((method, kind), dict.fromkeys(("cpu_us", "visible_median", "visible_95"), np.nan))
            limit = "< " if line.get("limit") else ""
            cells += [_two(line["cpu_us"] / 1e3), f"{limit}{_two(line['visible_median'])}", _two(line["visible_95"])]
            objects, key = f"{method}, {KINDS[kind]} on nodes", f"{method}_{kind}".replace(" ", "_")
            if method in OWN:
                what = f"{objects}: 95th percentile of the visible error"
                record.value(f"{key}_95", line["visible_95"], what, unit="of the object's noise")
            if method in ("noise_free", REFERENCE):
                record.value(f"{key}_cpu", line["cpu_us"] / 1e3, f"{objects}: median cost", unit="CPU-ms")
        rows.append(cells)
    heads = [f"{KINDS[kind]}: {what}" for kind in kinds for what in ("CPU ms", "visible error, median", "95%")]
    record.table("errors", ["method", *heads], rows)
    record.value("objects", int(max(line["objects"] for line in found.values())), "objects of a kind on nodes")


def _two(value: float) -> str:
    """Return a number with two digits, whole above 10."""
    return f"{value:,.0f}" if value >= 10 else f"{value:.2g}"


def biases(record: Record, lines: list[dict], goals: dict[str, float]) -> None:
    """Record the mean errors against direct optics of objects on nodes; those beyond their goal are marked."""
    rows = []
    for line in lines:
        if line["against"] == ON_NODES:
            cells = []
            for name, goal in goals.items():
                bias, error = line[name], line[f"{name}_error"]
                beyond = " !" if abs(bias) - 2 * error > goal else ""
                cells.append(f"{bias:+.0e} ± {error:.0e}{beyond}" if np.isfinite(bias) else "")
            rows.append([line["method"], KINDS[line["kind"]], *cells])
    record.table("biases", ["method", "kind", *(f"{name} (goal {goal:g})" for name, goal in goals.items())], rows)


def truths(record: Record, cases: list[dict]) -> None:
    """Record how far the two truths, reference and direct optics, are apart for objects on nodes."""
    for kind in dict.fromkeys(row["kind"] for row in cases):
        mine = [row for row in cases if row["method"] == REFERENCE and row["kind"] == kind and row["at_node"]]
        for key, names in TRUTHS.items():
            off = [abs(row[f"{name}_direct"]) for name in names for row in mine if f"{name}_direct" in row]
            if off or f"{names[0]}_direct" in cases[0]:
                what = f"reference and direct optics, {KINDS[kind]} on nodes: largest difference of {key}"
                record.value(f"truths_{kind}_{key}".replace(" ", "_"), max(off, default=np.nan), what)


def main(record: Record) -> None:
    """Run a part of the benchmark, and record it."""
    lines, cases = measured(record)
    if record.options.part == "GV":
        from csstsim.studies.bench.slitless.measures import GOALS
    else:
        from csstsim.studies.bench.imaging.benchmark import GOALS
    tables(record, lines)
    biases(record, lines, GOALS)
    truths(record, cases)
    chart(record)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", choices=PARTS, default="r", help="what is measured")
    with Record(parser) as record:
        main(record)
