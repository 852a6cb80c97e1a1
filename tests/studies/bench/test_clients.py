"""The benchmark of other programs: its own measures against closed forms, and parts that are left out say why."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from csstsim.base.errors import InputError

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
SAID = """
----- Astrometric stats (internal) :

           dAXIS1  dAXIS2   chi2   ndets | dAXIS1  dAXIS2   chi2   ndets
Group  1: 0.00168" 0.00158"    1.2    3734 0.00118" 0.00119"    2.2     699

----- Astrometric stats (external):

Group  1: 0.00126" 0.00131"    1.3    1785  0.001" 0.00101"    2.3     264
Group  2: 0.003" 0.003"    1.3    1000  0" 0"    0     0

----- Photometric stats (internal):

Group  1: P1   0.0243       1    3725 0.00369    0.87     699
"""


@pytest.fixture
def parts(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    from client_codes import coadd, early, scamp

    return SimpleNamespace(coadd=coadd, early=early, scamp=scamp)


def test_what_scamp_says_is_read(parts):
    found = parts.scamp.reported(SAID)
    assert found["internal"] == ("1.68, 1.58", "1.18, 1.19", 3734)
    rms = np.sqrt((1.26**2 * 1785 + 3.0**2 * 1000) / 2785)  # of two groups, weighted with their numbers
    assert found["external"][0].startswith(f"{rms:.2f}, ") and found["external"][2] == 2785
    assert found["external"][1] == "1.00, 1.01"  # the second has no bright stars


def test_mean_positions_are_of_stars_in_every_exposure(parts):
    seen = [{"star": np.array(s), "dx": np.array(x), "dy": np.array(x) + 1.0} for s, x in (
        ([4, 7], [2.0, 9.0]), ([7, 4, 5], [1.0, 4.0, 0.0]),
    )]  # fmt: skip
    east, north, number = parts.scamp.mean_places(seen)
    assert east.tolist() == [3.0, 5.0] and north.tolist() == [4.0, 6.0] and number == 2


def test_clipping(parts):
    """Outliers go; of a Gaussian's rms 1.5% goes with its tails (closed form, iterated); of equal values nothing."""
    values = np.random.default_rng(1).normal(0, 2.0, 200_000)
    assert parts.scamp.clipped_rms(np.append(values, [500.0, -80.0])) == pytest.approx(2.0 * 0.985, abs=0.01)
    assert parts.scamp.clipped_rms(np.zeros(3)) == 0.0


def test_the_reference_is_a_catalogue_of_two_tables(parts, tmp_path):
    stars = {name: np.array([1.0, 2.0, 3.0]) for name in ("ra", "dec", "mag")} | {"snr": np.array([5.0, 50.0, 1e5])}
    path = tmp_path / parts.scamp.reference(tmp_path, stars)
    with fits.open(path) as file:
        assert [hdu.name for hdu in file] == ["PRIMARY", "LDAC_IMHEAD", "LDAC_OBJECTS"]
    table = Table.read(path, hdu=2)
    assert table["X_WORLD"].tolist() == [2.0]  # those near the limits of S/N alone
    assert str(table["X_WORLD"].unit) == "deg"


def test_light_of_an_aperture(parts):
    """A plane of 1: as many as the circle has pixels; a single bright pixel is in the circles about it alone."""
    image = np.ones((40, 40), np.float32)
    image[20, 10] = 100.0
    sums, pixels = parts.coadd._apertures(image, np.array([[10.0, 20.0], [25.0, 25.0], [14.0, 20.0], [15.0, 20.0]]))
    assert pixels == 49
    np.testing.assert_allclose(sums, [148, 49, 148, 49])


def test_resampling_keeps_light_and_widens_little(parts):
    """Of a wide Gaussian the Lanczos function, which is flat in frequency there, changes the width by below 1%."""
    axis = 0.5 * (np.arange(121) - 60)
    psf = np.exp(-0.5 * (axis[:, None] ** 2 + axis**2) / 2.0**2) / (2 * np.pi * 2.0**2)
    fine = parts.coadd.resampled(psf, 0.5)
    assert fine.sum() * parts.coadd.FINE**2 == pytest.approx(1.0, abs=1e-3)
    at = parts.coadd.FINE * (np.arange(len(fine)) - len(fine) // 2)
    width = np.sqrt((fine.sum(0) * at**2).sum() / fine.sum())
    assert width == pytest.approx(2.0, rel=0.01)


def test_a_folder_that_is_not_the_pipeline(parts, tmp_path):
    with pytest.raises(InputError, match="--early"):
        parts.early.pipeline(tmp_path, tmp_path / "out", 9)


def test_parts_left_out_say_why(tmp_path):
    command = [sys.executable, BENCHMARKS / "clients.py", "--only", "early", "--output", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "skipped: early: --early names no checkout" in done.stdout
