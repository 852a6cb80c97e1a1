"""What is compared of a spectroscopic frame's sky."""

from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.instrument.chip import Window
from csstsim.measure.spectra.spectrum_columns import CUT, DIM, LOST
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.stages.parts import spectra_checks

DARK = 0.02  # electron / s / px


@pytest.mark.parametrize("exptime", [150.0, 1200.0])
@pytest.mark.parametrize("dark", [True, False])
@pytest.mark.parametrize("shipped", [True, False])
def test_the_sky_next_to_spectra_is_compared_without_the_dark_current(monkeypatch, exptime, dark, shipped):
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


def test_the_flux_is_that_of_bright_stars_by_whole_spectra():
    """Electrons of a spectrum are sums over its usable columns; orders of a star count apart, galaxies do not."""
    spectra = [(0, 1, 60, 1.028), (0, 0, 60, 1.031), (1, 1, 60, 5.0), (2, 1, 49, 6.0), (3, 1, 50, 1.03)]
    truth = ObjectTable({"obj_type": np.array([STAR, GALAXY, STAR, STAR, STAR])})
    spectra.append((4, 1, 60, 7.0))  # of S/N below 50
    row, order, fraction = (np.concatenate([np.full(n, v[k]) for v in spectra for n in v[2:3]]) for k in (0, 1, 3))
    model = np.full(len(row), 200.0)
    electrons, flags, error = fraction * model, np.zeros(len(row), int), np.where(row == 4, 50.0, 2.0)
    for column, flag in ((3, DIM), (7, LOST), (11, CUT)):
        flags[column], electrons[column] = flag, 1e7
    model[20], electrons[20] = np.nan, 1e7
    table = ObjectTable({"row": row, "order": order, "electrons": electrons, "electrons_err": error, "model": model,
                         "flags": flags})  # fmt: skip
    found = spectra_checks._flux(truth, table)
    weight = 1 / (0.01**2 / np.array([56, 60, 50]) + 0.005**2)  # of n columns: 2 electrons of 200 / sqrt(n)
    assert found["n"] == 3 and found["off"] == pytest.approx(np.average([0.028, 0.031, 0.03], weights=weight), abs=1e-9)
    assert found["error"] == pytest.approx(weight.sum() ** -0.5, rel=1e-6)


@pytest.mark.parametrize(("y", "row"), [(43.0, 0), (50.4, 0), (50.6, 1), (58.6, 9), (59.4, 9), (59.6, 9), (66.0, 9)])
def test_a_spectrum_at_an_edge_is_compared_with_the_sky_of_the_nearest_row(monkeypatch, y, row):
    """A window of rows 50 to 59, whose sky is 1 to 10 electrons."""
    image = np.arange(1.0, 11.0)[:, None] * np.ones(40)
    monkeypatch.setattr(spectra_checks, "dispersed_sky", lambda exposure, param: image)
    step = {"sky_background": SimpleNamespace(param=None)}.get
    run = SimpleNamespace(steps={"SCIE": SimpleNamespace(step=step, shipped=True)})
    job = SimpleNamespace(
        pointing=SimpleNamespace(type="SCIE", exptime=150.0), exposure=None, window=Window(100, 140, 50, 60)
    )
    table = ObjectTable({
        "row": np.array([0]), "y": np.array([y]), "column": np.array([139]), "sky": np.array([2.0 * (row + 1)]),
        "flags": np.array([0]), "model": np.ones(1),
    })  # fmt: skip
    assert spectra_checks._sky(run, job, table) == {"off": pytest.approx(1.0), "expected": row + 1.0, "n": 1}


def test_no_spectrum_no_sky():
    steps = {"SCIE": SimpleNamespace(step=lambda name: None, shipped=True)}
    job = SimpleNamespace(pointing=SimpleNamespace(type="SCIE", exptime=1.0))
    table = ObjectTable({"row": np.zeros(2)})
    assert spectra_checks._sky(SimpleNamespace(steps=steps), job, table) == {"off": None, "n": 0}


def test_the_pointing_of_keywords_and_of_the_wcs_is_compared_with_the_surveys(monkeypatch, camera, make_pointing):
    """Declination off by 0.01 deg, the position angle by 0.05 deg, the WCS by 0.02 deg: arcsec of each."""
    pointing = make_pointing()
    wcs = ChipWCS(camera.chips[29], pointing)
    header = wcs.header() | {"CRVAL2": wcs.header()["CRVAL2"] - 0.02}
    header0 = {"RA_OBJ": pointing.ra, "DEC_OBJ": pointing.dec + 0.01, "POS_ANG0": pointing.pa + 0.05}
    file = SimpleNamespace(header0=header0, header=header)
    monkeypatch.setattr(spectra_checks, "read_level0", lambda path: file if path == "LEVEL0" else None)
    monkeypatch.setattr(spectra_checks, "_flux", lambda truth, table: (truth, table))
    monkeypatch.setattr(spectra_checks, "_sky", lambda run, job, table: table)
    run = SimpleNamespace(paths=SimpleNamespace(level0=lambda job: "LEVEL0"))
    found = spectra_checks.spectra_checks(run, SimpleNamespace(pointing=pointing, wcs=wcs), "TRUTH", "TABLE")
    assert (found["flux"], found["sky"]) == (("TRUTH", "TABLE"), "TABLE")
    assert found["pointing"] == {
        "RA_OBJ": pytest.approx(36.0), "POS_ANG0": pytest.approx(180.0), "CRVAL1": pytest.approx(72.0, rel=3e-3),
    }  # fmt: skip
