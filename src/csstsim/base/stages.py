"""What follows from the order of the stages (base.stage_records): which depend on which, and what each reads first."""

from __future__ import annotations

import re
from fnmatch import translate
from typing import TYPE_CHECKING

from csstsim.base.stage_records import STAGES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Set
    from typing import Any, TypeVar

    ValueT = TypeVar("ValueT")

FIRST = ("truth", "psf", "select")  # nothing is before them but the campaign's files, and truth for some


def behind(stage: str) -> set[str]:
    """Return the set of stages that a stage's product depends on: itself and all before it."""
    return {stage}.union(*(behind(before) for before in STAGES[stage].inputs))


def levels() -> list[list[str]]:
    """Return the names of stages in groups: each waits for the group before, those of a group run side by side.

    Without those that stand for others (Stage.instead_of).
    """
    depth: dict[str, int] = {}
    for stage in [stage for stage in STAGES.values() if not stage.instead_of]:
        depth[stage.name] = max((depth[before] + 1 for before in stage.inputs), default=0)
    return [[name for name in depth if depth[name] == level] for level in range(max(depth.values()) + 1)]


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
