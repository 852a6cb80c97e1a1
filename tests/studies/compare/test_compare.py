"""`csstsim compare`: equal runs are the same; each change put in is found, named and measured, and nothing else."""

import json
import os
import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest
from astropy.io import fits
from delivery import spoil
from support.commands import command

from csstsim import __version__
from csstsim.catalog.table import ObjectTable
from csstsim.io.frames import load_frame, save_frame
from csstsim.io.level0 import read_level0
from csstsim.studies.compare.facts import array_facts
from csstsim.studies.compare.tables import unit_of

LEVEL0, TRUTH = "level0/10100000001/*_09_L0_V01.fits", "level0/10100000001/*_09*.truth.parquet"
COSMIC, CALIBRATED, MEASURED = "level0/10100000001/*_09*.cosmic.fits", "calibrated/*.fits", "measure/*.parquet"
MERGED, PSF = "merge/dataset/Norder=8/Dir=550000/Npix=550615.parquet", "psf/chip_09.h5"


def reported(a, b, *options):
    """Compare; return (lines about differences, the last line). The exit code must agree with both."""
    result = command("compare", a, b, *options)
    *lines, last = result.output.splitlines()
    same = last.endswith(" compared, all the same")
    assert same or last.split(", ")[-1].split()[1] in ("differ", "differs")
    assert result.exit_code == (0 if same else 1), (result.output, result.exception)
    return lines, last


def one(folder, pattern):
    """Return the one file, or the first, that a pattern names."""
    return sorted(folder.glob(pattern))[0]


def spoiled(copied, pattern, change, *options):
    """Spoil a file of the copy; return what is reported about it, without its name; all other files are the same."""
    original, folder = copied
    path = one(folder, pattern)
    change(path)
    lines, last = reported(original, folder, *options)
    name = path.relative_to(folder).as_posix()
    assert all(line.startswith(f"{name}: ") or line.startswith("provenance differs") for line in lines), lines
    return [line.removeprefix(f"{name}: ") for line in lines], last


def test_a_folder_is_itself(runs):
    count = sum(len(files) for _, _, files in os.walk(runs[0])) - 1  # of campaign.json
    assert reported(runs[0], runs[0]) == ([], f"{count} products compared, all the same")


def test_two_runs_are_the_same(runs):
    """Their Level-0 files, truth tables and pages differ in bytes: by dates, run times and the folder's name."""
    products = [[p for p in run.rglob("*") if p.is_file() and p.name != "campaign.json"] for run in runs]
    bytes_ = [{p.relative_to(run): p.read_bytes() for p in of} for run, of in zip(runs, products, strict=True)]
    unlike = [name for name in bytes_[0] if bytes_[0][name] != bytes_[1][name]]
    assert {name.suffix for name in unlike} == {".fits", ".parquet", ".html"}
    assert reported(*runs) == ([], f"{len(bytes_[0])} products compared, all the same")
    assert reported(*runs, "--provenance")[0] == []
    for name in unlike:
        assert reported(runs[0] / name, runs[1] / name) == ([], "1 product compared, all the same")


def test_files_that_are_not_products_are_not_compared(copied):
    original, folder = copied
    for name in ("logs", "benchmarks", ".snakemake", "level0/logs"):
        (folder / name).mkdir()
        (folder / name / "x.json").write_text("{}")
    for name in ("campaign.json", "MANIFEST.sha256", "MANIFEST.tsv", "psf/.chip_09.host.77.tmp.h5"):
        (folder / name).write_text("other")
    assert reported(original, folder)[0] == []


def test_a_pixel_by_one_dn(copied):
    """Where it is, by astropy's pixels and by the image that is put together."""
    row, column = 20, 3 * 26 + 7

    def change(stored):
        stored[row, column] += 1
        return stored

    before = read_level0(one(copied[0], LEVEL0))
    lines, last = spoiled(copied, LEVEL0, spoil.pixels(change))
    after = read_level0(one(copied[1], LEVEL0))
    assert before.readout.block_nx == 26
    (y, x), value = np.argwhere(before.assembled() != after.assembled())[0], fits.getdata(before.path)[row, column]
    position = f"in channel 4, column 7, row {row} (chip x {x}, y {y}): {value} and {value + 1}"
    size = before.readout.stored_shape("channels")
    assert lines == [
        f"IMAGE: 1 of {size[0] * size[1]} pixels differs, by at most 1 DN, rms 1 DN, first {position}"
    ] and last.endswith(" compared, 1 differs")


