"""The drawing method of docs/extension_points.md: one file, a line of the register and its cost make it render."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from render.imaging.test_reference import EXPTIME, objects
from support.canvases import blank

from csstsim.catalog.table import GALAXY
from csstsim.instrument.chip import Window
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.render import settings
from csstsim.render.drawing import Drawing
from csstsim.render.imaging import draw, methods, register

METHOD = Path(__file__).with_name("new_method")  # what the page shows
PACKAGE = "csstsim.render.imaging.methods"
WINDOW = Window(4000, 4200, 4000, 4120)
X, Y, ELECTRONS = np.array([4050.2, 4090.0, 4120.4]), np.array([4060.0, 4070.3, 4050.0]), np.array([2.0, 1e3, 2.0])


def insert(text, new, before):
    """Return a text with another one put before the only place where a third stands."""
    assert text.count(before) == 1, before
    return text.replace(before, new + before)


@pytest.fixture
def add_method(tmp_path, monkeypatch):
    """Return a function that adds the method of the page."""

    def add():
        spec = importlib.util.spec_from_file_location(f"{PACKAGE}.pixel", METHOD / "pixel.py")
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, spec.name, module)
        monkeypatch.setattr(methods, "pixel", module, raising=False)
        data = tmp_path / "render.yaml"
        text = settings.FILE.read_text(encoding="utf-8")
        data.write_text(insert(text, (METHOD / "cost.yaml").read_text(), "    photon_object:"), encoding="utf-8")
        numbers = settings.load_numbers(data)
        monkeypatch.setattr(settings, "load_numbers", lambda _: numbers)
        spec.loader.exec_module(module)
        line, names = (METHOD / "register.txt").read_text(), {}
        text = Path(register.__file__).read_text(encoding="utf-8")
        text = insert(insert(text, line, "    photons.PHOTONS,\n"), "pixel, ", "stamps, unresolved\n")
        exec(text, names)
        assert len(names["METHODS"]) == len(register.METHODS) + 1
        monkeypatch.setattr(draw, "METHODS", names["METHODS"])

    return add


def test_a_new_method_renders_what_it_is_for(add_method, camera, make_pointing, psf_r, psf_tables):
    """A faint star, a brighter one and a faint galaxy: the new method changes the first one only."""
    wcs = ChipWCS(camera.chips[9], make_pointing())
    drawing = Drawing(wcs, psf_r, EXPTIME, Scattered(), "standard", 60.0, np.uint64(5), psf_tables)

    def rendered():
        table = objects(wcs, X, Y, obj_type=np.array([0, 0, GALAXY]), size_disk=np.full(3, 0.3))
        table = table.with_columns(**{f"flux{i}": ELECTRONS / EXPTIME / 4 for i in range(4)})
        canvas = blank(WINDOW)
        return canvas, draw.draw_objects(canvas, table, drawing)

    canvas, before = rendered()
    assert before["method"].tolist() == ["photons"] * 3 and not canvas.expected.any()
    add_method()
    canvas, after = rendered()
    assert after["method"].tolist() == ["pixel", "photons", "photons"]
    counted = after["drawn"][1:]
    assert counted.tolist() == before["drawn"][1:].tolist() and canvas.counted.sum() == counted.sum()
    assert canvas.expected[60, 50] == pytest.approx(2.0) and np.count_nonzero(canvas.expected) == 1
    assert [after[name][0] for name in ("x0", "x1", "y0", "y1")] == [4050, 4051, 4060, 4061]
    assert after["fraction"][0] == pytest.approx(1.0) and after["error"][0] == after["snr"][0] < 0.1
