"""config/render.yaml, checked: presets, costs and the coefficients of the predicted error."""

from functools import cache
from pathlib import Path
from typing import Literal, TypeAlias, TypeVar

from pydantic import Field

from csstsim.base.model import Model, NotNegative, validate
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data

FILE = SHIPPED / "render.yaml"
Fidelity: TypeAlias = Literal["preview", "standard", "noise_free"]
CostT = TypeVar("CostT", bound=Model)


class Preset(Model):
    """Accuracy limits of one fidelity."""

    eps: float = Field(ge=0, description="error allowed, in units of an object's own noise")
    floor: float = Field(ge=0, description="S/N below which an object's light goes to a smooth background")


class StampError(Model):
    """Error of stamps as a fraction of S/N, in addition to `psf`."""

    cut: float = Field(ge=0)
    disk: float = Field(ge=0)
    bulge: float = Field(ge=0)


class Error(Model):
    """Coefficients of render.error_model."""

    size: float = Field(gt=0)
    bright: float = Field(gt=0)
    far: float = Field(gt=0)
    psf: dict[Literal[2, 4], float] = Field(min_length=2, description="fraction of S/N, by cells of the PSF to a pixel")
    stamp: StampError
    slabs: dict[Literal[1, 2, 4, 8], float] = Field(
        min_length=4, description="fraction of S/N of lines, by slabs to a pixel"
    )
    slabs_flat: dict[Literal[1, 2, 4, 8], float] = Field(min_length=4, description="the same, of a flat spectrum")
    bins: float = Field(gt=0, description="fraction of S/N, of a spectrum in bins of a pixel")


class Numbers(Model):
    """The contents of config/render.yaml."""

    presets: dict[Fidelity, Preset] = Field(min_length=3)
    cost: dict[str, NotNegative] = Field(min_length=1, description="CPU time [ns], of all methods")
    error: Error


@cache
def load_numbers(file: Path = FILE) -> Numbers:
    """Return the Numbers of config/render.yaml. Raises InputError."""
    return validate(Numbers, read_data(file), file)


def load_cost(cost: type[CostT], file: Path = FILE) -> CostT:
    """Return the constants of a method's cost, a Model with a field for each, from config/render.yaml.

    Raises InputError for a constant that is missing.
    """
    known = load_numbers(file).cost
    return validate(cost, {name: known[name] for name in cost.model_fields if name in known}, file, ("cost",))
