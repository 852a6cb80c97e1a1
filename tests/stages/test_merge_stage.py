"""What a stage gives to the merge: the time of each detection."""

from types import SimpleNamespace

import numpy as np

from csstsim.catalog.changing.motion import Interval
from csstsim.catalog.table import ObjectTable
from csstsim.stages.merge import _timed


def test_a_detection_is_of_the_middle_of_its_exposure():
    job = SimpleNamespace(exposure=SimpleNamespace(interval=Interval(61000.25, 300.0)))
    table = _timed(ObjectTable({"number": np.arange(3)}), job)
    assert np.allclose((table["mjd"] - 61000.25) * 86400.0, 150.0, atol=1e-5) and (table["exptime"] == 300.0).all()
