"""Text, JSON, HTML and pictures compared."""

from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.files.damage import reading
from csstsim.base.files.text_file import read_json, read_text
from csstsim.base.types import IntArray
from csstsim.studies.compare.facts import Fact, array_facts, short_repr
from csstsim.studies.compare.records import record_facts
from csstsim.studies.compare.varying import steady_page


def json_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two JSON files. Raises InputError for one that is none."""
    yield from record_facts("", *map(read_json, (a, b)))


def properties_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two files of lines `key=value`."""
    yield from record_facts("", *(dict(line.partition("=")[::2] for line in read_text(p).splitlines()) for p in (a, b)))


def page_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two reports, without run times."""
    (page_a, provenance_a), (page_b, provenance_b) = (steady_page(read_text(path)) for path in (a, b))
    if provenance_a != provenance_b:
        yield Fact("another section on provenance", "provenance")
    lines_a, lines_b = (page.replace("<", "\n<").removeprefix("\n") for page in (page_a, page_b))
    yield from _line_facts(lines_a, lines_b, "tags")


def text_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about two files whose bytes differ: line by line if they are text, otherwise their sizes."""
    try:
        texts = [read_text(path) for path in (a, b)]
    except InputError:
        sizes = " and ".join(str(path.stat().st_size) for path in (a, b))
        yield Fact(f"other bytes ({sizes} of them)")
        return
    yield from _line_facts(texts[0], texts[1], "lines") if texts[0] != texts[1] else [Fact("other ends of lines")]


def _line_facts(a: str, b: str, noun: str) -> Iterator[Fact]:
    lines_of_texts = a.splitlines(), b.splitlines()
    differing = [i for i, (x, y) in enumerate(zip_longest(*lines_of_texts)) if x != y]
    if differing:
        first = differing[0]
        x, y = (short_repr(lines[first]) if first < len(lines) else "nothing" for lines in lines_of_texts)
        total = max(map(len, lines_of_texts))
        verb = "differs" if len(differing) == 1 else "differ"
        yield Fact(f"{len(differing)} of {total} {noun} {verb}, first {noun[:-1]} {first + 1}: {x} and {y}")


def picture_facts(a: Path, b: Path) -> Iterator[Fact]:
    """Yield Facts about the pixels of two pictures. Raises InputError for one that is none."""
    yield from array_facts(
        "picture", *map(_picture, (a, b)), noun="values", position=lambda y, x, c: f"at x {x}, y {y}, colour {c}"
    )


def _picture(path: Path) -> IntArray:
    from PIL import Image

    try:
        with reading(path, "a picture"), Image.open(path) as picture:
            return np.asarray(picture.convert("RGBA"))
    except (SyntaxError, Image.DecompressionBombError) as exc:  # of a damaged PNG
        raise InputError(f"cannot be read as a picture: {exc}", file=path) from None
