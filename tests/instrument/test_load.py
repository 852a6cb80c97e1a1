"""Data files with the source of each number: what is unwrapped, what is refused."""

import pytest

from csstsim.base.errors import InputError
from csstsim.instrument.load import data_files, folder_digest, read_data, sections

TEXT = """
gain: {value: 1.1, unit: e-/DN, source: paper, confidence: S}
charge:
  source: paper
  confidence: S/E-low
  unit: e-
  note: words
  dark: 0.02
  deep: {bias: 500, unit: e-, values_of: [1, 2]}
nodes:
  source: paper
  confidence: K+D-medium
  note: dropped
  values: [[1, 2.5], [3, 4]]
plain: {unit: words, note: kept, flag: true, empty: null}
"""


def read(tmp_path, text):
    (tmp_path / "a.yaml").write_text(text)
    return read_data(tmp_path / "a.yaml")


def test_numbers_come_without_their_sources(tmp_path):
    """Sections lose source, confidence, unit and note; words without numbers keep theirs."""
    found = read(tmp_path, TEXT)
    assert found == {
        "gain": 1.1, "charge": {"dark": 0.02, "deep": {"bias": 500, "values_of": [1, 2]}}, "nodes": [[1, 2.5], [3, 4]],
        "plain": {"unit": "words", "note": "kept", "flag": True, "empty": None},
    }  # fmt: skip
    assert sections(found) == {"dark": 0.02, "deep": {"bias": 500, "values_of": [1, 2]}} | found["plain"]


@pytest.mark.parametrize("code", ["S", "D", "K", "E", "E-low", "S-medium", "S/E", "S+D-low/K"])
def test_codes_that_are_known(tmp_path, code):
    assert read(tmp_path, f"a: {{value: 2, source: x, confidence: {code}}}") == {"a": 2}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: {value: 2, source: x, confidence: S-high}", r"a.confidence: unknown code \(got 'S-high'\)"),
        ("a: {value: 2, source: x, confidence: SD}", "a.confidence: unknown code"),
        ("a: {value: 2, source: x, confidence: s}", "a.confidence: unknown code"),
        ("a: {value: 2, source: x}", "a: source is given, but confidence is missing"),
        ("a: {value: 2, confidence: S}", "a: confidence is given, but source is missing"),
        ("a: {value: 2, source: '', confidence: S}", "a: confidence is given, but source is missing"),
        ("a: {value: words}", "a: source and confidence are missing"),
        ("a: {values: [1]}", "a: source and confidence are missing"),
        ("a: {b: [x, {c: 3}]}", r"a.b\[1\].c: a number without source and confidence \(got 3\)"),
        ("a: 0.5", "a: a number without source"),
    ],
)
def test_numbers_without_their_source_are_refused_by_key(tmp_path, text, words):
    with pytest.raises(InputError, match=rf"a.yaml: {words}"):
        read(tmp_path, text)


def test_every_kind_of_data_file_is_in_the_digest(tmp_path):
    """Compressed FITS files, too, and a file's name; what is left out by name, pictures and hidden files are not."""
    (tmp_path / "maps").mkdir()
    names = ["a.yaml", "b.conf", "c.csv", "d.fits", "maps/e.fits.fz", "maps/f.fits.gz"]
    for name in (*names, ".g.yaml", "h.png", "README.md", "maps/.i.fits"):
        (tmp_path / name).write_text("one")
    assert list(data_files(tmp_path)) == names
    before, without = folder_digest(tmp_path), folder_digest(tmp_path, without=("c.csv",))
    assert len(before) == 16 and before != without
    for name in names:
        (tmp_path / name).write_text("two")
        assert folder_digest(tmp_path) != before, name
        assert (folder_digest(tmp_path, without=("c.csv",)) == without) is (name == "c.csv")
        (tmp_path / name).write_text("one")
    (tmp_path / "a.yaml").rename(tmp_path / "aa.yaml")
    assert folder_digest(tmp_path) != before
