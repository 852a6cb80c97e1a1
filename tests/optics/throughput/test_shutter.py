"""The shutter's exposure profile: its law of motion, its limits, its symmetry."""

from dataclasses import replace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.optics.geometry.wcs import chip_plane
from csstsim.optics.psf.chip_errors import mosaic_position
from csstsim.optics.throughput.shutter import check, deficit, exposed, lost, moments

TIME_S = 1e-5  # what the exposure of a column may be off


def test_middle_and_bearing(camera):
    """The paper's figure: nothing is missed in the middle, twice the shutter's time at the bearings."""
    t, half = camera.telescope.shutter_time, camera.telescope.shutter_span_mm / 2
    np.testing.assert_allclose(deficit([0.0, half, -half], camera.telescope), [0.0, 2 * t, 2 * t], atol=TIME_S)


def test_profile_follows_equation_14_integrated_by_steps(camera):
    """Leapfrog of the paper's acceleration, edge at L cos A: it passes a place at half of what that misses."""
    t_s, half = camera.telescope.shutter_time, camera.telescope.shutter_span_mm / 2
    time = np.linspace(0, t_s, 400_001)
    step = time[1]
    speed = np.cumsum(np.pi**2 / t_s**2 * np.sin(2 * np.pi * (time + step / 2) / t_s)) * step
    angle = np.concatenate([[0.0], np.cumsum(speed[:-1]) * step])
    assert angle[-1] == pytest.approx(np.pi / 2, abs=1e-5)
    position = half - half * np.cos(angle)  # from the middle
    x = np.linspace(5.0, half - 5.0, 50)
    np.testing.assert_allclose(deficit(x, camera.telescope), 2 * np.interp(x, position, time), atol=2e-5)


def test_it_is_symmetric_and_falls_to_the_sides(camera):
    x = np.linspace(0, 367, 500)
    missed = deficit(x, camera.telescope)
    assert (np.diff(missed) > 0).all()
    np.testing.assert_array_equal(missed, deficit(-x, camera.telescope))


def test_chips_see_their_part_of_it(camera):
    fractions = {n: exposed(camera.chips[n], camera.chips[n].full_window, 150.0) for n in camera.chips}
    for number, fraction in fractions.items():
        assert fraction.shape == (9216,) and (fraction > 1 - 2.6 / 150).all() and (fraction < 1).all(), number
        outward = np.sign(camera.chips[number].xc) * np.diff(fraction)
        assert (outward < 0).all()
    chip = camera.chips[9]
    _, origin = chip_plane(chip)
    where = (4000 - origin[0]) * 0.01
    assert fractions[9][4000] == pytest.approx(1 - deficit(where, camera.telescope) / 150, abs=1e-12)


def test_long_exposures_lose_nothing_and_short_ones_are_refused(camera):
    chip = camera.chips[6]
    assert exposed(chip, chip.full_window, 1e9).min() > 1 - 1e-8
    assert exposed(chip, chip.full_window, 2.6).min() >= 0
    with pytest.raises(InputError, match="too short for the shutter"):
        exposed(chip, chip.full_window, 2.5)


def test_a_window_has_the_columns_of_the_whole_chip(camera):
    chip = camera.chips[6]
    window = replace(chip.full_window, x0=100, x1=300)
    np.testing.assert_array_equal(exposed(chip, window, 150.0), exposed(chip, chip.full_window, 150.0)[100:300])


def test_turned_chips_see_what_lies_on_their_middle_row(camera):
    """Each column of each chip by its own place in the mosaic, turn and all; chips stand half a pixel off that."""
    turned = 0
    for chip in camera.chips.values():
        columns = np.array([0, 3000, 9215])
        x, _ = mosaic_position(chip, columns, np.full(3, (chip.detector.ny - 1) / 2))
        wanted = 1 - deficit(x * chip.detector.pixel_um * 1e-3, camera.telescope) / 150.0
        seen = exposed(chip, chip.full_window, 150.0)[columns]
        np.testing.assert_allclose(seen, wanted, atol=5e-6)
        turned += bool(chip.rotation)
    assert turned == 12


def test_the_shutter_opens_first_and_closes_last(camera):
    """Four moments of a 100 s exposure: opening and closing take 1.3 s each, within the exposure."""
    found = moments(61000.25, 100.0, camera.telescope)
    seconds = {name: (mjd - 61000.25) * 86400 for name, mjd in found.items()}
    wanted = {"shutter_open_0": 0.0, "shutter_open_1": 1.3, "shutter_close_0": 98.7, "shutter_close_1": 100.0}
    assert list(found) == list(wanted) and seconds == pytest.approx(wanted, abs=1e-5)


def test_lost_time_is_what_a_column_is_not_exposed(camera):
    """Also of columns beyond the chip; the shortest exposure is taken, leaves that end before the chip are not."""
    chip = camera.chips[29]
    columns = np.array([0.0, 17.0, 9215.0])
    fraction = exposed(chip, chip.full_window, 50.0)[columns.astype(int)]
    assert lost(chip, columns) == pytest.approx(50.0 * (1 - fraction), abs=1e-9)
    assert chip.xc < 0 and lost(chip, [-500.0])[0] > lost(chip, [0.0])[0]
    check(chip, 2.6)
    narrow = replace(chip, telescope=replace(chip.telescope, shutter_span_mm=500.0))
    with pytest.raises(InputError, match=r"telescope.yaml: shutter_span_mm: the leaves do not cover chip 29"):
        check(narrow, 150.0)
    needed = 2 * 0.01 * (abs(chip.xc) + 9216 / 2)  # mm, to half a pixel and the chip's turn
    enough = replace(chip, telescope=replace(chip.telescope, shutter_span_mm=needed + 0.1))
    check(enough, 150.0)


def test_another_shutter_before_another_detector(camera):
    """Leaves of 400 mm that take 3 s: none of it in the middle, 6 s at a bearing, also where pixels are 20 um wide."""
    telescope = replace(camera.telescope, shutter_span_mm=800.0, shutter_time=3.0)
    np.testing.assert_allclose(deficit([0.0, 400.0], telescope), [0.0, 6.0], atol=1e-4)
    assert 0.1 < deficit(200.0, telescope) < deficit(200.0, replace(telescope, shutter_span_mm=600.0)) < 5.9
    detector = replace(camera.chips[9].detector, nx=2000, ny=4000, pixel_um=20.0)
    for turn in (0.0, 30.0):
        chip = replace(camera.chips[9], detector=detector, telescope=telescope, xc=9000.0, yc=5000.0, rotation=turn)
        x = np.array([0.0, 700.0, 1999.0])
        # the mosaic's origin is FITS pixel (nx/2, ny/2), half a pixel below the middle
        column, _ = mosaic_position(chip, x, np.full(3, 1999.5))
        assert lost(chip, x) == pytest.approx(deficit((column + 0.5) * 0.020, telescope), abs=1e-9)