def test_pixels_of_the_overscan(copied):
    def change(stored):
        stored[4:6, 0] -= 2
        return stored

    lines, _ = spoiled(copied, LEVEL0, spoil.pixels(change))
    assert len(lines) == 1 and "2 of " in lines[0] and "by at most 2 DN, rms 2 DN" in lines[0]
    assert "first in channel 1, column 0, row 4 (overscan)" in lines[0]


def columns(chosen):
    """Return a spoiler that writes the columns chosen(names) of a table."""

    def spoil(path):
        table = ObjectTable.read(path)
        ObjectTable({name: table[name] for name in chosen([*table])}, table.meta).write(path)

    return spoil


# what is spoiled, how, the words that must be reported, a line each
ONE = {
    "a keyword": (
        LEVEL0, spoil.header(0, "EXPTIME", lambda v: v + 0.5), ["HDU 0: EXPTIME: 150.0 and 150.5, differ by 0.5"],
    ),
    "a remark": (LEVEL0, spoil.header("IMAGE", "COMMENT", lambda _: "of another"), ["IMAGE: COMMENT: "]),
    "a keyword of the image": (LEVEL0, spoil.header("IMAGE", "GAIN03", lambda v: v + 0.25), ["IMAGE: GAIN03: 1."]),
    "a keyword of a calibrated image": (
        CALIBRATED, spoil.header("SCI", "RDNOISE", lambda v: v + 1), ["SCI: RDNOISE: 4.9"],
    ),
    "a truth value": (
        TRUTH, spoil.column("mag", lambda c: np.where(np.arange(len(c)) == 7, c + np.float32(0.5), c)),
        ["column mag: 1 of 25 rows differs, by at most 0.5 mag, rms 0.5 mag, first in row 7 (obj_ID 7): 20.0 and 20.5"],
    ),
    "NaN": (
        TRUTH, spoil.column("drawn", lambda c: np.where(np.arange(len(c)) == 2, np.nan, c)),
        ["column drawn: 1 of 25 rows differs, 1 of them by NaN or infinity, first in row 2 (obj_ID 2)"],
    ),
    "text": (
        TRUTH, spoil.column("method", lambda c: np.where(np.arange(len(c)) > 22, "none", c.astype(str)).astype(object)),
        ["column method: 2 of 25 rows differ, first in row 23 (obj_ID 23)"],
    ),
    "a type": (TRUTH, spoil.column("mag", lambda c: c.astype(float)), ["column mag: float32 and float64, the same v"]),
    "rms of several": (
        MEASURED, spoil.column("flux_psf", lambda c: c + np.append([3.0, 4.0], np.zeros(len(c) - 2))),
        ["column flux_psf: 2 of 27 rows differ, by at most 4 electron, rms 3.53553 electron, first in row 0: "],
    ),
    "a row less": (TRUTH, spoil.rows(slice(0, 24)), ["25 and 24 rows", "only A has the rows of obj_ID 24"]),
    "rows without ids": (MEASURED, spoil.rows(slice(0, 24)), ["27 and 24 rows; the columns are not compared"]),
    "a column less": (
        TRUTH, columns(lambda names: [name for name in names if name != "snr"]),
        ["only A has the columns snr"],
    ),
    "columns in another order": (
        TRUTH, columns(lambda names: names[::-1]),
        ["the columns are in another order"],
    ),
    "a list": (MERGED, spoil.lists("detection_chip", 10), ["column detection_chip: 1 of ", "'[9]' and '[10]'"]),
    "a record": (
        MEASURED, spoil.record(lambda meta: meta.update(background=0.0)), ["metadata: background: "],
    ),
    "JSON": (
        "validate/550615.json", spoil.entry(lambda found: found["gates"][2].update(threshold=7)),
        ["gates[2].threshold: 0."],
    ),
    "a property": ("merge/hats.properties", spoil.text("hats_order=8", "hats_order=7"), ["hats_order: '8' and '7'"]),
    "a page": ("report/index.html", spoil.text("PASS: ", "FAIL: "), [" tags differs, first tag "]),
    "a line": ("merge/partition_info.csv", spoil.text("550615", "550616"), ["1 of 2 lines differs, first line 2: "]),
}  # fmt: skip


@pytest.mark.parametrize("case", ONE)
def test_one_difference(copied, case):
    pattern, change, words = ONE[case]
    lines, last = spoiled(copied, pattern, change)
    assert last.endswith(" compared, 1 differs") and len(lines) == max(1, len(words) - (case == "a list")), lines
    assert all(any(word in line for line in lines) for word in words), lines


