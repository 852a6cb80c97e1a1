"""SATURATED in the truth: light above the full well in the pixels at an object's position, and nowhere else."""

import numpy as np
import pytest

from csstsim.catalog.flags import OFF_CHIP, SATURATED
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.render.imaging.saturated import flag_saturated

WINDOW, FULL = Window(100, 120, 200, 230), 90_000.0


def flags_at(image, counted, x, y, given=0):
    table = ObjectTable({"x": np.array(x), "y": np.array(y), "flags": np.full(len(x), given, np.int32)})
    return flag_saturated(table, image, counted, WINDOW, FULL)["flags"].tolist()


@pytest.mark.parametrize("plane", ["image", "counted", "both"])
def test_a_pixel_above_the_full_well_flags_what_lies_beside_it(plane):
    image, counted = np.zeros(WINDOW.shape, np.float32), np.zeros(WINDOW.shape, np.int32)
    image[10, 5] = {"image": FULL + 1, "counted": 0, "both": FULL - 10}[plane]
    counted[10, 5] = {"image": 0, "counted": FULL + 1, "both": 11}[plane]
    x, y = [105.4, 106.4, 106.6, 105.0, 100.0, np.nan, 90.0], [210.4, 209.0, 210.0, 212.0, 200.0, 210.0, 210.0]
    assert flags_at(image, counted, x, y) == [SATURATED, SATURATED, 0, 0, 0, 0, 0]


def test_light_at_the_full_well_is_not_above_it_and_other_flags_stay():
    image = np.full(WINDOW.shape, FULL, np.float32)
    assert flags_at(image, None, [110.0], [210.0], OFF_CHIP) == [OFF_CHIP]
    image[...] += 100
    assert flags_at(image, None, [100.0, 119.0], [200.0, 229.0], OFF_CHIP) == [OFF_CHIP | SATURATED] * 2


def test_no_objects():
    table = ObjectTable({})
    assert flag_saturated(table, np.zeros(WINDOW.shape, np.float32), None, WINDOW, FULL) is table
