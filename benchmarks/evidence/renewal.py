"""A record stays current where code changed and no figure did: its run at the size of seconds tells.

A full run takes minutes or hours, its toy run seconds, and both go through the same code. So a record keeps what the
toy run gave on the same code (`toy`), without what differs from run to run, as times do. When code or data have
changed, `make toys` compares. The same values again renew the record (`renewed`: commit, date, and the digest of what
they were calculated with). Others leave it stale, and are printed. Times are not renewed: they are those of the commit
that they were measured on.
"""

import datetime
import math
import re
from collections.abc import Callable
from itertools import zip_longest

from evidence.commands import Command
from evidence.dependencies import changed, combined
from evidence.record import commit, read, store

SAME = 1e-4  # relative: small differences of large numbers vary with the processor by some 1e-5
VARIES = "*"  # in a table, in place of what differs from run to run
_TIME = re.compile(r"(CPU|GB|MB|s|ms|us|ns)\b")  # at the start of a unit that tells of a machine, not of the sky
_TIMES_COLUMN = re.compile(r"CPU|(?<![/\w])(s|ms|us|ns|GB|MB)\b(?!/)|[Ss]econd|[Tt]ime|[Ff]aster|[Cc]ost")
_CELL_TIME = re.compile(r"(?<![\w.])[\d.,]*\d(?:e[-+]?\d+)? (?=(?:ns|us|ms|s|min)\b(?!/))")  # the number of "3.2 s"
_TOKEN = re.compile(r"[^\s|]+")
_NUMBER = re.compile(r"[-+]?[\d,]*\.?\d+(?:e[-+]?\d+)?")


def is_time(unit: str) -> bool:
    """Tell whether a unit is one of time or memory."""
    return bool(_TIME.match(unit))


def steady(first: dict, second: dict) -> dict:
    """Return {values: {name: value}, tables: {name: text}} of what two toy runs agree on.

    A value that differs, or is a time, is None; so is a table of another layout. What differs in a table is VARIES.
    """
    values = {
        name: value["value"]
        if not is_time(value.get("unit", "")) and _is_same(value["value"], second["values"].get(name, {}).get("value"))
        else None
        for name, value in first["values"].items()
    }
    tables = {name: _common(text, second["tables"].get(name)) for name, text in first["tables"].items()}
    return {"values": values, "tables": tables, "skipped": sorted(first.get("skipped", ()))}


def moved(kept: dict, new: dict) -> list[str]:
    """Return a line for each figure of a toy run that is not as kept. Both are as `steady` returns them.

    A value that was the same in two runs and is not now has moved: code that draws at random must not renew a record.
    In a table a word may vary, as a time of few digits can be the same twice by chance.
    """
    lines = []
    if kept["skipped"] != new["skipped"]:
        lines.append(f"parts left out: {kept['skipped']} then, {new['skipped']} now")
    for name in kept["values"].keys() ^ new["values"].keys():
        lines.append(f"{name}: {'no longer' if name in kept['values'] else 'not yet'} among its values")
    for name in kept["values"].keys() & new["values"].keys():
        before = kept["values"][name]
        now = new["values"][name]
        if before is not None and not _is_same(before, now):
            lines.append(f"{name}: {before} then, {'another from run to run' if now is None else now} now")
    for name in kept["tables"].keys() | new["tables"].keys():
        before = kept["tables"].get(name, "")
        now = new["tables"].get(name, "")
        if before is not None:
            lines += [f"table {name}: {line}" for line in _moved_rows(before, now or "")]
    return sorted(lines)


def is_steady(toy: dict) -> bool:
    """Tell whether a toy run has anything that can be compared."""
    numbers = [_NUMBER.fullmatch(token) for text in toy["tables"].values() if text for token in _TOKEN.findall(text)]
    return any(value is not None for value in toy["values"].values()) or any(numbers)


def stale_parts(command: Command, content: dict) -> list[str]:
    """Return the parts that a command depends on that changed since its record was made or renewed."""
    parts = changed(command, content["depends"])
    return [] if parts and content.get("renewed", {}).get("digest") == combined(command) else parts


