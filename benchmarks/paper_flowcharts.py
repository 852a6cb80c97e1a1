"""Two diagrams as in the paper: how an exposure is simulated, and how the layers of a chip are run.

    python benchmarks/paper_flowcharts.py

Draws workflow.png and orchestration.png. Stages and their inputs are those of csstsim.base.stage_records, the layers
those of config/observations/science.yaml, so neither picture can show a step that the program lacks.
"""

import argparse

from evidence.record import Record

from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from csstsim.base.shipped import SHIPPED
from csstsim.base.stage_records import STAGES
from csstsim.simulation.sim_steps import SimSteps

DATA, WORK, FILE = "#f6d5c4", "#cfe3f2", "#cdeccf"  # what goes in, what is done, what comes out
# Of the workflow: name: (x, y, width, height, colour, text). A key that is a stage of base.stage_records is one job.
BOXES = {
    "survey": (0.2, 7.2, 2.5, 0.9, DATA, "survey table: time,\npointing, spacecraft"),
    "universe": (3.1, 7.2, 2.5, 0.9, DATA, "universe, or a catalogue\nof your own (CatalogBase)"),
    "camera": (6.0, 7.2, 2.5, 0.9, DATA, "camera: chips, filters,\noptics, gratings, detector"),
    "observation": (8.9, 7.2, 2.5, 0.9, DATA, "observation YAML: layers of\nrender, readout, level0"),
    "truth": (3.1, 5.7, 2.5, 0.9, WORK, "truth\na HEALPix brick a job"),
    "psf": (6.0, 5.7, 2.5, 0.9, WORK, "psf\na chip a job"),
    "select": (1.6, 4.3, 2.9, 0.9, WORK, "select: footprint, apparent\npositions, spectra, electrons"),
    "render": (5.2, 4.3, 3.3, 0.9, WORK, "render: objects x PSF, distorted;\ndispersed behind gratings; sky"),
    "readout": (8.9, 4.3, 2.5, 0.9, WORK, "readout: charge,\nchannels, bias, gain"),
    "level0": (8.9, 2.9, 2.5, 0.9, FILE, "level0: Level-0 FITS,\ntruth, orders"),
    "measure": (5.2, 2.9, 3.3, 0.9, FILE, "measure, extract:\ncatalogue or spectra of a chip"),
    "merge": (2.1, 2.9, 2.4, 0.9, FILE, "merge\na brick a job"),
    "validate": (2.1, 1.5, 2.4, 0.9, FILE, "validate: gates,\nin against out"),
    "report": (5.2, 1.5, 3.3, 0.9, FILE, "report: one page"),
}
# Beside those of base.stage_records: what comes from outside, and what is made of many files
ARROWS = [
    ("survey", "select"), ("universe", "truth"), ("camera", "psf"), ("observation", "readout"),
    ("measure", "merge"), ("merge", "validate"), ("validate", "report"),
]  # fmt: skip
PARTS = "Chip", "Filter", "Telescope", "Pointing", "Catalog", "image"  # of simulation.state.State


def box(axes, x, y, width, height, colour, text, size=8):
    """Draw a box with a text; x, y: its lower left corner."""
    style = "round,pad=0.02,rounding_size=0.12"
    axes.add_patch(FancyBboxPatch((x, y), width, height, boxstyle=style, fc=colour, ec="#555555", lw=0.8))
    axes.text(x + width / 2, y + height / 2, text, ha="center", va="center", fontsize=size)


def arrow(axes, start, end, **style):
    style = {
        "arrowstyle": "-|>",
        "mutation_scale": 11,
        "color": "#333333",
        "lw": 1.0,
        "shrinkA": 0,
        "shrinkB": 0,
    } | style
    axes.add_patch(FancyArrowPatch(start, end, **style))


def blank(width, height):
    """Return a Figure and its axes, with a unit of the axes 0.85 inches long."""
    figure = Figure(figsize=(0.85 * width, 0.85 * (height - 0.2)), layout="constrained")
    axes = figure.add_subplot()
    axes.set(xlim=(0, width), ylim=(0.2, height), aspect="equal")
    axes.axis("off")
    return figure, axes


def edge(first, second):
    """Return where an arrow leaves the first box and where it meets the second: the nearest sides."""
    (x1, y1, w1, h1, *_), (x2, y2, w2, h2, *_) = first, second
    low, high = max(x1, x2), min(x1 + w1, x2 + w2)
    if y1 != y2:
        down = y1 > y2
        x = 0.5 * (low + high) if low < high else None
        ends = (x1 + w1 / 2 if x is None else x), (x2 + w2 / 2 if x is None else x)
        return (ends[0], y1 if down else y1 + h1), (ends[1], y2 + h2 if down else y2)
    right = x2 > x1
    return (x1 + w1 if right else x1, y1 + h1 / 2), (x2 if right else x2 + w2, y2 + h2 / 2)


