"""A Sphinx extension: docstrings are plain English, not reStructuredText.

Names in `backticks` become code; tables, indented parts and the like are shown as they stand; nothing else is markup.
"""

import re
from itertools import groupby

_TABLE = re.compile(r"\s*[|+]")
_MARKUP = re.compile(r"([\\*|_<>])")


def as_rest(lines):
    """Return reStructuredText lines that show docstring lines (list of str) as they are meant."""
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
