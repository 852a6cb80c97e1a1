"""Intermediate frames: bits do not change, damaged and foreign files are refused."""

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.base.rng import stream
from csstsim.io.fits import open_fits
from csstsim.io.frames import _are_shapes, load_frame, save_frame

META = {"recipe": {"campaign": "abc"}, "stage": "render", "header": {"gain": [1.1, 1.0], "long": "é" * 5000}, "n": None}


def planes():
    image = stream(1, "bits").integers(0, 2**32, (37, 11), dtype=np.uint32).view(np.float32)  # NaNs of all kinds too
    image[0, :5] = [np.nan, np.inf, -np.inf, -0.0, 1e-45]
    counted = stream(1, "ints").integers(-(2**31), 2**31, (37, 11), dtype=np.int32)
    return {"image": image, "counted": counted, "mask": np.array([[0, 65535]], np.uint16)}


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "folder" / "render.fits"
    save_frame(path, planes(), META)
    return path


def test_every_bit_survives(saved):
    read, meta = load_frame(saved)
    assert meta == META
    assert list(read) == list(planes())
    for name, plane in planes().items():
        assert read[name].dtype == plane.dtype
        assert read[name].tobytes() == plane.tobytes()
        assert read[name].flags.writeable
    assert [p.name for p in saved.parent.iterdir()] == ["render.fits"]


def test_absent_planes_are_left_out(tmp_path):
    save_frame(tmp_path / "x.fits", {"image": np.zeros((2, 2), np.float32), "counted": None}, {})
    assert list(load_frame(tmp_path / "x.fits")[0]) == ["image"]


def test_same_content_same_bytes(saved, tmp_path):
    save_frame(tmp_path / "again.fits", planes(), META)
    assert (tmp_path / "again.fits").read_bytes() == saved.read_bytes()


def test_any_flipped_bit_is_found(saved, tmp_path):
    content = saved.read_bytes()
    damaged = tmp_path / "damaged.fits"
    for position in stream(2, "flip").integers(0, len(content), 150):
        changed = bytearray(content)
        changed[position] ^= 1
        damaged.write_bytes(changed)
        with pytest.raises(InputError, match=r"damaged\.fits"):
            load_frame(damaged)


def test_any_cut_is_found(saved, tmp_path):
    content = saved.read_bytes()
    for length in (0, 100, 2880, 5000, 8640, len(content) - 2880, len(content) - 1):
        (tmp_path / "cut.fits").write_bytes(content[:length])
        with pytest.raises(InputError, match=r"cut\.fits"):
            load_frame(tmp_path / "cut.fits")


def test_what_is_expected(saved, tmp_path):
    load_frame(saved, {"recipe": {"campaign": "abc"}, "stage": "render"})
    with pytest.raises(InputError, match=r"render.fits: recipe: .*'abc'.*allowed: {'campaign': 'abd'}"):
        load_frame(saved, {"recipe": {"campaign": "abd"}})
    with pytest.raises(InputError, match=r"missing_key: .*allowed: 5"):
        load_frame(saved, {"missing_key": 5})
    with pytest.raises(InputError, match=r"shape of mask: .*allowed: \[37, 11\]"):
        load_frame(saved, {"shape": (37, 11)})
    save_frame(tmp_path / "x.fits", {"image": np.zeros((2, 3), np.float32)}, {})
    load_frame(tmp_path / "x.fits", {"shape": (2, 3)})


