"""The numbers of the sky (config/instrument/sky.yaml); the comments there give units and meaning."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import numpy as np
from pydantic import AfterValidator, BeforeValidator, ValidationInfo

from csstsim.base.errors import InputError
from csstsim.base.model import Data, Number, Positive, Whole, require, validate
from csstsim.base.types import FloatArray, PathLike

if TYPE_CHECKING:
    Array: TypeAlias = FloatArray
else:
    Array = Any  # pydantic knows no arrays: `_array` makes and checks them


def _array(*shape: int | None) -> BeforeValidator:
    """Return what makes a float array of a value: of this shape, where None means any length; null is read as NaN."""

    def made(value: Any) -> FloatArray:
        try:
            values = np.array(value, dtype=float)
        except TypeError as exc:
            raise ValueError(str(exc)) from None
        if values.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, values.shape, strict=True)):
            raise ValueError(f"must be numbers of shape {shape} (None: any length)")
        return values

    return BeforeValidator(made)


def _table(*axes: str) -> AfterValidator:
    """Return the check that a table is of positive numbers, with the fields `axes` along its rows and columns."""

    def check(values: FloatArray, info: ValidationInfo) -> FloatArray:
        if values.shape != tuple(len(info.data[axis]) for axis in axes if axis in info.data):
            raise ValueError("rows and columns must fit its axes")
        if (values <= 0).any():  # NaN passes
            raise ValueError("must be positive")
        return values

    return AfterValidator(check)


def _rows(value: Any) -> Any:
    """Return the rows of numbers in a text, "1 2, 3 4": YAML reads thousands of numbers as one scalar; lists as is."""
    if not isinstance(value, str):
        return value
    return [[float(number) for number in row.split()] for row in value.split(",")]


Axis = Annotated[Array, _array(None), require(lambda axis: (np.diff(axis) > 0).all(), "must rise")]


@dataclass(frozen=True, eq=False)
class Zodiacal(Data):
    """Zodiacal light by |helio-ecliptic longitude| and |ecliptic latitude|."""

    longitude: Axis
    latitude: Axis
    intensity: Annotated[Array, _array(None, None), _table("longitude", "latitude")]
    colour: Annotated[Array, _array(2, 3)]
    nearest: Number


@dataclass(frozen=True, eq=False)
class Earth(Data):
    """The Earth in sunlight."""

    albedo: Number
    spectrum: Annotated[Array, _array(None, 2)]
    rings: Whole
    nominal: Number


@dataclass(frozen=True)
class ApertureDoor(Data):
    """The aperture door (csstsim.optics.sky.aperture_door); lengths in m, angles in deg."""

    tube_radius_m: Number
    length_m: Number
    opening_deg: Number
    half_width_deg: Number
    albedo: Number


@dataclass(frozen=True, eq=False)
class Transmittance(Data):
    """Point-source transmittance by angles from the line of sight [deg]."""

    zenith: Annotated[Axis, require(lambda axis: axis[0] > 0, "must start above 0")]
    azimuth: Annotated[Axis, require(lambda axis: axis[0] >= 0 and axis[-1] < 360, "must lie in 0..360")]
    matrix: Annotated[Array, _array(None, None), _table("zenith", "azimuth")]


@dataclass(frozen=True)
class Moon(Data):
    """Moonlight by phase."""

    magnitude: Number
    distance_km: Number
    phase: list[Number]


@dataclass(frozen=True, eq=False)
class Bodies(Data):
    """The Sun, the Moon and planets."""

    sun_magnitude: Number
    moon: Moon
    planets: Annotated[Array, _array(None, 7)]


@dataclass(frozen=True, eq=False)
class Starlight(Data):
    """Stars too faint for the list, together: stars of V = 10 per square degree by |galactic latitude| [deg]."""

    latitude: Axis
    brightness: Annotated[Array, _array(None), require(lambda light: (light >= 0).all(), "must not be negative")]
    temperature: Positive


@dataclass(frozen=True, eq=False)
class SkyNumbers(Data):
    """All of sky.yaml."""

    solar_spectrum: Annotated[Array, _array(None, 2)]
    zodiacal: Zodiacal
    earth: Earth
    door: ApertureDoor
    transmittance: Transmittance
    bodies: Bodies
    starlight: Starlight
    stars: Annotated[Array, _array(None, 4), BeforeValidator(_rows)]


def sky_numbers(data: Mapping[str, Any], file: PathLike = "sky.yaml") -> SkyNumbers:
    """Return the SkyNumbers of `data`, as instrument.load.read_data returns it for sky.yaml.

    Raises InputError for a missing or malformed entry, and if the file is missing (empty `data`).
    """
    if not data:
        raise InputError("the instrument folder has no sky parameters", file=file)
    return validate(SkyNumbers, data, file)
