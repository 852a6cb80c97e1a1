"""Pieces of HTML for the report: escaped text, tables, figures, links. Whatever is shown passes through `text`."""

import base64
import html
import math
from typing import NamedTuple

LONGEST = 40  # rows shown at once; longer tables are folded


class Link(NamedTuple):
    """A link in a table: `href` is relative to the page, or #section."""

    label: str
    href: str


class Verdict(NamedTuple):
    """True, False or None (not judged) in a table, said in a word and a colour."""

    passed: bool | None


WORDS = {True: ("pass", "pass"), False: ("FAIL", "fail"), None: ("not judged", "none")}


def text(value, digits=4):
    """Return escaped text of a value; floats to `digits` significant figures, None as a dash."""
    if value is None:
        return "-"
    return html.escape(f"{value:.{digits}g}" if isinstance(value, float) else str(value))


def inline(value, digits=4):
    """Return the HTML of a value: a Link, a Verdict, a tuple of such, or anything that has text."""
    if isinstance(value, Link):
        return f'<a href="{text(value.href)}">{text(value.label)}</a>'
    if isinstance(value, Verdict):
        word, style = WORDS[value.passed]
        return f'<span class="{style}">{word}</span>'
    if isinstance(value, tuple):
        return " ".join(inline(part) for part in value)
    return text(value, digits)


def table(head, rows, name="rows"):
    """Return a table of `rows` of values, folded under "N `name`" if it is long; "" without rows.

    Columns that hold nothing but numbers are set to the right.
    """
    if not rows:
        return ""
    styles = [' class="n"' if all(map(_is_number, column)) else "" for column in zip(*rows, strict=True)]
    top = _row("th", styles, map(text, head))
    body = "".join(_row("td", styles, map(inline, row)) for row in rows)
    whole = f'<div class="wide"><table><thead>{top}</thead><tbody>{body}</tbody></table></div>'
    return whole if len(rows) <= LONGEST else folded(f"{len(rows)} {name}", whole)


def _row(tag, styles, cells):
    marked = (f"<{tag}{style}>{cell}</{tag}>" for style, cell in zip(styles, cells, strict=True))
    return f"<tr>{''.join(marked)}</tr>"


def _is_number(value):
    """Whether a value is read as a number: also one already written out, and a figure that is missing."""
    try:
        return value is None or (not isinstance(value, bool) and math.isfinite(float(value)))
    except (TypeError, ValueError):
        return False


def mappings(rows, name="rows"):
    """Return a table of mappings: the heading has every key, in the order met."""
    rows = list(rows)
    keys = list(dict.fromkeys(key for row in rows for key in row))
    return table(keys, [[row.get(key) for key in keys] for row in rows], name)


def pairs(mapping):
    """Return a table of {label: value}."""
    rows = (f"<tr><th>{text(key)}</th><td>{inline(value, 10)}</td></tr>" for key, value in mapping.items())
    return f'<div class="wide"><table>{"".join(rows)}</table></div>' if mapping else ""


def paragraph(words, style=""):
    """Return a paragraph of inline values; "" for none."""
    return f'<p class="{style}">{inline(words)}</p>' if words else ""


def folded(summary, body):
    """Return `body` (HTML) behind a line to click on."""
    return f"<details><summary>{text(summary)}</summary>{body}</details>" if body else ""


def section(name, title, body, level=2):
    """Return a section that #`name` leads to; "" without a body."""
    return f'<section id="{text(name)}"><h{level}>{text(title)}</h{level}>{body}</section>\n' if body else ""


def data_url(png):
    """Return PNG bytes as what an image's source takes."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def image(png, caption):
    """Return a figure; "" for None."""
    if png is None:
        return ""
    said = text(caption)
    return f'<figure><img alt="{said}" src="{data_url(png)}"><figcaption>{said}</figcaption></figure>'
