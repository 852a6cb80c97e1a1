"""Parameters of the charge traps: config/instrument/cti.yaml."""

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationInfo

from csstsim.base.model import Data, Number, between, validate
from csstsim.base.types import PathLike


@dataclass(frozen=True)
class Traps:
    """Charge traps (cti.yaml): the shape of the well, and the density and timescale of each species.

    For transfer along columns, densities are per pixel and timescales in row transfers. `serial` has the traps of a
    serial register, per element and in its transfers; None if the file has none.
    """

    beta: float
    full_well: float
    notch: float
    density: tuple[float, ...]
    timescale: tuple[float, ...]
    serial: "Traps | None" = None


@dataclass(frozen=True, eq=False, repr=False)
class _Well(Data):
    beta: Annotated[Number, between(0.01, 5)]
    full_well: Annotated[Number, between(1, 1e9)]
    notch: Annotated[Number, between(0, 1e9)]


def _same_length(values: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
    if len(values) != len(info.data.get("density", values)):
        raise ValueError("density and timescale must be lists of the same length")
    return values


Species = tuple[Annotated[Number, Field(gt=0, le=1e6)], ...]


@dataclass(frozen=True, eq=False, repr=False)
class _Species(Data):
    density: Species
    timescale: Annotated[Species, AfterValidator(_same_length)]


@dataclass(frozen=True, eq=False, repr=False)
class _Section(Data):
    well: _Well
    species: _Species

    def traps(self, serial: Traps | None = None) -> Traps:
        return Traps(**vars(self.well), **vars(self.species), serial=serial)


@dataclass(frozen=True, eq=False, repr=False)
class _File(_Section):
    serial: _Section | None = None


def load_traps(data: Any, path: PathLike) -> Traps:
    """Return the Traps of the content of cti.yaml. path: named in errors. Raises InputError."""
    file = validate(_File, data, path)
    return file.traps(file.serial.traps() if file.serial else None)
