"""The order of the stages (base.stage_records): dependencies, levels, and the stages that read a value first."""

from __future__ import annotations

import re
from fnmatch import translate
from typing import TYPE_CHECKING

from csstsim.base.stage_records import STAGES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Set
    from typing import Any, TypeVar

    ValueT = TypeVar("ValueT")

FIRST = ("truth", "psf", "select")  # the stages that read the campaign's files (and select the truth bricks)


def with_dependencies(stage: str) -> set[str]:
    """Return the set of a stage and all stages that its product depends on."""
    return {stage}.union(*(with_dependencies(before) for before in STAGES[stage].inputs))


def levels() -> list[list[str]]:
    """Return groups of names of stages. Stages of a group run in parallel, after the previous group.

    Stages that replace others (Stage.instead_of) are left out.
    """
    depth: dict[str, int] = {}
    for stage in [stage for stage in STAGES.values() if not stage.instead_of]:
        depth[stage.name] = max((depth[before] + 1 for before in stage.inputs), default=0)
    return [[name for name in depth if depth[name] == level] for level in range(max(depth.values()) + 1)]


def read_by(stages: Set[str], parts: Mapping[str, ValueT], readers: Mapping[str, Iterable[str]]) -> dict[str, ValueT]:
    """Return the items of {name: value} that one of the stages reads.

    readers: {pattern of names: the stages that read them first}; the first pattern that matches is used. A name without
    a matching pattern is read by FIRST. So a new key changes every product until it has a pattern.
    """
    patterns = re.compile("|".join(f"({translate(pattern)})" for pattern in readers))
    first_readers: list[Iterable[str]] = [*readers.values(), FIRST]

    def first(name: str) -> Iterable[str]:
        match = patterns.match(name)
        return first_readers[(match.lastindex or 0) - 1 if match else -1]  # lastindex counts the patterns from 1

    return {name: value for name, value in parts.items() if not stages.isdisjoint(first(name))}


def flatten(tree: Mapping[Any, Any], above: str = "") -> dict[str, Any]:
    """Return {dotted name: value} of nested mappings; lists and empty mappings are values."""
    flattened: dict[str, Any] = {}
    for name, value in tree.items():
        nested = isinstance(value, dict) and value
        flattened |= flatten(value, f"{above}{name}.") if nested else {f"{above}{name}": value}
    return flattened
