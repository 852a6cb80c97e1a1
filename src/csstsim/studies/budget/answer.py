"""The rows of an answer: a CSV table of results from another program, which a budget scores."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from math import isfinite, nan
from typing import TYPE_CHECKING, Any

from csstsim.base.errors import InputError
from csstsim.base.files.text_file import read_text

if TYPE_CHECKING:
    from csstsim.base.types import PathLike


def answer_rows(path: PathLike, columns: Sequence[str], key: str | None = None) -> list[tuple[int, dict[str, Any]]]:
    """Return [(line, {column: text})] of a CSV file with these columns and at least one row.

    A byte-order mark and blank lines are ignored. key: the option that names the file. Raises InputError.
    """
    try:
        reader = csv.DictReader(read_text(path, "utf-8-sig").splitlines())
        rows = [(reader.line_num, row) for row in reader]
    except InputError as exc:
        raise InputError(exc.message, file=exc.file, key=key, allowed=exc.allowed) from None
    except csv.Error as exc:
        raise InputError(f"not a CSV table: {exc}", file=path, key=key) from None
    if not rows:
        raise InputError("not an answer: no row", file=path, allowed=", ".join(columns))
    names = reader.fieldnames
    assert names is not None  # there are rows
    if lacking := [name for name in columns if name not in names]:
        lacks = f"not an answer: it lacks {', '.join(lacking)}"
        found = ", ".join(names)
        raise InputError(lacks, file=path, key="columns", value=found, allowed=", ".join(columns))
    if repeated := [name for name in dict.fromkeys(names) if name and names.count(name) > 1]:
        raise InputError("the column is given twice", file=path, key=repeated[0], allowed="one column of each name")
    for line, row in rows:
        if None in row:  # the key of cells beyond the heading
            value = len(names) + len(row[None])
            allowed = len(names)
            more = "more cells than the heading"
            raise InputError(more, file=path, key=f"line {line}", value=value, allowed=allowed)
    return rows


def answer_number(
    path: PathLike,
    line: int,
    row: Mapping[str, Any],
    name: str,
    is_valid: Callable[[float], bool] = lambda value: True,
    allowed: str = "a finite number",
) -> float:
    """Return the number in a row's cell. Raises InputError for one that is not finite, or not is_valid(number)."""
    text = row[name]
    try:
        value = float(text)
    except (TypeError, ValueError):  # None: the row is short
        value = nan
    if not (isfinite(value) and is_valid(value)):
        raise InputError("not an answer", file=path, key=f"line {line}, {name}", value=text, allowed=allowed)
    return value
