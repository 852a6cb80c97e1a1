"""The laboratory maps listed in maps.yaml: the chips that have them, and the names of the files.

    prnu: {files: "maps/prnu_{chip}.fits", chips: [8, 9], source: "flats of March 2025", confidence: S}

{chip} is the chip's number with two digits; led_flats also have {led}, one of the wavelengths [nm] in leds.yaml,
`flat.wavelengths`. Names are relative to the instrument folder. Chips that are not listed have no map of that kind;
without `chips` all chips have one.
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
    """The entry of maps.yaml for a kind: the pattern of file names, and the chips with a map (None: all)."""

    files: str
    chips: list[Whole] | None = None
    source: str = ""  # this and confidence are checked by read_data
    confidence: str = ""


@dataclass(frozen=True, eq=False)
class ChipMaps:
    """The maps of one chip. A map is opened when it is first used; InputErrors are those of open_map.

    wavelengths: the LEDs [nm] whose flats the chip needs, because its filter transmits some of their light.
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
        """Return {name: LabMap} of the maps that one of these stages (base.stages) reads first."""
        kinds = [kind for kind in self.entries if STAGES[kind] in stages]
        maps = {kind: getattr(self, kind) for kind in kinds if kind != "led_flats"}
        flats = self.led_flats if "led_flats" in kinds else {}
        return maps | {f"led_flats.{wave:g}": flat for wave, flat in flats.items()}

    def digest(self, stages: Container[str]) -> str | None:
        """Return 16 hex digits of the content of these maps, or None if there are none."""
        maps = self.of(stages)
        return digest({name: [one.shape, one.datasum, one.maximum] for name, one in maps.items()}) if maps else None

    @property
    def record(self) -> dict[str, str]:
        """{name: file and DATASUM} of all maps, for headers."""
        maps = self.of(STAGES.values())
        return {f"maps.{name}": f"{one.path.name}, DATASUM {one.datasum}" for name, one in maps.items()}

    def _open(self, kind: str, led: str = "") -> LabMap | None:
        if kind not in self.entries or self.detector is None:
            return None
        name = self.entries[kind].files.replace("{chip}", f"{self.chip:02d}").replace("{led}", led)
        return open_map(relative_to_file(self.folder / FILE, name), KINDS[kind], self.detector)


NO_MAPS = ChipMaps({}, Path(), 0, None)


@explained("laboratory map")
def load_entries(folder: PathLike) -> dict[str, MapEntry]:
    """Return {kind: MapEntry} of the maps.yaml of an instrument folder; {} without the file.

    Raises InputError for an unknown kind or a wrong pattern of file names, and for a kind without source and
    confidence.
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
        provenance = {key: str(raw[kind][key]) for key in ("source", "confidence")}
        entries[kind] = validate(MapEntry, data | provenance, path, (kind,))
        _check_pattern(entries[kind].files, kind, path)
    return entries


def _check_pattern(pattern: str, kind: str, path: Path) -> None:
    """Raise InputError if a pattern of file names lacks a placeholder, or has special characters of globs."""
    placeholders = ("{chip}", "{led}") if kind == "led_flats" else ("{chip}",)
    rest = pattern
    for placeholder in placeholders:
        rest = rest.replace(placeholder, "")
    if any(placeholder not in pattern for placeholder in placeholders) or set("{}*?[]") & set(rest):
        allowed = f"with {' and '.join(placeholders)} in it, and no other {{, }}, *, ?, [ or ]"
        raise InputError("cannot be the files' name", file=path, key=f"{kind}.files", value=pattern, allowed=allowed)


def needed(wavelengths: Sequence[float], filter: "Filter") -> tuple[float, ...]:
    """Return those LED wavelengths [nm], rising, whose flats a Filter needs: flats are interpolated linearly."""
    passed = filter.wavelength[filter.throughput > 0] / 10
    below = [-np.inf, *wavelengths[:-1]]
    above = [*wavelengths[1:], np.inf]
    intervals = zip(wavelengths, below, above, strict=True)
    return tuple(wave for wave, low, high in intervals if low < passed[-1] and high > passed[0])


@explained("laboratory map")
def check_chips(entries: Mapping[str, MapEntry], folder: PathLike, chips: Iterable[int]) -> None:
    """Raise InputError if maps.yaml names a chip that is not one of `chips`, the numbers of the camera's chips."""
    for kind, entry in entries.items():
        unknown = sorted(set(entry.chips or ()) - set(chips))
        if unknown:
            allowed = ", ".join(map(str, sorted(chips)))
            path = Path(folder) / FILE
            raise InputError("no such chip", file=path, key=f"{kind}.chips", value=unknown[0], allowed=allowed)


def of_chip(entries: Mapping[str, MapEntry], chip: int) -> dict[str, MapEntry]:
    """Return the {kind: MapEntry} of one chip."""
    return {kind: entry for kind, entry in entries.items() if entry.chips is None or chip in entry.chips}


def map_files(entries: Mapping[str, MapEntry], names: Iterable[str]) -> set[str]:
    """Return those of some file names, relative to the instrument folder, that are maps.yaml or its maps."""
    patterns = [entry.files.replace("{chip}", "[0-9][0-9]").replace("{led}", "*") for entry in entries.values()]
    return {name for name in names if name == FILE or any(fnmatch(name, one.removeprefix("./")) for one in patterns)}
