"""The stages of the workflow: which stages each one depends on, and what it reads."""

import re
from fnmatch import translate

# Of each stage, those whose products it reads; measure stands for calibrate and extract, too
INPUTS = {
    "truth": (),
    "psf": (),
    "select": ("truth",),
    "render": ("select", "psf"),
    "readout": ("render",),
    "level0": ("readout",),
    "measure": ("level0", "psf"),
    "validate": ("measure",),
}
FIRST = ("truth", "psf", "select")  # nothing is before them but the campaign's files, and truth for some


def behind(stage):
    """Return the set of stages that a stage's product depends on: itself and all before it."""
    return {stage}.union(*(behind(before) for before in INPUTS[stage]))


def read_by(stages, parts, readers):
    """Return the items of {name: value} that one of the stages reads.

    readers: {pattern of names: the stages that read them first}; the first pattern that matches counts. A name that no
    pattern matches is read by FIRST: a new key changes every product until it gets a pattern.
    """

    patterns = re.compile("|".join(f"({translate(pattern)})" for pattern in readers))
    found = [*readers.values(), FIRST]  # lastindex: which pattern matches, from 1

    def first(name):
        match = patterns.match(name)
        return found[match.lastindex - 1 if match else -1]

    return {name: value for name, value in parts.items() if not stages.isdisjoint(first(name))}


def flat(tree, above=""):
    """Return {dotted name: value} of nested mappings; lists and empty mappings are values."""
    found = {}
    for name, value in tree.items():
        found |= flat(value, f"{above}{name}.") if isinstance(value, dict) and value else {f"{above}{name}": value}
    return found