def test_files_that_are_no_frames(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        load_frame(tmp_path / "none.fits")
    (tmp_path / "text.fits").write_text("not FITS at all")
    with pytest.raises(InputError, match=r"text.fits: not a readable FITS file"):
        load_frame(tmp_path / "text.fits")
    from astropy.io import fits

    fits.HDUList([fits.PrimaryHDU(), fits.ImageHDU(np.zeros((2, 2)))]).writeto(tmp_path / "other.fits")
    with pytest.raises(InputError, match="no CHECKSUM"):
        load_frame(tmp_path / "other.fits")


@pytest.mark.parametrize(("shapes", "good"), [
    ({}, True), ({"counted": [2, 3]}, True), ({"a": [1, 1], "b": [1, 7]}, True), ({"a": [2, 3], "b": [2, 0]}, False),
    ({"a": [0, 2]}, False), ({"a": [-1, 2]}, False), ({"a": [True, 2]}, False), ({"a": [2]}, False), ({"a": []}, False),
    ({"a": (2, 3)}, False), ({"a": [1, 2, 3]}, False),
    ({"a": [2.0, 3]}, False), ({"a": "23"}, False), ({"a": {"1": 2, "3": 4}}, False), ([[2, 3]], False),
])  # fmt: skip
def test_shapes_of_sparse_planes_are_two_whole_numbers(shapes, good):
    assert _are_shapes(shapes) == good


@pytest.mark.parametrize("plane", [np.zeros((2, 2)), np.zeros(3, np.float32), np.zeros((0, 3), np.float32)])
def test_planes_that_cannot_be_kept(tmp_path, plane):
    with pytest.raises(ValueError, match="plane 'image'"):
        save_frame(tmp_path / "x.fits", {"image": plane}, {})
    assert not list(tmp_path.iterdir())


def test_a_failed_write_leaves_the_old_file(saved):
    old = saved.read_bytes()
    with pytest.raises(ValueError, match="JSON"):
        save_frame(saved, planes(), {"bad": float("nan")})
    assert saved.read_bytes() == old
    assert [p.name for p in saved.parent.iterdir()] == ["render.fits"]


@pytest.fixture
def counted():
    """A plane with six counts, the first and the last pixel among them, and one that is negative."""
    plane = np.zeros((4, 9), np.int32)
    plane[[0, 1, 1, 2, 3, 3], [0, 2, 8, 5, 0, 8]] = [7, -3, 1, 2**31 - 1, 5, 4]
    return plane


def test_a_plane_of_few_counts_is_kept_as_their_places(tmp_path, counted):
    from astropy.io import fits

    path = tmp_path / "x.fits"
    save_frame(path, {"counted": counted, "image": np.ones((4, 9), np.float32)}, {"a": 1}, sparse=["counted", "none"])
    with fits.open(path, checksum=True) as file:
        assert [hdu.name for hdu in file] == ["PRIMARY", "IMAGE", "COUNTED_AT", "COUNTED_IS", "META"]
        assert file["COUNTED_AT"].data.tolist() == [[0, 11, 17, 23, 27, 35]]
        assert file["COUNTED_IS"].data.tolist() == [[7, -3, 1, 2**31 - 1, 5, 4]]
    found, meta = load_frame(path, {"a": 1, "shape": (4, 9)})
    assert meta == {"a": 1} and set(found) == {"image", "counted"} and np.array_equal(found["counted"], counted)
    plane = load_frame(path, sparse=True)[0]["counted"]
    assert plane.shape == (4, 9) and np.array_equal(plane.dense(), counted) and len(plane.pixel) == 6


def test_a_quarter_of_the_pixels_is_not_few(tmp_path, counted):
    """8 of 36 pixels are stored by index, 9 are not; nor is a plane that is not named."""
    names = []
    for more in (2, 3):
        plane = counted.copy()
        plane[0, 1 : 1 + more] = 1
        save_frame(tmp_path / "x.fits", {"counted": plane}, {}, sparse=["counted"])
        with open_fits(tmp_path / "x.fits") as file:
            names.append([hdu.get_extname() for hdu in file][1:-1])
        assert np.array_equal(load_frame(tmp_path / "x.fits")[0]["counted"], plane)
    assert names == [["COUNTED_AT", "COUNTED_IS"], ["COUNTED"]]
    save_frame(tmp_path / "x.fits", {"counted": counted}, {})
    assert isinstance(load_frame(tmp_path / "x.fits", sparse=True)[0]["counted"], np.ndarray)


def test_a_plane_without_counts_comes_back(tmp_path):
    save_frame(tmp_path / "x.fits", {"counted": np.zeros((3, 5), np.int32)}, {}, sparse=["counted"])
    found = load_frame(tmp_path / "x.fits")[0]["counted"]
    assert found.shape == (3, 5) and found.dtype == np.int32 and not found.any()


@pytest.mark.parametrize(("at", "values", "shape"), [
    ([0, 6], [1, 1], [2, 3]), ([-1, 5], [1, 1], [2, 3]), ([2, 2], [1, 1], [2, 3]), ([3, 1], [1, 1], [2, 3]),
    ([0, 1], [1], [2, 3]), ([0, 5], [1, 1], [1 << 15, 1 << 15]), (None, [1], [2, 3]), ([0], None, [2, 3]),
    ([0, 5], [1, 1], [2, 3]),
])  # fmt: skip
def test_places_that_do_not_fit_the_plane_are_refused(tmp_path, at, values, shape):
    """All but the last."""
    parts = {name: np.array([v], np.int32) for name, v in (("a_at", at), ("a_is", values)) if v is not None}
    save_frame(tmp_path / "x.fits", parts, {"sparse": {"a": shape}})
    if (at, values, shape) == ([0, 5], [1, 1], [2, 3]):
        assert load_frame(tmp_path / "x.fits")[0]["a"].tolist() == [[1, 0, 0], [0, 0, 1]]
        return
    with pytest.raises(InputError, match=r"x\.fits: a: damaged: the parts of a plane do not fit it"):
        load_frame(tmp_path / "x.fits")


@pytest.mark.parametrize("exposure", ["x", 3, [1]])
def test_a_record_of_another_kind_is_damage(tmp_path, exposure):
    save_frame(tmp_path / "x.fits", {}, {"exposure": exposure})
    with pytest.raises(InputError, match="META: damaged: its metadata"):
        load_frame(tmp_path / "x.fits")
    for good in (None, {"a": 1}):
        save_frame(tmp_path / "x.fits", {}, {"exposure": good})
        assert load_frame(tmp_path / "x.fits")[1] == {"exposure": good}


def test_tuples_of_a_recipe_are_as_lists(tmp_path):
    save_frame(tmp_path / "x.fits", {}, {"window": (1, 2)})
    load_frame(tmp_path / "x.fits", {"window": (1, 2)})
    with pytest.raises(InputError, match=r"window: made from another recipe.*\[1, 2\].*allowed: \[1, 3\]"):
        load_frame(tmp_path / "x.fits", {"window": (1, 3)})
