"""The distortion without compiled code gives the bits of the compiled loops; scipy is in test_distortion.py."""

import numpy as np
import pytest

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.optics.geometry import chip_distortion, distortion, few_points
from csstsim.optics.geometry.distortion import load_distortion

CAMERA = load_camera(SHIPPED / "instrument")
FIELD = load_distortion(CAMERA.folder / "distortion.fits")


@pytest.mark.parametrize("chip", [1, 9, 15, 30])
@pytest.mark.parametrize("direction", ["forward", "inverse"])
def test_bits_are_those_of_the_compiled_loops(chip, direction):
    model = FIELD.on(CAMERA.chips[chip]).model
    x, y = np.random.default_rng(chip).uniform(-9000, 18000, (2, 5000))  # more than few_points takes at a time
    x[:4], y[4:8] = model.chip_box[[0, 1, 0, 1]], model.chip_box[[2, 3, 2, 3]]  # on the edges of the chip's box
    x[8:12], y[12:14] = (np.nan, np.inf, 1e12, -1e300), (np.nan, -np.inf)
    found, wanted = (getattr(module, direction)(x, y, model) for module in (few_points, chip_distortion))
    assert np.isfinite(wanted).mean() > 0.99
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("count", [0, 1])
def test_no_point_and_one(count):
    model = FIELD.on(CAMERA.chips[9]).model
    x = np.full(count, 4000.0)
    assert few_points.forward(x, x, model).shape == (count, 6)
    np.testing.assert_array_equal(few_points.inverse(x, x, model), chip_distortion.inverse(x, x, model))


def test_many_points_are_compiled(monkeypatch):
    monkeypatch.setattr(distortion, "_asked", 0)
    assert distortion._splines(1) is few_points
    assert [distortion._splines(4) for _ in range(2000)][-1] is chip_distortion
    monkeypatch.setattr(distortion, "_asked", 0)
    assert distortion._splines(10**6) is chip_distortion
