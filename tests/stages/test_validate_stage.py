"""Input of the validation stage: published depths at the exposure time."""

from types import SimpleNamespace

import pytest

from csstsim.stages.validate import LIMIT_SECONDS, _depth


@pytest.mark.parametrize(("times", "magnitudes"), [(1.0, 0.0), (4.0, 0.7526), (0.01, -2.5)])
def test_depth_goes_with_the_root_of_the_time(camera, times, magnitudes):
    run, chip = SimpleNamespace(camera=camera), camera.chips[9]
    once, other = (
        _depth(run, SimpleNamespace(chip=chip, pointing=SimpleNamespace(exptime=LIMIT_SECONDS * share)))
        for share in (1.0, times)
    )
    assert once[0] <= once[1] and camera.filters[chip.filter].limiting_mag in once
    assert other == pytest.approx([depth + magnitudes for depth in once], abs=1e-4)
