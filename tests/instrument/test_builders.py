"""Builders of shipped data: run as a check they write nothing, and a rounding on another machine changes no file."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from build_dust_map import same_map
from kept import Keeper, same_fits
from make_tables import same_table

ROOT = Path(__file__).resolve().parents[2]
INSTRUMENT = ROOT / "config" / "instrument"
NUMBER = re.compile(r"-?\d\.\d+e-\d+")


@pytest.fixture
def instrument(tmp_path):
    return Path(shutil.copytree(INSTRUMENT, tmp_path / "instrument"))


def built(builder, *arguments):
    """Run a builder; return its exit code."""
    run = subprocess.run([sys.executable, ROOT / "builders" / builder, *map(str, arguments)], capture_output=True)
    assert run.returncode in (0, 1) and b"Traceback" not in run.stderr, run.stderr.decode()
    return run.returncode


def content(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def changed(path, factor, shift=0.0):
    """Change all numbers with an exponent of a .conf file, which are small coefficients."""
    text = NUMBER.sub(lambda number: f"{float(number[0]) * factor + shift:.9g}", path.read_text())
    path.write_text(text)


@pytest.mark.thorough
def test_gratings_that_differ_by_a_rounding_are_not_written(instrument):
    changed(instrument / "gratings" / "GV4.conf", 1 + 2e-9, 1e-20)
    before = content(instrument)
    assert built("build_gratings.py", "--check", instrument) == 0
    assert built("build_gratings.py", instrument) == 0
    assert content(instrument) == before


def test_a_check_tells_what_differs_and_writes_nothing(instrument):
    """A slope of 1e-6, an efficiency of 1e-4, and a missing file; a plain run then mends them."""
    changed(instrument / "gratings" / "GI1.conf", 1 + 1e-6)
    with fits.open(instrument / "gratings" / "GU_p1.fits", mode="update") as file:
        file[1].data["SENSITIVITY"] *= 1 + 1e-4
    (instrument / "gratings" / "GV_m1.fits").unlink()
    before = content(instrument)
    assert built("build_gratings.py", "--check", instrument) == 1
    assert content(instrument) == before
    assert built("build_gratings.py", instrument) == 0
    assert {path.name for path in content(instrument)} == {path.name for path in content(INSTRUMENT)}
    assert built("build_gratings.py", "--check", instrument) == 0


@pytest.mark.thorough
def test_distortion_is_checked_without_a_change(instrument):
    file = instrument / "distortion.fits"
    assert (
        built("build_distortion.py", "--check", instrument) == 0
        and file.read_bytes() == content(INSTRUMENT)[INSTRUMENT / "distortion.fits"]
    )
    with fits.open(file, mode="update") as table:
        table["GLOBAL"].data["coefficients"] *= 1 + 1e-5
    before = file.read_bytes()
    assert built("build_distortion.py", "--check", instrument) == 1 and file.read_bytes() == before


def test_what_the_same_is(tmp_path):
    """Tables to two units of the last digit; maps to a step of theirs; FITS by header, shape and tolerance."""
    one, other = (tmp_path / name for name in ("one.csv", "other.csv"))
    head = "obsid,ra,time\n"
    one.write_text(head + "10100000001,60.123456,2027-11-20T01:08:00\n")
    for cells, same in (
        ("10100000001,60.123458,2027-11-20T01:08:00", True), ("10100000001,60.123460,2027-11-20T01:08:00", False),
        ("10100000002,60.123456,2027-11-20T01:08:00", False), ("10100000001,60.123456,2027-11-20T01:12:00", False),
        ("10100000001,60.12345,2027-11-20T01:08:00", False),
        ("10100000001,60.123456,2027-11-20T01:08:00\n1,2,3", False),
    ):  # fmt: skip
        other.write_text(f"{head}{cells}\n")
        assert same_table(one, other) == same, cells
    values = np.linspace(0.01, 1.0, 12).astype(np.float32)
    paths = [tmp_path / f"{k}.fits" for k in range(4)]
    for path, data in zip(paths, (values, values * np.float32(1 + 1e-3), values * 1.02, values[:6]), strict=True):
        fits.BinTableHDU.from_columns([fits.Column("EBV", "1E", array=data)]).writeto(path)
    assert [same_map(paths[0], path) for path in paths] == [True, True, False, False]
    assert [same_fits(2e-3)(paths[0], path) for path in paths] == [True, True, False, False]
    fits.setval(paths[1], "UNIT", value="mag", ext=1)
    assert not same_fits(2e-3)(paths[0], paths[1])


def test_a_file_is_replaced_as_a_whole(tmp_path):
    path, keeper = tmp_path / "file.txt", Keeper()
    with keeper.file(path) as new:
        new.write_text("first")
    with pytest.raises(RuntimeError), keeper.file(path) as new:
        new.write_text("part")
        raise RuntimeError
    assert path.read_text() == "first" and keeper.differing == [path] and keeper.code() == 0
    with Keeper(check=True).file(tmp_path / "other.txt") as new:
        new.write_text("never")
    assert not (tmp_path / "other.txt").exists()
