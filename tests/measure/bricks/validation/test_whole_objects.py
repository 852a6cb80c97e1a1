"""Parts of objects join them in the truth with which catalogues are compared."""

import numpy as np
import pytest

from csstsim.catalog.flags import OUTSIDE_PSF_HULL, SATURATED
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.validation.whole_objects import whole_objects


def truth(**more):
    columns = {
        "id": [7, 3, 4, 5], "part_of": [-1, -1, 3, 3], "electrons": [10.0, 100.0, 40.0, 60.0],
        "drawn": [9.0, 90.0, 40.0, 60.0], "mag_r": np.float32([22.0, 20.0, 21.0, 20.5]), "snr": [2.0, 3.0, 4.0, 12.0],
        "flags": np.int32([0, SATURATED, 0, OUTSIDE_PSF_HULL]), "fraction": [0.9, 0.9, 1.0, 1.0],
    }  # fmt: skip
    return ObjectTable({name: np.asarray(values) for name, values in (columns | more).items()})


def test_light_of_parts_is_their_objects():
    whole = whole_objects(truth())
    assert whole["id"].tolist() == [7, 3]
    assert whole["electrons"].tolist() == [10.0, 200.0] and whole["drawn"].tolist() == [9.0, 190.0]
    light = sum(10 ** (-0.4 * mag) for mag in (20.0, 21.0, 20.5))
    assert whole["mag_r"] == pytest.approx([22.0, -2.5 * np.log10(light)], abs=1e-5)
    assert whole["snr"].tolist() == [2.0, 13.0] and whole["fraction"] == pytest.approx([0.9, 0.95])
    assert whole["flags"].tolist() == [0, SATURATED | OUTSIDE_PSF_HULL]


def test_a_part_whose_object_is_elsewhere_stays():
    whole = whole_objects(truth(part_of=np.array([-1, -1, 99, 3])))
    assert whole["id"].tolist() == [7, 3, 4] and whole["electrons"].tolist() == [10.0, 160.0, 40.0]


def test_a_table_without_parts_is_the_same():
    plain = truth(part_of=np.full(4, -1))
    assert whole_objects(plain) is plain
    bare = ObjectTable({"id": np.array([1])})
    assert whole_objects(bare) is bare
