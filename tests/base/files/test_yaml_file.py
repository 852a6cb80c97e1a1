"""YAML is read strictly: ambiguous content is refused in one line that says where it is."""

import pytest

from csstsim.base.errors import InputError
from csstsim.base.files import yaml_file
from csstsim.base.files.yaml_file import read_yaml


def written(tmp_path, text):
    path = tmp_path / "some.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: {c: 1,\n    d: 2, c: 3}\n", "some.yaml: line 3: not valid YAML: key 'c' given twice"),
        ("a: 1\na: 2\n", "line 2: .*key 'a' given twice"),
        ("a: 2027-13-45\n", "not valid YAML: month must be in 1..12"),
        ("a: " + "1" * 5000, "not valid YAML: Exceeds the limit"),
        ("a: !!timestamp x", "not valid YAML"),
        ("a: [1, 2", r"line \d: not valid YAML"),
        ("a: " + "[" * 5000 + "]" * 5000, "line 1: not valid YAML: nested deeper than 100 levels"),
        ("a: " + "[" * 300_000, "nested deeper than 100 levels"),
        ("a: " + "{b: " * 300_000, "nested deeper than 100 levels"),
        ("- " * 300_000, "nested deeper than 100 levels"),
        ("a: \x07", "not valid YAML"),
        ("? [1]\n: 2\n", "not valid YAML"),
        ("- 1\n- 2\n", "must hold a mapping of keys"),
        ("", "must hold a mapping of keys"),
    ],
)
def test_refused(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as caught:
        read_yaml(written(tmp_path, text))
    assert len(str(caught.value)) < 400 + len(str(tmp_path))


def test_numbers_are_decimal_and_times_text(tmp_path):
    text = "a: 1:30\nb: 010\nc: 1_000\nd: 1:30.5\ne: -7\nf: 0\ng: 1.5e+3\nh: 0x10\ni: 0.25\n"
    wanted = {"a": "1:30", "b": "010", "c": 1000, "d": "1:30.5", "e": -7, "f": 0, "g": 1500.0, "h": 16, "i": 0.25}
    assert read_yaml(written(tmp_path, text)) == wanted


def test_anchors_and_merged_keys_still_work(tmp_path):
    text = "base: &b {x: 1, y: 2}\nmore: {<<: *b, x: 3}\nsame: *b\n"
    assert read_yaml(written(tmp_path, text))["more"] == {"x": 3, "y": 2}


def test_what_was_read_is_the_readers_own(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("a: [1, 2]\nb: {c: 3}\n")
    first = read_yaml(path)
    first["a"].append(9), first["b"].clear()
    assert read_yaml(path) == {"a": [1, 2], "b": {"c": 3}}
    path.write_text("a: 1\n")
    assert read_yaml(path) == {"a": 1}


def test_missing_unreadable_and_impossible_files(tmp_path):
    (tmp_path / "latin.yaml").write_bytes(b"a: \xe9\n")
    for path, message in (
        (tmp_path / "none.yaml", "No such file"), (tmp_path, "is a folder, not a file"),
        (tmp_path / "latin.yaml", "not UTF-8"), ("a\0b", "null"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            read_yaml(path)


def test_long_values_are_cut_in_messages():
    endless = []
    endless.append(endless)
    deep = 1
    for _ in range(100_000):
        deep = [deep]
    for value in ("x" * 10_000, list(range(10_000)), 10**5000, endless, deep):
        assert len(str(InputError("no", value=value))) < 200
    while isinstance(deep, list):  # a list this deep must not be left to be freed at once
        deep = deep.pop()


@pytest.mark.parametrize(("text", "depth"), [
    ("a: " + "[" * 98 + "]" * 98, None), ("a: " + "[" * 99 + "]" * 99, None), ("a: " + "[" * 100 + "]" * 100, 100),
    ("a: &x " + "[" * 98 + "]" * 98 + "\nb: *x", None), ("a: &x " + "[" * 98 + "]" * 98 + "\nb: [*x]", None),
    ("a: &x " + "[" * 98 + "]" * 98 + "\nb: [[*x]]", 100), ("a: &x " + "[" * 50 + "]" * 50 + "\nb: " + "[" * 49
     + "*x" + "]" * 49, None), ("a: &x " + "[" * 50 + "]" * 50 + "\nb: " + "[" * 50 + "*x" + "]" * 50, 100),
])  # fmt: skip
def test_levels_are_a_hundred_at_most_those_of_aliases_added(tmp_path, text, depth):
    """The mapping itself is one of them."""
    if depth is None:
        assert set(read_yaml(written(tmp_path, text))) <= {"a", "b"}
    else:
        with pytest.raises(InputError, match=f"nested deeper than {depth} levels"):
            read_yaml(written(tmp_path, text))


def test_values_are_counted_once_and_again_where_an_alias_repeats_them(tmp_path, monkeypatch):
    """A collection is a value: {a: [1, [2]], b: *x} has 2 + 1 + 4 and 4 again for the alias."""
    text = "a: &x [1, [2]]\nb: *x\n"
    for limit, good in ((12, True), (11, False)):
        monkeypatch.setattr(yaml_file, "VALUES", limit)
        yaml_file._parsed.cache_clear()
        if good:
            assert read_yaml(written(tmp_path, text)) == {"a": [1, [2]], "b": [1, [2]]}
        else:
            with pytest.raises(InputError, match="more than 11 values"):
                read_yaml(written(tmp_path, text))
