"""Validation of YAML files by typed models: the base classes, and one clear error for the first fault.

Files written by users become a `Model`. Parameters of the camera and the sky become frozen dataclasses derived from
`Data`, with the types below. These are plain objects, which can be hashed and replaced; pydantic checks them when they
are read.
"""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from pydantic.fields import FieldInfo

from csstsim.base.model_faults import input_error
from csstsim.base.types import PathLike

T = TypeVar("T")


class Model(BaseModel):
    """Base of models read from a file: frozen; unknown keys, NaN, infinity and booleans as numbers are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _no_boolean_as_number(cls, value: Any, info: ValidationInfo) -> Any:
        given = value if isinstance(value, list) else [value]
        if bool not in _types(cls.model_fields[str(info.field_name)].annotation) and any(
            v is True or v is False for v in given
        ):
            raise ValueError("true and false are not allowed here")
        return value


class Data:
    """Base of frozen dataclasses read from a file; unknown keys and, with the types below, wrong types are errors."""

    __pydantic_config__ = ConfigDict(extra="forbid")


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Whole = Annotated[int, Field(strict=True)]


def between(low: float, high: float) -> FieldInfo:
    """Return the constraint from `low` to `high` (included) for `Annotated[Number, between(low, high)]`."""
    return Field(ge=low, le=high)


def at_least(other: str) -> AfterValidator:
    """Return the check that a number is not below the field `other`, which must be defined before it."""

    def check(value: float, info: ValidationInfo) -> float:
        if value < info.data.get(other, value):
            raise ValueError(f"must be at least {other}, {info.data[other]:g}")
        return value

    return AfterValidator(check)


def require(test: Callable[[Any], bool], message: str) -> AfterValidator:
    """Return the check that a value passes `test`, with `message` as the error."""

    def check(value: Any) -> Any:
        if not test(value):
            raise ValueError(message)
        return value

    return AfterValidator(check)


def _checked_path(value: Any) -> Any:
    if isinstance(value, str) and (not value.strip() or "\0" in value):
        raise ValueError("an empty path, or one with a NUL character")
    return value


FilePath = Annotated[Path, BeforeValidator(_checked_path)]


def validate(model: type[T], data: Any, file: PathLike, key: Sequence[str | int] = ()) -> T:
    """Return `model` built from `data`; the first fault becomes an InputError naming file, key, value, allowed."""
    try:
        return model.model_validate(data) if issubclass(model, BaseModel) else _adapter(model).validate_python(data)  # type: ignore[arg-type]  # a class is hashable
    except ValidationError as exc:
        raise input_error(exc, model, file, key) from None


_adapter = cache(TypeAdapter)


def _types(annotation: Any) -> list[Any]:
    args = getattr(annotation, "__args__", ())
    return [annotation, *(t for arg in args for t in _types(arg))]
