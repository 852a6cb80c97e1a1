"""Small rules that many modules share: messages, digests, stages, units, numbers of a model, files of one folder."""

import hashlib
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import h5py
import numpy as np
import pytest
from astropy import constants, units

from csstsim.base import digest as digests
from csstsim.base import help_page, sphere, stages
from csstsim.base import units as ours
from csstsim.base.errors import MAX_MESSAGE, InputError, first_line
from csstsim.base.files import hdf5_file
from csstsim.base.files.damage import reading
from csstsim.base.files.relative_to_file import relative_to_file
from csstsim.base.files.text_file import read_json, read_text
from csstsim.base.model import (
    Data,
    FilePath,
    Model,
    NotNegative,
    Number,
    Positive,
    at_least,
    between,
    require,
    validate,
)
from csstsim.base.model import Whole as WholeNumber
from csstsim.base.stage_records import STAGES


@pytest.mark.parametrize(("fields", "said"), [
    ({}, "bad"), ({"file": "a.fits"}, "a.fits: bad"), ({"key": "k"}, "k: bad"), ({"value": "v"}, "bad (got 'v')"),
    ({"file": "f", "key": "k", "value": 0, "allowed": "1 to 3"}, "f: k: bad (got 0); allowed: 1 to 3"),
    ({"key": 0, "allowed": 0}, "0: bad; allowed: 0"), ({"value": np.float32(1.5)}, "bad (got 1.5)"),
    ({"value": np.array([1, 2])}, "bad (got array([1, 2]))"), ({"key": "a\n\x1b"}, "a \\x1b: bad"),
    ({"value": Path("a/b c")}, "bad (got 'a/b c')"),
])  # fmt: skip
def test_a_message_names_file_key_value_and_what_is_allowed(fields, said):
    error = InputError("bad", **fields)
    assert str(error) == said and error.message == "bad"
    assert all(getattr(error, name) is fields.get(name) for name in ("file", "key", "value", "allowed"))


def test_long_parts_of_a_message_are_cut():
    assert str(InputError("bad", key="k" * 160)) == "k" * 160 + ": bad"
    assert str(InputError("bad", key="k" * 161)) == "k" * 156 + " ...: bad"
    assert len(str(InputError("x" * 5000))) == MAX_MESSAGE and str(InputError("x" * MAX_MESSAGE)) == "x" * MAX_MESSAGE


def test_the_innermost_page_explains_an_error(tmp_path, monkeypatch):
    with pytest.raises(InputError) as caught, help_page.explained("campaign"), help_page.explained("instrument"):
        raise InputError("bad")
    assert caught.value.page == "config/instrument/README.md"
    (tmp_path / "config" / "instrument").mkdir(parents=True)
    (tmp_path / "config" / "instrument" / "README.md").write_text("")
    monkeypatch.setattr(help_page, "ROOT", tmp_path)
    assert help_page.with_page(caught.value) == f"bad; see {tmp_path}/config/instrument/README.md"
    monkeypatch.chdir(tmp_path)
    assert help_page.with_page(caught.value) == "bad; see config/instrument/README.md"
    caught.value.page = "`csstsim aim --help`"
    assert help_page.with_page(caught.value) == "bad; see `csstsim aim --help`"
    assert help_page.with_page(InputError("bad")) == "bad"


def test_digests_are_the_first_digits_of_sha_256(tmp_path):
    assert digests.digest({"b": 1, "a": [1.5, None]}) == hashlib.sha256(b'{"a": [1.5, null], "b": 1}').hexdigest()[:16]
    (tmp_path / "a").write_bytes(b"abc")
    assert digests.file_digest(tmp_path / "a") == "ba7816bf8f01cfea"  # of FIPS 180-2
    assert digests.module_digest(digests) is None and digests.module_digest(type(stages)("none")) is None
    other = type(stages)("mine")
    other.__file__ = str(tmp_path / "a")
    assert digests.module_digest(other) == "ba7816bf8f01cfea"
    other.__file__ = str(tmp_path / "gone")
    assert digests.module_digest(other) is None


