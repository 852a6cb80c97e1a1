"""Which column of a list is which quantity, and the conventions of the list: a file that is kept.

Files of this form come with csstsim for known lists (survey_tables/lists); `csstsim import-pointings` writes the one
it followed beside its table, and reads it again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import yaml
from pydantic import BeforeValidator, Field, PrivateAttr

from csstsim.base.errors import InputError
from csstsim.base.files.yaml_file import read_yaml
from csstsim.base.model import Model, validate
from csstsim.base.shipped import ROOT
from csstsim.campaign.pointing_lists.quantities import BODIES, PLACES, STATE, Key, parse_key

if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.campaign.pointing_lists.read_list import PointingList

LISTS = ROOT / "survey_tables" / "lists"
HEAD = "# Written by csstsim import-pointings, which reads it again with --mapping\n"


def _text(value: Any) -> Any:
    """Return a number or a truth value of YAML as text, and the rest as it is."""
    return str(value).lower() if isinstance(value, bool | int | float) else value


Text = Annotated[str, BeforeValidator(_text)]


class ColumnSource(NamedTuple):
    """Where a quantity comes from: a column of the list, or a value of all rows; told: the (file, key) that says so."""

    key: Key
    column: str | None
    value: str | None
    told: tuple[PathLike | None, str]


class Mapping(Model):
    """The mapping of a list of pointings."""

    columns: dict[str, Text] = Field({}, description="quantity, with its unit: the list's column, or colN, the N-th")
    values: dict[str, Text] = Field({}, description="quantity, with its unit: its value in all rows")
    pa_sense: Literal["east", "west"] = Field("east", description="the list's position angle runs from north to here")
    pa_zero: float = Field(0.0, ge=-360, le=360, description="position angle (through east) of the list's 0, deg")
    pa_north: Literal["equator", "ecliptic", "galactic"] = Field("equator", description="whose north it begins at")
    directions: Literal["apparent", "icrs"] = Field("apparent", description="icrs: aberration and deflection are added")
    first_obsid: Annotated[Text, Field(pattern=r"^[0-9]{9,14}$")] = Field(
        "10100000001", description="obsid of number 0; without number and obsid, of the first row"
    )
    tolerance: float = Field(1.0, gt=0, le=180, description="largest difference from what the list states, deg")

    # {"columns.ra": (file, key)} of entries that a person wrote
    _told: dict[str, tuple[PathLike | None, str]] = PrivateAttr(default_factory=dict)

    def keys(self) -> dict[str, ColumnSource]:
        """Return {quantity: ColumnSource}. Raises InputError for unknown and repeated ones."""
        found: dict[str, ColumnSource] = {}
        for part in ("columns", "values"):
            for text, name in getattr(self, part).items():
                told = self._told.get(f"{part}.{text}", (None, f"{part}.{text}"))
                key = parse_key(text, *told)
                if key.name in found:
                    message = f"given twice, by {found[key.name].told[1]} and {told[1]}"
                    raise InputError(message, file=told[0], key=key.name)
                column, value = (name, None) if part == "columns" else (None, name)
                found[key.name] = ColumnSource(key, column, value, told)
        return found

    def completed(self, names: Iterable[str]) -> Mapping:
        """Return this mapping with the list's columns (names) that are called as a quantity, if it has none yet."""
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
                table.column(source.column, source.told)
        file = table.path
        known = set(self.keys())
        had = f"the list's columns: {', '.join(table.names)}"
        if not any(known.issuperset(pair) for pair in PLACES.values()):
            pairs = "; ".join(" and ".join(pair) for pair in PLACES.values())
            raise InputError("no direction is mapped: use --map", file=file, allowed=f"{pairs} ({had})")
        for name in ("pa", "time", "exptime"):
            if name not in known:
                raise InputError("not mapped: use --map, or --set for all rows", file=file, key=name, allowed=had)
        groups = [*PLACES.values(), STATE, *(tuple(f"{body}_{axis}" for axis in "xyz") for body in BODIES)]
        for group in groups:
            missing = [name for name in group if name not in known]
            if 0 < len(missing) < len(group):
                raise InputError("all of these or none", file=file, key=", ".join(group), value=f"no {missing[0]}")
        for one, other in (("obsid", "number"), ("deep", "deep_index")):
            if {one, other} <= known:
                raise InputError(f"{one} and {other} exclude each other", file=file, key=other)

    def changed(self, maps: dict[str, str], sets: dict[str, str], conventions: dict[str, Any]) -> Mapping:
        """Return this mapping with columns (maps) and values (sets) by key, and conventions, in place of its own."""
        told = {f"columns.{text}": (None, f"--map {text}") for text in maps}
        told |= {f"values.{text}": (None, f"--set {text}") for text in sets}
        new = {parse_key(place.partition(".")[2], *where).name for place, where in told.items()}
        columns, values = (
            {text: name for text, name in had.items() if parse_key(text).name not in new}
            for had in (self.columns, self.values)
        )
        data = self.model_dump() | {"columns": columns | maps, "values": values | sets} | conventions
        changed = validate(Mapping, data, "command line")
        changed._told = self._told | told
        return changed

    def text(self) -> str:
        """Return the file's text."""
        return HEAD + yaml.safe_dump(self.model_dump(), sort_keys=False, allow_unicode=True)


def load_mapping(path: PathLike) -> Mapping:
    """Return the Mapping in a YAML file. Raises InputError."""
    mapping = validate(Mapping, read_yaml(path), path)
    mapping._told = {
        place: (path, place)
        for part in ("columns", "values")
        for text in getattr(mapping, part)
        for place in [f"{part}.{text}"]
    }
    mapping.keys()
    return mapping


def known_lists() -> list[str]:
    """Return the names of the lists whose mappings come with csstsim."""
    return sorted(path.stem for path in LISTS.glob("*.yaml"))
