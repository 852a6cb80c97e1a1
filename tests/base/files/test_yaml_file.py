"""YAML is read strictly: ambiguous content is refused in one line that says where it is."""

import pytest

from csstsim.base.errors import InputError
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


@pytest.mark.parametrize(("text", "good"), [
    ("a: " + "[" * 98 + "]" * 98, True), ("a: " + "[" * 99 + "]" * 99, True), ("a: " + "[" * 100 + "]" * 100, False),
    ("a: &x " + "[" * 99 + "]" * 99 + "\nb: [*x]", True),  # levels of an alias do not count
])  # fmt: skip
def test_levels_are_a_hundred_at_most(tmp_path, text, good):
    """The mapping itself is one of them."""
    if good:
        assert set(read_yaml(written(tmp_path, text))) <= {"a", "b"}
    else:
        with pytest.raises(InputError, match="nested deeper than 100 levels"):
            read_yaml(written(tmp_path, text))


@pytest.mark.parametrize("text", ["a: 1\nb: &x {c: *x}\n", "a: 1\nb: &x [1, {d: [*x]}]\n", "a: 1\nb: [&x {c: *x}]"])
def test_an_alias_inside_its_own_value_is_refused_with_its_line(tmp_path, text):
    with pytest.raises(InputError, match=r"some\.yaml: line 2: not valid YAML: alias 'x' inside its own value"):
        read_yaml(written(tmp_path, text))


def test_an_alias_may_stand_in_any_other_value(tmp_path):
    assert read_yaml(written(tmp_path, "a: &x [1, &y {b: 2}]\nc: [*x, *y, {d: *y}]\n")) == {
        "a": [1, {"b": 2}], "c": [[1, {"b": 2}], {"b": 2}, {"d": {"b": 2}}],
    }  # fmt: skip


def test_an_alias_of_nothing_is_refused(tmp_path):
    with pytest.raises(InputError, match="line 1: not valid YAML: found undefined alias"):
        read_yaml(written(tmp_path, "a: *x\n"))
