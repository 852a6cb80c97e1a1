"""Readout geometry against an independent, pixel by pixel assembly and the published order of the channels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from csstsim.detector.channels import LAYOUTS, ReadoutFrame

SMALL = {
    "nx": 32, "ny": 12, "channels_x": 8, "channels_y": 2, "channel_nx": 4, "channel_ny": 6,
    "prescan": 2, "overscan": 3, "parallel_overscan": 2,
}  # fmt: skip
REAL = {
    "nx": 9216, "ny": 9232, "channels_x": 8, "channels_y": 2, "channel_nx": 1152, "channel_ny": 4616,
    "prescan": 27, "overscan": 71, "parallel_overscan": 84,
}  # fmt: skip


def frame_of(window=None, **changes):
    geometry = SMALL | changes
    return ReadoutFrame(window=window or (0, geometry["nx"], 0, geometry["ny"]), **geometry)


def numbered(window):
    """An active image in which every pixel of the chip has its own number."""
    x0, x1, y0, y1 = window
    y, x = np.mgrid[y0:y1, x0:x1]
    return (1 + x + SMALL["nx"] * y).astype(np.int32)


def assemble(stored):
    """Put a small `channels` array together as public readers of Cycle-9 files do: one channel after the other."""
    chip = np.zeros((12, 32), stored.dtype)
    for index in range(16):
        active = stored[:6, index * 9 + 2 : index * 9 + 6]
        if index < 4:
            chip[:6, index * 4 : index * 4 + 4] = active
        elif index < 8:
            chip[:6, index * 4 : index * 4 + 4] = np.fliplr(active)
        elif index < 12:
            slot = 15 - index
            chip[6:, slot * 4 : slot * 4 + 4] = np.flipud(np.fliplr(active))
        else:
            slot = 15 - index
            chip[6:, slot * 4 : slot * 4 + 4] = np.flipud(active)
    return chip


def edges(n):
    return st.tuples(st.integers(0, n - 1), st.integers(1, n)).filter(lambda e: e[0] < e[1])


@settings(max_examples=150, deadline=None)
@given(x=edges(32), y=edges(12))
def test_every_window_survives_every_arrangement(x, y):
    window = (*x, *y)
    readout, image = frame_of(window), numbered(window)
    frame = readout.embed(image)
    assert frame.shape == readout.shape
    assert frame.sum() == image.sum()  # nothing lost, nothing twice
    assert np.array_equal(readout.active(frame), image)
    whole = frame_of()
    chip = np.zeros((12, 32), np.int32)
    chip[y[0] : y[1], x[0] : x[1]] = image
    assert np.array_equal(frame, whole.embed(chip)[np.ix_(readout.rows, readout.cols)])
    for layout in LAYOUTS:
        stored = readout.to_stored(frame, layout)
        assert np.array_equal(readout.from_stored(stored, layout), frame)
        assert np.array_equal(stored, whole.to_stored(whole.embed(chip), layout))
    assert np.array_equal(assemble(readout.to_stored(frame, "channels")), chip)


@pytest.mark.parametrize("window", [(0, 1, 0, 1), (31, 32, 11, 12), (3, 5, 2, 3), (15, 17, 5, 7), (0, 32, 0, 12)])
def test_blocks_tile_the_frame(window):
    readout = frame_of(window)
    seen = np.zeros(readout.shape, int)
    for block in readout.blocks:
        seen[block.whole] += 1
        inside = np.zeros(readout.shape, int)
        for region in (block.active, block.prescan, block.serial_overscan, block.parallel_overscan):
            inside[region] += 1
        rows, cols = inside[block.whole].shape
        assert inside.max() == 1
        # what is in no region are the corners: overscan rows x (prescan + overscan) columns
        assert rows * cols - inside.sum() == SMALL["parallel_overscan"] * (SMALL["prescan"] + SMALL["overscan"])
    assert (seen == 1).all()
    assert [b.channel for b in readout.blocks] == sorted(b.channel for b in readout.blocks)


def test_a_window_across_one_channel_border_reads_two_channels():
    blocks = frame_of((3, 5, 2, 3)).blocks
    assert [b.channel for b in blocks] == [1, 2]
    assert frame_of((3, 5, 2, 3)).shape == (1 + 2, 2 + 2 * 5)
    assert [b.channel for b in frame_of((15, 17, 5, 7)).blocks] == [4, 5, 12, 13]


def test_real_detector():
    whole = ReadoutFrame(window=(0, 9216, 0, 9232), **REAL)
    assert whole.shape == whole.stored_shape("mosaic") == (9400, 10000)
    assert whole.stored_shape("channels") == (4700, 20000)
    x_pattern = [27, 1152, 71] * 4 + [71, 1152, 27] * 4
    edges = np.cumsum([0, *x_pattern])
    active_x = {(edges[i], edges[i + 1]) for i in range(1, 24, 3)}
    assert {(b.active[1].start, b.active[1].stop) for b in whole.blocks} == active_x
    assert {(b.active[0].start, b.active[0].stop) for b in whole.blocks} == {(0, 4616), (4784, 9400)}
    assert {(b.parallel_overscan[0].start, b.parallel_overscan[0].stop) for b in whole.blocks} == {
        (4616, 4700),
        (4700, 4784),
    }
    order = [(b.half, b.slot) for b in whole.blocks]
    assert order == [(0, s) for s in range(8)] + [(1, s) for s in range(7, -1, -1)]
    assert [(b.flip_x, b.flip_y) for b in whole.blocks[::4]] == [
        (False, False),
        (True, False),
        (True, True),
        (False, True),
    ]


def test_amplifiers_are_at_the_stored_origin():
    """The first stored row of a channel is the chip's edge row; the first columns are prescan."""
    whole = frame_of()
    frame = whole.embed(numbered(whole.window))
    for block in whole.blocks:
        frame[block.prescan] = -1
    stored = whole.to_stored(frame, "channels")
    for block in whole.blocks:
        corner = stored[:, block.stored_x0 : block.stored_x0 + 9]
        assert (corner[:6, :2] == -1).all()
        row = (corner[0, 2] - 1) // 32
        column = (corner[0, 2] - 1) % 32
        assert row == (11 if block.half else 0)
        assert column == (block.slot * 4 + 3 if block.slot >= 4 else block.slot * 4)


