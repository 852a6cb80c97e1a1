"""Reads YAML strictly, so that a campaign runs as it is written.

Refused are a key given twice (YAML would keep the last), tags that make objects, more than a hundred nested levels, and
more than a million values. Values that aliases repeat count each time: ten lines of aliases of aliases make a billion.
1:30 and 010 stay text (YAML 1.1 makes them 90 and 8).
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

DEPTH = 100
VALUES = 1_000_000
_BASE = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml parses ten times faster
_TEXT = "tag:yaml.org,2002:str"
_NOT_A_NUMBER = re.compile(r"[-+]?[0-9][0-9_]*(:[0-9_.]+)+$|[-+]?0[0-9_]+$")


class _Loader(_BASE):  # type: ignore[misc, valid-type]  # either of two
    yaml_implicit_resolvers: ClassVar[dict[str, list[tuple[str, re.Pattern[str]]]]] = {  # the first that matches counts
        first: [(_TEXT, _NOT_A_NUMBER), *resolvers] if first in list("-+0123456789") else resolvers
        for first, resolvers in _BASE.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: dict[Any, yaml.ScalarNode] = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and seen.setdefault(key.value, key) is not key:
                raise yaml.constructor.ConstructorError(None, None, f"key {key.value!r} given twice", key.start_mark)
        return super().construct_mapping(node, deep)


def read_yaml(path: PathLike) -> dict[Any, Any]:
    """Return the mapping in a YAML file; InputError if missing, unreadable or not a mapping."""
    path = Path(path)
    text = read_text(path)
    try:
        data = pickle.loads(_parsed(text))  # a copy of its own, which the caller may change
    except yaml.YAMLError as exc:
        mark = getattr(exc, "problem_mark", None)
        line = f"line {mark.line + 1}" if mark else None
        raise InputError(f"not valid YAML: {getattr(exc, 'problem', exc)}", file=path, key=line) from exc
    except (ValueError, AttributeError, RecursionError) as exc:  # of a date that is none, a number of 5000 digits
        raise InputError(f"not valid YAML: {exc}", file=path) from exc
    if not isinstance(data, dict):
        raise InputError("the file must hold a mapping of keys", file=path, value=data)
    return data


@lru_cache(maxsize=100)
def _parsed(text: str) -> bytes:
    """Return the content of a YAML text, pickled: a camera's files are read again for each Simulation."""
    _check_size(text)
    return pickle.dumps(yaml.load(text, Loader=_Loader))


def _check_size(text: str) -> None:
    """Raise YAMLError for text that is nested too deeply or has too many values.

    Deep nesting would overflow the stack of the C parser and crash the process. Values that an alias repeats count
    again, because a walk through the data meets them again.
    """
    open_: list[list[Any]] = []
    known: dict[Any, tuple[int, int]] = {}
    # [anchor, values, levels] of collections not yet at their end; (values, levels) of anchors
    for event in yaml.parse(text, Loader=_BASE):
        if isinstance(event, yaml.CollectionStartEvent):
            open_.append([event.anchor, 1, 0])
            values = 0
            levels = 0
        elif isinstance(event, yaml.AliasEvent):
            values, levels = known.get(event.anchor, (VALUES, DEPTH))  # of itself, or of nothing
        elif isinstance(event, yaml.ScalarEvent):
            values, levels = known[event.anchor] = 1, 0
        elif isinstance(event, yaml.CollectionEndEvent):
            anchor, values, levels = open_.pop()
            levels += 1
            known[anchor] = values, levels
        else:
            continue
        if open_:
            open_[-1][1] += values
            open_[-1][2] = max(open_[-1][2], levels)
        if len(open_) + levels > DEPTH or values >= VALUES:
            message = f"more than {VALUES} values, repeated by aliases, or an alias of itself"
            if values < VALUES:
                message = f"nested deeper than {DEPTH} levels"
            raise yaml.composer.ComposerError(None, None, message, event.start_mark)
