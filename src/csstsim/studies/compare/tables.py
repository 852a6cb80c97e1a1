"""Parquet tables compared, a column at a time."""

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from csstsim.base.types import AnyArray, BoolArray
from csstsim.catalog.table import ObjectTable, footer
from csstsim.studies.compare.facts import Fact, array_facts, only_in_one
from csstsim.studies.compare.records import record_facts
from csstsim.studies.compare.varying import COLUMNS

IDS = ("obj_ID", "source_id", "id")  # columns that identify the object of a row
_UNIT = re.compile(
    r"(electron|photon|erg|km|mas|arcsec|solar masses)( / \w+)+|FITS px|px|deg|arcsec|mag\b|AB\b|K\b|mas\b|microjansky|"
    r"angstrom|rad|dex|solar masses|(nominal )?electrons|Gyr|day\b|MJD\b|s(?=,| after)|CPU milliseconds"
)
_UNIT_SYMBOLS = {
    "AB": "mag",
    "FITS px": "px",
    "nominal electrons": "electron",
    "electrons": "electron",
    "MJD": "day",
    "CPU milliseconds": "ms",
}
_SAME_UNIT = re.compile("its error|(deg, )?the same")


def table_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two table files of csstsim. Raises InputError for one that is damaged or not a table."""
    metadata = [ObjectTable.read(path, []).meta for path in (a, b)]
    yield from record_facts("metadata: ", *metadata)
    columns = [footer(path).schema.to_arrow_schema().names for path in (a, b)]
    yield from only_in_one("columns", *columns)
    names = [name for name in columns[0] if name in columns[1]]
    if names != [name for name in columns[1] if name in names]:
        yield Fact("the columns are in another order")
    rows, facts = _common_rows(a, b, names)
    yield from facts
    if rows is None:
        return
    ids = _id_column(a, names)
    for name in names:
        if name not in COLUMNS:
            yield from _column_facts(
                name, [_column(path, name)[part] for path, part in zip((a, b), rows, strict=True)], ids, rows
            )


def footer_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two files of parquet metadata: columns, and the number of rows of the files they describe."""
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


def _id_column(path: Path, names: Sequence[str]) -> tuple[str, AnyArray] | None:
    return next(((name, _column(path, name)) for name in IDS if name in names), None)


def _common_rows(a: Path, b: Path, names: Sequence[str]) -> tuple[Sequence[slice | BoolArray] | None, list[Fact]]:
    """Return ((rows of A, rows of B) to be compared, or None; Facts about the rows)."""
    counts = [footer(path).num_rows for path in (a, b)]
    if counts[0] == counts[1]:
        return (slice(None), slice(None)), []
    facts = [Fact(f"{counts[0]} and {counts[1]} rows")]
    name = next((name for name in IDS if name in names), None)
    ids = [_column(path, name) for path in (a, b)] if name else []
    if not name or any(len(np.unique(column)) != len(column) for column in ids):
        return None, [Fact(f"{facts[0].text}; the columns are not compared")]
    facts += only_in_one(f"rows of {name}", *(column.tolist() for column in ids))
    return [np.isin(own, other) for own, other in (ids, ids[::-1])], facts


def _column_facts(
    name: str, columns: Sequence[AnyArray], ids: tuple[str, AnyArray] | None, rows: Sequence[slice | BoolArray]
) -> Iterator[Fact]:
    """Yield Facts about a column that both have; ids: (name of the id column, its values in A) or None."""

    def position(i: int) -> str:
        row = int(np.arange(len(ids[1]))[rows[0]][i]) if ids else i
        return f"in row {row}" + (f" ({ids[0]} {ids[1][row]})" if ids and ids[0] != name else "")

    yield from array_facts(f"column {name}", *columns, noun="rows", unit=unit_of(name), position=position)


def unit_of(name: str) -> str:
    """Return the unit of a column of any table, "" if it has none; a column of a band has that of name_B."""
    return units().get(name) or units().get(f"{name.rpartition('_')[0]}_B", "")


@cache
def units() -> dict[str, str]:
    """Return {column: unit} of all tables, from the start of their descriptions, for columns with a unit. B: a band."""
    from csstsim.catalog.table import OPTIONAL, columns_with
    from csstsim.io import orders, truth
    from csstsim.measure import source_columns
    from csstsim.measure.bricks import merge
    from csstsim.measure.spectra import line_columns, spectrum_columns

    units_by_column: dict[str, str] = {}
    for described in (
        columns_with("B"),
        OPTIONAL,
        orders.COLUMNS,
        truth.ABOUT,
        source_columns.COLUMNS,
        spectrum_columns.COLUMNS,
        line_columns.COLUMNS,
        merge.ABOUT,
        merge.ABOUT_BAND,
    ):
        units_by_column |= units_of(described)
    cat_units = {name: units_by_column.get(ours, "") for name, ours in truth.CAT_COLUMNS.items()}
    return units_by_column | {name: unit for name, unit in cat_units.items() if unit}


def units_of(described: Mapping[str, str | tuple[Any, ...]]) -> dict[str, str]:
    """Return {column: unit} of a table; described: {column: description, or a tuple that ends with it}."""
    units_by_column = {}
    unit = ""
    for name, text in described.items():
        text = text[-1] if isinstance(text, tuple) else text
        if not _SAME_UNIT.match(text):
            match = _UNIT.match(text)
            unit = _UNIT_SYMBOLS.get(match[0], match[0]) if match else ""
        if unit:
            units_by_column[name] = unit
    return units_by_column
