"""The log of files that are read and written."""

import logging
import re
import time

import pytest

from csstsim.base.files.file_log import logged


@pytest.mark.parametrize(("size", "said"), [(1500, "1.5 kB"), (2_500_000, "2.5 MB"), (999_999, "1e+03 kB")])
def test_a_line_has_the_size_and_the_time_that_the_work_took(tmp_path, caplog, size, said):
    path = tmp_path / "x"
    with caplog.at_level(logging.DEBUG, "csstsim.files"), logged("wrote", path):
        path.write_bytes(bytes(size))
        time.sleep(0.02)
    line = re.fullmatch(rf"wrote {path}: {re.escape(said)} in (\d+\.\d\d\d) s", caplog.messages[0])
    assert line and float(line[1]) >= 0.02


def test_what_failed_and_what_nobody_asks_for_has_no_line(tmp_path, caplog):
    with caplog.at_level(logging.INFO, "csstsim.files"), logged("read", tmp_path / "missing"):
        pass
    with caplog.at_level(logging.DEBUG, "csstsim.files"), pytest.raises(OSError, match="no"), logged("read", tmp_path):
        raise OSError("no")
    assert not caplog.messages
