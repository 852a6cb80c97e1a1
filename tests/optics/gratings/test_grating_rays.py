"""Trajectories behind a grating, against rays traced from point to point with vectors."""

import numpy as np
import pytest
from grating_rays import trajectories

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data

PUPIL = 19500.0  # mm


@pytest.fixture(scope="module")
def numbers():
    return read_data(SHIPPED / "instrument" / "gratings.yaml")


def traced(m, n, wave, order, sign, chip, band, numbers):
    """Return x, y [px] of one ray: from the pupil's middle through the grating plane, diffracted, to the detector.

    The wave vector's part along the grating changes by k times the grating's, its length does not.
    """
    size = chip.detector.pixel_um / 1e3  # mm
    middle = np.array([(chip.detector.nx - 1) / 2, (chip.detector.ny - 1) / 2])
    pupil, gap = np.array([0.0, 0.0, -PUPIL]), numbers["distance"]
    undispersed = np.append((np.array([m, n]) - middle) * size, 0.0)
    along = (undispersed - pupil) / np.linalg.norm(undispersed - pupil)
    hit = pupil + along * (PUPIL - gap) / along[2]
    period = numbers["dispersion"][band] * gap / size * 1e-7  # mm: grating equation at normal incidence, small angles
    vector = 2 * np.pi / (wave * 1e-7) * along
    vector[0] += order * sign * 2 * np.pi / period
    vector[2] = np.sqrt((2 * np.pi / (wave * 1e-7)) ** 2 - vector[0] ** 2 - vector[1] ** 2)
    return middle + (hit + vector * gap / vector[2])[:2] / size


@pytest.mark.parametrize("number, sign", [(3, 1), (2, -1), (1, 1)], ids=["GU", "GV", "GI"])
def test_against_vectors(camera, numbers, number, sign):
    """All orders at all of 4 x 4 positions and 3 wavelengths, to 1e-6 px; the wedge's shift is taken off."""
    chip = camera.chips[number]
    rays = trajectories(chip, (-600, 9800, -1600, 9700), sign, camera.filters[chip.filter], numbers, PUPIL, 4, 3)
    assert sorted(rays) == [-2, -1, 0, 1, 2]
    offset_x, offset_y = numbers["offset"]
    waves = rays[1][:, 2]
    across = (waves - np.unique(waves).mean()) / np.ptp(waves)
    for order, rows in rays.items():
        assert rows.shape == (4 * 4 * 3, 5)
        for (m, n, wave, x, y), where in zip(rows, across, strict=True):
            far_x, far_y = traced(m, n, wave, order, sign, chip, chip.filter, numbers)
            assert x == pytest.approx(far_x + sign * (offset_x + numbers["spread"] * where), abs=1e-6)
            assert y == pytest.approx(far_y + offset_y, abs=1e-6)


def test_zeroth_order_is_the_image_moved(camera, numbers):
    """By the wedge, the same at all places: 8 px, 2 px, and 1 px along the band."""
    rows = trajectories(camera.chips[1], (0, 9215, 0, 9231), -1, camera.filters["GI"], numbers, PUPIL)[0]
    dx, dy = (rows[:, 3:] - rows[:, :2]).T
    assert (dx.min(), dx.max()) == pytest.approx((-8.5, -7.5), abs=1e-9)
    assert np.allclose(dy, 2.0, rtol=0, atol=1e-9)
    assert dx[np.argmin(rows[:, 2])] == pytest.approx(-7.5)  # blue is nearer, as in the first order


def test_dispersion_in_the_middle_of_a_chip(camera, numbers):
    """Angstrom per pixel as gratings.yaml states, to 0.6%: of it 0.2-0.3% the wedge, 0.3% the cube of the angle."""
    for number, expected in ((3, 5.2), (2, 7.1), (1, 8.5)):
        chip = camera.chips[number]
        rays = trajectories(chip, (0, 9215, 0, 9231), 1, camera.filters[chip.filter], numbers, PUPIL, 3)
        middle = (rays[1][:, 0] == 4607.5) & (rays[1][:, 1] == 4615.5)
        wave, x = rays[1][middle][:, 2:4].T
        assert np.polyfit(x, wave, 1)[0] == pytest.approx(expected, rel=0.006)
        mirrored = rays[-1][middle][:, 3] - rays[0][middle][:, 3]
        assert mirrored == pytest.approx(-(x - rays[0][middle][:, 3]), abs=1e-6)  # px
