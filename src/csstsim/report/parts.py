"""What the report's page is made of: tables, figures, folds, sections. templates/parts.html draws each, escaped."""

import base64
import math
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

LONGEST = 40  # rows shown at once; longer tables are folded


class Link(NamedTuple):
    """A link: `href` is relative to the page, or #section."""

    label: str
    href: str


class Verdict(NamedTuple):
    """True, False or None (not judged), said in a word and a colour."""

    passed: bool | None

    @property
    def style(self):
        """Of the word."""
        return {True: "pass", False: "fail", None: "none"}[self.passed]

    @property
    def word(self):
        """What is said."""
        return {True: "pass", False: "FAIL", None: "not judged"}[self.passed]


class Table(NamedTuple):
    """Rows of values, folded under "N `name`" if there are many. Columns of numbers are set to the right."""

    head: tuple
    rows: list
    name: str = "rows"

    @property
    def styles(self):
        """One for each column."""
        return ["n" if all(map(_is_number, column)) else "" for column in zip(*self.rows, strict=True)]


class Pairs(NamedTuple):
    """A table of {label: value}."""

    values: dict


class Figure(NamedTuple):
    """A picture (PNG bytes) and its caption."""

    png: bytes
    caption: str

    @property
    def url(self):
        """What an image's source takes."""
        return data_url(self.png)


class Paragraph(NamedTuple):
    """A value, or a tuple of several."""

    words: Any
    style: str = ""


class Fold(NamedTuple):
    """Parts behind a line to click on."""

    summary: str
    body: list


class Section(NamedTuple):
    """Parts under a title, where #`name` leads to; without parts it is not shown."""

    name: str
    title: str
    body: list
    level: int = 2


def mappings(rows, name="rows"):
    """Return the Table of mappings: the heading has every key, in the order met."""
    rows = list(rows)
    keys = list(dict.fromkeys(key for row in rows for key in row))
    return Table(keys, [[row.get(key) for key in keys] for row in rows], name)


def data_url(png):
    """Return PNG bytes as what an image's source takes."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def draw(part):
    """Return the HTML of one part."""
    return str(_templates().get_template("parts.html").module.part(part))


def fill(template, **values):
    """Return a template of templates/ with values in it, which are escaped."""
    return _templates().get_template(template).render(values)


@cache
def _templates():
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters |= {"kind": lambda part: type(part).__name__, "shown": _shown}
    environment.globals["longest"] = LONGEST
    return environment


def _shown(value, digits):
    """Return the text of a value: floats to `digits` significant figures, None as a dash."""
    return "-" if value is None else f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def _is_number(value):
    """Whether a value is read as a number: also one already written out, and a figure that is missing."""
    try:
        return value is None or (not isinstance(value, bool) and math.isfinite(float(value)))
    except (TypeError, ValueError):
        return False
