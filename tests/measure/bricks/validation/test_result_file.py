"""The file of a brick's validation: read as written, refused when a byte of the verdict changed."""

import pytest

from csstsim.base.errors import InputError
from csstsim.measure.bricks.validation.result_file import read_result, write_result

RESULT = {"brick": 7, "purity": None, "gates": [{"name": "a", "value": 0.1, "passed": True}]}


def test_a_result_is_read_as_written(tmp_path):
    write_result(tmp_path / "a.json", RESULT)
    assert read_result(tmp_path / "a.json") == RESULT and "checksum" not in RESULT


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"passed": true', '"passed": false', "damaged"), ('"value": 0.1', '"value": 0.2', "damaged"),
        ('"checksum"', '"sum"', "not the validation of a brick"), ('"brick": 7', '"brick" 7', "a.json"),
    ],
)  # fmt: skip
def test_a_changed_file_is_refused(tmp_path, old, new, words):
    path = tmp_path / "a.json"
    write_result(path, RESULT)
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=words):
        read_result(path)


def test_other_json_and_no_file_are_refused(tmp_path):
    (tmp_path / "list.json").write_text("[1, 2]\n")
    for name, words in (("list.json", "not the validation of a brick"), ("none.json", "none.json")):
        with pytest.raises(InputError, match=words):
            read_result(tmp_path / name)
