"""Parts of a page: the words, numbers and HTML of each."""

import base64

import numpy as np
import pytest

from csstsim.report import parts
from csstsim.report.parts import Details, Gallery, Link, Pairs, Paragraph, Section, Table, Verdict, draw, mappings

PNG, WEBP = b"\x89PNG rest", b"RIFF rest"


def test_a_table_of_mappings_has_the_keys_of_all_rows():
    """A key that only a later row has is a column, too; what a row lacks is None."""
    table = mappings(iter([{"a": 1, "b": 2}, {"b": 3, "c": 0}, {}]), "things")
    assert table == Table(["a", "b", "c"], [[1, 2, None], [None, 3, 0], [None, None, None]], "things")
    assert mappings([]).rows == [] and mappings([{}]).name == "rows"


@pytest.mark.parametrize(
    ("column", "style"),
    [
        ([1, 2.5, None], "n"), (["12", "-3e2"], "n"), ([True, 1], ""), (["nan", 1], ""), ([np.inf], ""),
        (["a", 1], ""), ([Link("1", "#")], ""), ([(1,)], ""), ([None], "n"),
    ],
)  # fmt: skip
def test_a_column_of_numbers_is_one_in_which_all_are(column, style):
    assert Table(("x", "words"), [(value, "word") for value in column]).styles == [style, ""]


def test_verdicts_and_pictures_have_their_words_and_classes():
    assert [(v.style, v.word) for v in map(Verdict, (True, False, None))] == [
        ("pass", "pass"), ("fail", "FAIL"), ("none", "not evaluated"),
    ]  # fmt: skip
    for picture, kind, style in ((PNG, "png", "chart"), (WEBP, "webp", "photo")):
        figure = parts.Figure(picture, "caption", style)
        assert figure.url == f"data:image/{kind};base64,{base64.b64encode(picture).decode()}"
        assert figure.style == style
        image = f'<div class="pan"><img alt="caption" src="{figure.url}"></div><figcaption>caption</figcaption>'
        assert draw(figure).strip() == f'<figure class="{style}">{image}</figure>'


def test_values_have_four_digits_in_tables_and_ten_in_pairs():
    value = 1234.56789012
    table = draw(Table(("a", "b", "c"), [(value, 123456, None), (np.float64(0.5), (Link("x", "y.fits"), "z"), True)]))
    assert "<th>a</th>" in table or '<th class="n">a</th>' in table
    assert all(cell in table for cell in (">1235<", ">123456<", ">-<", ">0.5<", '<a href="y.fits">x</a> z', ">True<"))
    assert "<tr><th>k</th><td>1234.56789</td></tr>" in draw(Pairs({"k": value}))
    assert '<span class="fail">FAIL</span>' in draw(Table(("v",), [(Verdict(False),)]))
    assert '<p class="s">1235</p>' in draw(Paragraph(value, "s"))


def test_nested_parts_are_drawn_in_order_and_empty_ones_not_at_all():
    section = draw(Section("name", "A title", [Details("line", [Paragraph("in")]), Paragraph("out")], level=3))
    assert '<section id="name"><h3>A title</h3>' in section
    assert section.index("<summary>line</summary>") < section.index("in</p>") < section.index("</details>")
    assert section.index("</details>") < section.index("out</p>") < section.index("</section>")
    two = draw(Gallery([parts.Figure(PNG, "one"), parts.Figure(WEBP, "two")]))
    assert two.index("one") < two.index("two") and two.count("<figure") == 2 and 'class="gallery"' in two
    for empty in (Table((), []), Pairs({}), Gallery([]), Paragraph("")):
        assert draw(empty).strip() == ""
    assert "<details>" in draw(Table(("a",), [(1,)] * 41, "x")) and "<details>" not in draw(Table(("a",), [(1,)] * 40))
    assert "&lt;b&gt;" in draw(Details("<b>", []))
