"""What a stage gives to the merge: the time of each detection."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.catalog.changing.motion import Interval
from csstsim.catalog.table import ObjectTable
from csstsim.stages.merge import _timed, jobs_on


def test_a_detection_is_of_the_middle_of_its_exposure():
    job = SimpleNamespace(exposure=SimpleNamespace(interval=Interval(61000.25, 300.0)))
    table = _timed(ObjectTable({"number": np.arange(3)}), job)
    assert np.allclose((table["mjd"] - 61000.25) * 86400.0, 150.0, atol=1e-5) and (table["exptime"] == 300.0).all()


def test_a_brick_without_a_frame_is_refused_by_those_that_have_one():
    run = SimpleNamespace(file="a.yaml", merge_bricks={4: ["one", "two"], 7: ["two"]})
    assert jobs_on(run, 4) == ["one", "two"] and jobs_on(run, 7) == ["two"]
    with pytest.raises(InputError, match=r"a\.yaml: brick: not touched .*\(got 5\); allowed: 4, 7"):
        jobs_on(run, 5)
