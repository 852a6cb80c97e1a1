"""The commands of docs/look.md and docs/model_no_more.md: what they measure and how they place and colour pixels."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.table import Table

from csstsim.base.shipped import SHIPPED
from csstsim.catalog.table import STAR
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window

PLACE = 40.3, 36.8  # px in the image below


@pytest.fixture
def benchmarks(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    import exposure_page
    import focal_plane_picture
    import scene_measures
    import scene_needs
    import scene_table

    return SimpleNamespace(
        page=exposure_page, plane=focal_plane_picture, measures=scene_measures, needs=scene_needs, table=scene_table
    )  # fmt: skip


def _star(light, sigma_x, sigma_y, sky):
    """Return a Frame-like star of a window that begins at column 100: a Gaussian, electrons."""
    y, x = np.mgrid[:80, :90]
    r2 = ((x - PLACE[0]) / sigma_x) ** 2 + ((y - PLACE[1]) / sigma_y) ** 2
    image = sky + light / (2 * np.pi * sigma_x * sigma_y) * np.exp(-r2 / 2)
    truth = Table({
        "obj_ID": [7], "xImage": [PLACE[0] + 101.0], "yImage": [PLACE[1] + 1.0], "mag": [20.0], "obj_type": [STAR],
        "snr": [90.0], "electrons": [light], "size": [0.0],
    })  # fmt: skip
    return SimpleNamespace(electrons=image, truth=truth, window=Window(100, 190, 0, 80))


def test_moments_of_a_gaussian(benchmarks):
    measures = benchmarks.measures
    frame = _star(1e4, 1.5, 1.2, sky=30.0)
    assert list(measures.objects(frame, STAR)) == [7]
    [(light, size, e1, e2)] = measures.moments(frame, [7])
    xx, yy = (1 / (1 / s**2 + 1 / measures.WEIGHT**2) for s in (1.5, 1.2))  # a Gaussian under a Gaussian weight
    assert light == pytest.approx(1e4, rel=1e-3)
    assert size == pytest.approx(np.sqrt((xx + yy) / 2), rel=2e-3)
    assert (e1, e2) == pytest.approx(((xx - yy) / (xx + yy), 0.0), abs=2e-3)


def test_changes_are_of_the_default(benchmarks):
    frames = _star(1e4, 1.5, 1.5, 30.0), _star(0.9e4, 1.5, 1.5, 33.0)
    light, size, e = benchmarks.measures.changes(*(benchmarks.measures.moments(frame, [7]) for frame in frames))
    assert light == pytest.approx(10.0, abs=0.01)
    assert size == pytest.approx(0.0, abs=0.01)
    assert e == pytest.approx(0.0, abs=1e-6)


def test_an_object_that_left_the_window_is_not_measured(benchmarks):
    frame = _star(1e4, 1.5, 1.5, 30.0)
    assert np.isnan(benchmarks.measures.moments(frame, [8])).all()


def test_every_layer_of_the_default_can_be_left_out_or_is_needed(benchmarks):
    import csstsim

    named = {name for effect in benchmarks.needs.EFFECTS for name in effect[3].get("layers", {})}
    needed = {"prescan_overscan", "bias", "quantization_and_output"}
    assert {next(iter(each)) for each in csstsim.Simulation().layers} == named | needed


def test_table_leaves_out_what_is_not_defined(benchmarks):
    row = {"effect": "sky", "yaml": "remove sky_background", "cost": 0.1, "rms": 1.0, "largest": 1e4, "light": 80.0}
    head, [line] = benchmarks.table.table(
        [row | {"first orders light": 1.0, "first orders size": 2.0, "first orders e": np.nan}]
    )
    assert len(head) == len(line) == 8
    assert "first orders: e" not in head
    assert line[2:] == ["+0.10", "1", "10,000", "80", "1", "2"]


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
