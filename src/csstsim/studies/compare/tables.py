"""Parquet tables compared, a column at a time."""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from csstsim.base.types import AnyArray, BoolArray
from csstsim.catalog.table import ObjectTable, footer
from csstsim.studies.compare.facts import Fact, alone, array_facts
from csstsim.studies.compare.records import record_facts
from csstsim.studies.compare.varying import COLUMNS

IDS = ("obj_ID", "source_id", "id")  # columns that say which object a row is
_UNIT = re.compile(
    r"(electron|photon|erg|km|mas|arcsec|solar masses)( / \w+)+|FITS px|px|deg|arcsec|mag\b|AB\b|K\b|mas\b|microjansky|"
    r"angstrom|rad|dex|solar masses|(nominal )?electrons|Gyr|day\b|MJD\b|s(?=,| after)|CPU milliseconds"
)
_WRITTEN = {
    "AB": "mag",
    "FITS px": "px",
    "nominal electrons": "electron",
    "electrons": "electron",
    "MJD": "day",
    "CPU milliseconds": "ms",
}
_AS_BEFORE = re.compile("its error|(deg, )?the same")


def table_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two table files of csstsim's. Raises InputError for one that is damaged or no table."""
    metas = [ObjectTable.read(path, []).meta for path in (a, b)]
    yield from record_facts("metadata: ", *metas)
    columns = [footer(path).schema.to_arrow_schema().names for path in (a, b)]
    yield from alone("columns", *columns)
    names = [name for name in columns[0] if name in columns[1]]
    if names != [name for name in columns[1] if name in names]:
        yield Fact("the columns are in another order")
    rows, facts = _common_rows(a, b, names)
    yield from facts
    if rows is None:
        return
    key = _key(a, names)
    for name in names:
        if name not in COLUMNS:
            yield from _column_facts(
                name, [_column(path, name)[part] for path, part in zip((a, b), rows, strict=True)], key, rows
            )


def footer_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two files of parquet metadata: columns, and how many rows the files they are of have."""
    files = [footer(path) for path in (a, b)]
    if files[0].num_rows != files[1].num_rows:
        yield Fact(f"of {files[0].num_rows} and {files[1].num_rows} rows")
    columns = [
        [f"{c.name}: {c.physical_type}" for c in map(file.schema.column, range(file.num_columns))] for file in files
    ]
    yield from record_facts("columns", *columns)


def _column(path: Path, name: str) -> AnyArray:
    """Return a column, lists as text."""
    values = ObjectTable.read(path, [name])[name]
    if values.dtype == object and len(values) and isinstance(values[0], np.ndarray):
        return np.array([str(value.tolist()) for value in values], object)
    return values


def _key(path: Path, names: Sequence[str]) -> tuple[str, AnyArray] | None:
    return next(((name, _column(path, name)) for name in IDS if name in names), None)


def _common_rows(a: Path, b: Path, names: Sequence[str]) -> tuple[Sequence[slice | BoolArray] | None, list[Fact]]:
    """Return ((rows of A, rows of B) to be compared, or None; a list of Facts)."""
    counts = [footer(path).num_rows for path in (a, b)]
    if counts[0] == counts[1]:
        return (slice(None), slice(None)), []
    facts = [Fact(f"{counts[0]} and {counts[1]} rows")]
    key = next((name for name in IDS if name in names), None)
    ids = [_column(path, key) for path in (a, b)] if key else []
    if not key or any(len(np.unique(column)) != len(column) for column in ids):
        return None, [Fact(f"{facts[0].text}; the columns are not compared")]
    facts += alone(f"rows of {key}", *(column.tolist() for column in ids))
    return [np.isin(mine, other) for mine, other in (ids, ids[::-1])], facts


def _column_facts(
    name: str, columns: Sequence[AnyArray], key: tuple[str, AnyArray] | None, rows: Sequence[slice | BoolArray]
) -> Iterator[Fact]:
    """Yield Facts about a column of both; key: (name of the id, its values in A) or None."""

    def place(i: int) -> str:
        row = int(np.arange(len(key[1]))[rows[0]][i]) if key else i
        return f"in row {row}" + (f" ({key[0]} {key[1][row]})" if key and key[0] != name else "")

    yield from array_facts(f"column {name}", *columns, things="rows", unit=unit_of(name), place=place)


def unit_of(name: str) -> str:
    """Return the unit of a column of any table, "" if it has none; of a band's, that of name_B."""
    return units().get(name) or units().get(f"{name.rpartition('_')[0]}_B", "")


@cache
def units() -> dict[str, str]:
    """Return {column: its unit} of all tables, as their descriptions begin; what has none is left out. B: any band."""
    from csstsim.catalog.table import OPTIONAL, columns_with
    from csstsim.io import orders, truth
    from csstsim.measure import catalogue
    from csstsim.measure.bricks import merge
    from csstsim.measure.spectra import line_columns, spectrum_columns

    found: dict[str, str] = {}
    for described in (
        columns_with("B"),
        OPTIONAL,
        orders.COLUMNS,
        truth.ABOUT,
        catalogue.COLUMNS,
        spectrum_columns.COLUMNS,
        line_columns.COLUMNS,
        merge.ABOUT,
        merge.ABOUT_BAND,
    ):
        found |= units_of(described)
    return found | {name: found[ours] for name, ours in truth.CAT_COLUMNS.items() if ours in found}


def units_of(described: Mapping[str, str | tuple[Any, ...]]) -> dict[str, str]:
    """Return {column: its unit} of a table, {column: text, or a tuple that ends with it}."""
    found = {}
    unit = ""
    for name, text in described.items():
        text = text[-1] if isinstance(text, tuple) else text
        if not _AS_BEFORE.match(text):
            match = _UNIT.match(text)
            unit = _WRITTEN.get(match[0], match[0]) if match else ""
        if unit:
            found[name] = unit
    return found
