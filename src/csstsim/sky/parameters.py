"""The numbers of the sky (config/instrument/sky.yaml), checked and as arrays."""

from dataclasses import dataclass

import numpy as np

from csstsim.base.errors import InputError
from csstsim.instrument.load import build


@dataclass(frozen=True)
class Door:
    """The aperture door (csstsim.sky.aperture_door); lengths in m, angles in deg."""

    tube_radius_m: float
    length_m: float
    opening_deg: float
    half_width_deg: float
    albedo: float


@dataclass(frozen=True, eq=False)
class SkyNumbers:
    """Units and meaning: the comments of sky.yaml. Lists of tuples are arrays, one row each."""

    solar_spectrum: np.ndarray  # (n, 2) angstrom, W m-2 um-1
    zodiacal: dict  # longitude (n,), latitude (m,), intensity (n, m), colour (2, 3), nearest
    albedo: float
    earth_spectrum: np.ndarray  # (n, 2)
    rings: int
    nominal_earth: float
    door: Door
    zenith: np.ndarray  # (n,) deg
    azimuth: np.ndarray  # (m,) deg
    transmittance: np.ndarray  # (n, m)
    sun_magnitude: float
    moon: dict
    planets: np.ndarray  # (n, 7)
    field: np.ndarray  # (2,) deg
    stars: np.ndarray  # (n, 4)


def sky_numbers(data, file="sky.yaml"):
    """Return SkyNumbers of what instrument.load.read_data gives for sky.yaml.

    Raises InputError for a missing or malformed entry, and if the file was not there (empty `data`).
    """
    if not data:
        raise InputError("the instrument folder has no numbers of the sky's light", file=file)
    try:
        zodiacal, table, bodies = data["zodiacal"], data["transmittance"], data["bodies"]
        arrays = {k: np.array(zodiacal[k], dtype=float) for k in ("longitude", "latitude", "intensity", "colour")}
        numbers = SkyNumbers(
            solar_spectrum=np.array(data["solar_spectrum"], dtype=float),
            zodiacal=arrays | {"nearest": float(zodiacal["nearest"])},
            albedo=float(data["earth"]["albedo"]),
            earth_spectrum=np.array(data["earth"]["spectrum"], dtype=float),
            rings=int(data["earth"]["rings"]),
            nominal_earth=float(data["earth"]["nominal"]),
            door=build(Door, data["door"], file, "door"),
            zenith=np.array(table["zenith"], dtype=float),
            azimuth=np.array(table["azimuth"], dtype=float),
            transmittance=np.array(table["matrix"], dtype=float),
            sun_magnitude=float(bodies["sun_magnitude"]),
            moon=bodies["moon"],
            planets=np.array(bodies["planets"], dtype=float),
            field=np.array(data["field"], dtype=float),
            stars=np.array(data["stars"], dtype=float),
        )
    except KeyError as exc:
        raise InputError("required key is missing", file=file, key=str(exc.args[0])) from None
    except (TypeError, ValueError) as exc:
        raise InputError(f"malformed: {exc}", file=file) from None
    _check(numbers, file)
    return numbers


def _check(numbers, file):
    rising = {
        "zodiacal.longitude": numbers.zodiacal["longitude"], "zodiacal.latitude": numbers.zodiacal["latitude"],
        "transmittance.zenith": numbers.zenith, "transmittance.azimuth": numbers.azimuth,
    }  # fmt: skip
    for key, axis in rising.items():
        if axis.ndim != 1 or (np.diff(axis) <= 0).any():
            raise InputError("must rise", file=file, key=key)
    for key, values, axes in (
        ("zodiacal.intensity", numbers.zodiacal["intensity"], list(rising.values())[:2]),
        ("transmittance.matrix", numbers.transmittance, list(rising.values())[2:]),
    ):
        if values.shape != tuple(len(axis) for axis in axes):
            raise InputError("rows and columns must fit its axes", file=file, key=key, value=values.shape)
        if (values <= 0).any():
            raise InputError("must be positive", file=file, key=key)
    if numbers.zenith[0] <= 0 or numbers.azimuth[0] < 0 or numbers.azimuth[-1] >= 360:
        raise InputError("zenith starts above 0, azimuth lies in 0..360", file=file, key="transmittance")
