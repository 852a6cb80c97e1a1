"""The reported position of a pixel that differs, for every pixel of the channels."""

from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits

from csstsim.base.errors import InputError
from csstsim.detector.channels import ReadoutFrame
from csstsim.io.frames import save_frame
from csstsim.studies.compare.images import _channel_facts, _pixel_in_channel, _pixel_position, fits_facts


@pytest.mark.parametrize("window", [(0, 24, 0, 12), (5, 17, 4, 9)])
def test_a_channels_pixel_is_named_by_the_chip_or_as_overscan(window):
    """The words of each pixel of the window give the number that `to_stored` brings there; of prescan, none."""
    readout = ReadoutFrame(window, 24, 12, 4, 2, 6, 6, 3, 2, 1)
    (x0, x1, y0, y1), number = window, np.arange(12 * 24).reshape(12, 24)
    stored = readout.to_stored(readout.embed(number[y0:y1, x0:x1] + 1), "channels").astype(int) - 1
    seen = 0
    for block in readout.blocks:
        for row, column in np.ndindex(readout.block_ny, readout.block_nx):
            words = _pixel_in_channel(readout, block, row, column)
            assert words.startswith(f"in channel {block.channel}, column {column}, row {row} ")
            value = stored[row, block.stored_x0 + column]
            if value >= 0:
                assert words.endswith(f"(chip x {value % 24}, y {value // 24})"), (words, value)
                seen += 1
            elif column < 3 or column >= 9 or row >= 6:
                assert words.endswith("(overscan)")
    assert seen == (x1 - x0) * (y1 - y0)


def test_a_pixel_is_named_by_columns_before_rows():
    assert _pixel_position(20, 85) == "at x 85, y 20"
    assert _pixel_position(2, 20, 85) == "at x 85, y 20, z 2"


def facts(a, b):
    return [fact.text for fact in fits_facts(a, b)]


@pytest.fixture
def frames(tmp_path):
    """Return a function that writes a frame of three rows and five columns, with changes; it returns the path."""

    def write(name, meta=(), **planes):
        kept = {"image": np.arange(15, dtype=np.float32).reshape(3, 5), "mask": np.zeros((3, 5), np.uint8)} | planes
        save_frame(tmp_path / name, kept, {"unit": "electron", "seed": 1} | dict(meta))
        return tmp_path / name

    return write


def test_frames_are_compared_plane_by_plane_with_their_record(frames):
    image = np.arange(15, dtype=np.float32).reshape(3, 5)
    image[1, 4] += 2
    wide = np.zeros((3, 5), np.uint16)
    mask = np.zeros((3, 5), np.uint8)
    mask[2, 0] = 4
    one = frames("a.fits")
    assert facts(one, frames("same.fits")) == []
    [light] = facts(one, frames("b.fits", image=image))
    assert light.startswith("IMAGE: 1 of 15 pixels differ") and "electron" in light and "at x 4, y 1" in light
    [bits] = facts(one, frames("c.fits", mask=mask))
    assert bits.startswith("MASK: 1 of 15 pixels differ") and "electron" not in bits and "at x 0, y 2" in bits
    counts = facts(frames("g.fits", raw=wide), frames("h.fits", raw=wide + np.uint16(3)))
    assert len(counts) == 1 and "electron" in counts[0]  # of two bytes
    [seed] = facts(one, frames("d.fits", {"seed": 2}))
    assert seed.startswith("record: ") and "seed" in seed
    assert facts(one, frames("e.fits", mask=None)) == ["only A has the planes MASK"]
    more = frames("f.fits", counted=np.ones((3, 5), np.int32))
    assert facts(one, more) == ["only B has the planes COUNTED"]
    assert facts(more, one) == ["only A has the planes COUNTED"]


def test_damage_of_either_file_is_no_difference(frames):
    one, other = frames("a.fits"), frames("b.fits")
    content = bytearray(other.read_bytes())
    content[5000] ^= 1
    other.write_bytes(content)
    for pair in ((one, other), (other, one)):
        with pytest.raises(InputError, match=r"b\.fits: .*damaged"):
            facts(*pair)


def test_files_without_checksums_are_compared_too(tmp_path):
    """An image in the primary HDU; a header without pixels next to one with pixels."""
    for name, data in (("a", np.zeros((2, 3))), ("b", np.eye(2, 3)), ("none", None)):
        fits.PrimaryHDU(None if data is None else data.astype(np.float32)).writeto(tmp_path / f"{name}.fits")
    a, b, none = (tmp_path / f"{name}.fits" for name in ("a", "b", "none"))
    [found] = facts(a, b)
    assert found.startswith("HDU 0: 2 of 6 pixels differ")
    assert "HDU 0: pixels in one file only" in facts(a, none) and "HDU 0: pixels in one file only" in facts(none, a)


@pytest.mark.parametrize("record", [b"[1, 2]", b"no JSON", b"\xff\xfe"])
def test_a_record_that_is_none_is_damage(tmp_path, record):
    for name, text in (("a", b"{}"), ("b", record)):
        meta = fits.ImageHDU(np.frombuffer(text, np.uint8)[None], name="META")
        fits.HDUList([fits.PrimaryHDU(), meta]).writeto(tmp_path / f"{name}.fits")
    assert facts(tmp_path / "a.fits", tmp_path / "a.fits") == []
    with pytest.raises(InputError, match=r"b\.fits: META: damaged: its record cannot be read"):
        facts(tmp_path / "a.fits", tmp_path / "b.fits")


@pytest.mark.parametrize("dtype", [np.uint16, np.int32])
def test_channels_that_both_files_have_are_compared(dtype):
    """Of four, one is in one file only; the difference is in DN with its position. Of different types, only these."""
    readout = ReadoutFrame((0, 24, 0, 12), 24, 12, 4, 2, 6, 6, 3, 2, 1)

    def raw(changed, channels, kind):
        def pixels(plane, block):
            values = np.full((readout.block_ny, readout.block_nx), 7, kind)
            if block.channel == changed:
                values[2, 5] += 3
            return values

        return SimpleNamespace(readout=readout, channels=channels, pixels=pixels)

    every = [block.channel for block in readout.blocks]
    one, other = raw(None, every, np.uint16), raw(every[2], every, dtype)
    found = [fact.text for fact in _channel_facts("IMAGE", [one, other])]
    if dtype == np.uint16:
        assert len(found) == 1 and "1 of " in found[0] and "DN" in found[0]
        assert f"in channel {every[2]}, column 5, row 2 " in found[0]
        other.channels = [every[0], every[1]]
        assert not list(_channel_facts("IMAGE", [one, other]))
        [mask] = [fact.text for fact in _channel_facts("MASK", [one, raw(every[2], every, dtype)])]
        assert "by at most 3, rms 3, first in channel" in mask  # flags have no unit
    else:
        assert found == ["IMAGE: uint16 and int32"]


def test_the_comment_of_a_keyword_is_compared_too(tmp_path):
    """But for keywords of what varies, or of how a file was made."""
    for name, words in (("a", "[e-] rms"), ("b", "[DN] rms")):
        header = fits.Header()
        for keyword in ("RDNOISE", "CPU_L0", "SIMVER"):
            header[keyword] = (5.0, words)
        fits.PrimaryHDU(np.zeros((2, 3), np.float32), header).writeto(tmp_path / f"{name}.fits")
    assert facts(tmp_path / "a.fits", tmp_path / "b.fits") == ["HDU 0: comment of RDNOISE: '[e-] rms' and '[DN] rms'"]
