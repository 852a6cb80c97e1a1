"""MANIFEST.content: the same in two runs of one campaign, and another where a product holds something else."""

import json
import shutil

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy.io import fits

from csstsim.catalog.table import ObjectTable
from csstsim.delivery.manifest import CONTENT, HASHES, manifest_faults, write_manifest
from csstsim.studies.compare.content import content_hash, write_contents


def test_two_runs_of_a_campaign_have_one_content(runs, tmp_path):
    lines = []
    for number, run in enumerate(runs):
        folder = shutil.copytree(run, tmp_path / str(number), ignore=shutil.ignore_patterns("logs", "benchmarks"))
        names = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]
        write_manifest(folder, {name: "product" for name in names if name != "campaign.json"})
        lines.append((write_contents(folder)).read_text())
    hashes = [(tmp_path / number / HASHES).read_text() for number in "01"]
    assert lines[0] == lines[1] and hashes[0] != hashes[1], "dates and timings are in the files, not in their content"
    assert {name.rsplit(".", 1)[-1] for name in names} >= {"fits", "parquet", "json", "html", "h5", "png"}
    assert len(lines[0].splitlines()) == len(names) - ("campaign.json" in names) and CONTENT not in lines[0]


def change_table(path):
    table = ObjectTable.read(path)
    name = next(name for name in table.names if table[name].dtype.kind == "f" and name != "ms")
    values = table[name].copy()
    values[0] += 1.0
    table.with_columns(**{name: values}).write(path, table.meta)


def change_keyword(path):
    fits.setval(path, "OBJECT", value="another")


def change_record(path):
    record = json.loads(path.read_text())
    path.write_text(json.dumps(record | {"brick": -1}))


@pytest.mark.parametrize(
    ("pattern", "change"),
    [
        ("level0/*/*_L0_V01.fits", change_keyword),
        ("measure/*.parquet", change_table),
        ("validate/*.json", change_record),
    ],
)
def test_what_differs_has_another_hash(copied, pattern, change):
    run, copy = copied
    path = next(iter(sorted(copy.glob(pattern))))
    before = content_hash(run / path.relative_to(copy))
    assert content_hash(path) == before
    change(path)
    assert content_hash(path) != before


@pytest.mark.parametrize(("name", "count"), [("DATE", 1), ("DATE-OBS", 2), ("DATASECT", 2)])
def test_only_whole_keywords_vary(tmp_path, name, count):
    """DATE is when a file was written and is omitted; DATE-OBS and DATASECT only begin as such a keyword."""
    hashes = set()
    for day in ("2027-01-01", "2027-01-02"):
        path = tmp_path / f"{day}.fits"
        fits.PrimaryHDU(header=fits.Header([(name, day)])).writeto(path)
        hashes.add(content_hash(path))
    assert len(hashes) == count


def test_each_value_of_a_long_list_counts(tmp_path):
    """The text of a numpy array leaves out the middle of 1000 values and more."""
    hashes = set()
    for number, changed in enumerate((None, 500, 1499)):
        values = np.arange(1500.0)
        values[changed if changed else 0] += 1e-9 if changed else 0.0
        path = tmp_path / f"{number}.parquet"
        pq.write_table(pa.table({"counts": [values, values[:3]], "nested": [[values], []]}), path)
        hashes.add(content_hash(path))
    assert len(hashes) == 3
    again = tmp_path / "again.parquet"
    pq.write_table(pa.table({"counts": [values, values[:3]], "nested": [[values], []]}), again)
    assert content_hash(again) in hashes


def test_words_in_hdf5_are_the_same_in_two_files(tmp_path):
    for name in ("a.h5", "b.h5"):
        with h5py.File(tmp_path / name, "w") as file:
            file["words"] = np.array(["one", "two"], dtype=h5py.string_dtype())
    assert content_hash(tmp_path / "a.h5") == content_hash(tmp_path / "b.h5")


def test_a_changed_list_of_contents_is_found(tmp_path):
    (tmp_path / "a.txt").write_text("one")
    write_manifest(tmp_path, {"a.txt": "product"})
    write_contents(tmp_path)
    assert not list(manifest_faults(tmp_path, {"a.txt"}, {"a.txt"}))
    (tmp_path / CONTENT).write_text(f"{'0' * 64}  a.txt\n")
    assert [name for name, _ in manifest_faults(tmp_path, {"a.txt"}, {"a.txt"})] == [CONTENT]
    write_contents(tmp_path)
    assert not list(manifest_faults(tmp_path, {"a.txt"}, {"a.txt"}))


def frame(path, image, date="2026-01-01"):
    """Write a FITS file with checksums, as products have them."""
    hdus = fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(image, name="IMAGE")])
    hdus[0].header["DATE"], hdus[0].header["CPU_L0"] = date, len(date)
    hdus.writeto(path, checksum=True, overwrite=True)
    return content_hash(path)


def test_each_pixel_is_in_the_content_and_a_date_is_not(tmp_path):
    image = np.arange(12, dtype=np.int32).reshape(3, 4)
    one = frame(tmp_path / "a.fits", image)
    assert frame(tmp_path / "b.fits", image, "2027-02-03T04:05:06") == one
    image[2, 1] += 1
    assert frame(tmp_path / "c.fits", image) != one


@pytest.mark.parametrize("size", [10, 1 << 20, (1 << 20) + 1, 3 << 20])
def test_the_last_byte_of_a_file_of_any_size_counts(tmp_path, size):
    """Of pictures and text, whose bytes are the content."""
    hashes = set()
    for last in (b"a", b"b"):
        (tmp_path / "x.png").write_bytes(bytes(size - 1) + last)
        hashes.add(content_hash(tmp_path / "x.png"))
    assert len(hashes) == 2


@pytest.mark.parametrize("change", [
    {"columns": {"b": [1, 2]}}, {"columns": {"a": [1.0, 2.0]}}, {"meta": {"level": 2.5}},
    {"columns": {"a": np.array([1, 2]).view(float)}},
])  # fmt: skip
def test_names_types_and_metadata_of_a_table_are_in_its_content(tmp_path, change):
    """Bits that are the same are not, under another name or as another type; the recipe's time is no content."""

    def written(columns, meta):
        ObjectTable({name: np.asarray(values) for name, values in columns.items()}).write(tmp_path / "t.parquet", meta)
        return content_hash(tmp_path / "t.parquet")

    plain = {"columns": {"a": [1, 2]}, "meta": {"level": 2.0, "timing": [1.0]}}
    one = written(**plain)
    assert written(**plain | {"meta": {"level": 2.0, "timing": [3.0]}}) == one
    assert written(**plain | change) != one


def test_what_varies_is_no_content_however_deep(tmp_path):
    hashes = []
    for took, level in ((1.0, 2.0), (7.0, 2.0), (1.0, 3.0)):
        record = {"layers": [{"name": "bias", "timing": took, "in": [[{"stages": took, "level": level}]]}]}
        (tmp_path / "a.json").write_text(json.dumps(record))
        hashes.append(content_hash(tmp_path / "a.json"))
    assert hashes[0] == hashes[1] != hashes[2]
