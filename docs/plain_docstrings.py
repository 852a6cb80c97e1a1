"""A Sphinx extension: docstrings are plain English with numpydoc sections, not reStructuredText.

Names in `backticks` become code; tables, indented parts and the like are shown as they stand. Sections (Parameters,
Returns, Raises, Examples, ...) are those of numpydoc, which napoleon lays out. Nothing else is markup.
"""

import re
from itertools import groupby

from sphinx.ext.napoleon import Config, NumpyDocstring

# Sections whose entries are a line of name and type, and an indented description; the others are prose
FIELDS = ("Parameters", "Other Parameters", "Attributes", "Returns", "Yields", "Raises", "Warns")
PROSE = ("Examples", "Notes", "References")
LAYOUT = Config(
    napoleon_use_param=False, napoleon_use_rtype=False, napoleon_custom_sections=[("Attributes", "params_style")]
)
_TABLE = re.compile(r"\s*[|+]")
_MARKUP = re.compile(r"([\\*|_<>])")
_UNDERLINE = re.compile("-{3,}")


def sections(lines):
    """Return [(heading, lines)] of a docstring's lines; the heading of what comes first is empty."""
    parts = [("", [])]
    for line, below in zip(lines, [*lines[1:], ""], strict=True):
        heading, body = parts[-1]
        if line in FIELDS + PROSE and _UNDERLINE.fullmatch(below):
            parts.append((line, []))
        elif body or not (heading and _UNDERLINE.fullmatch(line)):
            body.append(line)
    return parts


def as_rest(lines):
    """Return reStructuredText lines that show docstring lines (list of str) as they are meant."""
    (_, first), *others = sections(lines)
    out = _as_prose(first)
    for heading, body in others:
        shown = _entries(body) if heading in FIELDS else _as_prose(body)
        out += [heading, "-" * len(heading), *shown, ""]
    return NumpyDocstring(out, LAYOUT).lines() if others else out


def _entries(body):
    """Return the lines of a section's entries; napoleon marks names and types, so they have no other markup."""
    out = []
    for indented, lines in groupby(body, lambda line: line.startswith(" ")):
        text = "\n".join(lines)
        out += _prose([text]) if indented else _inline(text.replace("`", "")).split("\n")
    return out


def _as_prose(lines):
    paragraphs = [list(group) for blank, group in groupby(lines, lambda line: not line.strip()) if not blank]
    out = []
    for verbatim, group in groupby(paragraphs, _is_verbatim):
        if verbatim:
            shown = [line for paragraph in group for line in (*paragraph, "")]
            out += [".. code-block:: text", "", *(f"   {line}".rstrip() for line in shown)]
        else:
            out += [line for paragraph in group for line in (*_prose(paragraph), "")]
    return out


def _is_verbatim(paragraph):
    return any(line.startswith((" ", "\t", ">>>")) or _TABLE.match(line) for line in paragraph)


def _prose(paragraph):
    return "".join(map(_inline, re.split(r"(`[^`]+`)", "\n".join(paragraph)))).split("\n")


def _inline(part):
    if part.startswith("`") and part.endswith("`") and len(part) > 2:
        return f"``{part[1:-1].strip()}``"
    return _MARKUP.sub(r"\\\1", part)


def setup(app):
    """Register the hook with autodoc."""

    def process(app, what, name, obj, options, lines):
        lines[:] = as_rest(lines)

    app.connect("autodoc-process-docstring", process)
    return {"parallel_read_safe": True}
