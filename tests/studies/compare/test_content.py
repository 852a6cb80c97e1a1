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
