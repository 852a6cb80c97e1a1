"""Atomic writing: the file is whole or as it was."""

import os
import subprocess

import pytest

from csstsim.atomic import HOST, atomic_path, remove_left


def test_success_replaces_and_leaves_nothing_else(tmp_path):
    path = tmp_path / "new" / "a.fits"
    for text in ("one", "two"):
        with atomic_path(path) as temporary:
            assert temporary.parent == path.parent and temporary.suffix == ".fits"
            temporary.write_text(text)
        assert path.read_text() == text
    assert list(path.parent.iterdir()) == [path]


def test_failure_keeps_the_old_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(RuntimeError), atomic_path(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_nothing_written_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_path(tmp_path / "a.txt"):
        pass
    assert not list(tmp_path.iterdir())


def left(path, host, pid):
    found = path.with_name(f".{path.stem}.{host}.{pid}.tmp{path.suffix}")
    found.write_text("half")
    return found


def test_what_a_killed_writer_left_is_removed_and_what_another_writes_is_not(tmp_path):
    path, dead = tmp_path / "a.txt", subprocess.Popen(["true"])
    dead.wait()
    lost, other = left(path, HOST, dead.pid), left(tmp_path / "b.txt", HOST, dead.pid)
    alive, elsewhere = left(path, HOST, os.getppid()), left(path, "node7", dead.pid)
    with atomic_path(path) as temporary:
        temporary.write_text("whole")
    assert not lost.exists() and all(file.exists() for file in (path, other, alive, elsewhere))
    assert remove_left(tmp_path) == 2
    assert sorted(tmp_path.iterdir()) == sorted([path, alive])
