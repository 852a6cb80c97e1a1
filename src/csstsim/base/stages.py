"""The stages of the workflow: whose product goes into whose, and what each of them reads."""

from fnmatch import fnmatchcase

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
    """Return the set of stages that a stage's product hangs on: itself and all before it."""
    return {stage}.union(*(behind(before) for before in INPUTS[stage]))


def read_by(stages, parts, readers):
    """Return those of {name: value} that one of the stages reads.

    readers: {pattern of names: the stages that read them first}, of which the first pattern that fits counts. A name
    that no pattern fits is read by FIRST: what is new, and not yet told of, decides everything.
    """

    def first(name):
        return next((found for pattern, found in readers.items() if fnmatchcase(name, pattern)), FIRST)

    return {name: value for name, value in parts.items() if not stages.isdisjoint(first(name))}


def flat(tree, above=""):
    """Return {dotted name: value} of nested mappings; lists and empty mappings are values."""
    found = {}
    for name, value in tree.items():
        found |= flat(value, f"{above}{name}.") if isinstance(value, dict) and value else {f"{above}{name}": value}
    return found