def workflow():
    """Return the Figure of the stages of a campaign and what they read."""
    figure, axes = blank(11.6, 8.6)
    for part in BOXES.values():
        box(axes, *part)
    jobs = [stage for stage in STAGES.values() if stage.name in BOXES and stage.unit == "job"]
    between = [(before, stage.name) for stage in jobs for before in stage.inputs if before in BOXES]
    between.remove(("render", "level0"))  # by way of readout
    for first, second in [*between, *ARROWS]:
        if (first, second) != ("psf", "measure"):  # drawn as a bend, or it would cross render
            arrow(axes, *edge(BOXES[first], BOXES[second]))
    arrow(axes, (8.5, 6.1), (8.5, 3.4), connectionstyle="arc3,rad=-0.12", ls=":")
    axes.text(
        0.2, 8.35, "Once for all exposures: truth, psf. For each exposure and chip: select to measure.", fontsize=9
    )
    told = (
        "Blue and green boxes are rules of the workflow, and commands; `csstsim chip` runs select to level0 in memory."
    )
    axes.text(
        0.2,
        0.9,
        f"{told}\nDotted: the PSF model that measure uses. Every stage reads the camera.",
        fontsize=8,
        va="top",
    )
    return figure


def orchestration():
    """Return the Figure of how the ordered layers of a chip are run on a State."""
    steps = SimSteps(SHIPPED / "observations" / "science.yaml", "SCIE").steps
    figure, axes = blank(11.6, 7.6)
    box(axes, 0.2, 6.6, 2.6, 0.9, DATA, "observation YAML\nordered layers, parameters")
    box(axes, 3.6, 6.6, 3.4, 0.9, WORK, "SimSteps: every layer, parameter,\nunit and frame is checked first")
    arrow(axes, (2.8, 7.05), (3.6, 7.05))
    box(axes, 0.2, 3.4, 4.2, 1.7, "#eaf2f8", "")
    axes.text(2.3, 4.85, "State of one chip of one exposure", ha="center", fontsize=9)
    for k, name in enumerate(PARTS):
        box(axes, 0.35 + 1.35 * (k % 3), 4.2 - 0.62 * (k // 3), 1.2, 0.5, WORK, name)
    arrow(axes, (4.0, 6.6), (2.9, 5.15))
    axes.text(2.2, 5.75, "pointing, chip,\nselected objects", fontsize=8, ha="center")
    box(axes, 0.9, 1.4, 2.8, 0.9, WORK, "state = layer.apply(\nstate, param, streams)")
    arrow(axes, (2.9, 3.35), (2.9, 2.35))
    arrow(axes, (1.7, 2.35), (1.7, 3.35))
    axes.text(3.05, 2.8, "read", fontsize=8)
    axes.text(1.6, 2.8, "update", fontsize=8, ha="right")
    colours = {"render": "#fbe6b8", "readout": "#d7e7d0", "level0": "#d9d4ea"}
    top = 6.35
    height = 6.0 / len(steps)
    for k, step in enumerate(steps):
        unit = " to ".join(dict.fromkeys(step.module.UNITS))
        y = top - (k + 1) * height
        box(axes, 7.7, y, 3.7, height - 0.06, colours[step.module.STAGE], "")
        axes.text(7.85, y + height / 2 - 0.03, f"{k + 1}  {step.keyword}", fontsize=8, va="center")
        axes.text(11.3, y + height / 2 - 0.03, unit, fontsize=7, va="center", ha="right", color="#555555")
    for k, (stage, colour) in enumerate(colours.items()):
        box(axes, 7.7 + 1.25 * k, 6.6, 1.15, 0.4, colour, stage)
    axes.text(7.7, 7.2, "the layers of science.yaml, by stage", fontsize=9)
    arrow(axes, (7.0, 7.05), (7.65, 6.4), connectionstyle="arc3,rad=-0.2")
    box(axes, 5.0, 3.7, 2.0, 1.0, DATA, "is a layer left?")
    arrow(axes, (7.65, 4.2), (7.0, 4.2))
    arrow(axes, (5.4, 3.7), (3.75, 1.95))
    axes.text(4.75, 2.6, "yes: call the next", fontsize=8)
    box(axes, 5.0, 0.3, 2.0, 0.9, FILE, "Level-0 FITS, truth,\nintermediate frames")
    arrow(axes, (6.6, 3.7), (6.2, 1.25))
    axes.text(6.5, 2.2, "no: done", fontsize=8)
    arrow(axes, (3.75, 1.5), (4.95, 0.85))
    axes.text(3.8, 0.85, "if any", fontsize=8)
    return figure


def main() -> None:
    """Draw both."""
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        for draw in (workflow, orchestration):
            draw().savefig(record.figure(f"{draw.__name__}.png"), dpi=100)


if __name__ == "__main__":
    main()
