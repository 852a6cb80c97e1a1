"""How a YAML file becomes a typed model: the base of all models, and one clear error for the first fault."""

from difflib import get_close_matches
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError, field_validator

from csstsim.base.errors import InputError


class Model(BaseModel):
    """Base of every model read from a file: frozen; an unknown key, NaN, infinity or true for a number is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_true_for_a_number(cls, value, info):
        given = value if isinstance(value, list) else [value]
        if bool not in _types(cls.model_fields[info.field_name].annotation) and any(
            v is True or v is False for v in given
        ):
            raise ValueError("true and false are no values here")
        return value


def _real_path(value):
    if isinstance(value, str) and (not value.strip() or "\0" in value):
        raise ValueError("an empty path, or one with a NUL character")
    return value


FilePath = Annotated[Path, BeforeValidator(_real_path)]


def validate(model, data, file, key=()):
    """Return `model` built from `data`; the first fault becomes an InputError naming file, key, value, allowed."""
    try:
        return model.model_validate(data)
    except ValidationError as exc:
        raise input_error(exc, model, file, key) from None


def input_error(exc, model, file, key=()):
    """Turn a pydantic ValidationError into an InputError about its first fault."""
    fault = exc.errors()[0]
    if fault["type"] == "missing":  # as a key is that was misspelt
        extra = {str(e["loc"][-1]): e for e in exc.errors() if e["type"] == "extra_forbidden"}
        fault = next((extra[key] for key in get_close_matches(str(fault["loc"][-1]), extra, 1)), fault)
    where = ".".join(str(part) for part in (*key, *fault["loc"]))
    more = f" (and {exc.error_count() - 1} more)" if exc.error_count() > 1 else ""
    if fault["type"] == "extra_forbidden":
        allowed = ", ".join(_known_keys(model, fault["loc"][:-1]))
        return InputError(f"unknown key{more}", file=file, key=where, value=fault["loc"][-1], allowed=allowed)
    if fault["type"] == "missing":
        return InputError(f"required key is missing{more}", file=file, key=where)
    message = fault["msg"].removeprefix("Value error, ")
    return InputError(_in_a_line(message) + more, file=file, key=where, value=fault["input"])


def _in_a_line(message):
    """Return a message without its capital; a name in capitals stays."""
    return message if message[1:2].isupper() else message[0].lower() + message[1:]


def _known_keys(model, loc):
    for part in loc:
        field = model.model_fields.get(part) if isinstance(part, str) else None
        inner = (
            [t for t in _types(field.annotation) if isinstance(t, type) and issubclass(t, BaseModel)] if field else []
        )
        if not inner:
            return []
        model = inner[0]
    return sorted(model.model_fields)


def _types(annotation):
    args = getattr(annotation, "__args__", ())
    return [annotation, *(t for arg in args for t in _types(arg))]
