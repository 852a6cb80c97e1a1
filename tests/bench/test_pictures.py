"""The commands of docs/look.md: how they place and colour pixels."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window


@pytest.fixture
def benchmarks(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    import exposure_page
    import focal_plane_picture

    return SimpleNamespace(page=exposure_page, plane=focal_plane_picture)


def test_the_page_places_a_chip_with_y_down(benchmarks, tmp_path):
    chip = load_camera(SHIPPED / "instrument").chips[9]
    rgb = np.zeros((4, 4, 3), np.uint8)
    whole = benchmarks.plane.Shown(chip, chip.full_window, 2400, rgb)
    zoom = benchmarks.plane.Shown(chip, Window(100, 300, 50, 250), 1, rgb)
    path = tmp_path / "page.html"
    benchmarks.page.write_page(path, [whole], [zoom], {"r": "#00ff00"})
    text = path.read_text()
    x, y = chip.xc - chip.detector.nx / 2 + 100, -(chip.yc - chip.detector.ny / 2 + 250)
    assert f'data-detail="{x:g} {y:g} 200 200"' in text
    assert "http" not in text.replace("http://www.w3.org", "")  # nothing is fetched


def test_colours_rise_from_black_to_white(benchmarks):
    noise = np.random.default_rng(1).normal(100.0, 5.0, (50, 50))
    noise[0, 0], noise[0, 1] = 0.0, 1e6
    shown = benchmarks.plane.stretched(noise, "#55c04a", 24).astype(int)
    assert tuple(shown[0, 1]) == (255, 255, 255)
    assert shown[0, 0].max() < 20
    assert shown.sum(axis=2)[1:].mean() < 200
