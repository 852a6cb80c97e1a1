"""Turns YAML files into typed models: the base classes, and one clear error for the first fault.

Files that a user writes become a `Model`. Numbers of the camera and the sky become frozen dataclasses derived from
`Data`, with the types below. These are plain objects, which can be hashed and replaced; pydantic checks them when they
are read.
"""

from functools import cache
from pathlib import Path
from typing import Annotated

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

from csstsim.base.model_faults import input_error


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


def _types(annotation):
    args = getattr(annotation, "__args__", ())
    return [annotation, *(t for arg in args for t in _types(arg))]
