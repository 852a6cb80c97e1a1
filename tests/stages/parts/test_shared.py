"""Products of a base that its variants copy: whole or not there at all, and files of their own."""

import shutil

import pytest

from csstsim.stages.parts.shared import copied


def pair(folder, name="frame.fits"):
    """Return (file of the base, file of the variant); the variant's folder is not there yet."""
    theirs = folder / "base" / name
    theirs.parent.mkdir(exist_ok=True)
    theirs.write_bytes(name.encode() * 1000)
    return theirs, folder / "variants" / "warm" / name


def test_what_the_base_made_is_copied_into_the_variants_folder(tmp_path):
    pairs, logged = [pair(tmp_path), pair(tmp_path, "truth.parquet")], []
    assert copied(pairs, logged.append) and logged == [f"equal in the base, not made: {pairs[0][0]}"]
    for theirs, own in pairs:
        assert own.read_bytes() == theirs.read_bytes() and not own.samefile(theirs) and not own.is_symlink()
    assert len(list(tmp_path.rglob("*.*"))) == 4
    assert not copied([], logged.append) and len(logged) == 1


@pytest.mark.parametrize("before", [None, b"of an earlier run"])
def test_a_copy_that_is_broken_off_leaves_what_was_there(tmp_path, monkeypatch, before):
    theirs, own = pair(tmp_path)
    if before:
        own.parent.mkdir(parents=True)
        own.write_bytes(before)
    logged = []

    def half(source, target):
        data = source.read_bytes()
        target.write_bytes(data[: len(data) // 2])
        assert not own.exists() or own.read_bytes() == before, "a reader sees half of it"
        raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "copyfile", half)
    with pytest.raises(KeyboardInterrupt):
        copied([(theirs, own)], logged.append)
    assert [path.read_bytes() for path in own.parent.iterdir()] == ([before] if before else []) and not logged
