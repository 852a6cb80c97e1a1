"""docs/check_prose.py finds long sentences and house words, and passes over code, links' targets and verbs."""

import runpy
from pathlib import Path

import pytest

CHECK = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "check_prose.py"))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("The place of a star, its share of the flux.", ["place", "its share"]),
        ("| least flux | drawn | the judged gate, beside it |", ["least", "drawn", "judged", "beside"]),
        ("At least two windows share a frame; this takes place in place, by least squares.", []),
        ("`drawn` and [positions](places.md)", []),
        ("    place = 1", []),
        ("```\nbeside\n```", []),
    ],
)
def test_house_words_are_found_in_prose_and_tables(line, words):
    assert sorted(word for word, *_ in CHECK["house_words"](line)) == sorted(words)


@pytest.mark.parametrize(("words", "count"), [(CHECK["WORDS"], 0), (CHECK["WORDS"] + 1, 1)])
def test_a_sentence_of_one_word_too_many_is_found(words, count):
    assert len(CHECK["too_long"]("word " * (words - 1) + "end. Short one.")) == count


def test_a_page_with_a_house_word_fails(tmp_path, capsys):
    page = tmp_path / "page.md"
    page.write_text("A plain sentence.\n")
    assert CHECK["main"]([str(page)]) == 0
    page.write_text("The drawn galaxy.\n")
    assert CHECK["main"]([str(page)]) == 1
    assert "`drawn`: write rendered" in capsys.readouterr().out
