"""Reads a list of pointings: FITS, ECSV, CSV (comma, semicolon, tab or bar), or columns separated by blanks.

Cells stay text until they are converted, so that each row can be refused by itself. astropy reads FITS and the header
of ECSV. It does not read the rows of text, because it refuses a complete file for one row that is too long.
"""

from __future__ import annotations

import csv
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from csstsim.base.errors import InputError, first_line
from csstsim.base.files.damage import reading
from csstsim.base.files.fits_headers import check_headers
from csstsim.base.files.text_file import read_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    import numpy as np
    from astropy.units import UnitBase

    from csstsim.base.types import PathLike

_DELIMITERS = ",;\t|"  # of CSV; a text without them has columns separated by blanks


class Origin(NamedTuple):
    """The file and key (or option) from which an entry of a mapping comes, for error messages."""

    file: PathLike | None
    key: str


class RefusedRow(NamedTuple):
    """A row that is not imported: its place in the list ("line 7"), its text, and the reason."""

    place: str
    text: str
    reason: str


@dataclass(frozen=True)
class PointingList:
    """A list with its cells as text: rows [(place in the file, cells)], and `broken` rows that cannot be split.

    names: of the columns; units {name: astropy unit} stated in the file.
    """

    path: Path
    names: list[str]
    rows: list[tuple[str, list[str]]]
    broken: list[RefusedRow] = field(default_factory=list)
    units: dict[str, UnitBase] = field(default_factory=dict)

    def column(self, name: str, origin: Origin = Origin(None, "columns")) -> int:  # noqa: B008  # immutable
        """Return the index of the column `name`, or of colN, the N-th. Raises InputError if it does not exist.

        origin: of the name, for the message.
        """
        file, key = origin
        if self.names.count(name) > 1:
            raise InputError(f"{self.path} has this column twice", file=file, key=key, value=name)
        if name in self.names:
            return self.names.index(name)
        number = name.removeprefix("col")
        if number.isascii() and number.isdigit() and 0 < int(number[:6]) <= len(self.names):
            return int(number[:6]) - 1
        raise InputError(
            f"no such column in {self.path}", file=file, key=key, value=name, allowed=", ".join(self.names)
        )


def read_list(path: PathLike) -> PointingList:
    """Return the PointingList in a file. Raises InputError if it is not a list, or has no row."""
    path = Path(path)
    read = _fits if path.is_file() and _begins_as_fits(path) else _text
    table = read(path)
    if not table.rows and not table.broken:
        raise InputError("the list is empty: no row", file=path)
    return table


def _begins_as_fits(path: Path) -> bool:
    with open(path, "rb") as file:
        return file.read(9) == b"SIMPLE  ="


def _fits(path: Path) -> PointingList:
    """Return the first table of a FITS file."""
    import numpy as np
    from astropy.io import fits
    from astropy.table import Table

    check_headers(path)
    with reading(path, "a FITS table"), fits.open(path) as hdus:
        kinds = fits.BinTableHDU, fits.TableHDU
        first = next((hdu for hdu in hdus if isinstance(hdu, kinds) and not isinstance(hdu, fits.CompImageHDU)), None)
        if first is None:
            raise ValueError("it has images only")
        table = Table.read(first, format="fits", unit_parse_strict="silent")
        columns = [_texts(np.ma.asarray(table[name])) for name in table.colnames]
    rows = [(f"row {k + 1}", list(cells)) for k, cells in enumerate(zip(*columns, strict=True))]
    units = {name: table[name].unit for name in table.colnames if table[name].unit is not None}
    return PointingList(path, list(table.colnames), rows, units=units)


def _texts(column: np.ma.MaskedArray[Any, Any]) -> list[str]:
    """Return the values of a column as text without loss of precision; "" for masked values."""
    values = column.filled() if column.dtype.kind in "SU" else column.tolist()
    return [
        "" if value is None else value.decode("latin-1").strip() if isinstance(value, bytes) else str(value).strip()
        for value in values
    ]


def _text(path: Path) -> PointingList:
    lines = list(enumerate(read_text(path, "utf-8-sig").splitlines(), start=1))
    comments = [line for _, line in lines if line.lstrip().startswith("#")]
    lines = [(n, line) for n, line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise InputError("the list is empty: no header and no row", file=path)
    first_line = lines[0][1]
    is_ecsv = bool(comments) and comments[0].startswith("# %ECSV")
    units, delimiter = _ecsv(path, comments, first_line) if is_ecsv else ({}, None)
    delimiter = delimiter or next((d for d in _DELIMITERS if d in first_line), " ")
    split = [(f"line {n}", line, _cells(line, delimiter)) for n, line in lines]
    _, _, first = split[0]
    if first is None:
        raise InputError("the header is not a line of CSV", file=path, key=split[0][0])
    if any(_is_number(cell) for cell in first):
        names = _names_in_comments(comments, delimiter, len(first)) or [f"col{k + 1}" for k in range(len(first))]
    else:
        names = first
        split = split[1:]
    rows: list[tuple[str, list[str]]] = []
    broken: list[RefusedRow] = []
    for place, line, cells in split:
        if cells is None:
            broken.append(RefusedRow(place, line, "not a line of CSV"))
        elif len(cells) != len(names):
            broken.append(RefusedRow(place, line, f"{len(cells)} cells under {len(names)} columns"))
        else:
            rows.append((place, cells))
    return PointingList(path, names, rows, broken, units)


def _ecsv(path: Path, comments: Sequence[str], header: str) -> tuple[dict[str, UnitBase], str]:
    """Return ({column: unit}, delimiter) from the comments and the line of names of an ECSV text."""
    from astropy.table import Table

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about types: cells are read as text
            table = Table.read([*comments, header], format="ascii.ecsv")
    except Exception as exc:  # of many types
        raise InputError(f"the header is not ECSV: {first_line(exc)}", file=path) from None
    units = {name: table[name].unit for name in table.colnames if getattr(table[name], "unit", None) is not None}
    return units, "," if "delimiter: ','" in " ".join(comments) else " "


def _cells(line: str, delimiter: str) -> list[str] | None:
    """Return the cells of a line; None if it cannot be split."""
    if "\0" in line:
        return None
    try:
        line = line.strip() if delimiter != "\t" else line
        if delimiter == " ":
            line = line.replace("\t", " ")
        return [
            cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True))
        ]
    except csv.Error:  # an open quote, a cell of more than 131,072 characters
        return None


def _names_in_comments(comments: Sequence[str], delimiter: str, count: int) -> list[str] | None:
    """Return the words of the last comment that has as many words as a row has cells, or None."""
    for line in reversed(comments):
        names = _cells(line.lstrip().lstrip("#"), delimiter) or []
        if len(names) == count and not any(_is_number(name) for name in names):
            return names
    return None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text.lower().lstrip("+-") not in ("nan", "inf", "infinity")
