"""Input of the validation stage: published depths at the exposure time."""

from types import SimpleNamespace

import pytest

from csstsim.base.files.yaml_file import read_yaml
from csstsim.stages.validate import LIMIT_SECONDS, LIMITS, _depth


@pytest.mark.parametrize(("times", "magnitudes"), [(1.0, 0.0), (4.0, 0.7526), (0.01, -2.5)])
def test_depth_goes_with_the_root_of_the_time(camera, times, magnitudes):
    run, chip = SimpleNamespace(camera=camera), camera.chips[9]
    once, other = (
        _depth(run, SimpleNamespace(chip=chip, pointing=SimpleNamespace(exptime=LIMIT_SECONDS * fraction)))
        for fraction in (1.0, times)
    )
    assert once[0] <= once[1] and camera.filters[chip.filter].limiting_mag in once
    assert other == pytest.approx([depth + magnitudes for depth in once], abs=1e-4)


def test_the_depth_has_both_published_numbers_the_lower_first(camera):
    """Of another camera that of its filters alone."""
    published = read_yaml(LIMITS)["computed"]["values"]
    for chip in (camera.chips[number] for number in (7, 8, 9)):
        job = SimpleNamespace(chip=chip, pointing=SimpleNamespace(exptime=LIMIT_SECONDS))
        stated = camera.filters[chip.filter].limiting_mag
        assert _depth(SimpleNamespace(camera=camera), job) == tuple(sorted([stated, published[chip.filter]]))
        other = SimpleNamespace(shipped=False, filters=camera.filters)
        assert _depth(SimpleNamespace(camera=other), job) == (stated, stated)
