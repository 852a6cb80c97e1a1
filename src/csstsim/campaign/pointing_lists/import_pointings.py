"""`csstsim import-pointings`: a list of pointings is converted to a survey table.

The mapping that was used and a table of refused rows with the reasons are written next to the survey table.
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
    count_reasons,
    log_blocked,
    log_catalogue_directions,
    log_not_used,
    log_overlaps,
    log_refused,
)
from csstsim.campaign.pointing_lists.read_list import RefusedRow, read_list
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
    log: Callable[[str], object],
    *,
    like: str | None = None,
    mapping: PathLike | None = None,
    maps: Iterable[str] = (),
    sets: Iterable[str] = (),
    **conventions: Any,
) -> int:
    """Write the survey table of a list, the mapping, and the refused rows; return the number of refused rows.

    like: a list of known_lists(); mapping: a file; maps, sets: texts KEY=COLUMN, KEY=VALUE; conventions: fields of
    Mapping by name, None for those not given. Raises InputError if the list or all its rows cannot be used.
    """
    path = Path(path)
    output = Path(output)
    mapping_file = output.with_name(output.stem + MAPPING)
    rejected_file = output.with_name(output.stem + REJECTED)
    _check_free(output, {mapping_file: HEAD, rejected_file: REJECTED_HEAD})
    used = _initial_mapping(like, mapping)
    conventions = {name: value for name, value in conventions.items() if value is not None}
    used = used.changed(_pairs(maps, "--map"), _pairs(sets, "--set"), conventions)
    table = read_list(path)
    used = used.completed(table.names)
    used.check(table)
    orbit = load_telescope(SHIPPED / "instrument" / "telescope.yaml").orbit
    converted = convert(table, used, orbit)
    refused = [*table.broken, *(_refused_row(table, row, reason) for row, reason in converted.reasons.items())]
    kinds = count_reasons(refused)
    if refused:
        _write(rejected_file, _rejected(refused))
    if not converted.rows:
        log_refused(rejected_file, kinds, log)
        [(reason, count)] = kinds.most_common(1)
        message = f"no row can be used; {count} of {number_of(len(refused), 'row')}: {reason}"
        raise InputError(f"{message}; {rejected_file} has all reasons", file=path)
    text = _table(converted.rows.values(), f"{path.name}, by {mapping_file.name}")
    exposures = exposures_of(text, orbit, output)  # checks the table as its reader does
    _write(mapping_file, used.text())
    if not refused:
        rejected_file.unlink(missing_ok=True)  # from an earlier attempt
    _write(output, text)
    count = len(converted.rows)
    log(f"{output}: {number_of(count, 'exposure')} of {number_of(count + len(refused), 'row')}")
    log(f"{mapping_file}: " + ", ".join(f"{key} from {name}" for key, name in used.columns.items()))
    log_not_used(used, table.names, log)
    if refused:
        log_refused(rejected_file, kinds, log)
    if "directions" not in conventions:
        log_catalogue_directions(used, table, log)
    log_blocked(converted.blocked, log)
    log_overlaps(exposures, {cells["obsid"]: table.rows[row][0] for row, cells in converted.rows.items()}, log)
    return len(refused)


def _check_free(output: Path, headers: dict[Path, str]) -> None:
    """Raise InputError if an output file exists, unless an import without a table has left it.

    headers: {file: its header} of the other output files; such files with their header are overwritten.
    """
    for file in (output, *headers):
        if file.exists() and not (file in headers and file.is_file() and _begins(file, headers[file])):
            raise InputError("exists already; name another table", file=file, key="--output")


def _begins(file: Path, head: str) -> bool:
    with open(file, "rb") as content:
        return content.read(len(head)) == head.encode()


def _initial_mapping(like: str | None, mapping: PathLike | None) -> Mapping:
    if like and mapping:
        raise InputError("--like and --mapping exclude each other", key="--mapping", value=mapping)
    if like and like not in known_lists():
        raise InputError("no such list", key="--like", value=like, allowed=", ".join(known_lists()))
    if like:
        return load_mapping(LISTS / f"{like}.yaml")
    return load_mapping(Path(mapping)) if mapping else Mapping()


def _pairs(texts: Iterable[str], option: str) -> dict[str, str]:
    """Return {key: name} of texts KEY=NAME."""
    pairs: dict[str, str] = {}
    for text in texts:
        key, equals, name = (part.strip() for part in text.partition("="))
        if not (key and equals and name):
            raise InputError("not KEY=NAME", key=option, value=text)
        if key in pairs:
            raise InputError("given twice", key=option, value=key)
        pairs[key] = name
    return pairs


def _refused_row(table: PointingList, row: int, reason: str) -> RefusedRow:
    place, cells = table.rows[row]
    return RefusedRow(place, _line(cells), reason)


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


def _rejected(refused: Iterable[RefusedRow]) -> str:
    """Return the text of the table of refused rows, in the order of the list: place, reason and the row itself."""
    ordered = sorted(refused, key=lambda row: int(row.place.split()[1]))
    rows = [_line([row.place, row.reason, row.text]) for row in ordered]
    return REJECTED_HEAD + "\n".join(rows) + "\n"


def _write(path: Path, text: str) -> None:
    try:
        with atomic_path(path) as temporary:
            Path(temporary).write_text(text, encoding="utf-8")
    except OSError as exc:  # a folder without files, such as /proc
        raise InputError(f"cannot be written: {exc.strerror}", file=path, key="--output") from exc
