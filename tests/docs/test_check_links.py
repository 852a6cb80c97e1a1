"""docs/check_links.py finds broken links in a site, and nothing else."""

import runpy
from pathlib import Path

import pytest

CHECK = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "check_links.py"))
GOOD = (
    '<h1 id="here">a</h1><a href="#here">1</a><a href="sub/b.html#there">2</a><a href="https://csst.invalid/x">3</a>'
    '<img src="a%20picture.png"><a href="#">4</a><a href="mailto:a@b">5</a>'
)


@pytest.fixture
def site(tmp_path):
    """A site of two pages and a picture, all of whose links are good; its folder."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "a.html").write_text(GOOD)
    (tmp_path / "sub" / "b.html").write_text('<a name="there"></a><a href="../a.html#here">back</a>')
    (tmp_path / "a picture.png").write_bytes(b"png")
    return tmp_path


def test_good_links_pass(site):
    assert CHECK["main"](site) == 0


@pytest.mark.parametrize(
    "planted",
    [
        '<a href="gone.html">x</a>', '<a href="#nowhere">x</a>', '<a href="sub/b.html#nowhere">x</a>',
        '<img src="gone.png">', '<a href="sub">a folder is no page</a>', '<a href="../outside.html">x</a>',
    ],
)  # fmt: skip
def test_a_planted_dead_link_is_found(site, planted, capsys):
    (site.parent / "outside.html").write_text("")
    (site / "c.html").write_text(GOOD + planted)
    assert CHECK["main"](site) == 1
    assert capsys.readouterr().out.count("dead link") == 1


def test_a_folder_without_pages_is_a_fault(tmp_path, capsys):
    assert CHECK["main"](tmp_path) == 1
