"""docs/plain_docstrings.py shows docstrings as intended: names as code, tables verbatim, no other markup."""

import runpy
from pathlib import Path

from docutils.core import publish_doctree

MODULE = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "plain_docstrings.py"))


def shown(text):
    """Return (texts of paragraphs, of code in them, of literal blocks) that docutils makes of a docstring."""
    rest = "\n".join(MODULE["as_rest"](text.split("\n")))
    tree = publish_doctree(rest, settings_overrides={"report_level": 1, "halt_level": 1})  # any message is an error
    parts = ("paragraph", "literal", "literal_block")
    return tuple([node.astext() for node in tree.findall(lambda n, p=part: n.tagname == p)] for part in parts)


def test_marks_of_other_languages_are_plain_text():
    text = "Shape (n, 2), |e| = a*b**2, x_ and _y, <g>, a `name` and `b[0]`.\n\nA second paragraph."
    paragraphs, code, blocks = shown(text)
    assert paragraphs == [text.split("\n\n")[0].replace("`", ""), "A second paragraph."]
    assert code == ["name", "b[0]"] and blocks == []


def test_tables_code_and_what_lies_between_stand_as_written():
    table = "| a | b |\n|---|---|\n| 1 | 2 |"
    code = "    import x\n\n    class Y:\n        z = 1"
    paragraphs, _, blocks = shown(f"First.\n\n{code}\n\nThen:\n\n{table}")
    assert paragraphs == ["First.", "Then:"]
    assert [block.replace("    ", "") for block in blocks] == [code.replace("    ", ""), table]


def test_an_empty_docstring_gives_nothing():
    assert MODULE["as_rest"]([""]) == []


SECTIONS = """Return the flux of `star_` in a*b.

Parameters
----------
ra, dec : (n,) array of float
    Position [deg], ICRS; of `mag_r` and x_.
**keys : object
    Others.

Returns
-------
(n, 4) array of float
    Rate [electron / s].

Raises
------
InputError
    For a_ and b.

Examples
--------
In words:

>>> flux(1)
2
"""


def test_sections_are_lists_of_names_types_and_descriptions():
    paragraphs, code, blocks = shown(SECTIONS)
    assert paragraphs == [
        "Return the flux of star_ in a*b.",
        "ra, dec ((n,) array of float) -- Position [deg], ICRS; of mag_r and x_.",
        "**keys (object) -- Others.",
        "(n, 4) array of float -- Rate [electron / s].",
        "For a_ and b.",
        "In words:",
    ]
    assert code == ["star_", "mag_r"]
    assert blocks == [">>> flux(1)\n2"]


def test_a_heading_without_its_line_is_prose():
    assert shown("Returns\nnothing")[0] == ["Returns\nnothing"]
