"""Where a pixel that differs is said to be, for every pixel of the channels."""

import numpy as np
import pytest

from csstsim.compare.images import _pixel, _place
from csstsim.detector.channels import ReadoutFrame


@pytest.mark.parametrize("window", [(0, 24, 0, 12), (5, 17, 4, 9)])
def test_a_channels_pixel_is_named_by_the_chip_or_as_overscan(window):
    """The words of each pixel of the window give the number that `to_stored` brings there; of prescan, none."""
    readout = ReadoutFrame(window, 24, 12, 4, 2, 6, 6, 3, 2, 1)
    (x0, x1, y0, y1), number = window, np.arange(12 * 24).reshape(12, 24)
    stored = readout.to_stored(readout.embed(number[y0:y1, x0:x1] + 1), "channels").astype(int) - 1
    seen = 0
    for block in readout.blocks:
        for row, column in np.ndindex(readout.block_ny, readout.block_nx):
            words = _place(readout, block, row, column)
            assert words.startswith(f"in channel {block.channel}, column {column}, row {row} ")
            value = stored[row, block.stored_x0 + column]
            if value >= 0:
                assert words.endswith(f"(chip x {value % 24}, y {value // 24})"), (words, value)
                seen += 1
            elif column < 3 or column >= 9 or row >= 6:
                assert words.endswith("(overscan)")
    assert seen == (x1 - x0) * (y1 - y0)


def test_a_pixel_is_named_by_columns_before_rows():
    assert _pixel(20, 85) == "at x 85, y 20"
    assert _pixel(2, 20, 85) == "at x 85, y 20, z 2"
