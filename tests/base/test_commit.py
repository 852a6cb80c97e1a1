"""The commit of a clone, of a package, and of neither."""

import pytest
from support.commands import done

from csstsim import __version__
from csstsim.base import commit

COMMIT = "c" * 40


@pytest.mark.parametrize("how", ["detached", "loose", "packed", "noted", "clone and note", "neither", "none"])
def test_commit_of_a_folder(tmp_path, how):
    git = tmp_path / ".git"
    if how not in ("noted", "none"):
        (git / "refs" / "heads").mkdir(parents=True)
        (git / "HEAD").write_text(f"{COMMIT}\n" if how == "detached" else "ref: refs/heads/main\n")
        (git / "packed-refs").write_text(
            f"# pack-refs\n{'a' * 40} refs/heads/main2\n" + f"{COMMIT} refs/heads/main\n" * (how == "packed")
        )
    if how in ("loose", "clone and note"):
        (git / "refs" / "heads" / "main").write_text(f"{COMMIT}\n")
    if how in ("noted", "clone and note"):
        (tmp_path / commit.NOTE).write_text(f"{COMMIT if how == 'noted' else 'b' * 40}\n")
    assert commit.commit_of(tmp_path) == (None if how in ("neither", "none") else COMMIT)


@pytest.mark.parametrize(("known", "words"), [(COMMIT, f" (commit {COMMIT})"), (None, "")])
def test_version_is_printed_with_the_commit(monkeypatch, known, words):
    monkeypatch.setattr(commit, "git_commit", lambda: known)
    assert done("--version") == f"csstsim {__version__}{words}\n"
