"""Sums of light in apertures against sep, with isophotes of other sources, off the edge and where nothing is left."""

from types import SimpleNamespace

import numpy as np
import pytest
import sep

from csstsim.base.rng import stream
from csstsim.measure.detection.maps import BIN
from csstsim.measure.light.apertures import KRON_REACH, ellipse_sums, kron_flux, kron_radius

SHAPE = 90, 121  # the last bins have a single row or column
N = 400


@pytest.fixture(scope="module")
def scene():
    """Return a noise image with a slope, isophotes at both sizes, and ellipses, some of which reach over its edge."""
    rng = stream(26, "apertures")
    image = rng.normal(20.0, 3.0, SHAPE).astype(np.float32) + np.arange(SHAPE[1], dtype=np.float32)
    rms = rng.uniform(1.0, 2.0, SHAPE).astype(np.float32)
    small = rng.integers(0, 4, [-(-n // BIN) for n in SHAPE]).astype(np.int32)
    small[20:, 20:40] = 0
    segments = np.repeat(np.repeat(small, BIN, 0), BIN, 1)[: SHAPE[0], : SHAPE[1]]
    x, y = rng.uniform(0, SHAPE[1] - 1, N), rng.uniform(0, SHAPE[0] - 1, N)
    a = 10.0 ** rng.uniform(0.0, 1.2, N)
    b, theta = a * rng.uniform(0.2, 1.0, N), rng.uniform(-np.pi / 2, np.pi / 2, N)
    return SimpleNamespace(
        image=image, rms=rms, small=small, x=x, y=y, a=a, b=b, theta=theta, number=rng.integers(0, 4, N),
        sep={"segmap": np.ascontiguousarray(segments), "mask": np.zeros(SHAPE, bool)},  # else no mean for others
    )  # fmt: skip


def of_sep(number):
    """sep's number of the own isophote: for a source without one, a number that no isophote has."""
    return np.where(number > 0, number, np.iinfo(np.int32).max).astype(np.int32)


def test_sums_are_those_of_sep(scene):
    ellipses = scene.x, scene.y, scene.a, scene.b, scene.theta
    ours = ellipse_sums(scene.image, scene.rms, scene.small, scene.number, *ellipses)
    light, error, _ = sep.sum_ellipse(
        scene.image, *ellipses, 1.0, err=scene.rms, subpix=5, seg_id=of_sep(scene.number), **scene.sep
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
