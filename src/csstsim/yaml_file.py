"""The one way YAML is read: strictly, so that what is run is what was written.

Refused beside what is no YAML: a key given twice, which YAML would let overwrite the first, and anything nested deeper
than a hundred levels. 1:30 and 010 stay text (YAML 1.1 makes them 90 and 8).
"""

import re
from pathlib import Path

import yaml

from csstsim.errors import InputError

DEPTH = 100
_BASE = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml parses ten times faster
_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_NOT_A_NUMBER = re.compile(r".*:.*|[-+]?0[0-9_]+")


class _Loader(_BASE):
    def resolve(self, kind, value, implicit):
        tag = super().resolve(kind, value, implicit)
        text = kind is yaml.ScalarNode and tag in _NUMBERS and _NOT_A_NUMBER.fullmatch(value)
        return "tag:yaml.org,2002:str" if text else tag

    def construct_mapping(self, node, deep=False):
        seen = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and seen.setdefault(key.value, key) is not key:
                raise yaml.constructor.ConstructorError(None, None, f"key {key.value!r} given twice", key.start_mark)
        return super().construct_mapping(node, deep)


def read_yaml(path):
    """Return the mapping in a YAML file; InputError if missing, unreadable or not a mapping."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as exc:
        raise InputError(
            f"cannot read the file: {getattr(exc, 'strerror', None) or 'not UTF-8 text'}", file=path
        ) from exc
    except ValueError as exc:
        raise InputError(f"cannot read the file: {exc}", file=path) from exc
    try:
        _check_depth(text)
        data = yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as exc:
        mark = getattr(exc, "problem_mark", None)
        line = f"line {mark.line + 1}" if mark else None
        raise InputError(f"not valid YAML: {getattr(exc, 'problem', exc)}", file=path, key=line) from exc
    except (ValueError, AttributeError, RecursionError) as exc:  # of a date that is none, a number of 5000 digits
        raise InputError(f"not valid YAML: {exc}", file=path) from exc
    if not isinstance(data, dict):
        raise InputError("the file must hold a mapping of keys", file=path, value=data)
    return data


def _check_depth(text):
    """Raise YAMLError for text nested too deep: the parser in C would run out of stack and end the process."""
    depth = 0
    for event in yaml.parse(text, Loader=_BASE):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if depth > DEPTH:
            message = f"nested deeper than {DEPTH} levels"
            raise yaml.composer.ComposerError(None, None, message, event.start_mark)
