"""Find long sentences and house words in pages: python docs/check_prose.py [PAGE]...

Without a page: every page, and README.md's length. A sentence has at most WORDS words. HOUSE has words that the field
does not use for what is meant (docs/glossary.md), with those that it does. Code, maths and links' targets are not
prose; tables are searched for words alone. Prints a line for each find; exit code 1 if there is any, or if README.md
has more than README_WORDS words.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
WORDS, README_WORDS = 35, 1500
PAGES = ("README.md", "CONTRIBUTING.md", "docs/**/*.md", "survey_tables/README.md", "examples/*/README.md")
MADE = {ROOT / "docs/products.md"}  # by builders/make_products.py, with lists of keywords
HOUSE = {
    r"(?<!in )(?<!take )(?<!takes )places?": "position",
    r"(?:the|an?|its|their) shares?|shares? of": "fraction",
    r"(?<!at )least(?! squares)": "minimum, smallest",
    r"drawn": "rendered; a random number is sampled",
    r"judged?": "evaluated",
    r"beside": "next to, near; compared with",
}
_HOUSE = {re.compile(rf"\b(?:{word})\b", re.IGNORECASE): instead for word, instead in HOUSE.items()}
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


def house_words(text):
    """Return [(word, the field's words, line)] of a page's house words, tables included."""
    for pattern, instead in _NOT_PROSE:
        if not pattern.startswith(r"(?m)^\|"):
            text = re.sub(pattern, instead, text)
    return [
        (match.group(), better, line.strip())
        for line in text.splitlines()
        for word, better in _HOUSE.items()
        if (match := word.search(line))
    ]


def main(names):
    """Print what is found; return the exit code."""
    paths = [Path(name) for name in names] or sorted({p for pattern in PAGES for p in ROOT.glob(pattern)} - MADE)
    long_ones = [(path, *found) for path in paths for found in too_long(path.read_text())]
    for path, count, sentence in long_ones:
        print(f"{path}: {count} words: {sentence}")
    house = [(path, *found) for path in paths for found in house_words(path.read_text())]
    for path, word, better, line in house:
        print(f"{path}: `{word}`: write {better}: {line}")
    readme = len((ROOT / "README.md").read_text().split())
    if not names:
        print(f"README.md has {readme} words, at most {README_WORDS}")
    return 1 if long_ones or house or (not names and readme > README_WORDS) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
