"""Counted electrons kept as a list of pixels are those of a whole plane, however they are added."""

import numpy as np
import pytest

from csstsim.base.rng import Streams, stream
from csstsim.detector.noise import MEAN_MAX, add_poisson
from csstsim.detector.sparse_plane import SparsePlane

SHAPE = 40, 70


def drawn(name, fraction):
    """A plane with electrons in a fraction of its pixels, and its SparsePlane."""
    rng = stream(1, name)
    plane = np.where(rng.random(SHAPE) < fraction, rng.integers(1, 2**20, SHAPE), 0).astype(np.int32)
    at = np.flatnonzero(plane)
    return plane, SparsePlane(SHAPE, at.astype(np.int32), plane.reshape(-1)[at])


@pytest.mark.parametrize("fractions", [(0.1, 0.1), (0.0, 0.2), (0.2, 0.0), (1.0, 0.3), (0.3, 1.0), (0.0, 0.0)])
def test_sums_are_those_of_planes(fractions):
    (one, few), (other, more) = (drawn(name, fraction) for name, fraction in zip("ab", fractions, strict=True))
    before = few.electrons.copy()
    both = few.plus(more.pixel, more.electrons)
    assert np.array_equal(both.dense(), one + other) and both.dense().dtype == np.int32
    assert (np.diff(both.pixel) > 0).all() and both.pixel.dtype == both.electrons.dtype == np.int32
    assert np.array_equal(few.electrons, before)


@pytest.mark.parametrize("bright", [0.0, 3 * MEAN_MAX])
def test_poisson_adds_the_list_as_the_plane(bright):
    """Also where electrons do not fit a float32 exactly, and in pixels too bright for 32-bit integers."""
    key = Streams(1, "1", 1, "noise").exposure_key("frame")
    plane, few = drawn("a", 0.2)
    expected = stream(1, "light").uniform(0, 3e7, SHAPE).astype(np.float32)
    expected[3, 5] = expected[39, 69] = bright
    images = [expected.copy(), expected.copy(), expected.copy()]
    for image, counted in zip(images, (plane, few, None), strict=True):
        add_poisson(image, key, dark=2.0, counted=counted)
    assert np.array_equal(images[0], images[1]) and not np.array_equal(images[0], images[2])
