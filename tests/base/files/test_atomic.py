"""Atomic writing: a file is either complete or unchanged."""

import errno
import os
import subprocess
from pathlib import Path

import pytest

from csstsim.base.errors import InputError
from csstsim.base.files.atomic import HOST, atomic_path, remove_left


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


@pytest.fixture
def calls(monkeypatch, tmp_path):
    """What is asked of the disk, in order: ("fsync", name, size of the file or None) and ("rename", from, to)."""
    seen, fsync, replace = [], os.fsync, os.replace
    names = {}

    def synced(handle):
        about = os.fstat(handle)
        here = [tmp_path, *tmp_path.rglob("*")]
        names.update({path.stat().st_ino: path for path in here})
        seen.append(("fsync", names[about.st_ino], about.st_size if names[about.st_ino].is_file() else None))
        fsync(handle)

    def renamed(old, new):
        seen.append(("rename", Path(old), Path(new)))
        replace(old, new)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", renamed)
    return seen


def test_the_file_is_on_disk_before_it_has_its_name_and_then_the_name_is(tmp_path, calls):
    """Else a crash of the machine leaves a product that is empty, or one that a later rule saw and is gone."""
    path = tmp_path / "a.fits"
    with atomic_path(path) as temporary:
        temporary.write_bytes(b"x" * 5000)
        assert not calls
    assert calls == [("fsync", temporary, 5000), ("rename", temporary, path), ("fsync", tmp_path, None)]


def test_nothing_is_renamed_that_could_not_be_flushed(tmp_path, calls, monkeypatch):
    def broken(handle):
        raise OSError(errno.EIO, "the disk is broken")

    monkeypatch.setattr(os, "fsync", broken)
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(InputError, match="cannot be written"), atomic_path(path) as temporary:
        temporary.write_text("new")
    assert calls == [] and path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


def test_only_errors_of_the_disk_on_the_way_to_the_product_are_said_of_it(tmp_path):
    """Another file's, such as an input that may not be read, keep their own name; so do errors that are bugs."""
    path, other = tmp_path / "new" / "a.txt", tmp_path / "input.txt"
    for error, product in (
        (OSError(errno.ENOSPC, "full"), True), (PermissionError(errno.EACCES, "no", str(tmp_path)), True),
        (OSError(errno.EROFS, "read only", str(path.parent)), True),
        (PermissionError(errno.EACCES, "no", str(other)), False), (OSError(errno.EIO, "broken", str(other)), False),
        (FileNotFoundError(errno.ENOENT, "none", str(tmp_path)), False),
    ):  # fmt: skip
        with pytest.raises(InputError if product else OSError) as caught, atomic_path(path):
            raise error
        if product:
            assert caught.value.file == path and caught.value.__cause__ is error
        else:
            assert caught.value is error
    assert list(tmp_path.rglob("*")) == [path.parent]


def test_what_a_process_of_another_user_writes_is_left(tmp_path, monkeypatch):
    """Signals to it are forbidden, so it lives; one whose number is beyond all processes does not."""
    path = tmp_path / "a.txt"
    alive, gone = left(path, HOST, 4321), left(path, HOST, 10**30)

    def kill(pid, number):
        if pid > 2**31:
            raise OverflowError
        raise PermissionError(errno.EPERM, "not permitted")

    monkeypatch.setattr(os, "kill", kill)
    with atomic_path(path) as temporary:
        temporary.write_text("whole")
    assert remove_left(tmp_path) == 0 and alive.exists() and not gone.exists()


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