def keep_toy(command: Command, again: Callable[[], dict | None]) -> str:
    """Put into a command's record what two toy runs agree on; `again` runs one. Return what went wrong, or ""."""
    first = again()
    second = again()
    content = read(command.name)
    if first is None or second is None or content is None:
        return "its toy run failed: a change of code will make the record stale"
    toy = steady(first, second)
    if not is_steady(toy):
        return "its toy run has times alone: a change of code will make the record stale"
    store(command.name, content | {"toy": toy})
    return ""


def renew(command: Command, first: dict, again: Callable[[], dict | None]) -> list[str] | None:
    """Compare a toy run with what the record keeps; return what moved, None if there is nothing to compare.

    Nothing is there if no toy run is kept, or if this one left out a part that the kept one has. If nothing moved, and
    code or data have changed, the record is renewed. `again` runs the toy a second time: it is called where something
    moved, as that may differ from run to run.
    """
    content = read(command.name)
    if content is None or "toy" not in content or set(first.get("skipped", ())) - set(content["toy"]["skipped"]):
        return None
    now = steady(first, first)
    if moved(content["toy"], now):
        now = steady(first, again() or first)
    lines = moved(content["toy"], now)
    if not lines and stale_parts(command, content):
        content["renewed"] = {
            "commit": commit(),
            "date": datetime.date.today().isoformat(),
            "digest": combined(command),
        }
        store(command.name, content)
    return lines


def _is_same(a: object, b: object) -> bool:
    if isinstance(a, int | float) and isinstance(b, int | float):
        return math.isclose(a, b, rel_tol=SAME)
    return a == b


def _same_token(a: str, b: str) -> bool:
    if VARIES in (a, b) or a == b:
        return True
    if _NUMBER.sub("", a) != _NUMBER.sub("", b):
        return False
    pairs = zip_longest(_NUMBER.findall(a), _NUMBER.findall(b), fillvalue="nan")
    return all(_is_same(float(x.replace(",", "")), float(y.replace(",", ""))) for x, y in pairs)


def _common(text: str, other: str | None) -> str | None:
    """Return a table's text with VARIES for each word that differs from the other's; None if rows or words do.

    So have columns and rows of times and memory, which their heads tell.
    """
    rows = text.split("\n")
    others = (other or "").split("\n")
    if other is None or len(rows) != len(others):
        return None
    times: set[int] = set()
    common = []
    for number, (row, twin) in enumerate(zip(rows, others, strict=True)):
        is_table = row.startswith("|")
        cells = row.split("|") if is_table else [row]
        twins = twin.split("|") if is_table else [twin]
        if is_table and number == 0:
            times = {k for k, cell in enumerate(cells) if _TIMES_COLUMN.search(cell)}
        if len(cells) != len(twins):
            return None
        is_time = is_table and number > 1 and bool(_TIMES_COLUMN.search(cells[1]))  # of a row of times or memory
        found = []
        for k, (cell, pair) in enumerate(zip(cells, twins, strict=True)):
            words = _TOKEN.findall(pair)
            if len(words) != len(_TOKEN.findall(cell)):
                return None
            found.append(_shared(cell, words, varies=(k in times and number > 1) or (is_time and k > 1)))
        common.append("|".join(found))
    return "\n".join(common)


def _shared(cell: str, others: list[str], varies: bool) -> str:
    """Return a cell with VARIES for each time and each word that differs from the other run's, or for all."""
    waiting = iter(others)
    times = [match.span() for match in _CELL_TIME.finditer(cell)]

    def shared(one: re.Match[str]) -> str:
        is_time = any(start < one.end() and one.start() < end for start, end in times)
        return one[0] if _same_token(one[0], next(waiting)) and not (varies or is_time) else VARIES

    return _TOKEN.sub(shared, cell)


def _moved_rows(before: str, now: str) -> list[str]:
    """Return a line for each row of a table that moved."""
    rows = before.split("\n")
    others = now.split("\n")
    if len(rows) != len(others):
        return [f"{len(rows)} rows then, {len(others)} now"]
    lines = []
    for row, other in zip(rows, others, strict=True):
        a = _TOKEN.findall(row)
        b = _TOKEN.findall(other)
        if len(a) != len(b) or not all(map(_same_token, a, b)):
            lines.append(f"{row.strip()} then, {other.strip()} now")
    return lines
