"""Conversion of the first fault that pydantic finds in a user's file to an InputError with the keys of the file.

pydantic reports a separate fault for each branch of a union (`window`: four numbers, or 'region'). Here they become one
fault: that of the branch to which the value belongs, or else the types of all branches.
"""

from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass
from difflib import get_close_matches
from itertools import groupby
from types import UnionType
from typing import Annotated, Any, Union, cast, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ValidationError

from csstsim.base.errors import InputError
from csstsim.base.types import PathLike

_UNKNOWN = "extra_forbidden", "unexpected_keyword_argument"  # for a Model, for Data
_EXPECTED = {
    "path_type": "a path",
    "dict_type": "a mapping",
    "dataclass_type": "a mapping",
    "tuple_type": "a list",
    "list_type": "a list",
}


def input_error(exc: ValidationError, model: type, file: PathLike, key: Sequence[str | int] = ()) -> InputError:
    """Return the InputError for the first fault of a pydantic ValidationError about `model`."""
    faults = _faults(exc, model)
    fault = faults[0]
    if fault["type"] == "missing":  # a misspelt key is also missing: report the misspelling
        unknown = {str(e["loc"][-1]): e for e in faults if e["type"] in _UNKNOWN}
        fault = next((unknown[key] for key in get_close_matches(str(fault["loc"][-1]), unknown, 1)), fault)
    where = ".".join(str(part) for part in (*key, *fault["loc"]))
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    if fault["type"] in _UNKNOWN:
        allowed = ", ".join(sorted(fields(_type_at(model, fault["loc"][:-1]))))
        return InputError(f"unknown key{more}", file=file, key=where, value=fault["loc"][-1], allowed=allowed)
    if fault["type"] == "unknown_key":
        return InputError(f"unknown key{more}", file=file, key=where, value=fault["input"], allowed=fault["expected"])
    if fault["type"] == "missing" and isinstance(fault["loc"][-1], int):
        where = where.rpartition(".")[0]
        return InputError(f"too few numbers{more}", file=file, key=where, value=fault["input"])
    if fault["type"] == "missing":
        return InputError(f"required key is missing{more}", file=file, key=where)
    expected = _expected(fault, model)
    empty = ", and is empty" if fault["input"] is None else ""
    message = f"must be {expected}{empty}" if expected else _lower_case(fault["msg"].removeprefix("Value error, "))
    return InputError(message + more, file=file, key=where, value=fault["input"])


def fields(model: Any) -> dict[str, Any]:
    """Return {name: type} of the fields of a Model or dataclass; {} for another type."""
    if is_dataclass(model):
        return get_type_hints(model)
    if isinstance(model, type) and issubclass(model, BaseModel):
        return {name: field.annotation for name, field in model.model_fields.items()}
    return {}


def _faults(exc: ValidationError, model: type) -> list[dict[str, Any]]:
    """Return pydantic's errors, with one error for a union, and without names of branches in `loc`."""
    merged: list[dict[str, Any]] = []
    for union, group in groupby(cast("list[dict[str, Any]]", exc.errors()), lambda fault: _union(model, fault["loc"])):
        faults = list(group)
        if union is None:
            merged += faults
            continue
        depth = len(union) + 1
        deeper = [fault for fault in faults if len(fault["loc"]) > depth]
        if deeper:  # the value has the type of a branch
            merged += [fault for fault in deeper if fault["loc"][:depth] == deeper[0]["loc"][:depth]]
        else:
            types = [_expected(fault, model) or fault["msg"].removeprefix("Input should be ") for fault in faults]
            merged.append(faults[0] | {"type": "union", "loc": union, "expected": ", or ".join(dict.fromkeys(types))})
    return [_at_key(fault | {"loc": tuple(part for part, _ in _steps(model, fault["loc"]))}) for fault in merged]


def _at_key(fault: dict[str, Any]) -> dict[str, Any]:
    """Return the fault of a key of a mapping, which pydantic marks with "[key]", as a fault at that key."""
    if fault["loc"][-1:] != ("[key]",):
        return fault
    fault = fault | {"loc": fault["loc"][:-1]}
    return fault | {"type": "unknown_key", "expected": fault.get("ctx", {}).get("expected", "text")}


def _expected(fault: dict[str, Any], model: type) -> str | None:
    """Return the expected type or values, if a value has the wrong type; else None."""
    if fault["type"] == "literal_error":
        return fault["ctx"]["expected"] if "expected" in fault or _union(model, fault["loc"]) is not None else None
    if fault["type"] == "model_type":
        return "a mapping of " + ", ".join(fields(_type_at(model, fault["loc"])))
    return fault.get("expected") or _EXPECTED.get(fault["type"])


def _union(model: type, loc: Sequence[str | int]) -> Sequence[str | int] | None:
    """Return the part of an error's location before the first name of a branch, or None without one."""
    length = len(list(_steps(model, loc, to_branch=True)))
    return loc[:length] if length < len(loc) else None


def _type_at(model: type, loc: Sequence[str | int]) -> Any:
    """Return the type at a location."""
    kind = model
    for _, inner in _steps(model, loc):
        kind = inner
    named = str(loc[-1]) if loc else ""
    return next((branch for branch in _branches(kind) if _named(branch, named)), _branches(kind)[0])


def _steps(model: type, loc: Sequence[str | int], *, to_branch: bool = False) -> Iterator[tuple[str | int, Any]]:
    """Yield (part, type) along an error's location, without names of branches; to_branch: end before the first."""
    kind = model
    for part in loc:
        branches = _branches(kind)
        if len(branches) > 1 and to_branch:
            return
        if len(branches) > 1:
            kind = next((branch for branch in branches if _named(branch, part)), Any)
            continue
        kind = _within(branches[0], part)
        yield part, kind


def _branches(kind: Any) -> list[Any]:
    """Return the types that a union allows besides None, or the type itself."""
    while get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    if get_origin(kind) not in (Union, UnionType):
        return [kind]
    return [branch for one in get_args(kind) if one is not type(None) for branch in _branches(one)]


def _named(branch: Any, part: str | int) -> bool:
    """Return whether `part` is pydantic's name of a branch: PixelWindow, dict[str,any], literal['region']."""
    return getattr(get_origin(branch) or branch, "__name__", str(branch)).lower() == str(part).partition("[")[0].lower()


def _within(kind: Any, part: str | int) -> Any:
    """Return the type of the field, value or item `part` of a type."""
    inner = [one for one in get_args(kind) if one is not Ellipsis]
    if get_origin(kind) is dict:
        return inner[1]
    if get_origin(kind) in (list, tuple) and inner:
        return inner[part] if isinstance(part, int) and part < len(inner) else inner[-1]
    return fields(kind).get(part, Any) if isinstance(part, str) else Any


def _lower_case(message: str) -> str:
    """Return a message with a lower-case first letter, unless its first word is in capitals."""
    return message if message[1:2].isupper() else message[0].lower() + message[1:]
