"""Parts of the report's stage: room for figures, whole PNGs, sizes in words."""

import struct
import zlib

import pytest

from csstsim.base.errors import InputError
from csstsim.stages.report import Budget, _is_png, _size


def chunk(kind, content=b""):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


PNG = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", b"0123456789abc") + chunk(b"IDAT", b"pixels") + chunk(b"IEND")


@pytest.mark.parametrize(("data", "whole"), [
    (PNG, True), (PNG[:-1], False), (PNG[:-12], False), (PNG + b"x", False), (b"\x89PNG\r\n\x1a\n", False),
    (PNG.replace(b"pixels", b"pixelz"), False), (b"\x88" + PNG[1:], False), (b"", False), (PNG + chunk(b"IEND"), False),
])  # fmt: skip
def test_a_png_is_whole(data, whole):
    assert _is_png(data) is whole


def test_figures_are_read_while_there_is_room(tmp_path, monkeypatch):
    """Their size is that of what the page shows."""
    monkeypatch.setattr("csstsim.report.pictures.chart", lambda png: png[:40])
    path, small = tmp_path / "a.png", tmp_path / "b.png"
    path.write_bytes(PNG)
    small.write_bytes(PNG)
    budget = Budget(80)
    assert [budget.read(path), budget.read(small), budget.read(small)] == [PNG[:40], PNG[:40], None]
    assert Budget(39).read(path) is None
    with pytest.raises(InputError, match=r"none\.png: cannot read a figure"):
        budget.read(tmp_path / "none.png")
    path.write_bytes(PNG[:-3])
    with pytest.raises(InputError, match=r"a\.png: the PNG is damaged"):
        Budget(1000).read(path)


@pytest.mark.parametrize(("size", "words"), [
    (0, "0 bytes"), (999, "999 bytes"), (1000, "1 kB"), (12_345, "12.3 kB"), (2_500_000, "2.5 MB"),
    (3e9, "3 GB"), (4_567e9, "4567 GB"),
])  # fmt: skip
def test_a_size_in_words(size, words):
    assert _size(size) == words
