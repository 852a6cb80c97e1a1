"""What is compared of a spectroscopic frame's sky."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.measure.spectra.spectrum_columns import DIM
from csstsim.stages.parts import spectra_checks

DARK = 0.02  # electron / s / px


@pytest.mark.parametrize("exptime", [150.0, 1200.0])
@pytest.mark.parametrize("dark", [True, False])
@pytest.mark.parametrize("shipped", [True, False])
def test_the_sky_beside_spectra_is_compared_without_the_dark_current(monkeypatch, exptime, dark, shipped):
    """3% above that of the campaign, in each row another; columns without a known light do not count."""
    window = Window(100, 140, 50, 60)
    image = np.arange(1.0, 11.0)[:, None] * np.ones(40)
    monkeypatch.setattr(spectra_checks, "dispersed_sky", lambda exposure, param: image)
    layers = {"sky_background": SimpleNamespace(param=None)} | ({"poisson_and_dark": object()} if dark else {})
    run = SimpleNamespace(
        steps={"SCIE": SimpleNamespace(step=layers.get, shipped=shipped)},
        camera=SimpleNamespace(detector=SimpleNamespace(dark=DARK)),
    )
    job = SimpleNamespace(
        pointing=SimpleNamespace(type="SCIE", exptime=exptime), exposure=None, window=window
    )  # fmt: skip
    row = np.repeat([0, 1], 10)
    y, column = np.where(row == 0, 52.2, 57.7), np.tile(np.arange(110, 120), 2)
    sky = 1.03 * np.where(row == 0, 3.0, 9.0) + (DARK * exptime if dark else 0.0)
    flags = np.where(column == 115, DIM, 0)
    sky[flags > 0] = 1e6
    table = ObjectTable(
        {"row": row, "y": y, "column": column, "sky": sky, "flags": flags, "model": np.ones(len(row))}
    )  # fmt: skip
    found = spectra_checks._sky(run, job, table)
    if shipped:
        assert found["off"] == pytest.approx(0.03, abs=1e-9) and found["n"] == 2
    else:
        assert found == {"off": None, "n": 0}
