"""Files that change are read again; those that do not are read once."""

import os
from pathlib import Path

from csstsim.base.files.lru_by_file_state import lru_by_file_state


def test_a_file_is_read_again_when_it_changes(tmp_path):
    read = []

    @lru_by_file_state(8)
    def text(name):
        read.append(name)
        return Path(name.partition("[")[0]).read_text()

    file = tmp_path / "a.txt"
    file.write_text("one")
    assert [text(str(file)), text(str(file)), text(f"{file}[1]")] == ["one"] * 3 and len(read) == 2
    file.write_text("two!")
    assert text(str(file)) == "two!"
    file.write_text("2222")
    os.utime(file, ns=(1, 1))  # of the same size
    assert text(str(file)) == "2222"
