"""Reads YAML strictly, so that a campaign runs as it is written.

A key that is given twice is refused (YAML would keep the last one), and so are tags that make objects, more than a
hundred nested levels, and an alias of a collection inside itself. 1:30 and 010 stay text (YAML 1.1 makes them 90 and
8). The expansion of aliases is not limited: a campaign may name any Python class, so its author is trusted.
"""

from __future__ import annotations

import pickle
import re
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import yaml

from csstsim.base.errors import InputError
from csstsim.base.files.text_file import read_text

if TYPE_CHECKING:
    from typing import Any

    from csstsim.base.types import PathLike

MAX_LEVELS = 100
_BASE = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml parses ten times faster
_TEXT = "tag:yaml.org,2002:str"
_NOT_A_NUMBER = re.compile(r"[-+]?[0-9][0-9_]*(:[0-9_.]+)+$|[-+]?0[0-9_]+$")


class _Loader(_BASE):  # type: ignore[misc, valid-type]  # either of two
    yaml_implicit_resolvers: ClassVar[dict[str, list[tuple[str, re.Pattern[str]]]]] = {  # the first match is used
        first: [(_TEXT, _NOT_A_NUMBER), *resolvers] if first in list("-+0123456789") else resolvers
        for first, resolvers in _BASE.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys: dict[Any, yaml.ScalarNode] = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and keys.setdefault(key.value, key) is not key:
                raise yaml.constructor.ConstructorError(None, None, f"key {key.value!r} given twice", key.start_mark)
        return super().construct_mapping(node, deep)


def read_yaml(path: PathLike) -> dict[Any, Any]:
    """Return the mapping in a YAML file. Raises InputError for a missing or invalid file, and without a mapping."""
    path = Path(path)
    text = read_text(path)
    try:
        data = pickle.loads(_parsed(text))  # a copy, which the caller may change
    except yaml.YAMLError as exc:
        mark = getattr(exc, "problem_mark", None)
        line = f"line {mark.line + 1}" if mark else None
        raise InputError(f"not valid YAML: {getattr(exc, 'problem', exc)}", file=path, key=line) from exc
    except (ValueError, AttributeError, RecursionError) as exc:  # for an impossible date, a number of 5000 digits
        raise InputError(f"not valid YAML: {exc}", file=path) from exc
    if not isinstance(data, dict):
        raise InputError("the file must hold a mapping of keys", file=path, value=data)
    return data


@lru_cache(maxsize=100)
def _parsed(text: str) -> bytes:
    """Return the content of a YAML text, pickled. It is cached, because each Simulation reads the camera's files."""
    _check_levels(text)
    return pickle.dumps(yaml.load(text, Loader=_Loader))


def _check_levels(text: str) -> None:
    """Raise YAMLError for more than MAX_LEVELS nested levels, which crash the C parser, and for recursive aliases."""
    anchors: list[str | None] = []  # of the collections around an event
    for event in yaml.parse(text, Loader=_BASE):
        if isinstance(event, yaml.CollectionStartEvent):
            anchors.append(event.anchor)
        elif isinstance(event, yaml.CollectionEndEvent):
            anchors.pop()
        fault = None
        if len(anchors) > MAX_LEVELS:
            fault = f"nested deeper than {MAX_LEVELS} levels"
        elif isinstance(event, yaml.AliasEvent) and event.anchor in anchors:
            fault = f"alias {event.anchor!r} inside its own value"
        if fault:
            raise yaml.composer.ComposerError(None, None, fault, event.start_mark)
