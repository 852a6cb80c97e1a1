"""The extensions of the site: what they take from a page, and which picture they choose."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from docutils import nodes
from docutils.core import publish_doctree
from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))
import number_cells
import page_summaries
import webp_pictures

PAGE = """
Title
=====

First sentence. {second}

One
---

Words of one.

Two
---

===== =====
a     b
===== =====
in    table
===== =====

Words of two.

Deep
~~~~

Words below.
"""


@pytest.fixture
def doctree() -> nodes.document:
    return publish_doctree(PAGE.format(second=" ".join(["word"] * 100) + "."), settings_overrides={"doctitle_xform": 0})


def test_a_description_ends_with_a_sentence(doctree: nodes.document) -> None:
    assert page_summaries.description(doctree) == "First sentence."


def test_a_long_first_sentence_is_cut_between_words() -> None:
    lines = page_summaries.description(publish_doctree("word " * 100))
    assert lines.endswith("word ...") and len(lines) <= page_summaries.LINES + 4


def test_a_page_without_a_paragraph_has_no_description() -> None:
    assert page_summaries.description(publish_doctree("")) == ""


def test_sections_have_their_own_lines_with_tables_last(doctree: nodes.document) -> None:
    assert list(page_summaries.sections(doctree)) == [
        ("One", "one", "Words of one."), ("Two", "two", "Words of two. a b in table"), ("Deep", "deep", "Words below."),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "expected"),
    [("-1e-06 ± 3e-07", True), ("< 0.064", True), ("5,022 ± 133 †", True), ("12% !", True), ("848 to 999", False),
     ("r", False), ("", False), ("1,234.5", False), ("0.16, 0.46, 0.83, 0.92, 1.00", False)],
)  # fmt: skip
def test_numbers_are_known(text: str, expected: bool) -> None:
    assert bool(len(text) <= number_cells.LONGEST and number_cells._NUMBER.fullmatch(text)) == expected


def test_a_drawing_becomes_lossless_webp_of_at_most_the_width(tmp_path: Path) -> None:
    drawing = np.zeros((300, 2 * webp_pictures.MAX_WIDTH, 3), np.uint8)
    drawing[::7] = 255
    Image.fromarray(drawing).save(tmp_path / "a.png", compress_level=0)
    assert webp_pictures.to_webp(tmp_path / "a.png", tmp_path / "a.webp")
    with Image.open(tmp_path / "a.webp") as picture:
        assert picture.size == (webp_pictures.MAX_WIDTH, 150)
    assert sorted(os.listdir(tmp_path)) == ["a.png", "a.webp"]


def test_a_picture_that_would_not_get_lighter_stays(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (64, 64, 3), np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.jpg", quality=1)
    assert not webp_pictures.to_webp(tmp_path / "noise.jpg", tmp_path / "noise.webp")
    assert not list(tmp_path.glob("*.webp"))
