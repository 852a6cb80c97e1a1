"""The truth table as text: `.cat`, as the Cycle-9 mocks have it beside each image (facts of the columns: io.truth).

The first line is `#` and the names of the 33 columns; a row for each object follows, words apart by spaces, `nan` where
there is no such quantity. `astropy.table.Table.read(path, format="ascii")` reads it. obj_type is a word.

`read_cat` also reads the mission's own files: lines of comment before the names, columns in any order, more of them or
fewer, obj_type as a word or a number.
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

LARGEST = 500_000_000  # bytes: a million objects
_ROWS = 20_000  # formatted at a time
# Digits: places to 1e-5 px and a microarcsecond, other numbers as their columns of 32 bits hold them
_FORMS = dict.fromkeys(("obj_ID", "ID_chip", "galType"), "%d") | dict.fromkeys(("filter", "obj_type"), "%s")
_FORMS |= dict.fromkeys(("xImage", "yImage"), "%.5f") | {"mag": "%.6f"}
_FORMS |= dict.fromkeys(("ra", "dec", "ra_orig", "dec_orig"), "%.10f")
_WORDS = {"qso": "quasar", "agn": "quasar", "gal": "galaxy"}  # others' words for our types


def write_cat(path: PathLike, table: ObjectTable) -> None:
    """Write the `.cat` of a truth table (io.truth.truth_table) (temporary name, fsync, rename)."""
    with atomic_path(path) as temporary, open(temporary, "w", encoding="ascii", newline="\n") as file:
        file.writelines(cat_lines(table))


def cat_lines(table: ObjectTable) -> Iterator[str]:
    """Yield the text of a truth table: the names, then many rows at a time."""
    yield "# " + " ".join(CAT_COLUMNS) + "\n"
    form = " ".join(_FORMS.get(name, "%.8g") for name in CAT_COLUMNS) + "\n"
    for start in range(0, len(table), _ROWS):
        part = table.take(slice(start, start + _ROWS))
        columns: list[Any] = [part[name] for name in CAT_COLUMNS]
        columns[list(CAT_COLUMNS).index("obj_type")] = [_type_word(code) for code in part["obj_type"]]
        yield "".join(form % row for row in zip(*columns, strict=True))


def _type_word(code: int) -> str:
    return TYPES[code] if 0 <= code < len(TYPES) else str(code)


def read_cat(path: PathLike) -> ObjectTable:
    """Return the ObjectTable of a `.cat` file, with our column names and 0-based x, y, as io.truth.read_truth.

    Columns of other names keep theirs. `meta["types"]` says how numbers of obj_type were understood. Raises InputError
    for a file that is not such a table; it names the line.
    """
    lines = read_text(path, largest=LARGEST).splitlines()
    rows = [(number, line.split()) for number, line in enumerate(lines, 1) if line.strip() and line.lstrip()[0] != "#"]
    names = _names(path, lines, len(rows[0][1]) if rows else 0)
    for number, words in rows:
        if len(words) != len(names):
            what = f"line {number} has {len(words)} words, not the {len(names)} of the heading"
            raise InputError(what, file=path)
    cells = np.array([row for _, row in rows], dtype=str).reshape(len(rows), len(names))
    numbers = [number for number, _ in rows]
    columns = {name: _column(path, name, cells[:, k], numbers) for k, name in enumerate(names)}
    types = {}
    if "obj_type" in columns:
        columns["obj_type"], types["types"] = _types(path, columns, numbers)
    columns = {CAT_COLUMNS.get(name, name): values for name, values in columns.items()}
    columns |= {axis: columns[axis] - 1.0 for axis in ("x", "y") if axis in columns}
    return ObjectTable(columns, types)


def _names(path: PathLike, lines: Sequence[str], count: int) -> list[str]:
    """Return the names of the columns: the last comment of as many words as a row has, before the first row."""
    found = None
    for line in lines:
        text = line.strip()
        if not text:
            continue
        if text[0] != "#":
            break
        words = text.lstrip("#").split()
        found = words if len(words) == count or (not count and len(words) > 1) else found
    if found is None:
        raise InputError(
            "no heading: a line of # and the names of the columns", file=path, allowed="as many as columns"
        )
    if twice := next((name for name in found if found.count(name) > 1), None):
        raise InputError("column given twice", file=path, key=twice)
    return found


def _column(path: PathLike, name: str, words: AnyArray, lines: Sequence[int]) -> AnyArray:
    """Return a column's numbers; the words of those that are words."""
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
    """Return (obj_type as in the truth table, how numbers were understood or "")."""
    words = np.char.lower(columns["obj_type"].astype(str))
    kinds, inverse = np.unique(words, return_inverse=True)
    known = {_WORDS.get(kind, kind) for kind in kinds}
    if known <= set(TYPES):
        own = [TYPES.index(_WORDS.get(kind, kind)) for kind in kinds]
        return np.array(own, np.int8)[inverse] if len(kinds) else np.zeros(0, np.int8), ""
    try:
        numbers = np.array([int(float(kind)) for kind in kinds])
        if not set(numbers.tolist()) <= {STAR, GALAXY, QUASAR}:
            raise ValueError
    except (ValueError, OverflowError):
        bad = next(k for k, word in enumerate(words) if _WORDS.get(word, word) not in TYPES)
        raise InputError(
            f"line {lines[bad]}: unknown type",
            file=path,
            key="obj_type",
            value=str(columns["obj_type"][bad]),
            allowed=f"{', '.join(TYPES)}; or 0, 1, 2",
        ) from None
    codes = numbers[inverse].astype(np.int8)
    sized = np.nan_to_num(np.asarray(columns.get("size", np.zeros(len(codes))), float)) > 0
    if (sized & (codes == 0)).sum() > (sized & (codes == 1)).sum():  # other codes than ours: galaxies have sizes
        swapped = np.array([GALAXY, STAR, QUASAR], np.int8)[codes]
        return swapped, "0 galaxy, 1 star, 2 quasar: those of type 0 have sizes"
    return codes, "0 star, 1 galaxy, 2 quasar"
