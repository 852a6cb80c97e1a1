"""The truth table as text: the `.cat` file of each image, in the form of the Cycle-9 mocks (columns: io.truth).

The first line is `#` and the names of the 33 columns. A row for each object follows, with its values separated by
spaces, and `nan` where the object has no such quantity. obj_type is a word.
`astropy.table.Table.read(path, format="ascii")` reads it.

`read_cat` also reads the files of the mission: with lines of comment before the names, with columns in any order and
of any number, and with obj_type as a word or a number.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.files.text_file import read_text
from csstsim.base.types import AnyArray, IntArray, PathLike
from csstsim.catalog.table import GALAXY, QUASAR, STAR, TYPES, ObjectTable
from csstsim.io.truth import CAT_COLUMNS

MAX_BYTES = 500_000_000  # of a file: a million objects
_ROWS = 20_000  # formatted at a time
# Digits: positions to 1e-5 px and to a microarcsecond, other numbers as columns of 32 bits represent them
_FORMATS = dict.fromkeys(("obj_ID", "ID_chip", "galType"), "%d") | dict.fromkeys(("filter", "obj_type"), "%s")
_FORMATS |= dict.fromkeys(("xImage", "yImage"), "%.5f") | {"mag": "%.6f"}
_FORMATS |= dict.fromkeys(("ra", "dec", "ra_orig", "dec_orig"), "%.10f")
_SYNONYMS = {"qso": "quasar", "agn": "quasar", "gal": "galaxy"}  # words of other files for our types


def write_cat(path: PathLike, table: ObjectTable) -> None:
    """Write the `.cat` of a truth table (io.truth.truth_table) (temporary name, fsync, rename)."""
    with atomic_path(path) as temporary, open(temporary, "w", encoding="ascii", newline="\n") as file:
        file.writelines(cat_lines(table))


def cat_lines(table: ObjectTable) -> Iterator[str]:
    """Yield the text of a truth table: the line of names, then blocks of rows."""
    yield "# " + " ".join(CAT_COLUMNS) + "\n"
    row_format = " ".join(_FORMATS.get(name, "%.8g") for name in CAT_COLUMNS) + "\n"
    for start in range(0, len(table), _ROWS):
        block = table.take(slice(start, start + _ROWS))
        columns: list[Any] = [block[name] for name in CAT_COLUMNS]
        columns[list(CAT_COLUMNS).index("obj_type")] = [_type_word(code) for code in block["obj_type"]]
        yield "".join(row_format % row for row in zip(*columns, strict=True))


def _type_word(code: int) -> str:
    return TYPES[code] if 0 <= code < len(TYPES) else str(code)


def read_cat(path: PathLike) -> ObjectTable:
    """Read a `.cat` file, of csstsim or of the mission.

    Parameters
    ----------
    path : str or Path
        The file, of at most 500 MB.

    Returns
    -------
    ObjectTable
        The columns with the names and units of `io.truth.read_truth`: x and y [px] count from 0. Columns that the
        truth table does not have keep their names. `meta["types"]` states how numbers of obj_type were understood.

    Raises
    ------
    InputError
        If the file is not such a table. The message names the line.
    """
    lines = read_text(path, max_bytes=MAX_BYTES).splitlines()
    rows = [(number, line.split()) for number, line in enumerate(lines, 1) if line.strip() and line.lstrip()[0] != "#"]
    names = _names(path, lines, len(rows[0][1]) if rows else 0)
    for number, words in rows:
        if len(words) != len(names):
            what = f"line {number} has {len(words)} words, not the {len(names)} of the heading"
            raise InputError(what, file=path)
    cells = np.array([row for _, row in rows], dtype=str).reshape(len(rows), len(names))
    numbers = [number for number, _ in rows]
    columns = {name: _column(path, name, cells[:, k], numbers) for k, name in enumerate(names)}
    meta = {}
    if "obj_type" in columns:
        columns["obj_type"], meta["types"] = _types(path, columns, numbers)
    columns = {CAT_COLUMNS.get(name, name): values for name, values in columns.items()}
    columns |= {axis: columns[axis] - 1.0 for axis in ("x", "y") if axis in columns}
    return ObjectTable(columns, meta)


def _names(path: PathLike, lines: Sequence[str], count: int) -> list[str]:
    """Return the names of the columns: the last comment before the first row with as many words as a row (`count`)."""
    names = None
    for line in lines:
        text = line.strip()
        if not text:
            continue
        if text[0] != "#":
            break
        words = text.lstrip("#").split()
        names = words if len(words) == count or (not count and len(words) > 1) else names
    if names is None:
        raise InputError(
            "no heading: a line of # and the names of the columns", file=path, allowed="as many as columns"
        )
    if duplicate := next((name for name in names if names.count(name) > 1), None):
        raise InputError("column given twice", file=path, key=duplicate)
    return names


def _column(path: PathLike, name: str, words: AnyArray, lines: Sequence[int]) -> AnyArray:
    """Return a column as numbers, or as words if it has words."""
    if name in ("filter", "obj_type"):
        return words
    try:
        return words.astype(np.int64 if name in ("obj_ID", "ID_chip", "galType") else np.float64)
    except (ValueError, OverflowError):
        pass
    try:
        return words.astype(np.float64)
    except ValueError:
        if name not in CAT_COLUMNS:
            return words
        bad = next(k for k, word in enumerate(words) if not _is_number(word))
        raise InputError(f"line {lines[bad]}: must be a number", file=path, key=name, value=str(words[bad])) from None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _types(path: PathLike, columns: Mapping[str, AnyArray], lines: Sequence[int]) -> tuple[IntArray, str]:
    """Return obj_type as in the truth table, and how its numbers were understood ("" for words)."""
    words = np.char.lower(columns["obj_type"].astype(str))
    labels, inverse = np.unique(words, return_inverse=True)
    names = {_SYNONYMS.get(kind, kind) for kind in labels}
    if names <= set(TYPES):
        known_codes = [TYPES.index(_SYNONYMS.get(kind, kind)) for kind in labels]
        return np.array(known_codes, np.int8)[inverse] if len(labels) else np.zeros(0, np.int8), ""
    try:
        numbers = np.array([int(float(kind)) for kind in labels])
        if not set(numbers.tolist()) <= {STAR, GALAXY, QUASAR}:
            raise ValueError
    except (ValueError, OverflowError):
        bad = next(k for k, word in enumerate(words) if _SYNONYMS.get(word, word) not in TYPES)
        raise InputError(
            f"line {lines[bad]}: unknown type",
            file=path,
            key="obj_type",
            value=str(columns["obj_type"][bad]),
            allowed=f"{', '.join(TYPES)}; or 0, 1, 2",
        ) from None
    codes = numbers[inverse].astype(np.int8)
    sized = np.nan_to_num(np.asarray(columns.get("size", np.zeros(len(codes))), float)) > 0
    if (sized & (codes == 0)).sum() > (sized & (codes == 1)).sum():  # codes of another convention: galaxies have sizes
        swapped = np.array([GALAXY, STAR, QUASAR], np.int8)[codes]
        return swapped, "0 galaxy, 1 star, 2 quasar: those of type 0 have sizes"
    return codes, "0 star, 1 galaxy, 2 quasar"
