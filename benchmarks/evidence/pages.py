"""Figures of records in the pages: python benchmarks/evidence/pages.py [--check]

In a page a figure is a link to its record, and its text is the figure:

    within [0.001](../benchmarks/records/astrometry.yaml#erfa) microarcseconds
    [99.7%](../benchmarks/records/paper_figures.yaml#points:.1%) of points, [-0.11 ± 0.02](...#total:+-.2f)

After the colon stands a format of Python, with `+-` before it for value and error, or `error:` for the error alone.
Without one a figure has two digits. A whole table stands between two comments:

    <!-- table astrometry.costs -->
    <!-- end table -->

This command writes what the records say into the pages; `--check` tells where a page differs, with exit code 1. The
site (docs/conf.py) does the same when it is built, marks what is stale, and leads from each figure to its command.
`--toy`, after `make toys`, tells which figures of pages are not among what the commands measured at that size.
"""

import argparse
import re
import sys
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

if __name__ == "__main__":  # started as a script, the folder on the path is this one
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from evidence import ROOT
from evidence.commands import commands
from evidence.dependencies import changed
from evidence.record import read
from evidence.renewal import is_time, stale_parts

PAGES = ("README.md", "CONTRIBUTING.md", "docs/**/*.md", "*/README.md", "examples/*/README.md")
FIGURE = re.compile(r"\[([^\]\n]*)\]\(((?:\.\./)*benchmarks/records/(\w+)\.yaml#([\w.-]+?)(?::([^)\s]+))?)\)")
TABLE = re.compile(r"(<!-- table (\w+)\.([\w.-]+) -->\n)(.*?)(<!-- end table -->)", re.DOTALL)
STALE = "†"


class Missing(Exception):
    """A page asks for a figure that no record has."""


class NeverRecorded(Missing):
    """A page asks for a figure of a command that was never recorded: it shows what it was written with."""


@cache
def record(name: str, toy: bool = False) -> dict | None:
    """Return a record, read once."""
    return read(name, toy)


@cache
def is_stale(name: str) -> bool:
    """Tell whether a command has no record, or one that was neither made nor renewed with the code as it is."""
    known = record(name)
    return known is None or name not in commands() or bool(stale_parts(commands()[name], known))


@cache
def _is_renewed(name: str) -> bool:
    """Tell whether a record was made by other code: its times are those of that code."""
    known = record(name)
    return known is not None and name in commands() and bool(changed(commands()[name], known["depends"]))


def _is_stale_figure(name: str, key: str) -> bool:
    value = (record(name) or {"values": {}})["values"].get(key, {})
    return is_stale(name) or (is_time(value.get("unit", "")) and _is_renewed(name))


def _found(name: str, kind: str, key: str, toy: bool) -> object:
    if name not in commands():
        raise Missing(f"benchmarks/commands.yaml has no {name}")
    content = record(name, toy)
    if content is None or content.get("skipped"):
        raise NeverRecorded(f"{name} was never recorded")
    if key not in content[kind]:
        raise Missing(f"record {name} has no {key}; its {kind}: {', '.join(content[kind])}")
    return content[kind][key]


def _number(value: float | int | str, form: str) -> str:
    if isinstance(value, str):
        return value
    if not form and isinstance(value, int):
        return f"{value:,}"
    text = format(value, form or ".2g")
    text = re.sub(r"e([+-])0*(\d)", lambda found: "e" + found[1].replace("+", "") + found[2], text)
    if not form and "e" in text and 1e-3 <= abs(value) < 1e6:
        text = f"{value:,.0f}"
    return text


def shown(text: str) -> str:
    """Return a table as a page shows it: Markdown as it is, plain text in a fence."""
    return text if text.lstrip().startswith("|") else f"```text\n{text}\n```"


def figure(name: str, key: str, form: str | None, toy: bool = False) -> str:
    """Return a figure as a page shows it. Raises Missing."""
    value = _found(name, "values", key, toy)
    assert isinstance(value, dict)
    form = form or ""
    if form.startswith("error:"):
        return _number(value["error"], form.removeprefix("error:"))
    if form.startswith("+-"):
        return f"{_number(value['value'], form[2:])} ± {_number(value['error'], form[2:].lstrip('+'))}"
    return _number(value["value"], form)


def filled(text: str, fault: Callable[[str], None], toy: bool = False) -> str:
    """Return a page's text with what the records say; call `fault` with what they lack, which stays as it is."""

    def number(found: re.Match) -> str:
        try:
            return f"[{figure(found[3], found[4], found[5], toy)}]({found[2]})"
        except NeverRecorded:
            return found[0]
        except (Missing, ValueError, KeyError) as error:
            fault(f"{found[0]}: {error}")
            return found[0]

    def table(found: re.Match) -> str:
        try:
            return f"{found[1]}{shown(str(_found(found[2], 'tables', found[3], toy)))}\n{found[5]}"
        except NeverRecorded:
            return found[0]
        except Missing as error:
            fault(f"table {found[2]}.{found[3]}: {error}")
            return found[0]

    return TABLE.sub(table, FIGURE.sub(number, text))


def used() -> dict[str, list[str]]:
    """Return the pages that show figures of each record."""
    found: dict[str, list[str]] = {}
    for page in pages():
        text = page.read_text()
        for name in {match[3] for match in FIGURE.finditer(text)} | {match[2] for match in TABLE.finditer(text)}:
            found.setdefault(name, []).append(str(page.relative_to(ROOT)))
    return found


def pages() -> list[Path]:
    """Return all pages."""
    return sorted({path for pattern in PAGES for path in ROOT.glob(pattern)})


def anchor(name: str) -> str:
    """Return the anchor of a command's section on the page of evidence: headings' are in lower case."""
    return name.lower()


def for_site(text: str, page: str) -> str:
    """Return the text of a page of the site (its name without .md): each figure leads to its command's section."""
    up = "../" * page.count("/")

    def number(found: re.Match) -> str:
        mark = STALE if _is_stale_figure(found[3], found[4]) else ""
        return f"[{found[1]}{mark}]({up}evidence.md#{anchor(found[3])})"

    def table(found: re.Match) -> str:
        content = record(found[2])
        when = f"{content['date']}, commit {content['commit']}" if content else "not recorded"
        stale = f" {STALE} stale" if is_stale(found[2]) else ""
        return f"{found[4]}\n*[{found[2]}]({up}evidence.md#{anchor(found[2])}): {when}{stale}*\n"

    return TABLE.sub(table, FIGURE.sub(number, filled(text, lambda fault: None)))


def main() -> int:
    """Fill the pages, or check them; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if a page differs")
    parser.add_argument("--toy", action="store_true", help="only tell of figures that the commands do not measure")
    asked = parser.parse_args()
    faults: list[str] = []
    for page in pages():
        text = page.read_text()
        if asked.toy:
            filled(text, partial(_add, faults, page), toy=True)
            continue
        new = filled(text, partial(_add, faults, page))
        if new == text:
            continue
        if asked.check:
            pairs = zip(text.split("\n"), new.split("\n"), strict=False)
            differing = [f"{a.strip()[:150]}\n      record: {b.strip()[:150]}" for a, b in pairs if a != b]
            _add(faults, page, "differs from its records:\n    " + "\n    ".join(differing[:5]))
        else:
            page.write_text(new)
            print(f"{page.relative_to(ROOT)}: filled")
    print("\n".join(faults) or "All pages show what the records say")
    return int(bool(faults))


def _add(faults: list[str], page: Path, fault: str) -> None:
    faults.append(f"{page.relative_to(ROOT)}: {fault}")


if __name__ == "__main__":
    sys.exit(main())
