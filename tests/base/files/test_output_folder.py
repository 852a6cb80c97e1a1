"""An output folder that cannot be written is refused before any work, and is not made."""

import pytest

from csstsim.base.errors import InputError
from csstsim.base.files.output_folder import output_folder


def test_a_new_folder_is_not_made_yet(tmp_path):
    assert output_folder(tmp_path / "a" / "b") == tmp_path / "a" / "b" and not (tmp_path / "a").exists()


@pytest.mark.parametrize("name", ["file", "file/inside"])
def test_a_file_is_no_folder(tmp_path, name):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"--output: .*file is not a folder.*allowed: a folder"):
        output_folder(tmp_path / name)
