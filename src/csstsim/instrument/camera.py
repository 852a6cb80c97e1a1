"""The camera: all data files of an instrument folder (config/instrument/README.md), read and checked."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.help_page import explained
from csstsim.base.model import Data, validate
from csstsim.base.shipped import SHIPPED
from csstsim.base.stages import read_by, with_dependencies
from csstsim.base.types import PathLike
from csstsim.instrument.camera_parts import READERS
from csstsim.instrument.chip import Chip, ChipEntry, Detector, DetectorNumbers
from csstsim.instrument.cosmic_rays import CosmicRays
from csstsim.instrument.defects import Defects
from csstsim.instrument.files import InstrumentFiles
from csstsim.instrument.filter import Filter, FilterEntry
from csstsim.instrument.grating import Gratings, load_gratings
from csstsim.instrument.load import read_data
from csstsim.instrument.maps.chip_maps import NO_MAPS, ChipMaps, check_chips, needed, of_chip
from csstsim.instrument.orbit import Orbit
from csstsim.instrument.telescope import Telescope
from csstsim.instrument.traps import load_traps

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True, eq=False, repr=False)
class _TelescopeFile(Data):
    telescope: Telescope
    orbit: Orbit


class TelescopeData(NamedTuple):
    """The content of telescope.yaml."""

    telescope: Telescope
    orbit: Orbit


@dataclass(frozen=True, eq=False)
class Camera:
    """The Survey Camera as described by its data files; `digest` is that of their content."""

    chips: dict[int, Chip]
    filters: dict[str, Filter]
    telescope: Telescope
    orbit: Orbit
    detector: Detector
    keywords: list[dict[str, Any]]  # level-0 header entries of level0_keywords.yaml; empty without the file
    psf: dict[str, Any]  # psf.yaml; empty without the file
    scatter: dict[str, Any]  # scatter.yaml; empty without the file
    ghosts: dict[str, Any]  # ghosts.yaml; empty without the file
    sky: dict[str, Any]  # sky.yaml; empty without the file
    leds: dict[str, Any]  # leds.yaml and `mosaic`, its columns and rows; empty without the file
    files: InstrumentFiles

    @property
    def folder(self) -> Path:
        """Path of the instrument folder."""
        return self.files.folder

    @property
    def digest(self) -> str:
        """16 hex digits of all data files, and of the parameters that a campaign changes."""
        return self.files.digest

    @property
    def shipped(self) -> bool:
        """Whether this is the shipped camera without changed parameters."""
        return self.folder == SHIPPED / "instrument" and not self.files.changes

    @cached_property
    def bands(self) -> dict[str, Filter]:
        """{name in lower case, as in columns' names: Filter} of the imaging filters, in the order of filters.yaml."""
        return {name.lower(): filter_ for name, filter_ in self.filters.items() if filter_.kind == "imaging"}

    @property
    def imaging_chips(self) -> list[Chip]:
        """Chips with imaging filters, by number."""
        return [chip for chip in self.chips.values() if chip.kind == "imaging"]

    @property
    def slitless_chips(self) -> list[Chip]:
        """Chips with gratings, by number."""
        return [chip for chip in self.chips.values() if chip.kind == "slitless"]

    def digest_for(self, stage: str, *layers: str, chip: Chip | None = None) -> str:
        """Return the digest, 16 hex digits, of the parameters read by a stage and the stages before it (camera_parts).

        layers: further stages whose parameters may be read, because a user's own layer may read any. chip: a Chip whose
        laboratory maps are read, too. Raises InputError for a map that cannot be used.
        """
        stages = with_dependencies(stage).union(layers)
        numbers = digest(read_by(stages, self.files.parts, READERS))
        maps = chip and chip.maps.digest(stages)
        return digest([numbers, maps]) if maps else numbers

    @cached_property
    def gratings(self) -> dict[int, Gratings]:
        """{chip id: instrument.grating.Gratings} of the slitless chips. Raises InputError."""
        if not self.files.exists("gratings"):
            raise InputError("the instrument folder has no gratings", file=self.files.path("gratings"))
        if self.digest not in _GRATINGS:
            chips = {chip.id: chip for chip in self.slitless_chips}
            data = self.files.data("gratings")
            read = load_gratings(self.folder / "gratings", data, chips, self.filters, self.telescope)
            _GRATINGS.clear()
            _GRATINGS[self.digest] = read
        return _GRATINGS[self.digest]


# {digest of the last camera: its gratings}, because a process may open its campaign many times
_GRATINGS: dict[str, dict[int, Gratings]] = {}


@explained("instrument")
def load_camera(instrument: PathLike | Mapping[str, Any] | None = None, campaign: PathLike | None = None) -> Camera:
    """Return the Camera of an instrument folder (config/instrument/README.md), or of the shipped one with changes.

    instrument: as for instrument.files.InstrumentFiles; campaign: the file that gives it, named in errors. Raises
    InputError with file, key and value.
    """
    try:
        files = InstrumentFiles(instrument)
    except InputError as error:
        raise InputError(str(error), file=campaign) from None
    try:
        return _camera(files)
    except InputError as error:
        if not files.changes:
            raise
        changed = ", ".join(f"{name}: {value}" for name, value in files.changes.items())
        raise InputError(f"{error}; `instrument` has {changed}", file=campaign) from None


def _camera(files: InstrumentFiles) -> Camera:
    detector = _detector(files)
    filters = _filters(files)
    telescope, orbit = _telescope(files.data("telescope"), files.path("telescope"))
    more = {
        name: files.data(name) if files.exists(name) else {} for name in ("psf", "scatter", "ghosts", "sky", "leds")
    }
    chips = _chips(files, filters, detector, telescope, more["leds"])
    if more["leds"]:
        more["leds"] |= {"mosaic": tuple(max(getattr(c, of) for c in chips.values()) for of in ("column", "row"))}
    keywords = "level0_keywords"
    return Camera(
        chips=chips,
        filters=filters,
        telescope=telescope,
        orbit=orbit,
        detector=detector,
        keywords=_only_list(files, keywords) if files.exists(keywords) else [],
        **more,
        files=files,
    )


def _detector(files: InstrumentFiles) -> Detector:
    numbers = validate(DetectorNumbers, files.sections("detector"), files.path("detector"))
    effects: dict[str, Any] = {
        name: validate(kind, files.sections(name), files.path(name))
        for name, kind in (("cosmic_rays", CosmicRays), ("defects", Defects))
        if files.exists(name)
    }
    if files.exists("brighter_fatter"):
        effects["brighter_fatter"] = files.data("brighter_fatter")
    traps = load_traps(files.data("cti"), files.path("cti")) if files.exists("cti") else None
    return Detector(**vars(numbers), **effects, traps=traps)


def load_telescope(path: PathLike) -> TelescopeData:
    """Return the TelescopeData of a file telescope.yaml. Raises InputError."""
    return _telescope(read_data(path), path)


def _telescope(data: Mapping[str, Any], path: PathLike) -> TelescopeData:
    file = validate(_TelescopeFile, data, path)
    return TelescopeData(file.telescope, file.orbit)


def _filters(files: InstrumentFiles) -> dict[str, Filter]:
    path = files.path("filters")
    entries = {name: validate(FilterEntry, entry, path, (name,)) for name, entry in files.data("filters").items()}
    filters = {name: entry.filter(name) for name, entry in entries.items()}
    columns = [name.lower() for name in filters]
    for name in filters:
        if not _NAME.fullmatch(name) or columns.count(name.lower()) > 1:
            allowed = "letters, digits and _, a letter first; names must differ in more than case: they name columns"
            raise InputError("not a valid name of a filter", file=path, key=name, allowed=allowed)
    return filters


def _chips(
    files: InstrumentFiles,
    filters: Mapping[str, Filter],
    detector: Detector,
    telescope: Telescope,
    leds: Mapping[str, Any],
) -> dict[int, Chip]:
    chips: dict[int, Chip] = {}
    path = files.path("chips")
    for i, row in enumerate(_only_list(files, "chips")):
        entry = validate(ChipEntry, row, path, (f"chips[{i}]",))
        if entry.filter not in filters:
            raise InputError(
                "unknown filter", file=path, key=f"chips[{i}].filter", value=entry.filter, allowed=", ".join(filters)
            )
        if entry.id in chips:
            raise InputError("another chip has this id", file=path, key=f"chips[{i}].id", value=entry.id)
        kind = filters[entry.filter].kind
        maps = _maps(files, entry.id, detector, leds, filters[entry.filter])
        chips[entry.id] = Chip(**vars(entry), kind=kind, detector=detector, telescope=telescope, maps=maps)
    check_chips(files.maps, files.folder, chips)
    return dict(sorted(chips.items()))


def _maps(files: InstrumentFiles, chip: int, detector: Detector, leds: Mapping[str, Any], filter: Filter) -> ChipMaps:
    """Return the ChipMaps of a chip with a filter."""
    entries = of_chip(files.maps, chip)
    led_wavelengths: tuple[float, ...] = ()
    if "led_flats" in entries:
        flat = leds.get("flat")
        wavelengths: Any = flat.get("wavelengths") if isinstance(flat, dict) else None
        numbers = isinstance(wavelengths, list) and all(type(wave) in (int, float) for wave in wavelengths)
        if not numbers or len(wavelengths) < 2 or sorted(set(wavelengths)) != wavelengths:
            raise InputError(
                "missing or out of range, but maps.yaml has led_flats",
                file=files.path("leds"),
                key="flat.wavelengths",
                value=wavelengths,
                allowed="two numbers or more, rising",
            )
        led_wavelengths = needed(wavelengths, filter)
    return ChipMaps(entries, files.folder, chip, detector, led_wavelengths) if entries else NO_MAPS


def _only_list(files: InstrumentFiles, name: str) -> list[Any]:
    """Return the one list that the file's sections hold."""
    lists = [value for value in files.data(name).values() if isinstance(value, list)]
    if len(lists) != 1:
        raise InputError(f"the file must hold one list, not {len(lists)}", file=files.path(name))
    return lists[0]
