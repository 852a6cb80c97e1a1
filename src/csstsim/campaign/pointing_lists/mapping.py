"""The mapping of a list: the quantity in each column, and the conventions of the list. Mappings are YAML files.

Mappings of known lists come with csstsim (survey_tables/lists). `csstsim import-pointings` saves the mapping that it
used next to its table, and can read it again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import yaml
from pydantic import BeforeValidator, Field, PrivateAttr

from csstsim.base.errors import InputError
from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.model import Model, validate
from csstsim.base.shipped import ROOT
from csstsim.campaign.pointing_lists.quantities import BODIES, COORDINATES, STATE, Key, parse_key
from csstsim.campaign.pointing_lists.read_list import Origin

if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.campaign.pointing_lists.read_list import PointingList

LISTS = ROOT / "survey_tables" / "lists"
HEAD = "# Written by csstsim import-pointings, which reads it again with --mapping\n"


def _text(value: Any) -> Any:
    """Return numbers and booleans of YAML as text, and other values unchanged."""
    return str(value).lower() if isinstance(value, bool | int | float) else value


Text = Annotated[str, BeforeValidator(_text)]


class ColumnSource(NamedTuple):
    """The source of a quantity: a column of the list, or a value for all rows."""

    key: Key
    column: str | None
    value: str | None
    origin: Origin


class Mapping(Model):
    """The mapping of a list of pointings."""

    columns: dict[str, Text] = Field({}, description="{quantity with unit: column of the list, or colN for the N-th}")
    values: dict[str, Text] = Field({}, description="{quantity with unit: its value in all rows}")
    pa_sense: Literal["east", "west"] = Field("east", description="sense of the list's position angle, from north")
    pa_zero: float = Field(0.0, ge=-360, le=360, description="deg; position angle (through east) of the list's angle 0")
    pa_north: Literal["equator", "ecliptic", "galactic"] = Field("equator", description="frame that defines north")
    directions: Literal["apparent", "icrs"] = Field("apparent", description="icrs: aberration and deflection are added")
    first_obsid: Annotated[Text, Field(pattern=r"^[0-9]{9,14}$")] = Field(
        "10100000001", description="obsid of number 0; without number and obsid, of the first row"
    )
    tolerance: float = Field(1.0, gt=0, le=180, description="deg; maximum difference from Sun, Moon, second direction")

    # {"columns.ra": (file, key)} of entries from a file or the command line
    _origins: dict[str, Origin] = PrivateAttr(default_factory=dict)

    def keys(self) -> dict[str, ColumnSource]:
        """Return {quantity: ColumnSource}. Raises InputError for unknown and repeated quantities."""
        sources: dict[str, ColumnSource] = {}
        for section in ("columns", "values"):
            for text, name in getattr(self, section).items():
                origin = self._origins.get(f"{section}.{text}", Origin(None, f"{section}.{text}"))
                key = parse_key(text, *origin)
                if key.name in sources:
                    message = f"given twice, by {sources[key.name].origin.key} and {origin.key}"
                    raise InputError(message, file=origin.file, key=key.name)
                column, value = (name, None) if section == "columns" else (None, name)
                sources[key.name] = ColumnSource(key, column, value, origin)
        return sources

    def completed(self, names: Iterable[str]) -> Mapping:
        """Return this mapping with the columns (names) of a list whose name is a quantity that it does not have yet."""
        columns = dict(self.columns)
        known = set(self.keys())
        for name in names:
            try:
                key = parse_key(name)
            except InputError:
                continue
            if key.name not in known:
                columns[name] = name
                known.add(key.name)
        return self.model_copy(update={"columns": columns})

    def check(self, table: PointingList) -> None:
        """Raise InputError if a PointingList lacks a column, or a quantity is missing that a survey table needs."""
        for source in self.keys().values():
            if source.column is not None:
                table.column(source.column, source.origin)
        file = table.path
        known = set(self.keys())
        columns = f"the list's columns: {', '.join(table.names)}"
        if not any(known.issuperset(pair) for pair in COORDINATES.values()):
            pairs = "; ".join(" and ".join(pair) for pair in COORDINATES.values())
            raise InputError("no direction is mapped: use --map", file=file, allowed=f"{pairs} ({columns})")
        for name in ("pa", "time", "exptime"):
            if name not in known:
                raise InputError("not mapped: use --map, or --set for all rows", file=file, key=name, allowed=columns)
        groups = [*COORDINATES.values(), STATE, *(tuple(f"{body}_{axis}" for axis in "xyz") for body in BODIES)]
        for group in groups:
            missing = [name for name in group if name not in known]
            if 0 < len(missing) < len(group):
                raise InputError("all of these or none", file=file, key=", ".join(group), value=f"no {missing[0]}")
        for one, other in (("obsid", "number"), ("deep", "deep_index")):
            if {one, other} <= known:
                raise InputError(f"{one} and {other} exclude each other", file=file, key=other)

    def changed(self, maps: dict[str, str], sets: dict[str, str], conventions: dict[str, Any]) -> Mapping:
        """Return this mapping with columns (maps) and values (sets) by key, and conventions, that replace its own."""
        origins = {f"columns.{text}": Origin(None, f"--map {text}") for text in maps}
        origins |= {f"values.{text}": Origin(None, f"--set {text}") for text in sets}
        new = {parse_key(name.partition(".")[2], *origin).name for name, origin in origins.items()}
        columns, values = (
            {text: name for text, name in entries.items() if parse_key(text).name not in new}
            for entries in (self.columns, self.values)
        )
        data = self.model_dump() | {"columns": columns | maps, "values": values | sets} | conventions
        changed = validate(Mapping, data, "command line")
        changed._origins = self._origins | origins
        return changed

    def text(self) -> str:
        """Return the file's text."""
        return HEAD + yaml.safe_dump(self.model_dump(), sort_keys=False, allow_unicode=True)


def load_mapping(path: PathLike) -> Mapping:
    """Return the Mapping in a YAML file. Raises InputError."""
    mapping = validate(Mapping, read_yaml(path), path)
    names = [f"{section}.{text}" for section in ("columns", "values") for text in getattr(mapping, section)]
    mapping._origins = {name: Origin(path, name) for name in names}
    mapping.keys()  # checks them
    return mapping


def known_lists() -> list[str]:
    """Return the names of the lists with a mapping in csstsim."""
    return sorted(path.stem for path in LISTS.glob("*.yaml"))
