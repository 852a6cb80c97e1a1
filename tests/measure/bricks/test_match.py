"""One-to-one matching against its definition written as loops, and where truth and measurement are matched."""

import time
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.csst import PIXEL

from csstsim.base.rng import stream
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.match import one_to_one
from csstsim.measure.bricks.validation import compare
from csstsim.measure.bricks.validation.trials import matched

PIXEL_DEG = 0.074 / 3600.0


def by_definition(positions, others, reach):
    """The closest free pair, again and again, every pair looked at."""
    row, left = np.full(len(positions), -1), set(range(len(others)))
    pairs = sorted((np.linalg.norm(p - q), i, j) for i, p in enumerate(positions) for j, q in enumerate(others))
    for distance, i, j in pairs:
        if row[i] < 0 and j in left and distance <= reach[i]:
            row[i] = j
            left.remove(j)
    return row


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 40), st.integers(0, 40), st.floats(0.1, 20.0), st.booleans())
def test_any_crowd_is_matched_as_defined(seed, n, m, side, lattice):
    """From all in each other's reach to nearly alone; on a lattice, where many distances are the same."""
    rng = stream(seed, "match")
    positions, others = (rng.uniform(0, side, (k, 2)) for k in (n, m))
    if lattice:
        positions, others = np.rint(positions), np.rint(others)
    reach = rng.uniform(0.0, 3.0, n)
    row = one_to_one(positions, others, reach)
    assert row.tolist() == by_definition(positions, others, reach).tolist()
    assert np.unique(row[row >= 0]).size == (row >= 0).sum()


def test_the_sky_is_matched_as_the_plane_is():
    rng = stream(3, "sky")
    ra, dec = 359.999 + rng.uniform(0, 0.002, 300), 60.0 + rng.uniform(0, 0.001, 300)
    truth = {"ra_epoch": ra % 360, "dec_epoch": dec, "half_light": np.zeros(300)}
    shift = 0.05 / 3600 * rng.normal(size=(2, 300))
    sources = {"ra": (ra + shift[0] / 0.5) % 360, "dec": dec + shift[1]}
    row = compare.match(ObjectTable(truth), ObjectTable(sources))
    plane = [np.stack([(a - 360) * np.cos(np.radians(60.0)), d], axis=1) * 3600
             for a, d in ((ra, dec), (ra + shift[0] / 0.5, sources["dec"]))]  # fmt: skip
    assert row.tolist() == by_definition(*plane, np.full(300, compare.MATCH_ARCSEC)).tolist()
    assert (row >= 0).mean() > 0.9


def both(x, y):
    """A table with positions on a frame and on the sky, of truth and of measurement alike."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    ra, dec = 10.0 + x * PIXEL_DEG, y * PIXEL_DEG
    n = len(x)
    return ObjectTable({
        "x": x, "y": y, "ra": ra, "dec": dec, "ra_epoch": ra, "dec_epoch": dec, "half_light": np.zeros(n),
        "obj_type": np.zeros(n, int), "snr": np.full(n, 9.0),
    }, {"window": [0, 1000, 0, 1000]})  # fmt: skip


@pytest.mark.parametrize("match", [partial(matched, pixel=PIXEL), compare.match])
def test_one_detection_is_one_object(match):
    """Two objects 1.5 px apart and one detection between them: the nearer has it, in either order of rows."""
    assert match(both([100.0, 101.5], [100, 100]), both([101.0], [100])).tolist() == [-1, 0]
    assert match(both([101.5, 100.0], [100, 100]), both([101.0], [100])).tolist() == [0, -1]
    assert match(both([100.0, 101.5], [100, 100]), both([101.0, 102.9], [100, 100])).tolist() == [-1, 0]
    assert match(both([], []), both([1.0], [1])).tolist() == []
    assert match(both([1.0], [1]), both([], [])).tolist() == [-1]


def test_of_two_at_the_same_position_the_brighter_has_the_source():
    """A quasar in its host, in either order of rows and in any band."""
    for mags in ([24.0, 20.0], [20.0, 24.0]):
        truth = both([100.0, 100.0], [100, 100]).with_columns(mag_g=np.full(2, np.nan), mag_r=np.array(mags))
        assert compare.match(truth, both([100.3], [100])).tolist() == [0 if m == 20.0 else -1 for m in mags]


def test_an_object_broken_in_two_is_one_real_source():
    truth, broken = both([100.0], [100]), both([99.5, 101.0], [100, 100])
    assert compare.matched_sources(truth, broken).tolist() == [0]


def test_a_benchmarks_detections_are_real_one_by_one(monkeypatch):
    monkeypatch.syspath_prepend("benchmarks")
    from source_extractor_compare import detections

    from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame

    found = both([99.5, 101.0, 300.0, 200.0], [100, 100, 300, 200]).with_columns(flags=np.array([0, 0, 0, 64]))
    snr, real = detections(MeasuredFrame(both([100.0], [100]), found, 500, PIXEL))
    assert real.tolist() == [True, False, False] and len(snr) == 3  # the last is sharp


def test_a_hundred_thousand_take_seconds():
    rng = stream(5, "many")
    positions = rng.uniform(0, 9000, (100_000, 2))
    others = positions + rng.normal(size=positions.shape)
    one_to_one(positions[:9], others[:9], np.full(9, 2.5))
    start = time.process_time()
    row = one_to_one(positions, others, np.full(len(positions), 2.5))
    assert time.process_time() - start < 10.0  # 0.8 s on an idle machine; all pairs would take hours
    assert (row == np.arange(len(row))).mean() > 0.85
