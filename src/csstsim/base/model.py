"""Turns YAML files into typed models: the base classes, and one clear error for the first fault.

Files that a user writes become a `Model`. Numbers of the camera and the sky become frozen dataclasses derived from
`Data`, with the types below. These are plain objects, which can be hashed and replaced; pydantic checks them when they
are read.
"""

from dataclasses import is_dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Annotated, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    field_validator,
)

from csstsim.base.errors import InputError


class Model(BaseModel):
    """Base of models read from a file: frozen; unknown keys, NaN, infinity and true for a number are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _no_true_for_a_number(cls, value, info):
        given = value if isinstance(value, list) else [value]
        if bool not in _types(cls.model_fields[info.field_name].annotation) and any(
            v is True or v is False for v in given
        ):
            raise ValueError("true and false are not allowed here")
        return value


class Data:
    """Base of frozen dataclasses read from a file: unknown keys are errors and, with the types below, wrong types."""

    __pydantic_config__ = ConfigDict(extra="forbid")


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Whole = Annotated[int, Field(strict=True)]


def between(low, high, kind=Number):
    """Return the type of a number from `low` to `high`."""
    return Annotated[kind, Field(ge=low, le=high)]


def at_least(other):
    """Return the check that a number is not below that of the field `other`, which must come before it."""

    def check(value, info):
        if value < info.data.get(other, value):
            raise ValueError(f"must be at least {other}, {info.data[other]:g}")
        return value

    return AfterValidator(check)


def must(test, message):
    """Return the check that a value passes `test`; the error says `message`."""

    def check(value):
        if not test(value):
            raise ValueError(message)
        return value

    return AfterValidator(check)


def _real_path(value):
    if isinstance(value, str) and (not value.strip() or "\0" in value):
        raise ValueError("an empty path, or one with a NUL character")
    return value


FilePath = Annotated[Path, BeforeValidator(_real_path)]


def validate(model, data, file, key=()):
    """Return `model` built from `data`; the first fault becomes an InputError naming file, key, value, allowed."""
    try:
        return model.model_validate(data) if issubclass(model, BaseModel) else _adapter(model).validate_python(data)
    except ValidationError as exc:
        raise input_error(exc, model, file, key) from None


_adapter = cache(TypeAdapter)
_UNKNOWN = "extra_forbidden", "unexpected_keyword_argument"  # of a Model, of Data


def input_error(exc, model, file, key=()):
    """Turn a pydantic ValidationError into an InputError about its first fault."""
    fault = exc.errors()[0]
    if fault["type"] == "missing":  # as a key is that was misspelt
        extra = {str(e["loc"][-1]): e for e in exc.errors() if e["type"] in _UNKNOWN}
        fault = next((extra[key] for key in get_close_matches(str(fault["loc"][-1]), extra, 1)), fault)
    where = ".".join(str(part) for part in (*key, *fault["loc"]))
    more = f" (and {exc.error_count() - 1} more)" if exc.error_count() > 1 else ""
    if fault["type"] in _UNKNOWN:
        allowed = ", ".join(_known_keys(model, fault["loc"][:-1]))
        return InputError(f"unknown key{more}", file=file, key=where, value=fault["loc"][-1], allowed=allowed)
    if fault["type"] == "missing" and isinstance(fault["loc"][-1], int):
        where = where.rpartition(".")[0]
        return InputError(f"too few numbers{more}", file=file, key=where, value=fault["input"])
    if fault["type"] == "missing":
        return InputError(f"required key is missing{more}", file=file, key=where)
    message = "must be a mapping" if fault["type"] == "dataclass_type" else fault["msg"].removeprefix("Value error, ")
    return InputError(_in_a_line(message) + more, file=file, key=where, value=fault["input"])


def _in_a_line(message):
    """Return a message with a lower-case first letter; a name in capitals stays."""
    return message if message[1:2].isupper() else message[0].lower() + message[1:]


def _known_keys(model, loc):
    for part in loc:
        inner = [t for t in _types(_fields(model).get(part)) if isinstance(t, type) and issubclass(t, BaseModel | Data)]
        if not inner:
            return []
        model = inner[0]
    return sorted(_fields(model))


def _fields(model):
    """Return {name: type} of a Model's or dataclass' fields."""
    if is_dataclass(model):
        return get_type_hints(model)
    return {name: field.annotation for name, field in model.model_fields.items()}


def _types(annotation):
    args = getattr(annotation, "__args__", ())
    return [annotation, *(t for arg in args for t in _types(arg))]
