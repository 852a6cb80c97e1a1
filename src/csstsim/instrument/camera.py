"""The camera: every data file of an instrument folder (config/instrument/README.md), read and checked as one object."""

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from csstsim.base.digest import digest
from csstsim.base.errors import InputError
from csstsim.base.help_page import explained
from csstsim.base.model import Data, validate
from csstsim.base.stages import behind, read_by
from csstsim.instrument.camera_parts import READERS, camera_parts
from csstsim.instrument.chip import Chip, ChipPlace, Detector, DetectorNumbers
from csstsim.instrument.cosmic_rays import CosmicRays
from csstsim.instrument.defects import Defects
from csstsim.instrument.filter import Filter, FilterEntry
from csstsim.instrument.grating import load_gratings
from csstsim.instrument.load import folder_digest, read_data, read_sections
from csstsim.instrument.orbit import Orbit
from csstsim.instrument.telescope import Telescope
from csstsim.instrument.traps import load_traps

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True, eq=False, repr=False)
class _TelescopeFile(Data):
    telescope: Telescope
    orbit: Orbit


@dataclass(frozen=True, eq=False)
class Camera:
    """The Survey Camera as its data files describe it; `digest` is that of their content."""

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
    leds: dict[str, Any]  # leds.yaml, and `mosaic`: (columns, rows) of chips; empty without the file
    folder: Path
    digest: str

    @cached_property
    def bands(self):
        """{name in lower case, as in columns' names: Filter} of the imaging filters, in the order of filters.yaml."""
        return {name.lower(): filter_ for name, filter_ in self.filters.items() if filter_.kind == "imaging"}

    @property
    def imaging_chips(self):
        """Chips behind the imaging filters, by number."""
        return [chip for chip in self.chips.values() if chip.kind == "imaging"]

    @property
    def slitless_chips(self):
        """Chips behind the gratings, by number."""
        return [chip for chip in self.chips.values() if chip.kind == "slitless"]

    @cached_property
    def _parts(self):
        return camera_parts(self.folder)

    def digest_for(self, stage, *layers):
        """Return the digest, 16 hex digits, of the numbers read by a stage and those before it (camera_parts).

        layers: further stages whose numbers it may read; a user's own layer may read any.
        """
        return digest(read_by(behind(stage).union(layers), self._parts, READERS))

    @cached_property
    def gratings(self):
        """{chip id: instrument.grating.Gratings} of the slitless chips. Raises InputError."""
        file = self.folder / "gratings.yaml"
        if not file.exists():
            raise InputError("the instrument folder has no gratings", file=file)
        chips = {chip.id: chip for chip in self.slitless_chips}
        return load_gratings(self.folder / "gratings", read_data(file), chips, self.filters, self.telescope)


@explained("instrument")
def load_camera(folder):
    """Read an instrument folder (config/instrument/README.md). Raises InputError naming file, key and value."""
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError("no such instrument folder", file=folder)
    detector = _detector(folder / "detector.yaml")
    filters = _filters(folder / "filters.yaml")
    telescope, orbit = load_telescope(folder / "telescope.yaml")
    keywords = folder / "level0_keywords.yaml"
    optional = {name: folder / f"{name}.yaml" for name in ("psf", "scatter", "ghosts", "sky", "leds")}
    chips = _chips(folder / "chips.yaml", filters, detector, telescope)
    more = {name: read_data(path) if path.exists() else {} for name, path in optional.items()}
    if more["leds"]:
        more["leds"] |= {"mosaic": tuple(max(getattr(c, of) for c in chips.values()) for of in ("column", "row"))}
    return Camera(
        chips=chips,
        filters=filters,
        telescope=telescope,
        orbit=orbit,
        detector=detector,
        keywords=_only_list(keywords) if keywords.exists() else [],
        **more,
        folder=folder,
        digest=folder_digest(folder),
    )


def _detector(path):
    files = {name: path.with_name(f"{name}.yaml") for name in ("cosmic_rays", "defects", "brighter_fatter")}
    numbers = validate(DetectorNumbers, read_sections(path), path)
    effects = {
        name: validate(kind, read_sections(files[name]), files[name])
        for name, kind in (("cosmic_rays", CosmicRays), ("defects", Defects)) if files[name].exists()
    }  # fmt: skip
    areas = files["brighter_fatter"]
    if areas.exists():
        effects["brighter_fatter"] = read_data(areas)
    return Detector(**vars(numbers), **effects, traps=load_traps(path.with_name("cti.yaml")))


def load_telescope(path):
    """Read telescope.yaml: (Telescope, Orbit). Raises InputError."""
    file = validate(_TelescopeFile, read_data(path), path)
    return file.telescope, file.orbit


def _filters(path):
    entries = {name: validate(FilterEntry, entry, path, (name,)) for name, entry in read_data(path).items()}
    filters = {name: entry.filter(name) for name, entry in entries.items()}
    columns = [name.lower() for name in filters]
    for name in filters:
        if not _NAME.fullmatch(name) or columns.count(name.lower()) > 1:
            allowed = "letters, digits and _, a letter first; names must differ in more than case: they name columns"
            raise InputError("not a valid name of a filter", file=path, key=name, allowed=allowed)
    return filters


def _chips(path, filters, detector, telescope):
    chips = {}
    for i, row in enumerate(_only_list(path)):
        place = validate(ChipPlace, row, path, (f"chips[{i}]",))
        if place.filter not in filters:
            raise InputError(
                "unknown filter", file=path, key=f"chips[{i}].filter", value=place.filter, allowed=", ".join(filters)
            )
        if place.id in chips:
            raise InputError("another chip has this id", file=path, key=f"chips[{i}].id", value=place.id)
        kind = filters[place.filter].kind
        chips[place.id] = Chip(**vars(place), kind=kind, detector=detector, telescope=telescope)
    return dict(sorted(chips.items()))


def _only_list(path):
    """Return the only list among the file's sections."""
    lists = [value for value in read_data(path).values() if isinstance(value, list)]
    if len(lists) != 1:
        raise InputError(f"the file must have one list, not {len(lists)}", file=path)
    return lists[0]