def test_a_large_file_is_known_by_its_size_and_its_pieces(tmp_path, monkeypatch):
    """Every byte of a file that the pieces cover; else the first and the last ones and the size."""
    monkeypatch.setattr(digests, "_PIECE_SIZE", 4)
    monkeypatch.setattr(digests, "_PIECES", 3)
    content = bytearray(range(10))
    wanted = hashlib.sha256(b"10" + bytes([0, 1, 2, 3, 3, 4, 5, 6, 6, 7, 8, 9])).hexdigest()[:16]
    (tmp_path / "a").write_bytes(content)
    assert digests.large_file_digest(tmp_path / "a") == wanted
    for place in (0, 5, 9):
        changed = bytearray(content)
        changed[place] ^= 1
        (tmp_path / "a").write_bytes(changed)
        assert digests.large_file_digest(tmp_path / "a") != wanted
    (tmp_path / "a").write_bytes(b"ab")
    assert digests.large_file_digest(tmp_path / "a") == hashlib.sha256(b"2ababab").hexdigest()[:16]


def test_stages_that_run_side_by_side():
    assert stages.levels() == [
        ["truth", "psf"], ["select"], ["render"], ["readout"], ["level0"],
        ["masters", "calibrate", "measure", "extract"], ["merge"], ["validate"], ["report"], ["variants"],
    ]  # fmt: skip


def test_what_is_behind_each_stage():
    assert {name: len(stages.with_dependencies(name)) for name in STAGES} == {
        "truth": 1, "psf": 1, "select": 2, "render": 4, "readout": 5, "level0": 6, "chip": 3, "masters": 7,
        "calibrate": 7, "measure": 7, "extract": 7, "merge": 8, "validate": 9, "report": 11, "variants": 12,
    }  # fmt: skip
    assert stages.with_dependencies("render") == {"render", "select", "psf", "truth"}


def test_parts_are_read_by_the_stages_of_the_first_pattern_that_matches():
    readers = {"a.b*": ("render",), "a.*": ("select", "level0"), "c": ("level0",)}
    parts = {"a.bc": 1, "a.x": 2, "c": 3, "cc": 4, "new": 5}
    read = {stage: set(stages.read_by({stage}, parts, readers)) for stage in ("render", "select", "level0", "truth")}
    assert read == {
        "render": {"a.bc"}, "select": {"a.x", "cc", "new"}, "level0": {"a.x", "c"}, "truth": {"cc", "new"},
    }  # fmt: skip
    assert stages.read_by({"psf", "render"}, parts, readers) == {"a.bc": 1, "cc": 4, "new": 5}


def test_nested_names_are_dotted():
    tree = {"a": {"b": {"c": 1}, "d": []}, "e": {}, "f": None}
    assert stages.flatten(tree) == {"a.b.c": 1, "a.d": [], "e": {}, "f": None}


def test_constants_are_astropys():
    """Exact ones to rounding; the Earth's of WGS84, and of other sets, to what the sets differ by."""
    critical = 3 * (100 * units.km / units.s / units.Mpc) ** 2 / (8 * np.pi * constants.G)
    wanted = {
        "C_KM_S": (constants.c.to_value("km/s"), 1e-15), "C_A_S": (constants.c.to_value("AA/s"), 1e-15),
        "H_J_S": (constants.h.value, 1e-15), "K_J_K": (constants.k_B.value, 1e-15),
        "AU_KM": (constants.au.to_value("km"), 1e-15), "DAY_S": (units.day.to("s"), 1e-15),
        "JULIAN_YEAR_DAYS": (units.yr.to("day"), 1e-15), "EARTH_J2": (1.0826e-3, 1e-4),
        "EARTH_RADIUS_KM": (constants.R_earth.to_value("km"), 1e-5),
        "EARTH_GM_KM3_S2": (constants.GM_earth.to_value("km3/s2"), 2e-7),
        "SOLAR_RADIUS_PC": (constants.R_sun.to_value("pc"), 1e-6), "UM_PER_MM": (units.mm.to("um"), 1e-15),
        "CRITICAL_DENSITY_H2": (critical.to_value("solMass/Mpc3"), 1e-4), "NM_PER_UM": (units.um.to("nm"), 1e-15),
        "ARCSEC_PER_DEG": (units.deg.to("arcsec"), 1e-14), "ARCSEC_PER_RAD": (units.rad.to("arcsec"), 1e-14),
        "MAS_PER_RAD": (units.rad.to("mas"), 1e-14),
    }  # fmt: skip
    for name, (value, within) in wanted.items():
        assert getattr(ours, name) == pytest.approx(value, rel=within), name