def test_a_psf(copied):
    """By its size in the array; and the flux that goes with it, which is no unit."""
    import h5py

    def change(path):
        with h5py.File(path, "r+") as file:
            file["image"][1, 2, 3, 4] += np.float32(2.0**-20)
            file["tilt"][0, 1] += 0.125

    lines, _ = spoiled(copied, PSF, change)
    assert (
        lines[0].startswith("dataset image: 1 of 1048576 values differs, by at most ") and "at [1, 2, 3, 4]" in lines[0]
    )
    assert lines[1].startswith("dataset tilt: 1 of 8 values differs, by at most 0.125 px") and "at [0, 1]" in lines[1]


def test_a_picture(copied):
    from PIL import Image

    def change(path):
        with Image.open(path) as picture:
            other = picture.convert("RGBA")
        red, *rest = other.getpixel((5, 3))
        other.putpixel((5, 3), ((red + 9) % 256, *rest))
        other.save(path)

    lines, _ = spoiled(copied, "validate/550615.png", change)
    assert len(lines) == 1 and "picture: 1 of " in lines[0] and "at x 5, y 3, colour 0" in lines[0]


def test_electrons_of_a_frame_but_not_its_seconds(copied):
    """What stages and layers took is in the frame's record; a saturated pixel is not."""
    b = one(copied[1], COSMIC)
    a = b.with_name("a.fits")
    planes, meta = load_frame(b)
    for path, header in ((a, {"stages": [["render", 1.0, 2.0]]}), (b, {"stages": [["render", 3.0]], "timing": [3.0]})):
        save_frame(path, planes, meta | {"header": header | {"saturated": 3}})
    assert reported(a, b)[0] == []
    planes["cosmic"][3, 5] += 2
    save_frame(b, planes, meta | {"header": {"saturated": 4}})
    lines, _ = reported(a, b)
    assert lines[0].startswith("a.fits: COSMIC: 1 of 16384 pixels differs, by at most 2 electron, rms 2 electron, ")
    assert "first at x 5, y 3: 0 and 2" in lines[0]
    assert lines[1:] == ["a.fits: record: header.saturated: 3 and 4, differ by 1"]


def test_types_and_shapes_of_planes(tmp_path):
    plane = np.arange(12, dtype=np.float32).reshape(3, 4)
    save_frame(tmp_path / "a.fits", {"image": plane, "mask": plane.astype(np.uint8)}, {"unit": "electron"})
    save_frame(
        tmp_path / "b.fits", {"image": plane.astype(np.int32), "mask": plane[:2].astype(np.uint8)}, {"unit": "DN"}
    )
    lines, _ = reported(tmp_path / "a.fits", tmp_path / "b.fits")
    assert lines == [
        "a.fits: IMAGE: float32 and int32, the same values", "a.fits: MASK: shape (3, 4) and (2, 4)",
        "a.fits: record: unit: 'electron' and 'DN'",
    ]  # fmt: skip


@pytest.mark.parametrize(("left", "right", "words"), [
    ([np.nan, 1.0], [np.nan, 1.0], None),
    ([np.nan, 1.0], [np.copysign(np.nan, -1.0), 1.0], None),
    ([np.inf, 1.0], [np.inf, 1.0], None),
    ([0.0, 1.0], [-0.0, 1.0], "1 of 2 rows differs, by at most 0, rms 0"),
    ([np.nan, 1.0], [3.0, 3.0], "2 of 2 rows differ, by at most 2, rms 2, 1 of them by NaN or infinity"),
    ([np.inf, 1.0], [-np.inf, 1.0], "1 of 2 rows differs, 1 of them by NaN or infinity"),
    ([2**62, 0], [2**62 + 1, 0], "by at most 1, rms 1"),
    ([-(2**63), 0], [2**63 - 1, 0], "by at most 1.84467e+19"),
    ([True, False], [True, True], "1 of 2 rows differs, by at most 1"),
])  # fmt: skip
def test_numbers_that_are_odd(tmp_path, left, right, words):
    for name, values in (("a", left), ("b", right)):
        (tmp_path / name).mkdir()
        ObjectTable({"value": np.array(values), "ms": np.random.default_rng().random(2)}).write(
            tmp_path / name / "t.parquet"
        )
    lines, _ = reported(tmp_path / "a", tmp_path / "b")
    assert (len(lines) == 1 and words in lines[0]) if words else lines == []


