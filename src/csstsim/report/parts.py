"""Parts of the report's page: tables, figures, details, sections. templates/parts.html has the HTML of each."""

from __future__ import annotations

import base64
import math
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from jinja2 import Environment

    from csstsim.report.gate_matrix import GateMatrix
    from csstsim.report.mosaic import FocalPlane

SIGNATURES = {b"\x89PNG": "png", b"RIFF": "webp"}  # first bytes of a picture
MAX_OPEN_ROWS = 40  # rows shown at once; longer tables are folded


class Link(NamedTuple):
    """A link: `href` is relative to the page, or #section."""

    label: str
    href: str


class Verdict(NamedTuple):
    """True, False or None (not evaluated), shown as a word in a colour."""

    passed: bool | None

    @property
    def style(self) -> str:
        """The CSS class of the word."""
        return {True: "pass", False: "fail", None: "none"}[self.passed]

    @property
    def word(self) -> str:
        """The word that is shown."""
        return {True: "pass", False: "FAIL", None: "not evaluated"}[self.passed]


class Table(NamedTuple):
    """Rows of values, folded under "N `name`" if there are many. Columns of numbers are right-aligned."""

    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    name: str = "rows"

    @property
    def styles(self) -> list[str]:
        """The CSS class of each column."""
        return ["n" if all(map(_is_number, column)) else "" for column in zip(*self.rows, strict=True)]


class Pairs(NamedTuple):
    """A table of {label: value}."""

    values: Mapping[str, Any]


class Figure(NamedTuple):
    """A picture (bytes of a PNG or WebP), its caption, and its CSS class.

    A "chart" has text that must stay legible; a "photo" has pixels of the sky.
    """

    image: bytes
    caption: str
    style: str = "chart"

    @property
    def url(self) -> str:
        """The picture as a data URL."""
        return data_url(self.image)


class Gallery(NamedTuple):
    """Small pictures side by side."""

    figures: Sequence[Figure]


class Paragraph(NamedTuple):
    """A paragraph of one value, or of a tuple of them."""

    words: Any
    style: str = ""


class Details(NamedTuple):
    """Parts folded under a line; a click on it opens them."""

    summary: str
    body: Sequence[Part]


class Section(NamedTuple):
    """Parts under a title; the link #`name` leads there. A section without parts is not shown."""

    name: str
    title: str
    body: Sequence[Part]
    level: int = 2


Part: TypeAlias = "Table | Pairs | Figure | Gallery | Paragraph | Details | Section | FocalPlane | GateMatrix"


def mappings(rows: Iterable[Mapping[str, Any]], name: str = "rows") -> Table:
    """Return the Table of `rows`, which are mappings; its columns are all their keys, in order of appearance."""
    rows = list(rows)
    keys = list(dict.fromkeys(key for row in rows for key in row))
    return Table(keys, [[row.get(key) for key in keys] for row in rows], name)


def data_url(picture: bytes) -> str:
    """Return the bytes of a PNG or WebP as a data URL."""
    kind = SIGNATURES[picture[:4]]
    return f"data:image/{kind};base64," + base64.b64encode(picture).decode("ascii")


def draw(part: Part) -> str:
    """Return the HTML of one part."""
    return str(_templates().get_template("parts.html").module.part(part))  # type: ignore[attr-defined] # its macro


def fill(template: str, **values: Any) -> str:
    """Return the text of a template in templates/ with `values` filled in, escaped."""
    return _templates().get_template(template).render(values)


@cache
def _templates() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"kind": lambda part: type(part).__name__, "shown": _shown}
    environment.globals["max_open_rows"] = MAX_OPEN_ROWS
    return environment


def _shown(value: Any, digits: int) -> str:
    """Return the text of a value: floats to `digits` significant figures, None as a dash."""
    return "-" if value is None else f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def _is_number(value: Any) -> bool:
    """Whether a value counts as a number: a number, its text, or None (a missing number)."""
    try:
        return value is None or (not isinstance(value, bool) and math.isfinite(float(value)))
    except (TypeError, ValueError):
        return False