@pytest.mark.parametrize(("wave", "magnitude"), [(2550.0, 0.0), (6200.0, 22.5), (9900.0, -1.0)])
def test_photons_of_an_ab_magnitude_are_astropys(wave, magnitude):
    density, at = units.photon / units.s / units.m**2 / units.AA, units.spectral_density(wave * units.AA)
    theirs = (magnitude * units.ABmag).to(density, at)
    assert ours.ab_photon_density(wave, magnitude) == pytest.approx(theirs.value, rel=1e-4)
    assert ours.ab_photon_density(wave) == ours.ab_photon_density(wave, 0.0)


def test_angles_at_the_ends_of_their_ranges():
    wrapped = {-180.0: -180, 180.0: -180, 179.0: 179, -181.0: 179, 540.0: -180, 0.0: 0}
    assert {angle: sphere.wrap_180(angle) for angle in wrapped} == wrapped
    assert sphere.wrap_360(np.array([-90.0, 360.0, 725.0, -1e-20])).tolist() == [270.0, 0.0, 5.0, 0.0]
    assert np.allclose(sphere.rotation(np.radians(30)) @ [1.0, 0.0], [np.sqrt(0.75), 0.5])
    assert np.allclose(sphere.rotation(np.radians(30)) @ [0.0, 1.0], [-0.5, np.sqrt(0.75)])
    assert np.allclose(sphere.normalised(np.array([[3.0, 0.0, 4.0], [0.0, -2.0, 0.0]])), [[0.6, 0, 0.8], [0, -1, 0]])
    east, north = sphere.offsets([10.2, 359.0], [-59.9, 1.0], [10.0, 1.0], [-60.0, 0.0])
    assert np.allclose(east, [0.1, -2.0]) and np.allclose(north, [0.1, 1.0])


class Numbers(Model):
    low: NotNegative = 0.0
    high: Positive = 1.0
    above: Number | None = None
    share: Annotated[Number, between(0.25, 0.5)] = 0.3
    count: WholeNumber = 1
    flag: bool = False
    several: list[float] = []  # noqa: RUF012
    path: FilePath = "."


@pytest.mark.parametrize(("data", "good"), [
    ({"low": 0.0}, True), ({"low": -1e-9}, False), ({"high": 0.0}, False), ({"high": 1e-9}, True),
    ({"share": 0.25}, True), ({"share": 0.5}, True), ({"share": 0.51}, False), ({"share": 0.24}, False),
    ({"count": 2}, True), ({"count": 2.0}, False), ({"count": "2"}, False), ({"low": "1"}, False), ({"low": 1}, True),
    ({"above": float("nan")}, False), ({"above": float("inf")}, False), ({"above": True}, False),
    ({"several": [1.0, True]}, False), ({"several": [1.0]}, True), ({"flag": True}, True), ({"count": True}, False),
    ({"path": " "}, False), ({"path": "a\0b"}, False), ({"path": "a b"}, True), ({"other": 1}, False),
])  # fmt: skip
def test_numbers_of_a_model(data, good):
    if good:
        assert getattr(validate(Numbers, data, "f"), next(iter(data))) is not None
        return
    with pytest.raises(InputError, match=rf"f: a\.{next(iter(data))}"):
        validate(Numbers, data, "f", ("a",))


def test_a_number_is_not_below_another():
    from typing import Annotated

    @dataclass(frozen=True)
    class Pair(Data):
        first: Number
        last: Annotated[Number, at_least("first")]
        even: Annotated[int, require(lambda n: n % 2 == 0, "Must be even")] = 2

    assert validate(Pair, {"first": 2.5, "last": 2.5}, "f").last == 2.5
    with pytest.raises(InputError, match=r"f: last: must be at least first, 2.5 \(got 2.4\)"):
        validate(Pair, {"first": 2.5, "last": 2.4}, "f")
    with pytest.raises(InputError, match=r"f: even: must be even \(got 3\)"):
        validate(Pair, {"first": 1.0, "last": 2.0, "even": 3}, "f")
    with pytest.raises(InputError, match="f: third: unknown key"):
        validate(Pair, {"first": 1.0, "last": 2.0, "third": 3}, "f")


def test_paths_relative_to_a_file(tmp_path):
    assert str(relative_to_file("a/b.yaml", "c.fits")) == "a/c.fits"
    assert str(relative_to_file("a/b.yaml", "../c")) == "c"
    assert str(relative_to_file("a/b.yaml", "/c/./d")) == "/c/d"
    (tmp_path / "real" / "deep").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "real" / "deep")
    assert relative_to_file(tmp_path / "link" / "f", "../x") == (tmp_path / "real" / "x").resolve()
    assert relative_to_file(tmp_path / "link" / "f", "x") == tmp_path / "link" / "x"


