"""The laboratory maps that maps.yaml names: which chips have them, and where the files lie.

    prnu: {files: "maps/prnu_{chip}.fits", chips: [8, 9], source: "flats of March 2025", confidence: S}

{chip} is the chip's number with two digits; led_flats also have {led}, a wavelength [nm] of leds.yaml,
`flat.wavelengths`. A relative name begins in the instrument folder. Chips that are not listed have no map of that kind;
without `chips` all have one.
"""

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.files.relative_to_file import relative_to_file
from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.help_page import explained
from csstsim.base.model import Data, Whole, validate
from csstsim.base.types import PathLike
from csstsim.instrument.load import read_data
from csstsim.instrument.maps.kinds import KINDS
from csstsim.instrument.maps.lab_map import LabMap, open_map

if TYPE_CHECKING:
    from csstsim.instrument.chip import Detector
    from csstsim.instrument.filter import Filter

# The stage that reads a kind first (base.stages.read_by)
STAGES = {"led_flats": "render", "prnu": "render", "bad_pixels": "readout", "bias": "readout"}
FILE = "maps.yaml"


@dataclass(frozen=True)
class MapEntry(Data):
    """What maps.yaml says of a kind: the pattern of the files' names, and the chips that have them (None: all)."""

    files: str
    chips: list[Whole] | None = None
    source: str = ""  # read_data has checked these two
    confidence: str = ""


@dataclass(frozen=True, eq=False)
class ChipMaps:
    """The maps of one chip; each is looked for when it is asked for first. Raises InputError as open_map.

    wavelengths: the LEDs [nm] whose flats the chip needs, because its filter lets some of their light pass.
    """

    entries: dict[str, MapEntry]
    folder: Path
    chip: int
    detector: "Detector | None"
    wavelengths: tuple[float, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.entries)

    @cached_property
    def prnu(self) -> LabMap | None:
        """The response of each pixel, or None."""
        return self._open("prnu")

    @cached_property
    def bad_pixels(self) -> LabMap | None:
        """Hot and dead pixels and bad columns, or None."""
        return self._open("bad_pixels")

    @cached_property
    def bias(self) -> LabMap | None:
        """The bias structure, or None."""
        return self._open("bias")

    @cached_property
    def led_flats(self) -> dict[float, LabMap]:
        """{wavelength [nm]: flat} of the wavelengths that the chip needs; {} without maps of flats."""
        opened = {wave: self._open("led_flats", f"{wave:g}") for wave in self.wavelengths}
        return {wave: flat for wave, flat in opened.items() if flat is not None}

    def of(self, stages: Container[str]) -> dict[str, LabMap]:
        """Return {name: LabMap} of the maps that one of some stages (base.stages) reads first."""
        kinds = [kind for kind in self.entries if STAGES[kind] in stages]
        found = {kind: getattr(self, kind) for kind in kinds if kind != "led_flats"}
        flats = self.led_flats if "led_flats" in kinds else {}
        return found | {f"led_flats.{wave:g}": flat for wave, flat in flats.items()}

    def digest(self, stages: Container[str]) -> str | None:
        """Return 16 hex digits of the content of these maps, or None if there are none."""
        found = self.of(stages)
        return digest({name: [one.shape, one.datasum, one.maximum] for name, one in found.items()}) if found else None

    @property
    def record(self) -> dict[str, str]:
        """{name: file and DATASUM} of all maps, for headers."""
        found = self.of(STAGES.values())
        return {f"maps.{name}": f"{one.path.name}, DATASUM {one.datasum}" for name, one in found.items()}

    def _open(self, kind: str, led: str = "") -> LabMap | None:
        if kind not in self.entries or self.detector is None:
            return None
        name = self.entries[kind].files.replace("{chip}", f"{self.chip:02d}").replace("{led}", led)
        return open_map(relative_to_file(self.folder / FILE, name), KINDS[kind], self.detector)


NO_MAPS = ChipMaps({}, Path(), 0, None)


@explained("laboratory map")
def load_entries(folder: PathLike) -> dict[str, MapEntry]:
    """Return {kind: MapEntry} of the maps.yaml of an instrument folder; {} without the file.

    Raises InputError for an unknown kind or place in a name, and for a kind without source and confidence.
    """
    path = Path(folder) / FILE
    if not path.exists():
        return {}
    raw = read_yaml(path)
    entries = {}
    for kind, data in read_data(path).items():
        if kind not in KINDS:
            raise InputError("unknown map", file=path, key=kind, allowed=", ".join(KINDS))
        if not isinstance(data, dict) or not raw[kind].get("source"):
            raise InputError("source and confidence are missing", file=path, key=kind)
        about = {key: str(raw[kind][key]) for key in ("source", "confidence")}
        entries[kind] = validate(MapEntry, data | about, path, (kind,))
        _check_name(entries[kind].files, kind, path)
    return entries


def _check_name(name: str, kind: str, path: Path) -> None:
    """Raise InputError if a name lacks a place that each of its files fills, or has characters of patterns."""
    places = ("{chip}", "{led}") if kind == "led_flats" else ("{chip}",)
    rest = name
    for place in places:
        rest = rest.replace(place, "")
    if any(place not in name for place in places) or set("{}*?[]") & set(rest):
        allowed = f"with {' and '.join(places)} in it, and no other {{, }}, *, ?, [ or ]"
        raise InputError("cannot be the files' name", file=path, key=f"{kind}.files", value=name, allowed=allowed)


def needed(wavelengths: Sequence[float], filter: "Filter") -> tuple[float, ...]:
    """Return those LED wavelengths [nm], rising, whose flats count for a Filter: flats are linear between them."""
    seen = filter.wavelength[filter.throughput > 0] / 10
    below = [-np.inf, *wavelengths[:-1]]
    above = [*wavelengths[1:], np.inf]
    around = zip(wavelengths, below, above, strict=True)
    return tuple(wave for wave, low, high in around if low < seen[-1] and high > seen[0])


@explained("laboratory map")
def check_chips(entries: Mapping[str, MapEntry], folder: PathLike, chips: Iterable[int]) -> None:
    """Raise InputError if maps.yaml names a chip that is not one of `chips`, the camera's numbers."""
    for kind, entry in entries.items():
        unknown = sorted(set(entry.chips or ()) - set(chips))
        if unknown:
            allowed = ", ".join(map(str, sorted(chips)))
            path = Path(folder) / FILE
            raise InputError("no such chip", file=path, key=f"{kind}.chips", value=unknown[0], allowed=allowed)


def of_chip(entries: Mapping[str, MapEntry], chip: int) -> dict[str, MapEntry]:
    """Return the entries of one chip."""
    return {kind: entry for kind, entry in entries.items() if entry.chips is None or chip in entry.chips}


def map_files(entries: Mapping[str, MapEntry], names: Iterable[str]) -> set[str]:
    """Return those of some names of files, relative to the instrument folder, that are maps.yaml or its maps."""
    patterns = [entry.files.replace("{chip}", "[0-9][0-9]").replace("{led}", "*") for entry in entries.values()]
    return {name for name in names if name == FILE or any(fnmatch(name, one.removeprefix("./")) for one in patterns)}