@pytest.mark.parametrize("step", [1, 7, 40, 1000])
def test_pieces_are_added_up(step):
    """Sizes and positions of a large array, compared a few elements at a time, are those of the whole."""
    a = np.random.default_rng(5).normal(size=(13, 20))
    b = a.copy()
    b[9, 4:7] += [1.0, -2.0, 4.0]
    (fact,) = array_facts("x", a, b, noun="values", unit="mag", position=lambda y, x: f"at {y}, {x}", step=step)
    assert fact.text.startswith("x: 3 of 260 values differ, by at most 4 mag, rms 2.64575 mag, first at 9, 4: ")


def test_units_of_columns():
    """The unit of a column is that in its table's description; errors have that of their quantity."""
    expected = {
        "ra": "deg", "dec": "deg", "xImage": "px", "mag": "mag", "mag_psf_err": "mag", "pm_ra": "mas / yr",
        "RV": "km / s", "sky": "electron / px", "flux_psf": "electron", "flux_psf_err": "electron", "drawn": "electron",
        "flux0": "electron / s", "teff": "K",
        "flux_r": "microjansky", "kron_mag_err_y": "mag", "pos_err": "arcsec", "wavelength": "angstrom",
        "flux_erg": "erg / s / cm2 / angstrom", "stellarmass": "solar masses", "theta": "rad", "logg": "dex",
    }  # fmt: skip
    assert {name: unit_of(name) for name in expected} == expected
    without = ("id", "obj_type", "z", "e1", "e2", "kappa", "flags", "snr", "chi2", "spread_err", "method")
    assert not any(map(unit_of, without))


def test_a_row_more_does_not_hide_a_value(copied):
    """Rows are identified by their ids: the columns of those that both have are compared."""

    def change(path):
        table = ObjectTable.read(path)
        kept = np.delete(np.arange(25), 3)
        mag = table["mag"].copy()
        mag[20] += np.float32(0.5)
        table.with_columns(mag=mag).take(kept).write(path)

    lines, _ = spoiled(copied, TRUTH, change)
    assert lines[:2] == ["25 and 24 rows", "only A has the rows of obj_ID 3"] and len(lines) == 3
    assert lines[2].startswith("column mag: 1 of 24 rows differs, by at most 0.5 mag")
    assert "in row 20 (obj_ID 20)" in lines[2]


def test_what_one_side_has(copied):
    original, folder = copied
    one(folder, TRUTH).unlink()
    (folder / "more.txt").write_text("more")
    lines, last = reported(original, folder)
    name = one(original, TRUTH).relative_to(original).as_posix()
    assert lines == [f"{name}: only A has it", "more.txt: only B has it"] and last.endswith(" compared, 2 differ")
    assert reported(folder, original)[0] == [f"{name}: only B has it", "more.txt: only A has it"]


PROVENANCE = {
    LEVEL0: (spoil.header(0, "CAMHASH", lambda _: "0" * 16), "CAMHASH"),
    CALIBRATED: (spoil.header(0, "SIMVER", lambda _: "9.9"), "SIMVER"),
    TRUTH: (spoil.record(lambda meta: meta["recipe"].update(camera="0")), "recipe"),
    "validate/550615.json": (spoil.entry(lambda found: found.update(csstsim="9", checksum=1)), "csstsim"),
    "report/index.html": (spoil.text(f"<td>{__version__}</td>", "<td>9.9.9</td>"), "provenance"),
}


@pytest.mark.parametrize("pattern", PROVENANCE)
def test_provenance_does_not_count_unless_asked(copied, pattern):
    change, name = PROVENANCE[pattern]
    lines, last = spoiled(copied, pattern, change)
    assert lines == [f"provenance differs in 1 product, which does not count: {name}"] and last.endswith("all the same")
    lines, last = reported(*copied, "--provenance")
    assert len(lines) == 1 and name in lines[0] and last.endswith("1 differs")


def test_a_commit_that_one_side_does_not_know(copied):
    """Run from a clone and from an installation."""

    def change(path):
        with fits.open(path, mode="update", checksum=True) as file:
            file[0].header["SIMGIT"] = "f" * 40, "git commit"

    lines, last = spoiled(copied, LEVEL0, change)
    assert lines == ["provenance differs in 1 product, which does not count: SIMGIT"] and last.endswith("all the same")


