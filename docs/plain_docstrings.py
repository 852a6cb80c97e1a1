"""A Sphinx extension: docstrings are plain English, not reStructuredText.

Names in `backticks` become code; tables, indented parts and the like are shown as they stand; nothing else is markup.
"""

import re
from itertools import groupby

_TABLE = re.compile(r"\s*[|+]")
_MARKUP = re.compile(r"([\\*|_<>])")


def as_rest(lines):
    """Return reStructuredText lines that show docstring lines (list of str) as they are meant."""
    out, paragraph = [], []
    for blank, group in groupby(lines, lambda line: not line.strip()):
        if blank:
            continue
        paragraph = list(group)
        if any(line.startswith((" ", "\t")) or _TABLE.match(line) for line in paragraph):
            out += [".. code-block:: text", "", *(f"   {line}" for line in paragraph), ""]
        else:
            out += ["".join(map(_inline, re.split(r"(`[^`]+`)", "\n".join(paragraph)))), ""]
    return "\n".join(out).split("\n")


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
