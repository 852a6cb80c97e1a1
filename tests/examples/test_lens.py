"""The worked example of a strong lens: its files are lenstronomy's, its images obey gravity, and it is drawn."""

import importlib.util
import sys

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from scipy.ndimage import map_coordinates

import csstsim
from csstsim.base.shipped import ROOT

EXAMPLE = ROOT / "examples" / "lens"
FOUR = range(2, 6)  # rows of the quasar's images
BRIGHTNESS, DAYS, MAG = 0.12, 1.0, 2e-3


@pytest.fixture(scope="module")
def objects():
    return Table.read(EXAMPLE / "objects.csv")


def test_surface_brightness_is_conserved(objects):
    """The quasar is in the middle of the disk: at each of its images the arcs are as bright as the brightest pixel."""
    pixels = fits.getdata(EXAMPLE / "arcs.fits").astype(float)
    scale, middle = objects["image_scale"][1], (len(pixels) - 1) / 2
    row = middle + np.array(objects["offset_dec"][FOUR]) / scale
    column = middle - np.array(objects["offset_ra"][FOUR]) / scale
    assert map_coordinates(pixels, [row, column], order=3) == pytest.approx(np.full(4, pixels.max()), rel=BRIGHTNESS)
    off = map_coordinates(pixels, [row, 2 * middle - column], order=3)  # east and west exchanged
    assert (off < 0.8 * pixels.max()).any()


def test_images_vary_one_after_another():
    """The curves are one walk, with the delays that the README states."""
    curves = Table.read(EXAMPLE / "curves.csv")
    first, *others = ([np.array(curves[n][curves["curve"] == name]) for n in ("mjd", "dmag")] for name in "ABCD")
    delays = np.linspace(0, 20, 401)
    for (mjd, dmag), wanted in zip(others, (0.13, 1.73, 14.88), strict=True):
        inner = slice(10, -10)
        off = [np.std(np.interp(mjd[inner] - delay, *first) - dmag[inner]) for delay in delays]
        assert delays[np.argmin(off)] == pytest.approx(wanted, abs=DAYS)


def test_lenstronomy_gives_these_files(objects, tmp_path, capsys):
    pytest.importorskip("lenstronomy")
    spec = importlib.util.spec_from_file_location("make_lens", EXAMPLE / "make_lens.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    module.main(tmp_path)
    made = Table.read(tmp_path / "objects.csv")
    for name in ("offset_ra", "offset_dec", "mag_r"):
        assert np.ma.filled(made[name], 0.0) == pytest.approx(np.ma.filled(objects[name], 0.0), abs=1e-4)
    assert fits.getdata(tmp_path / "arcs.fits") == pytest.approx(
        fits.getdata(EXAMPLE / "arcs.fits"), rel=1e-4, abs=1e-9
    )
    for name in ("curves.csv", "old.csv", "disk.csv", "quasar.csv"):
        a, b = Table.read(tmp_path / name), Table.read(EXAMPLE / name)
        values = [np.array([t[c] for c in t.colnames if t[c].dtype.kind in "if"], float) for t in (a, b)]
        assert values[0] == pytest.approx(values[1], abs=2e-4)


def test_it_is_drawn_in_both_epochs(objects, monkeypatch):
    """Six rows; the four images change as their curves say, and are where the table has them."""
    monkeypatch.chdir(EXAMPLE)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    sim, curves = csstsim.Simulation("campaign.yaml"), Table.read(EXAMPLE / "curves.csv")
    light = [sim.light(obsid, 8) for obsid in ("10100000001", "10100000005")]
    for frame, mjd in zip(light, (61729.0564, 61789.1259), strict=True):
        truth = frame.truth
        assert truth["obj_ID"].tolist() == [1, 2, 3, 4, 5, 6]
        wanted = [
            np.interp(mjd, *(curves[name][curves["curve"] == curve] for name in ("mjd", "dmag"))) for curve in "ABCD"
        ]
        assert np.asarray(truth["dmag"])[FOUR] == pytest.approx(wanted, abs=MAG)
        apart = np.hypot(truth["xImage"][FOUR] - truth["xImage"][0], truth["yImage"][FOUR] - truth["yImage"][0])
        asked = np.hypot(objects["offset_ra"][FOUR], objects["offset_dec"][FOUR])
        assert np.asarray(apart * 0.074) == pytest.approx(np.asarray(asked), rel=5e-3)
    one, two = (np.asarray(frame.truth["electrons"]) for frame in light)
    assert two[:2] == pytest.approx(one[:2], rel=1e-3)
    change = -2.5 * np.log10(two[FOUR] / one[FOUR])
    dmag = [np.asarray(frame.truth["dmag"])[FOUR] for frame in light]
    assert change == pytest.approx(dmag[1] - dmag[0], abs=MAG)
