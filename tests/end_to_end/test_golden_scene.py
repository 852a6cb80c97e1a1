"""A small scene, layer by layer, against stored statistics (builder: tests/reference/builders/golden_scene.py)."""

import json
import runpy
from pathlib import Path

import pytest

REFERENCE = Path(__file__).parents[1] / "reference"
# Float rounding between processors and libraries; and what one electron moved by it does to a discrete draw.
RELATIVE, ABSOLUTE = 1e-4, 0.02


def test_golden_scene(tmp_path):
    builder = runpy.run_path(str(REFERENCE / "builders" / "golden_scene.py"))
    found, stored = builder["statistics"](tmp_path), json.loads((REFERENCE / "golden_scene.json").read_text())
    assert list(found) == list(stored), "the list of layers changed"
    for layer, statistics in stored.items():
        assert found[layer] == pytest.approx(statistics, rel=RELATIVE, abs=ABSOLUTE), layer
