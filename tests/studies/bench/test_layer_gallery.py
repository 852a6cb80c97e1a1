"""The gallery shows every layer, and each alone on the pixels it is given."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.simulation.sim_steps import known_layers
from csstsim.studies.bench.setting import POINTING


@pytest.fixture
def gallery(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    import layer_cells
    import layer_stamp

    return SimpleNamespace(cells=layer_cells.GALLERY, steps=layer_stamp.STEPS, Stamp=layer_stamp.Stamp)


def test_every_layer_is_in_it(gallery):
    assert sorted(gallery.cells) == known_layers()
    assert set(gallery.cells) <= set(gallery.steps)
    for name, cell in gallery.cells.items():
        assert name not in cell.base
        assert set(cell.base) <= set(gallery.steps)


def test_a_layer_alone(gallery):
    camera = load_camera(SHIPPED / "instrument")
    chip = camera.chips[9]
    setting = SimpleNamespace(
        camera=camera, chip=chip, filter=camera.filters[chip.filter], wcs=ChipWCS(chip, POINTING), psf=None, table=None
    )
    stamp = gallery.Stamp(setting, Window(1152 - 40, 1152 + 20, 3000, 3050), 1, "10100000001")
    before, after, laid, header = stamp.pair(("sky_background", "prescan_overscan"), "bias")
    assert before.shape == after.shape == (50 + 84, 60 + 71 + 27)
    np.testing.assert_array_equal(before, laid)
    left, right = header["bias"]
    np.testing.assert_allclose((after - before)[:, : 40 + 71], left, atol=1e-4)  # float32 of 530 e-
    np.testing.assert_allclose((after - before)[:, 40 + 71 :], right, atol=1e-4)
    image, frame, laid, _ = stamp.pair(("sky_background",), "prescan_overscan")
    assert image.shape == (50, 60)
    np.testing.assert_array_equal(frame, laid)
