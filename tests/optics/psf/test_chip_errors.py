"""A chip's errors of the wavefront: geometry of a defocus, statistics of the draws, frames."""

from dataclasses import replace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.optics.psf.chip_errors import (
    chip_coefficients,
    chip_position,
    detector_defocus,
    filter_figure,
    mosaic_position,
)
from csstsim.optics.psf.wavefront import load_wavefront


def chips(camera, count):
    """As many chips with draws of their own."""
    return [replace(camera.chips[8], id=i) for i in range(count)]


def test_defocus_is_the_difference_of_two_spheres(camera):
    """A detector dz behind the focus: path from the pupil to there against the path to the focus, on Noll's Z4."""
    focal, dz = 28.0, 1e-4  # m
    r = np.sqrt((np.arange(4000) + 0.5) / 4000)  # equal areas of a pupil of 1 m radius
    path = np.hypot(focal + dz, r) - np.hypot(focal, r)
    z4 = np.sqrt(3) * (2 * r**2 - 1)
    expected = abs(np.mean(path * z4)) * 1e9  # nm
    params = {"detector": {"height": dz * 1e6, "tilt": 0.0}}
    rows = np.array([detector_defocus(params, chip) for chip in chips(camera, 2000)])
    assert not rows[:, 1:].any()
    # 2000 normal draws: 5 sigma of their rms is 8%
    assert np.sqrt(np.mean(rows[:, 0] ** 2)) == pytest.approx(expected, rel=0.08)


def test_filter_figure_has_the_rms_asked_over_chip_and_pupil(camera):
    params = {"filter_figure": {"rms": {"g": 6.0}, "noll": [4, 5, 7, 11]}}
    tables = [filter_figure(params, chip) for chip in chips(camera, 500)]
    assert set(tables[0]) == {4, 5, 7, 11}
    side = np.linspace(-1, 1, 41)
    position = np.stack([np.ones((41, 41)), *np.meshgrid(side, side)])
    squares = [
        sum(np.mean(np.tensordot(row, position, axes=1) ** 2) for row in table.values()) for table in tables
    ]  # Zernikes of unit rms are orthogonal
    # 500 chips of 12 draws: 5 sigma is under 8%; the grid's own mean of X^2 is 1.05/3
    assert np.sqrt(np.mean(squares)) == pytest.approx(6.0, rel=0.08)


def test_every_chip_differs_and_stays_the_same(camera):
    wavefront, params = load_wavefront(camera.psf), camera.psf
    own = [
        chip_coefficients(wavefront, params, chip, 4607.5, 4615.5) - wavefront.coefficients(chip.xc, chip.yc)
        for chip in camera.chips.values()
    ]
    assert len({tuple(row) for row in np.round(own, 6)}) == 30
    again = chip_coefficients(wavefront, params, camera.chips[8], 4607.5, 4615.5)
    assert np.array_equal(again, chip_coefficients(wavefront, params, camera.chips[8], 4607.5, 4615.5))
    # 5 to 6 nm of the filter, 2.8 nm of defocus at the middle of a chip
    assert 2.0 < np.sqrt(np.mean(np.sum(np.square(own), axis=1))) < 9.0


def test_own_terms_are_linear_over_the_chip(camera):
    chip, wavefront = camera.chips[8], load_wavefront(camera.psf)
    x, y = np.array([-0.5, 4607.5, 9215.5]), np.full(3, 7000.0)
    total = chip_coefficients(wavefront, camera.psf, chip, x, y)
    own = total - wavefront.coefficients(*mosaic_position(chip, x, y))
    assert own[0] + own[2] == pytest.approx(2 * own[1], abs=1e-9)
    assert np.abs(own[2] - own[0]).max() > 0.1  # nm
    expected = 2 * (detector_defocus(camera.psf, chip) + filter_figure(camera.psf, chip)[4])[1]
    assert (own[2] - own[0])[wavefront.noll.index(4)] == pytest.approx(expected, abs=1e-9)
    assert chip_coefficients(wavefront, camera.psf, chip, np.zeros((2, 0)), np.zeros((2, 0))).shape == (2, 0, 12)


@pytest.mark.parametrize("of_width, of_height", [(0.0, 0.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 1.0)])
def test_own_terms_are_the_height_in_the_middle_and_the_tilts_at_the_edges(camera, of_width, of_height):
    """X and Y run from -1 to 1 between the edges of pixels of a chip that is not square."""
    detector = replace(camera.chips[8].detector, nx=2048, ny=4096)
    chip, wavefront = replace(camera.chips[8], detector=detector), load_wavefront(camera.psf)
    x, y = 1023.5 + 1024 * of_width, 2047.5 + 2048 * of_height
    own = chip_coefficients(wavefront, camera.psf, chip, x, y) - wavefront.coefficients(*mosaic_position(chip, x, y))
    rows = filter_figure(camera.psf, chip)
    rows[4] = rows[4] + detector_defocus(camera.psf, chip)
    for noll, row in rows.items():
        expected = row @ [1.0, of_width, of_height]
        assert own[wavefront.noll.index(noll)] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("rotation", [0.0, 1.0, -1.0, 90.0])
def test_chip_and_mosaic_frames_are_inverse(camera, rotation):
    chip = replace(camera.chips[3], rotation=rotation)
    x, y = np.array([0.0, 9215.0, -400.0]), np.array([9231.0, 10.0, 50.0])
    assert chip_position(chip, *mosaic_position(chip, x, y)) == pytest.approx(np.stack([x, y]), abs=1e-9)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"detector": {"height": -1.0, "tilt": 0.0}}, r"detector\.height: must be a number"),
        ({"detector": {}}, r"detector\.height: must be a number"),
        ({"filter_figure": {"rms": {}, "noll": [5]}}, r"filter_figure\.rms\.g: must be a number"),
        ({"filter_figure": {"rms": {"g": 5.0}, "noll": [3]}}, r"filter_figure\.noll: bad list"),
        ({"filter_figure": None}, r"filter_figure\.noll: bad list"),
    ],
)
def test_impossible_numbers_are_refused(camera, change, key):
    with pytest.raises(InputError, match=rf"psf\.yaml: {key}"):
        chip_coefficients(load_wavefront(camera.psf | change), camera.psf | change, camera.chips[8], 0.0, 0.0)


def test_defocus_goes_with_the_square_of_the_focal_ratio(camera):
    chip = camera.chips[8]
    fast = replace(chip, telescope=replace(chip.telescope, focal_length_m=chip.telescope.focal_length_m / 2))
    large = replace(chip, telescope=replace(chip.telescope, diameter_m=2 * chip.telescope.diameter_m))
    for other in (fast, large):
        assert detector_defocus(camera.psf, other) == pytest.approx(4 * detector_defocus(camera.psf, chip))
