"""Observation files: the layers an exposure is made with, in order. config/README.md is generated from the model."""

from typing import Any

from pydantic import Field, field_validator

from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.help_page import explained
from csstsim.base.model import Model, validate


class Observation(Model):
    """How an exposure is made: the ordered list of layers, each a one-key mapping keyword -> obs_param."""

    layers: tuple[dict[str, dict[str, Any] | None], ...] = Field(min_length=1, description="layers in order")

    @field_validator("layers")
    @classmethod
    def _one_key_each(cls, value):
        for entry in value:
            if len(entry) != 1:
                raise ValueError(f"each layer is one 'keyword: parameters' entry, not {sorted(entry)}")
        return value


@explained("observation")
def load_observation(path):
    """Read and check an observation file (layers' own parameters are checked by SimSteps). Raises InputError."""
    return validate(Observation, read_yaml(path), path)
