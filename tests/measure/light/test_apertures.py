"""Sums of light in apertures against sep, with isophotes of other sources, off the edge and where nothing is left."""

from types import SimpleNamespace

import numpy as np
import pytest
import sep

from csstsim.base.rng import stream
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.apertures import (
    APERTURE,
    KRON_FACTOR,
    KRON_MIN_RADIUS,
    KRON_REACH,
    aperture_flux,
    ellipse_sums,
    kron_flux,
    kron_radius,
)

SHAPE = 90, 121  # the last bins have a single row or column
N = 400


@pytest.fixture(scope="module")
def scene():
    """Return a noise image with a slope, isophotes at both sizes, and ellipses, some of which reach over its edge."""
    rng = stream(26, "apertures")
    image = rng.normal(20.0, 3.0, SHAPE).astype(np.float32) + np.arange(SHAPE[1], dtype=np.float32)
    binned = [-(-n // BIN) for n in SHAPE]
    rms = rng.uniform(1.0, 2.0, binned).astype(np.float32)
    small = rng.integers(0, 4, binned).astype(np.int32)
    small[20:, 20:40] = 0
    segments, error = (np.repeat(np.repeat(map_, BIN, 0), BIN, 1)[: SHAPE[0], : SHAPE[1]] for map_ in (small, rms))
    x, y = rng.uniform(0, SHAPE[1] - 1, N), rng.uniform(0, SHAPE[0] - 1, N)
    a = 10.0 ** rng.uniform(0.0, 1.2, N)
    b, theta = a * rng.uniform(0.2, 1.0, N), rng.uniform(-np.pi / 2, np.pi / 2, N)
    return SimpleNamespace(
        image=image, rms=rms, small=small, x=x, y=y, a=a, b=b, theta=theta, number=rng.integers(0, 4, N),
        error=np.ascontiguousarray(error),
        sep={"segmap": np.ascontiguousarray(segments), "mask": np.zeros(SHAPE, bool)},  # else no mean for others
    )  # fmt: skip


def of_sep(number):
    """sep's number of the own isophote: for a source without one, a number that no isophote has."""
    return np.where(number > 0, number, np.iinfo(np.int32).max).astype(np.int32)


def test_sums_are_those_of_sep(scene):
    ellipses = scene.x, scene.y, scene.a, scene.b, scene.theta
    ours = ellipse_sums(scene.image, scene.rms, scene.small, scene.number, *ellipses)
    light, error, _ = sep.sum_ellipse(
        scene.image, *ellipses, 1.0, err=scene.error, subpix=5, seg_id=of_sep(scene.number), **scene.sep
    )
    assert np.count_nonzero(light) > 0.8 * N  # around the others all is others'
    assert ours[:, 0] == pytest.approx(light, rel=1e-6, nan_ok=True)
    assert np.sqrt(ours[:, 1]) == pytest.approx(error, rel=1e-6, nan_ok=True)


def test_kron_radii_are_those_of_sep(scene):
    ellipses = scene.x, scene.y, scene.a, scene.b, scene.theta
    ours = kron_radius(scene.image, scene.small, scene.number, *ellipses)
    theirs, _ = sep.kron_radius(scene.image, *ellipses, KRON_REACH, seg_id=of_sep(scene.number), **scene.sep)
    assert ours == pytest.approx(np.nan_to_num(theirs), rel=1e-6)
    assert np.count_nonzero(ours) > 0.9 * N


def test_where_nothing_is_left_there_is_no_light():
    found = SimpleNamespace(
        image=np.ones((20, 20), np.float32), rms=np.ones((20, 20), np.float32), segments=np.ones((10, 10), np.int32),
        segment=np.array([2, 1, 2, 1]), x=np.array([10.0, 10.0, np.nan, -40.0]), y=np.full(4, 10.0), a=np.full(4, 2.0),
        b=np.full(4, 1.0), theta=np.zeros(4),
    )  # fmt: skip
    flux, _, failed = kron_flux(found, np.ones(4))
    assert np.isnan(flux[[0, 2]]).all() and flux[1] > 0 and flux[3] == 0
    assert failed.tolist() == [True, False, True, True]


def even(light, x, y, a, b, theta, shape=(120, 160), rms=3.0):
    """Detections on an image, without isophotes."""
    n = len(x)
    return SimpleNamespace(
        image=np.broadcast_to(np.float32(light), shape).astype(np.float32), rms=np.full(shape, rms, np.float32),
        segments=np.zeros([-(-v // BIN) for v in shape], np.int32), segment=np.zeros(n, int), x=np.array(x, float),
        y=np.array(y, float), a=np.array(a, float), b=np.array(b, float), theta=np.array(theta, float),
    )  # fmt: skip


def test_flux_in_a_circle_over_the_fraction_of_a_point():
    """50 e- a pixel in pi 4^2 px; noise of 3 e- a pixel and of the light as counted; both over the fraction."""
    found = even(50.0, [60.0, 80.3], [40.0, 70.6], [9.0, 9.0], [2.0, 2.0], [0.5, 0.5])
    counted, fraction = np.array([1.0, 0.25]), np.array([0.8, 0.5])
    flux, error = aperture_flux(found, counted, fraction)
    area = np.pi * APERTURE**2
    assert flux == pytest.approx(50 * area / fraction, rel=0.02)
    assert error == pytest.approx(np.sqrt(9 * area + 50 * area / counted) / fraction, rel=0.02)
    dark = even(-50.0, [60.0], [40.0], [9.0], [2.0], [0.5])
    flux, error = aperture_flux(dark, counted[1:], fraction[1:])
    assert flux == pytest.approx(-100 * area, rel=0.02) and error == pytest.approx(6 * np.sqrt(area), rel=0.02)


def test_kron_apertures_of_even_light():
    """The first moment of even light within 6 ellipses is 4; 2.5 of them make 10 axes, in the ellipse's direction."""
    found = even(1.0, [80.0, 80.0], [60.0, 60.0], [3.0, 3.0], [1.5, 1.5], [0.0, np.pi / 2])
    flux, error, failed = kron_flux(found, np.ones(2))
    area = np.pi * 3.0 * 1.5 * (KRON_FACTOR * 4) ** 2
    assert flux == pytest.approx(area, rel=0.02) and not failed.any()
    assert error == pytest.approx(np.sqrt(10 * area), rel=0.02)
    slope = even(1.0, [80.0, 80.0], [60.0, 60.0], [3.0, 3.0], [1.5, 1.5], [0.0, np.pi / 2])
    slope.image = slope.image * np.where(np.abs(np.arange(120) - 60) <= 15, 1, 0)[:, None].astype(np.float32)
    lying, standing = kron_flux(slope, np.ones(2))[0]
    assert lying > 1.15 * standing


def test_a_small_source_has_the_minimum_circle_and_a_hollow_one_no_more_than_six_radii():
    point = even(0.0, [80.0], [60.0], [0.5], [0.4], [0.0])
    point.image[60, 80] = 100.0
    point.image[50:71, 70:91] += 0.01
    flux, error, _ = kron_flux(point, np.ones(1))
    area = np.pi * KRON_MIN_RADIUS**2
    assert flux == pytest.approx(100 + 0.01 * area, rel=0.02) and error == pytest.approx(
        np.sqrt(9 * area + flux), rel=0.02
    )
    ring = even(0.0, [80.0], [60.0], [2.0], [2.0], [0.0])
    away = np.hypot(*np.meshgrid(np.arange(160) - 80.0, np.arange(120) - 60.0))
    ring.image[(away > 9) & (away < 12)] = 1.0
    ring.image[60, 80] = -180.0  # little light in all: its first moment is far beyond the ellipse
    ring.image[away > 31] = 5.0
    ring.image[(away > 28) & (away < 29.9)] = 2.0
    flux, _, failed = kron_flux(ring, np.ones(1))
    inside = away < KRON_FACTOR * KRON_REACH * 2.0
    assert not failed[0] and flux[0] == pytest.approx(ring.image[inside].sum(), rel=0.05)
