"""`csstsim import-pointings`: another's list of pointings becomes a survey table.

Beside the table stand the mapping that was followed and, if rows were refused, those rows with the reason.
"""

import csv
import io
import re
from collections import Counter
from pathlib import Path

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.base.help_page import explained
from csstsim.base.plural import number_of
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.pointing_lists.convert import convert
from csstsim.campaign.pointing_lists.mapping import LISTS, Mapping, known_lists, load_mapping
from csstsim.campaign.pointing_lists.read_list import read_list
from csstsim.campaign.survey_table import exposures_of
from csstsim.instrument.camera import load_telescope

MAPPING, REJECTED = ".mapping.yaml", ".rejected.csv"
MOST = 8  # kinds of reasons that are printed


@explained("list of pointings")
def import_pointings(path, output, say, *, like=None, mapping=None, maps=(), sets=(), **conventions):
    """Write the survey table of a list and what stands beside it; return how many rows were refused.

    like: a list of known_lists(); mapping: a file; maps, sets: texts KEY=COLUMN, KEY=VALUE; conventions: fields of
    Mapping by name, None for those not said. Raises InputError if the list as a whole cannot be used, or no row.
    """
    path, output = Path(path), Path(output)
    beside = {suffix: output.with_name(output.stem + suffix) for suffix in (MAPPING, REJECTED)}
    for file in (output, *beside.values()):
        if file.exists():
            raise InputError("exists already; name another table", file=file, key="--output")
    given = _given(like, mapping)
    given = given.changed(_pairs(maps, "--map"), _pairs(sets, "--set"), _said(conventions))
    table = read_list(path)
    given = given.completed(table.names)
    given.check(path, table.names)
    orbit = load_telescope(SHIPPED / "instrument" / "telescope.yaml")[1]
    made = convert(table, given, orbit)
    refused = [*table.broken, *((*_row(table, row), reason) for row, reason in made.reasons.items())]
    if refused:
        _write(beside[REJECTED], _rejected(refused))
    if not made.rows:
        first = f"{refused[0][0]}: {refused[0][2]}"
        raise InputError(f"no row can be used ({beside[REJECTED]} has the reasons); {first}", file=path)
    text = _table(made.rows.values(), f"{path.name}, by {beside[MAPPING].name}")
    exposures_of(text, orbit, output)  # what the reader of tables would refuse is refused now
    _write(beside[MAPPING], given.text())
    _write(output, text)
    say(f"{output}: {number_of(len(made.rows), 'exposure')} of {number_of(len(made.rows) + len(refused), 'row')}")
    say(f"{beside[MAPPING]}: " + ", ".join(f"{key} from {name}" for key, name in given.columns.items()))
    if refused:
        say(f"{beside[REJECTED]}: {number_of(len(refused), 'row')} rejected")
        _count(refused, say)
    if made.blocked:
        say(
            f"Earth in the way of {number_of(made.blocked, 'exposure')}: the list has no state of the spacecraft, and "
            "the model orbit is elsewhere. Without the stray-light model this does not matter."
        )
    return len(refused)


def _given(like, mapping):
    if like and mapping:
        raise InputError("--like and --mapping exclude each other", key="--mapping", value=mapping)
    if like and like not in known_lists():
        raise InputError("no such list", key="--like", value=like, allowed=", ".join(known_lists()))
    return load_mapping(LISTS / f"{like}.yaml" if like else Path(mapping)) if like or mapping else Mapping()


def _pairs(texts, option):
    """Return {key: name} of texts KEY=NAME."""
    found = {}
    for text in texts:
        key, equals, name = (part.strip() for part in text.partition("="))
        if not (key and equals and name):
            raise InputError("not KEY=NAME", key=option, value=text)
        if key in found:
            raise InputError("given twice", key=option, value=key)
        found[key] = name
    return found


def _said(conventions):
    return {name: value for name, value in conventions.items() if value is not None}


def _row(table, row):
    place, cells = table.rows[row]
    return place, _line(cells)


def _line(cells):
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(cells)
    return text.getvalue()


def _table(rows, source):
    rows = list(rows)
    return (
        "\n".join([f"# csstsim import-pointings from {source}", _line(rows[0]), *(_line(r.values()) for r in rows)])
        + "\n"
    )


def _rejected(refused):
    """Return the text of the table of refused rows, in the list's order: place, reason and the row itself."""
    ordered = sorted(refused, key=lambda row: int(row[0].split()[1]))
    rows = [_line([place, reason, line]) for place, line, reason in ordered]
    return "\n".join(["place,reason,row", *rows]) + "\n"


def _count(refused, say):
    """Print how many rows each reason has, values left out."""
    kinds = Counter(re.sub(r" \(got .*?\)(?=;|$)|; line \d+ has it|-?\d+\.\d+ deg", "", row[2]) for row in refused)
    for reason, count in kinds.most_common(MOST):
        say(f"  {count}  {reason}")
    if len(kinds) > MOST:
        say(f"  {sum(kinds.values()) - sum(n for _, n in kinds.most_common(MOST))}  of {len(kinds) - MOST} other kinds")


def _write(path, text):
    with atomic_path(path) as temporary:
        Path(temporary).write_text(text, encoding="utf-8")
