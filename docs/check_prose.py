"""Find long sentences in pages: python docs/check_prose.py [PAGE]...      default: every page, and README.md's length.

A sentence has at most WORDS words. Code, tables, maths and links' targets are not prose. Prints a line for each
sentence that is too long; exit code 1 if there is any, or if README.md has more than README_WORDS words.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WORDS, README_WORDS = 35, 1500
PAGES = ("README.md", "CONTRIBUTING.md", "docs/**/*.md", "survey_tables/README.md", "examples/*/README.md")
_NOT_PROSE = (
    (r"(?s)^---\n.*?\n---\n", "\n"), (r"(?ms)^ *(```+|~~~).*?^ *\1 *$", "\n\n"), (r"(?s)\$\$.*?\$\$", " maths "),
    (r"(?m)^ {4,}\S.*$", ""), (r"(?m)^\|.*$", ""), (r"(?m)^\(.*\)=$", ""), (r"!?\[([^\]]*)\]\([^)]*\)", r"\1"),
    (r"\$[^$\n]+\$", "maths"), (r"`[^`\n]*`", "code"), (r"(?m)^#+ .*$", "\n\n"), (r"<[^>]+>", ""),
)  # fmt: skip
_BREAK = re.compile(r"\n\s*\n|\n\s*(?:[-*+]|\d+\.) ")  # between paragraphs, and items of a list
_ENDS = re.compile(r"(?<=[.!?])[\"')]*\s+")


def sentences(text):
    """Return the sentences of a page."""
    for pattern, instead in _NOT_PROSE:
        text = re.sub(pattern, instead, text)
    found = [part for block in _BREAK.split("\n" + text) for part in _ENDS.split(" ".join(block.split()))]
    return [part for part in found if re.search(r"[a-z]", part)]


def too_long(text):
    """Return [(words, sentence)] of a page's sentences with more than WORDS words."""
    counted = [(len(re.findall(r"[A-Za-z][\w'-]*", sentence)), sentence) for sentence in sentences(text)]
    return [(count, sentence) for count, sentence in counted if count > WORDS]


def main(names):
    """Print what is too long; return the exit code."""
    paths = [Path(name) for name in names] or sorted({p for pattern in PAGES for p in ROOT.glob(pattern)})
    long_ones = [(path, *found) for path in paths for found in too_long(path.read_text())]
    for path, count, sentence in long_ones:
        print(f"{path}: {count} words: {sentence}")
    readme = len((ROOT / "README.md").read_text().split())
    if not names:
        print(f"README.md has {readme} words, at most {README_WORDS}")
    return 1 if long_ones or (not names and readme > README_WORDS) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