def test_texts_up_to_their_size(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"1\r\n2\r3\n")
    assert read_text(path) == "1\n2\n3\n" and read_text(path, max_bytes=7) == "1\n2\n3\n"
    with pytest.raises(InputError, match=r"a\.txt: too large a file; allowed: 0 MB"):
        read_text(path, max_bytes=6)
    path.write_text('{"a": [1, NaN]}')
    assert read_json(path)["a"][0] == 1
    path.write_text('{"a": ')
    with pytest.raises(InputError, match=r"a\.txt: not readable as JSON"):
        read_json(path)


def test_numbers_of_hdf5_files(tmp_path, monkeypatch):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file["g/x"], file["g/text"], file["empty"] = np.arange(6.0).reshape(2, 3), "words", h5py.Empty("f8")
        file["whole"] = np.arange(3, dtype=np.uint8)
    with h5py.File(path) as file:
        inner = hdf5_file.group(file, "g", path)
        assert hdf5_file.numbers(inner, "x", path).tolist() == [[0, 1, 2], [3, 4, 5]]
        assert hdf5_file.numbers(file, "whole", path).dtype == np.uint8
        for parent, name, said in (
            (inner, "y", "g/y: dataset is missing"), (inner, "text", "g/text: must be numbers"),
            (file, "empty", "empty: dataset is missing"), (file, "g", "g: dataset is missing"),
        ):  # fmt: skip
            with pytest.raises(InputError, match=said):
                hdf5_file.numbers(parent, name, path)
        with pytest.raises(InputError, match="whole: group is missing"):
            hdf5_file.group(file, "whole", path)
        monkeypatch.setattr(hdf5_file, "MAX_BYTES", 48)
        assert hdf5_file.numbers(inner, "x", path).size == 6
        monkeypatch.setattr(hdf5_file, "MAX_BYTES", 47)
        with pytest.raises(InputError, match=r"g/x: too large \(got \(2, 3\)\)"):
            hdf5_file.numbers(inner, "x", path)


@pytest.mark.parametrize("way", ["external", "virtual"])
def test_numbers_that_are_stored_in_another_file_are_not_read(tmp_path, way):
    """It may be any file of the machine, or a device that never ends."""
    path, other = tmp_path / "a.h5", tmp_path / "other"
    with h5py.File(path, "w") as file:
        if way == "external":
            other.write_bytes(bytes(16))
            file.create_dataset("x", (2,), "f8", external=[(str(other), 0, 16)])
        else:
            with h5py.File(other, "w") as source:
                source["y"] = np.arange(2.0)
            layout = h5py.VirtualLayout((2,), "f8")
            layout[:] = h5py.VirtualSource(str(other), "y", (2,))
            file.create_virtual_dataset("x", layout)
    with h5py.File(path) as file, pytest.raises(InputError, match="x: its numbers are stored in another file"):
        hdf5_file.numbers(file, "x", path)


def test_a_warning_is_damage_unless_it_is_allowed(tmp_path):
    """astropy only warns of a file that is cut short; other libraries warn of what is harmless."""
    path = tmp_path / "a"
    path.write_text("x")
    with pytest.raises(InputError, match=r"a: cannot be read as FITS: UserWarning cut short"), reading(path, "FITS"):
        warnings.warn("cut short", UserWarning, stacklevel=1)
    with reading(path, "a table", strict=False):
        warnings.warn("an odd unit", UserWarning, stacklevel=1)
        found = path.read_text()
    assert found == "x"


def test_damage_is_named_and_bugs_are_not(tmp_path):
    path = tmp_path / "a"
    path.write_text("x")
    for error in (OSError("no"), ValueError("no"), KeyError("no"), EOFError("no"), ZeroDivisionError("no")):
        said = rf"a: cannot be read as a table: {type(error).__name__} .*no"
        with pytest.raises(InputError, match=said), reading(path, "a table"):
            raise error
    with pytest.raises(NotImplementedError), reading(path, "a table"):
        raise NotImplementedError


def test_the_first_line_of_an_exception_is_never_empty():
    assert first_line(ValueError("\n one\ntwo")) == "one" and first_line(MemoryError()) == "MemoryError"
