"""Numbers of the charge traps: config/instrument/cti.yaml, checked."""

from dataclasses import dataclass

from csstsim.errors import InputError
from csstsim.instrument.load import build, read_data


@dataclass(frozen=True)
class Traps:
    """Charge traps met along a column: the well's shape and, of each species, density and timescale (cti.yaml)."""

    beta: float
    full_well: float
    notch: float
    density: tuple[float, ...]
    timescale: tuple[float, ...]


def load_traps(path):
    """Return Traps, or None if there is no such file. Raises InputError."""
    if not path.exists():
        return None
    data = read_data(path)
    species = data.get("species")
    lists = [species.get(name) if isinstance(species, dict) else None for name in ("density", "timescale")]
    if not all(isinstance(numbers, list) for numbers in lists) or len(lists[0]) != len(lists[1]):
        raise InputError("density and timescale must be lists of one length", file=path, key="species", value=species)
    for name, numbers in zip(("density", "timescale"), lists, strict=True):
        for number in numbers:
            if not isinstance(number, int | float) or not 0 < number <= 1e6:
                raise InputError("out of range", file=path, key=f"species.{name}", value=number, allowed="0 to 1e6")
    density, timescale = (tuple(map(float, numbers)) for numbers in lists)
    traps = build(Traps, data.get("well"), path, "well", density=density, timescale=timescale)
    if not (traps.beta > 0 and traps.full_well > 0 and traps.notch >= 0):
        allowed = "beta and full_well above 0, notch 0 or more"
        raise InputError("out of range", file=path, key="well", value=data["well"], allowed=allowed)
    return traps