def test_other_random_numbers(runs, tmp_path, monkeypatch):
    """Read noise of another stream: pixels of Level-0 alone, by as much as astropy and numpy find."""
    from csstsim.base.rng import Streams

    file = shutil.copytree(runs[0].parent, tmp_path / "again") / "campaign.yaml"
    key = Streams.exposure_key
    monkeypatch.setattr(Streams, "exposure_key", lambda self, word: key(self, word + "x" * (word == "read")))
    out = tmp_path / "out"
    done = command("chip", file, "--obsid", "10300000001", "--chip", 9, "--output", out)
    assert done.exit_code == 0, done.output
    level0 = "level0/10300000001/*_09_L0_V01.fits"
    lines, last = reported(one(runs[0], level0), one(out, level0))
    images = [fits.getdata(one(folder, level0)).astype(float) for folder in (runs[0], out)]
    size = np.abs(images[0] - images[1])
    size = size[size > 0]
    words = f"{size.size} of {images[0].size} pixels differ, by at most {size.max():.6g} DN, rms "
    assert len(lines) == 1 and words + f"{np.sqrt(np.mean(size**2)):.6g} DN" in lines[0] and last.endswith("1 differs")
    assert size.size > images[0].size / 2


def halved(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def test_damaged_files(copied):
    """Two files: one line, exit code 2. In a folder: a product that differs, and the others are compared still."""
    original, folder = copied
    cases = {
        LEVEL0: spoil.flip, CALIBRATED: spoil.cut, TRUTH: spoil.scratch, PSF: spoil.cut, "validate/*.json": halved,
        "validate/550615.png": halved, "merge/dataset/_metadata": halved,
    }  # fmt: skip
    paths = {one(folder, pattern): change for pattern, change in cases.items()}
    for path, change in paths.items():
        change(path)
        result = command("compare", original / path.relative_to(folder), path)
        assert result.exit_code == 2 and len(result.output.splitlines()) == 1, (path, result.output, result.exception)
        assert str(path) in result.output
    lines, last = reported(original, folder)
    assert len(lines) == len(paths) and all(": cannot be compared: " in line for line in lines)
    assert last.endswith(f"{len(paths)} differ")
    assert reported(folder, folder)[0] == [], "the same bytes are the same product: verify tells damage"


def test_what_cannot_be_compared(runs, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "logs").mkdir()
    (tmp_path / "file.json").write_text("{}")
    (tmp_path / "file.txt").write_text("{}")
    os.mkfifo(tmp_path / "pipe.json")
    for a, b, word in (
        (runs[0], tmp_path / "none", "no such file or folder"),
        (tmp_path / "none", runs[0], "no such file or folder"),
        (runs[0], tmp_path / "empty", "holds no product"),
        (tmp_path / "empty", tmp_path / "empty", "holds no product"),
        (runs[0], tmp_path / "file.json", "one is a folder, the other a file"),
        (tmp_path / "file.json", tmp_path / "file.txt", "files of two kinds"),
        (tmp_path / "file.json", tmp_path / "pipe.json", "not a file"),
    ):
        result = command("compare", a, b)
        assert result.exit_code == 2 and word in result.output and len(result.output.splitlines()) == 1, result.output


def test_json_that_is_odd(tmp_path):
    """Numbers beyond floats, NaN, another type, another length."""
    a = {"huge": 10**400, "nan": float("nan"), "one": 1, "list": [1, 2], "deep": {"x": [{"y": 1.5}]}, "stages": 1}
    b = {"huge": 1.5, "nan": float("nan"), "one": True, "list": [1], "deep": {"x": [{"y": 1.25}]}, "stages": 2}
    for name, content in (("a", a), ("b", b)):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    lines, _ = reported(tmp_path / "a.json", tmp_path / "b.json")
    assert [line.split(": ", 1)[1] for line in lines][1:] == [
        "one: 1 and True", "list: 2 and 1 values", "deep.x[0].y: 1.5 and 1.25, differ by 0.25",
    ]  # fmt: skip
    assert "huge: 1000" in lines[0] and lines[0].endswith(" and 1.5")


def test_metadata_of_a_catalogue(copied):
    path = one(copied[1], "merge/dataset/_metadata")
    pq.write_metadata(pq.read_schema(path).append(pq.read_schema(path).field(0).with_name("more")), path)
    lines, _ = reported(one(copied[0], "merge/dataset/_metadata"), path)
    assert any("rows" in line for line in lines) and any("more" in line or "values" in line for line in lines)
