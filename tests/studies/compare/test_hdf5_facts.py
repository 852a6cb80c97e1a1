"""HDF5 files compared: names, attributes, units, and files that hold other things than numbers."""

import h5py
import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.studies.compare.content import content_hash
from csstsim.studies.compare.hdf5 import hdf5_facts


def written(path, attributes=(), **datasets):
    with h5py.File(path, "w") as file:
        for name, values in datasets.items():
            file.create_dataset(name.replace("__", "/"), data=values)
        file.attrs.update(dict(attributes))
    return path


def facts(a, b):
    return [(fact.text, fact.provenance) for fact in hdf5_facts(a, b)]


def test_attributes_names_and_numbers(tmp_path):
    image = np.arange(24.0).reshape(2, 3, 4)
    a = written(
        tmp_path / "a.h5", {"chip": 9, "word": b"x", "csstsim": "1", "timing": 1.0, "list": [1, 2]},
        image=image, g__nodes_xy=np.array([[1.0, 2.0]]), nodes_xy=np.array([[1.0, 2.0]]), old=[1], scalar=2.0,
    )  # fmt: skip
    image[1, 0, 2] -= 5
    b = written(
        tmp_path / "b.h5", {"chip": 8, "word": "x", "csstsim": "2", "timing": 2.0, "list": [1, 3]},
        image=image, g__nodes_xy=np.array([[1.0, 2.0]]), nodes_xy=np.array([[1.0, 2.5]]), new=[1], scalar=2.25,
    )  # fmt: skip
    assert facts(a, a) == []
    assert facts(a, b) == [
        ("attribute csstsim: '1' and '2'", "csstsim"), ("attribute chip: 9 and 8, differ by 1", None),
        ("attribute list[1]: 2 and 3, differ by 1", None), ("only A has the datasets old", None),
        ("only B has the datasets new", None),
        ("dataset image: 1 of 24 values differs, by at most 5, rms 5, first at [1, 0, 2]: 14.0 and 9.0", None),
        ("dataset nodes_xy: 1 of 2 values differs, by at most 0.5 px, rms 0.5 px, first at [0, 1]: 2.0 and 2.5", None),
        ("dataset scalar: 1 of 1 values differs, by at most 0.25, rms 0.25, first at []: 2.0 and 2.25", None),
    ]  # fmt: skip


@pytest.mark.parametrize("values", ["words", np.array([1 + 2j]), h5py.Empty("f8")])
def test_what_is_no_number_is_refused(tmp_path, values):
    a, b = (written(tmp_path / name, x=[1.0]) for name in ("a.h5", "b.h5"))
    with h5py.File(b, "a") as file:
        file["odd"] = values
    with pytest.raises(InputError, match=r"b\.h5: odd: not numbers in this file"):
        facts(a, b)


@pytest.mark.parametrize("change", [
    {"x": [1.0, 3.0]}, {"x": np.array([1, 2])}, {"x": [[1.0, 2.0]]}, {"y": [1.0]}, {"attributes": {"chip": 8}},
])  # fmt: skip
def test_each_number_type_shape_and_name_is_in_the_content(tmp_path, change):
    plain = {"x": [1.0, 2.0], "attributes": {"chip": 9, "timing": 1.0}}
    one = content_hash(written(tmp_path / "a.h5", **plain))
    assert content_hash(written(tmp_path / "b.h5", **plain | {"attributes": {"chip": 9, "timing": 2.0}})) == one
    assert content_hash(written(tmp_path / "c.h5", **plain | change)) != one


def test_a_damaged_chunk_is_an_input_error(tmp_path):
    """Checksums of chunks are tested before values are compared, of both files."""
    values = np.random.default_rng(1).integers(0, 1 << 40, (64, 64))
    for name in ("a.h5", "b.h5"):
        with h5py.File(tmp_path / name, "w") as file:
            file.create_dataset("x", data=values, chunks=(8, 64), fletcher32=True)
    a, b = tmp_path / "a.h5", tmp_path / "b.h5"
    content = bytearray(b.read_bytes())
    at = content.index(values[40].tobytes())
    content[at] ^= 1
    b.write_bytes(content)
    assert facts(a, a) == []
    for pair in ((a, b), (b, a)):
        with pytest.raises(InputError, match=r"b\.h5"):
            facts(*pair)


@pytest.mark.parametrize("kind", ["external", "virtual"])
def test_numbers_that_lie_in_another_file_are_refused(tmp_path, kind):
    a = written(tmp_path / "a.h5", x=[1.0, 2.0])
    with h5py.File(tmp_path / "b.h5", "w") as file:
        if kind == "external":
            (tmp_path / "raw").write_bytes(np.array([1.0, 2.0]).tobytes())
            file.create_dataset("x", (2,), "f8", external=[(str(tmp_path / "raw"), 0, 16)])
        else:
            layout = h5py.VirtualLayout((2,), "f8")
            layout[:] = h5py.VirtualSource(str(a), "x", (2,))
            file.create_virtual_dataset("x", layout)
    with pytest.raises(InputError, match=r"b\.h5: x: not numbers in this file"):
        facts(a, tmp_path / "b.h5")
