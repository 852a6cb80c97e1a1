"""Numbers of the charge traps: config/instrument/cti.yaml, checked."""

from dataclasses import dataclass

from csstsim.base.errors import InputError
from csstsim.instrument.load import build, read_data


@dataclass(frozen=True)
class Traps:
    """Charge traps (cti.yaml): the well's shape and, of each species, density and timescale.

    Those met along a column are in pixels and transfers of a row; `serial` are those of a register, in its elements and
    transfers, or None if the file has none.
    """

    beta: float
    full_well: float
    notch: float
    density: tuple[float, ...]
    timescale: tuple[float, ...]
    serial: "Traps | None" = None


def load_traps(path):
    """Return Traps, or None if there is no such file. Raises InputError."""
    if not path.exists():
        return None
    data = read_data(path)
    serial = data.get("serial")
    return _traps(data, path, "", None if serial is None else _traps(serial, path, "serial.", None))


def _traps(data, path, at, serial):
    """Return Traps from a mapping with `well` and `species`; `at` is where it stands in the file."""
    if not isinstance(data, dict):
        raise InputError("must be a mapping", file=path, key=at.rstrip("."), value=data)
    species, key = data.get("species"), f"{at}species"
    lists = [species.get(name) if isinstance(species, dict) else None for name in ("density", "timescale")]
    if not all(isinstance(numbers, list) for numbers in lists) or len(lists[0]) != len(lists[1]):
        raise InputError("density and timescale must be lists of one length", file=path, key=key, value=species)
    for name, numbers in zip(("density", "timescale"), lists, strict=True):
        for number in numbers:
            if not isinstance(number, int | float) or not 0 < number <= 1e6:
                raise InputError("out of range", file=path, key=f"{key}.{name}", value=number, allowed="0 to 1e6")
    density, timescale = (tuple(map(float, numbers)) for numbers in lists)
    well = data.get("well")
    traps = build(Traps, well, path, f"{at}well", density=density, timescale=timescale, serial=serial)
    if not (traps.beta > 0 and traps.full_well > 0 and traps.notch >= 0):
        allowed = "beta and full_well above 0, notch 0 or more"
        raise InputError("out of range", file=path, key=f"{at}well", value=well, allowed=allowed)
    return traps
