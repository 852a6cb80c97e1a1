"""The manifest: sha256sum reads it, it is reproducible, each change is found, hostile lines are refused."""

import shutil
import subprocess

import pytest
import spoil
from support.commands import command, done

from csstsim.delivery.manifest import HASHES, SIZES, manifest_faults, write_manifest


@pytest.fixture
def folder(tmp_path):
    """Two files, one empty, with their manifest."""
    for name, content in (("b/Norder=8.parquet", b"two"), ("a.fits", b"")):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    write_manifest(tmp_path, {"b/Norder=8.parquet": "merged brick", "a.fits": "Level-0"})
    return tmp_path


def found(folder, present=("a.fits", "b/Norder=8.parquet"), expected=()):
    return list(manifest_faults(folder, set(present), set(expected)))


def test_sha256sum_reads_the_manifest_of_a_campaign(copied):
    file, folder = copied
    said = done("verify", file, "--output", folder, "--manifest")
    assert HASHES in said
    subprocess.run(["sha256sum", "--strict", "--quiet", "-c", HASHES], cwd=folder, check=True)
    rows = [line.split("\t") for line in (folder / SIZES).read_text().splitlines()]
    assert rows[0] == ["path", "bytes", "product"] and len(rows) == 1 + int(said.split(": ")[1].split()[0])
    assert [row[0] for row in rows[1:]] == sorted(row[0] for row in rows[1:])
    assert all((folder / name).stat().st_size == int(size) for name, size, _ in rows[1:])
    first = [(folder / name).read_bytes() for name in (HASHES, SIZES)]
    done("verify", folder, "--manifest")
    assert first == [(folder / name).read_bytes() for name in (HASHES, SIZES)]
    moved = shutil.move(folder, folder.parent / "moved")
    done("verify", moved)
    (page,) = moved.glob("report/index.html")
    spoil.text("</title>", " </title>")(page)
    result = command("verify", moved)
    assert result.exit_code == 1 and result.output.startswith("report/index.html: its SHA-256 is not that of")


def test_no_manifest_of_a_folder_with_faults(copied):
    file, folder = copied
    (folder / "psf" / "chip_09.h5").unlink()
    result = command("verify", file, "--output", folder, "--manifest")
    assert result.exit_code == 1 and "no manifest was written" in result.output
    assert not (folder / HASHES).exists() and not (folder / SIZES).exists()


def test_what_changed(folder):
    assert found(folder) == []
    assert (folder / HASHES).read_text().splitlines()[0].startswith("e3b0c44298fc1c14")  # SHA-256 of nothing
    assert found(folder, ["a.fits"])[0] == ("b/Norder=8.parquet", "no product")
    (folder / "a.fits").write_bytes(b"x")
    assert found(folder) == [("a.fits", f"its SHA-256 is not that of {HASHES}: changed since")]
    (folder / "a.fits").unlink()
    assert found(folder, ["b/Norder=8.parquet"]) == [("a.fits", f"listed in {HASHES}, but missing")]
    assert found(folder, ["b/Norder=8.parquet"], ["a.fits"]) == []  # missed as a product already
    (folder / "a.fits").write_bytes(b"")
    assert found(folder, ["a.fits", "b/Norder=8.parquet", "c"]) == [("c", f"not listed in {HASHES}: newer")]
    (folder / SIZES).write_text("path\tbytes\tproduct\n")
    assert [name for name, _ in found(folder)] == [SIZES]
    (folder / SIZES).unlink()
    assert found(folder) == [(SIZES, "missing")]


@pytest.mark.parametrize(
    "line",
    [
        "0" * 64 + "  ../../etc/passwd", "0" * 64 + "  /etc/passwd", "0" * 64 + "  b/../../x",
        "\\" + "0" * 64 + "  a\\nb",
        "0" * 63 + "  a.fits", "0" * 64 + " a.fits", "", "x" * 100_000, "0" * 64 + "  a.fits\n" + "0" * 64 + "  a.fits",
    ],
)  # fmt: skip
def test_hostile_lines(folder, line):
    (folder / HASHES).write_text(line + "\n")
    ((name, fault),) = found(folder)
    assert name == HASHES and "line " in fault and len(fault) < 400


def test_bytes_that_are_no_text(folder):
    (folder / HASHES).write_bytes(b"\xff\x00" * 40)
    assert found(folder) == [(HASHES, "holds bytes that are no text")]


def test_an_interrupted_write_leaves_the_old_manifest(folder):
    old = (folder / HASHES).read_bytes()
    with pytest.raises(OSError):
        write_manifest(folder, {"a.fits": "Level-0", "gone.fits": "Level-0"})
    assert (folder / HASHES).read_bytes() == old and found(folder) == []
