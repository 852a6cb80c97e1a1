"""The data files of a camera, and single parameters that a campaign changes: `detector.read_noise: 20`.

The name of a parameter is its file, then its key in the file. Sections between them may be omitted if the name stays
unique. The files state the source of each value (paper, section 2; config/instrument/README.md).
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from csstsim.base.digest import digest, file_digest
from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.base.stages import flatten
from csstsim.base.types import PathLike
from csstsim.instrument.load import data_files, folder_digest, read_data, sections
from csstsim.instrument.maps.chip_maps import MapEntry, load_entries, map_files

# Files with parameters that may be changed: all that a camera reads except lists (chips, keywords)
CHANGEABLE = (
    "detector", "telescope", "filters", "psf", "scatter", "ghosts", "sky", "leds", "cosmic_rays", "defects", "cti",
    "brighter_fatter", "gratings",
)  # fmt: skip
# Files of which each parameter is a part (camera_parts), with the function that returns their content
BY_PARAMETER: dict[str, Callable[[dict[Any, Any]], dict[Any, Any]]] = {
    "detector": sections,
    "filters": dict,
    "telescope": dict,
}
_POWER_OF_TEN = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+")


class InstrumentFiles:
    """The files of an instrument folder, with changed parameters.

    instrument: the folder; None: the shipped one; or a mapping of changed parameters {name: number}, nested or dotted,
    and `folder`, if it is not the shipped one. Raises InputError for a missing folder, and for an unknown parameter.
    """

    def __init__(self, instrument: PathLike | Mapping[str, Any] | None = None) -> None:
        given = dict(instrument) if isinstance(instrument, Mapping) else {"folder": instrument}
        folder = given.pop("folder", None)
        if not isinstance(folder, str | Path | None):
            raise InputError("must be the name of a folder", key="instrument.folder", value=folder)
        self.folder = Path(folder or SHIPPED / "instrument")
        if not self.folder.is_dir():
            raise InputError("no such instrument folder", file=self.folder)
        self._changes: dict[str, dict[tuple[str, ...], float]] = {}  # {file: {keys: number}}
        for name, value in flatten(given).items():
            value = _as_number(value)
            file, keys = self._find(str(name), value)
            if keys in self._changes.get(file, {}):
                raise InputError("the parameter is given twice", key=f"instrument.{name}", value=value)
            self._changes.setdefault(file, {})[keys] = value
        self.changes = {
            ".".join((file, *keys)): value for file, new in self._changes.items() for keys, value in new.items()
        }

    def path(self, name: str) -> Path:
        """Return the path of a YAML file, named without its suffix."""
        return self.folder / f"{name}.yaml"

    def exists(self, name: str) -> bool:
        """Return whether the folder has a YAML file, named without its suffix."""
        return self.path(name).exists()

    def data(self, name: str) -> dict[Any, Any]:
        """Return a file's content as instrument.load.read_data does, with the changes. Raises InputError."""
        data = deepcopy(read_data(self.path(name))) if name in self._changes else read_data(self.path(name))
        for keys, value in self._changes.get(name, {}).items():
            _within(data, keys[:-1])[keys[-1]] = value
        return data

    def sections(self, name: str) -> dict[Any, Any]:
        """Return {key: value} of a file without its sections, which only group the parameters."""
        return sections(self.data(name))

    @cached_property
    def maps(self) -> dict[str, MapEntry]:
        """{kind: maps.chip_maps.MapEntry} of maps.yaml; {} without the file. Raises InputError."""
        return load_entries(self.folder)

    @cached_property
    def _map_files(self) -> set[str]:
        """Names of the files of laboratory maps. They are large, and each belongs to one chip."""
        return map_files(self.maps, data_files(self.folder))

    @cached_property
    def digest(self) -> str:
        """16 hex digits of all files except laboratory maps, and of the changes."""
        content = folder_digest(self.folder, self._map_files)
        return digest([content, self.changes]) if self.changes else content

    @cached_property
    def parts(self) -> dict[str, Any]:
        """{part: its value, or the digest of its file} without laboratory maps; see instrument.camera_parts."""
        parts: dict[str, Any] = {}
        for name, path in data_files(self.folder).items():
            if name in self._map_files:
                continue
            stem = path.stem
            changes = self._changes.get(path.stem) if path == self.path(path.stem) else None
            if name == f"{stem}.yaml" and stem in BY_PARAMETER:
                parts |= flatten({stem: BY_PARAMETER[stem](self.data(stem))})
            else:
                content = file_digest(path)
                parts[name] = digest([content, sorted(map(str, changes.items()))]) if changes else content
        return parts

    def _find(self, name: str, value: object) -> tuple[str, tuple[str, ...]]:
        """Return (file, keys) of a parameter to be changed. Raises InputError."""
        file, _, key = name.partition(".")
        known = self._numbers(file) if file in CHANGEABLE and self.exists(file) else {}
        matches = [keys for keys in known if ".".join(keys) == key]
        matches = matches or [keys for keys in known if ".".join(keys).endswith(f".{key}")]
        if len(matches) != 1:
            names = [".".join((file, *keys)) for keys in matches] or self._similar_names(name)
            message = "several parameters have this name" if matches else "no such parameter of the camera"
            raise InputError(message, key=f"instrument.{name}", value=value, allowed=", ".join(names))
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError("must be a number", key=f"instrument.{name}", value=value, allowed="finite numbers")
        return file, matches[0]

    def _similar_names(self, name: str) -> list[str]:
        names = [".".join((file, *keys)) for file in CHANGEABLE if self.exists(file) for keys in self._numbers(file)]
        last_part = {one: one.rpartition(".")[2] for one in names}
        equal = [one for one in names if last_part[one] == name.rpartition(".")[2]]
        similar = get_close_matches(name, names, 5, 0.5) or get_close_matches(name, set(last_part.values()), 5, 0.5)
        return equal or similar or [f"{file}.NAME, a parameter of {self.path(file)}" for file in CHANGEABLE[:2]]

    def _numbers(self, file: str) -> dict[tuple[str, ...], float]:
        """Return {keys: number} of a file."""
        numbers = {tuple(map(str, keys)): value for keys, value in _leaves(read_data(self.path(file)))}
        return {k: v for k, v in numbers.items() if isinstance(v, int | float) and not isinstance(v, bool)}


def _leaves(data: Mapping[Any, Any], above: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Any]]:
    for key, value in data.items():
        yield from _leaves(value, (*above, key)) if isinstance(value, dict) else [((*above, key), value)]


def _within(data: dict[Any, Any], keys: tuple[str, ...]) -> dict[Any, Any]:
    """Return the mapping at some keys; a key may be text where the file has a number."""
    for key in keys:
        data = next(value for name, value in data.items() if str(name) == key)
    return data


def _as_number(value: Any) -> Any:
    """Return a numpy number as Python's, and text such as 1e-3, which is not a number in YAML 1.1, as a number.

    Other text, as a number in quotes, is returned as it is.
    """
    if isinstance(value, np.number):
        return value.item()
    return float(value) if isinstance(value, str) and _POWER_OF_TEN.fullmatch(value) else value
