"""A place for compiled code where neither the package nor the home can be written."""

import os
import tempfile
from pathlib import Path

import pytest

import csstsim
from csstsim.base.process.compiled_code import choose_folder


@pytest.fixture
def read_only(tmp_path, monkeypatch):
    """A package that cannot be written, for root neither, and a temporary folder of the test's."""
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path / "package"


def test_a_folder_of_the_users_own_is_chosen_where_there_is_no_other(read_only, tmp_path):
    environment = {"HOME": "/proc/nowhere"}
    chosen = choose_folder(environment, read_only)
    assert environment["NUMBA_CACHE_DIR"] == chosen == str(tmp_path / f"csstsim-compiled-{os.getuid()}")
    assert os.stat(chosen).st_mode & 0o777 == 0o700
    assert choose_folder({"HOME": "/proc/nowhere"}, read_only) == chosen, "the next process finds the code"


def test_nothing_is_chosen_where_numba_finds_a_place(read_only, tmp_path):
    for environment in ({"HOME": str(tmp_path)}, {"XDG_CACHE_HOME": str(tmp_path / "x")}, {"NUMBA_CACHE_DIR": "mine"}):
        given = dict(environment)
        assert choose_folder(environment, read_only) is None and environment == given


@pytest.mark.parametrize("environment", [{"HOME": ""}, {"HOME": "x"}, {"XDG_CACHE_HOME": "x", "HOME": "/nowhere"}])
def test_nothing_is_made_in_the_folder_where_one_stands(read_only, tmp_path, monkeypatch, environment):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    made = []
    monkeypatch.setattr(os, "makedirs", lambda path, **_: made.append(path))
    choose_folder(dict(environment), read_only)
    assert made and all(os.path.isabs(path) for path in made)


def test_a_folder_that_others_can_write_is_not_trusted(read_only, tmp_path):
    (tmp_path / f"csstsim-compiled-{os.getuid()}").mkdir()
    os.chmod(tmp_path / f"csstsim-compiled-{os.getuid()}", 0o777)
    assert choose_folder({"HOME": "/proc/nowhere"}, read_only) is None


def test_no_function_lets_the_compiler_reorder_its_sums():
    """With fastmath the bits depend on the order in which functions were compiled, which no two processes share."""
    files = list(Path(csstsim.__file__).parent.rglob("*.py"))
    assert len(files) > 300 and [str(path) for path in files if "fastmath" in path.read_text()] == []


def test_a_link_or_a_file_in_the_folders_place_is_not_trusted(read_only, tmp_path):
    """Whoever made the link decides what it leads to."""
    place, own = tmp_path / f"csstsim-compiled-{os.getuid()}", tmp_path / "own"
    own.mkdir(mode=0o700)
    place.symlink_to(own)
    environment = {"HOME": "/proc/nowhere"}
    assert choose_folder(environment, read_only) is None and "NUMBA_CACHE_DIR" not in environment
    place.unlink()
    place.write_text("a file")
    assert choose_folder(environment, read_only) is None
    place.unlink()
    place.mkdir(mode=0o750)
    assert choose_folder(environment, read_only) is None, "others can read it"
