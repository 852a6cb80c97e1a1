"""A Sphinx extension: what search engines and the site's own search show of each page.

Each page gets `<meta name="description">`, its first sentences, and `<meta name="keywords">`, its words of
search_words.yaml. `_static/search_pages.js` has the same, and the headings with their first lines, for
`_static/search.js`: a page opened from disk cannot read other pages.
"""

import html
import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import yaml
from docutils import nodes
from sphinx.application import Sphinx

WORDS = Path(__file__).with_name("search_words.yaml")
LINES = 240  # characters of a description, and of a section's first lines
_SENTENCE = re.compile(r"(?<=[.!?]) +")
# Text of the other kinds is no sentence, or is that of another section
_NOT_PROSE = (nodes.title, nodes.section, nodes.comment, nodes.raw, nodes.target, nodes.image, nodes.figure)


@cache
def _words() -> dict[str, str]:
    return yaml.safe_load(WORDS.read_text())


def _text(node: nodes.Node) -> str:
    return " ".join(node.astext().split())


def _shorten(text: str, length: int = LINES) -> str:
    """Return the first sentences that fit into `length` characters, or the first one cut between words."""
    kept = ""
    for sentence in _SENTENCE.split(text):
        if len(kept) + len(sentence) > length:
            break
        kept = f"{kept} {sentence}".strip()
    return kept or f"{text[:length].rsplit(' ', 1)[0]} ..."


def description(doctree: nodes.document) -> str:
    """Return the first sentences of a page's first paragraph, with at most LINES characters; "" without one."""
    paragraph = next(iter(doctree.findall(nodes.paragraph)), None)
    return _shorten(_text(paragraph)) if paragraph else ""


def sections(doctree: nodes.document) -> Iterator[tuple[str, str, str]]:
    """Yield (heading, anchor, first lines) of each section below the page's title."""
    for section in doctree.findall(nodes.section):
        if isinstance(section.parent, nodes.section):
            own = [child for child in section.children if not isinstance(child, _NOT_PROSE)]
            # A table's words come last: they read badly in a line, but are all that some sections have
            own.sort(key=lambda child: isinstance(child, nodes.table))
            lines = " ".join(_text(child) for child in own)
            yield _text(section.next_node(nodes.title)), section["ids"][0], _shorten(lines) if own else ""


def _add_meta(app: Sphinx, page: str, template: str, context: dict, doctree: nodes.document | None) -> None:
    if doctree is not None:
        for name, content in (("description", description(doctree)), ("keywords", _words().get(page, ""))):
            if content:
                context["metatags"] += f'\n<meta name="{name}" content="{html.escape(content)}" />'


def _write_pages(app: Sphinx, error: Exception | None) -> None:
    if error or app.builder.format != "html":
        return
    pages = {}
    for page in sorted(app.env.found_docs):
        doctree = app.env.get_doctree(page)
        pages[page] = {
            "title": _text(app.env.titles[page]), "words": _words().get(page, ""),
            "description": description(doctree), "sections": list(sections(doctree)),
        }  # fmt: skip
    if unknown := _words().keys() - pages.keys():
        raise ValueError(f"{WORDS.name}: no page {', '.join(sorted(unknown))}")
    path = Path(app.outdir) / "_static/search_pages.js"
    path.write_text(f"const SEARCH_PAGES = {json.dumps(pages, ensure_ascii=False)};\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register both."""
    app.connect("html-page-context", _add_meta)
    app.connect("build-finished", _write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
