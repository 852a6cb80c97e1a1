"""`csstsim import-pointings`: another's list of pointings becomes a survey table.

Beside the table stand the mapping that was followed and, if rows were refused, those rows with the reason.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.help_page import explained
from csstsim.base.plural import number_of
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.pointing_lists.convert import convert
from csstsim.campaign.pointing_lists.mapping import HEAD, LISTS, Mapping, known_lists, load_mapping
from csstsim.campaign.pointing_lists.messages import (
    kinds_of,
    say_blocked,
    say_catalogue_places,
    say_not_used,
    say_overlaps,
    say_refused,
)
from csstsim.campaign.pointing_lists.read_list import read_list
from csstsim.campaign.survey_table import exposures_of
from csstsim.instrument.camera import load_telescope

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable
    from typing import Any

    from csstsim.base.types import PathLike
    from csstsim.campaign.pointing_lists.read_list import PointingList

MAPPING = ".mapping.yaml"
REJECTED = ".rejected.csv"
REJECTED_HEAD = "place,reason,row\n"


@explained("list of pointings")
def import_pointings(
    path: PathLike,
    output: PathLike,
    say: Callable[[str], object],
    *,
    like: str | None = None,
    mapping: PathLike | None = None,
    maps: Iterable[str] = (),
    sets: Iterable[str] = (),
    **conventions: Any,
) -> int:
    """Write the survey table of a list and what stands beside it; return how many rows were refused.

    like: a list of known_lists(); mapping: a file; maps, sets: texts KEY=COLUMN, KEY=VALUE; conventions: fields of
    Mapping by name, None for those not said. Raises InputError if the list as a whole cannot be used, or no row.
    """
    path = Path(path)
    output = Path(output)
    beside = {suffix: output.with_name(output.stem + suffix) for suffix in (MAPPING, REJECTED)}
    _check_free(output, beside)
    given = _given(like, mapping)
    given = given.changed(_pairs(maps, "--map"), _pairs(sets, "--set"), _said(conventions))
    table = read_list(path)
    given = given.completed(table.names)
    given.check(table)
    orbit = load_telescope(SHIPPED / "instrument" / "telescope.yaml").orbit
    made = convert(table, given, orbit)
    refused = [*table.broken, *((*_row(table, row), reason) for row, reason in made.reasons.items())]
    kinds = kinds_of(refused)
    if refused:
        _write(beside[REJECTED], _rejected(refused))
    if not made.rows:
        say_refused(beside[REJECTED], kinds, say)
        [(reason, count)] = kinds.most_common(1)
        message = f"no row can be used; {count} of {number_of(len(refused), 'row')}: {reason}"
        raise InputError(f"{message}; {beside[REJECTED]} has all reasons", file=path)
    text = _table(made.rows.values(), f"{path.name}, by {beside[MAPPING].name}")
    exposures = exposures_of(text, orbit, output)  # what the reader of tables would refuse is refused now
    _write(beside[MAPPING], given.text())
    if not refused:
        beside[REJECTED].unlink(missing_ok=True)  # of an earlier attempt
    _write(output, text)
    say(f"{output}: {number_of(len(made.rows), 'exposure')} of {number_of(len(made.rows) + len(refused), 'row')}")
    say(f"{beside[MAPPING]}: " + ", ".join(f"{key} from {name}" for key, name in given.columns.items()))
    say_not_used(given, table.names, say)
    if refused:
        say_refused(beside[REJECTED], kinds, say)
    if conventions.get("directions") is None:
        say_catalogue_places(given, table, say)
    say_blocked(made.blocked, say)
    say_overlaps(exposures, {cells["obsid"]: table.rows[row][0] for row, cells in made.rows.items()}, say)
    return len(refused)


def _check_free(output: Path, beside: dict[str, Path]) -> None:
    """Raise InputError if the table exists, or a file beside it that is not left of an import without a table."""
    heads = {beside[MAPPING]: HEAD, beside[REJECTED]: REJECTED_HEAD}
    for file in (output, *heads):
        if file.exists() and not (file in heads and file.is_file() and _begins(file, heads[file])):
            raise InputError("exists already; name another table", file=file, key="--output")


def _begins(file: Path, head: str) -> bool:
    with open(file, "rb") as content:
        return content.read(len(head)) == head.encode()


def _given(like: str | None, mapping: PathLike | None) -> Mapping:
    if like and mapping:
        raise InputError("--like and --mapping exclude each other", key="--mapping", value=mapping)
    if like and like not in known_lists():
        raise InputError("no such list", key="--like", value=like, allowed=", ".join(known_lists()))
    if like:
        return load_mapping(LISTS / f"{like}.yaml")
    return load_mapping(Path(mapping)) if mapping else Mapping()


def _pairs(texts: Iterable[str], option: str) -> dict[str, str]:
    """Return {key: name} of texts KEY=NAME."""
    found: dict[str, str] = {}
    for text in texts:
        key, equals, name = (part.strip() for part in text.partition("="))
        if not (key and equals and name):
            raise InputError("not KEY=NAME", key=option, value=text)
        if key in found:
            raise InputError("given twice", key=option, value=key)
        found[key] = name
    return found


def _said(conventions: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in conventions.items() if value is not None}


def _row(table: PointingList, row: int) -> tuple[str, str]:
    place, cells = table.rows[row]
    return place, _line(cells)


def _line(cells: Iterable[str]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(cells)
    return text.getvalue()


def _table(rows: Iterable[dict[str, str]], source: str) -> str:
    rows = list(rows)
    return (
        "\n".join([f"# csstsim import-pointings from {source}", _line(rows[0]), *(_line(r.values()) for r in rows)])
        + "\n"
    )


def _rejected(refused: Iterable[tuple[str, str, str]]) -> str:
    """Return the text of the table of refused rows, in the list's order: place, reason and the row itself."""
    ordered = sorted(refused, key=lambda row: int(row[0].split()[1]))
    rows = [_line([place, reason, line]) for place, line, reason in ordered]
    return REJECTED_HEAD + "\n".join(rows) + "\n"


def _write(path: Path, text: str) -> None:
    try:
        with atomic_path(path) as temporary:
            Path(temporary).write_text(text, encoding="utf-8")
    except OSError as exc:  # a folder in which no file can be made, as /proc
        raise InputError(f"cannot be written: {exc.strerror}", file=path, key="--output") from exc
