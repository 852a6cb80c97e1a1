"""Association: against its definition written as loops, the tolerance by hand, no chains, rivals in one frame."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from csstsim.base.rng import stream
from csstsim.base.sphere import unit_vectors
from csstsim.measure.bricks.associate import ARCSEC, CAP, FLOOR, N_SIGMA, associate


def around(x, y, dec=33.0):
    """Unit vectors of positions x, y [arcsec] around a point of the sky."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    return unit_vectors(120.0 + x / 3600.0 / np.cos(np.radians(dec)), dec + y / 3600.0)


def by_definition(vectors, error, frame):
    """The sources as sets of detections, from the module's words: every pair looked at, one decision at a time."""
    sigma = np.hypot(error, FLOOR)
    sources, left = [], list(range(len(vectors)))

    def apart(i, j):
        distance = np.linalg.norm(vectors[i] - vectors[j]) / ARCSEC
        return distance / np.hypot(sigma[i], sigma[j]) if distance <= CAP and frame[i] != frame[j] else np.inf

    while left:
        seeds = []
        for i in left:
            if all(apart(i, j) > N_SIGMA for j in seeds):
                seeds.append(i)
        groups = {seed: [seed] for seed in seeds}
        agree = [(i, j) for i in left for j in seeds if i not in groups and apart(i, j) <= N_SIGMA]
        # the density of a Gaussian of two dimensions, largest first
        pairs = sorted((apart(i, j) ** 2 / 2 + 2 * np.log(np.hypot(sigma[i], sigma[j])), i, j) for i, j in agree)
        placed = set(seeds)
        for _, i, seed in pairs:
            if i not in placed and frame[i] not in frame[groups[seed]]:
                groups[seed].append(i)
                placed.add(i)
        sources += [frozenset(group) for group in groups.values()]
        left = [i for i in left if i not in placed]
    return set(sources)


def sets(number):
    return {frozenset(np.flatnonzero(number == k).tolist()) for k in range(number.max(initial=-1) + 1)}


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 60), st.floats(0.05, 3.0), st.integers(1, 8), st.floats(0.001, 0.1))
def test_any_crowd_is_shared_out_as_defined(seed, count, side, frames, largest):
    """From all in each other's way to nearly alone; few frames and many."""
    rng = stream(seed, "crowd")
    vectors = around(*rng.uniform(0, side, (2, count)))
    error, frame = rng.uniform(0.0005, largest, count), rng.integers(0, frames, count)
    number = associate(vectors, error, frame)
    assert sets(number) == by_definition(vectors, error, frame)
    for source in sets(number):
        members = sorted(source)
        assert len(set(frame[members])) == len(members)
        distance = np.linalg.norm(vectors[members] - vectors[members, None], axis=2) / ARCSEC
        sigma = np.hypot(error[members], FLOOR)
        agree = distance <= np.minimum(CAP, N_SIGMA * np.hypot(sigma, sigma[:, None])) + 1e-9
        assert agree.all(axis=1).any()  # with the seed


@pytest.mark.parametrize(
    ("snr", "apart", "sources"),
    [
        (500, 0.08, 2),
        (500, 0.065, 1),  # the astrometry's residuals, half a year of 130 mas / yr
        (20, 0.08, 2),
        (4, 0.12, 1),
        (4, 0.15, 2),
        (1, 0.39, 1),
        (0.01, 0.41, 2),  # beyond the cap
    ],
)
def test_how_far_apart_two_detections_may_be(snr, apart, sources):
    error = np.full(2, 0.065 / snr)  # arcsec: the PSF's Gaussian width over the S/N
    for x, y in ((apart, 0), (0, apart), (-apart / 2**0.5, apart / 2**0.5)):
        vectors = around([0, x], [0, y])
        assert associate(vectors, error, np.array([1, 2])).max() + 1 == sources
        assert associate(vectors, error, np.array([1, 1])).max() + 1 == 2  # one frame has seen both
    assert associate(around([0, 0], [0, 0]), error, np.array([1, 1])).tolist() == [0, 1]


def test_no_chain_of_faint_detections_is_one_source():
    """Thirty frames, each with one detection 0.12 arcsec on: neighbours agree, the ends are 3.5 arcsec apart."""
    x = 0.12 * np.arange(30)
    number = associate(around(x, 0 * x), np.full(30, 0.016), np.arange(30))
    assert max(np.ptp(x[number == k]) for k in range(number.max() + 1)) <= 2 * CAP
    assert 10 <= number.max() + 1 <= 20


@pytest.mark.parametrize("spacing", [0.15, 0.2, 0.3])
def test_stars_side_by_side_in_every_frame_stay_apart(spacing):
    """A lattice of stars of S/N 8 to 80, in twelve frames, the faint ones' tolerance nearly as wide."""
    rng = stream(3, "lattice")
    x, y = (spacing * v.ravel() for v in np.meshgrid(np.arange(12.0), np.arange(12.0)))
    star, frame = np.tile(np.arange(144), 12), np.repeat(np.arange(12), 144)
    snr = rng.uniform(8, 80, 144)[star] * rng.uniform(0.9, 1.1, len(star))
    order = np.argsort(-snr)
    star, frame, error = star[order], frame[order], 0.065 / snr[order]
    noise = error * rng.normal(size=(2, len(star)))
    number = associate(around(x[star] + noise[0], y[star] + noise[1]), error, frame)
    assert sets(number) == {frozenset(np.flatnonzero(star == k).tolist()) for k in range(144)}


def test_a_star_that_only_some_frames_resolve():
    """One frame sees a pair as one, brightest of all: the others' fainter halves find each other."""
    x = np.array([0.0, 0.02, 0.01, 0.09, 0.1, 0.08])
    frame, error = np.array([0, 1, 2, 1, 2, 3]), np.full(6, 0.012)
    assert associate(around(x, 0 * x), error, frame).tolist() == [0, 0, 0, 1, 1, 0]
    assert associate(around(x[:5], 0 * x[:5]), error[:5], frame[:5]).tolist() == [0, 0, 0, 1, 1]


def test_nothing_one_and_all_the_same():
    none = np.zeros(0, np.int64)
    assert associate(np.zeros((0, 3)), np.zeros(0), none).tolist() == []
    for vectors in (around([0], [0]), np.array([[0.0, 0.0, 1.0]])):
        assert associate(vectors, np.ones(1), np.zeros(1, np.int64)).tolist() == [0]
    same = around(np.zeros(40), np.zeros(40))
    assert associate(same, np.full(40, 0.01), np.arange(40)).max() == 0
    assert associate(same, np.full(40, 0.01), np.zeros(40, np.int64)).tolist() == list(range(40))
    number = associate(same, np.full(40, 0.01), np.arange(40) % 10)  # four in each of ten frames: four sources
    assert sorted(np.bincount(number)) == [10] * 4