def test_stored_axis_names_the_chip_pixel_of_a_stored_one():
    for layout in LAYOUTS:
        whole = frame_of().of_file(layout)
        stored = whole.to_stored(whole.embed(numbered(whole.window)), layout)
        y, x = np.nonzero(stored)
        number = stored[y, x] - 1
        for block in whole.blocks:
            (x0, sx), (y0, sy) = whole.stored_axis(block, layout)
            cx, cy = x0 + sx * x, y0 + sy * y
            here = (number % 32 // 4 == block.slot) & (number // 32 // 6 == block.half)
            assert here.sum() == 24
            assert np.array_equal((cx + 32 * cy)[here], number[here])


@pytest.mark.parametrize("window", [(0, 0, 0, 12), (5, 4, 0, 12), (-1, 4, 0, 12), (0, 33, 0, 12), (0, 4, 0, 13)])
def test_impossible_windows(window):
    with pytest.raises(ValueError, match="window"):
        frame_of(window)


@pytest.mark.parametrize("changes", [{"channels_y": 1}, {"channels_x": 7}, {"channel_nx": 5}, {"ny": 13}])
def test_impossible_detectors(changes):
    with pytest.raises(ValueError, match="channels"):
        frame_of((0, 1, 0, 1), **changes)


def test_wrong_arrays():
    readout = frame_of()
    with pytest.raises(ValueError, match="shape"):
        readout.to_stored(np.zeros((3, 3)), "channels")
    with pytest.raises(ValueError, match="shape"):
        readout.from_stored(np.zeros((3, 3)), "mosaic")
    with pytest.raises(ValueError, match="known: channels, mosaic"):
        readout.stored_shape("tiles")


@pytest.mark.parametrize("window", [(0, 32, 0, 12), (3, 5, 2, 3)])
def test_a_chip_has_the_active_pixels_where_they_are(window):
    """Scans are not stored, and come back as 0; places in them cannot be asked for."""
    readout = frame_of(window)
    frame = readout.embed(numbered(window))
    frame[frame == 0] = -1
    stored = readout.to_stored(frame, "chip")
    x0, x1, y0, y1 = window
    assert stored.shape == readout.stored_shape("chip") == (12, 32)
    assert np.array_equal(stored[y0:y1, x0:x1], numbered(window))
    assert (stored != 0).sum() == (x1 - x0) * (y1 - y0)
    assert np.array_equal(readout.from_stored(stored, "chip"), np.where(frame == -1, 0, frame))
    assert readout.of_file("chip").shape == (y1 - y0, x1 - x0)
    assert all(readout.of_file(layout) is readout for layout in ("channels", "mosaic"))
    with pytest.raises(ValueError, match="of_file"):
        readout.stored_axis(readout.blocks[0], "chip")


def test_no_prescan_or_overscan():
    readout = frame_of(prescan=0, overscan=0, parallel_overscan=0)
    image = numbered(readout.window)
    assert np.array_equal(readout.embed(image), image)
    assert np.array_equal(readout.from_stored(readout.to_stored(image, "channels"), "channels"), image)
