"""Observation files: the layers an exposure is made with, in order. config/README.md is generated from the model."""

import copy
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import Field, field_validator

from csstsim.base.errors import InputError
from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.help_page import explained
from csstsim.base.model import Model, validate
from csstsim.base.types import PathLike


class Observation(Model):
    """How an exposure is made: the ordered list of layers, each a one-key mapping keyword -> obs_param."""

    layers: tuple[dict[str, dict[str, Any] | None], ...] = Field(min_length=1, description="layers in order")

    @field_validator("layers")
    @classmethod
    def _one_key_each(
        cls, value: tuple[dict[str, dict[str, Any] | None], ...]
    ) -> tuple[dict[str, dict[str, Any] | None], ...]:
        for entry in value:
            if len(entry) != 1:
                raise ValueError(f"each layer is one 'keyword: parameters' entry, not {sorted(entry)}")
        return value


@explained("observation")
def load_observation(path: PathLike) -> Observation:
    """Read and check an observation file (layers' own parameters are checked by SimSteps). Raises InputError."""
    return validate(Observation, read_yaml(path), path)


def changed_layers(
    changes: Mapping[str, dict[str, Any] | None],
    entries: Sequence[Mapping[str, dict[str, Any] | None]] | None,
    file: PathLike,
) -> tuple[dict[str, dict[str, Any] | None], ...]:
    """Return a list of layers with parameters changed, and layers omitted.

    changes: {keyword: {parameter: value}, or None to omit it}; entries: the list as Observation.layers, None for that
    of the observation file. Raises InputError, which names the file, for changes that cannot be used.
    """
    entries = entries or load_observation(file).layers
    if not isinstance(changes, dict) or any(not isinstance(change, dict | None) for change in changes.values()):
        allowed = "{keyword: {parameter: value}, or None}"
        raise InputError("cannot be used", file=file, key="layers", value=changes, allowed=allowed)
    known = [keyword for entry in entries for keyword in entry]
    given = {str(name).lower(): change for name, change in changes.items()}
    for name in given.keys() - set(map(str.lower, known)):
        omitted = name in (keyword.lower() for entry in load_observation(file).layers for keyword in entry)
        if not omitted or given[name] is not None:
            fault = "an earlier change omitted this layer" if omitted else "not a layer of the list"
            allowed = f"{', '.join(known)}; a list with others: observations={{'SCIE': file}}"
            raise InputError(fault, file=file, key="layers", value=name, allowed=allowed)
    result = []
    for entry in entries:
        [(keyword, param)] = entry.items()
        change = given.get(keyword.lower(), {})
        if change is not None:
            result.append({keyword: (param or {}) | change})
    return validate(Observation, {"layers": copy.deepcopy(result)}, file).layers
