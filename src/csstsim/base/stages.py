"""The stages of the workflow: which stages each one depends on, and what it reads."""

from __future__ import annotations

import re
from fnmatch import translate
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Set
    from typing import Any, TypeVar

    ValueT = TypeVar("ValueT")

# Of each stage, those whose products it reads; measure stands for calibrate and extract, too
INPUTS: dict[str, tuple[str, ...]] = {
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


def behind(stage: str) -> set[str]:
    """Return the set of stages that a stage's product depends on: itself and all before it."""
    return {stage}.union(*(behind(before) for before in INPUTS[stage]))


def read_by(stages: Set[str], parts: Mapping[str, ValueT], readers: Mapping[str, Iterable[str]]) -> dict[str, ValueT]:
    """Return the items of {name: value} that one of the stages reads.

    readers: {pattern of names: the stages that read them first}; the first pattern that matches counts. A name that no
    pattern matches is read by FIRST: a new key changes every product until it gets a pattern.
    """

    patterns = re.compile("|".join(f"({translate(pattern)})" for pattern in readers))
    found: list[Iterable[str]] = [*readers.values(), FIRST]  # lastindex: which pattern matches, from 1

    def first(name: str) -> Iterable[str]:
        match = patterns.match(name)
        return found[(match.lastindex or 0) - 1 if match else -1]

    return {name: value for name, value in parts.items() if not stages.isdisjoint(first(name))}


def flat(tree: Mapping[Any, Any], above: str = "") -> dict[str, Any]:
    """Return {dotted name: value} of nested mappings; lists and empty mappings are values."""
    found: dict[str, Any] = {}
    for name, value in tree.items():
        found |= flat(value, f"{above}{name}.") if isinstance(value, dict) and value else {f"{above}{name}": value}
    return found
