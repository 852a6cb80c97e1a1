"""Each source belongs to one brick, with all detections: at borders, corners, RA 0 and the poles."""

import healpy
import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support.csst import BANDS
from support.measured_table import ARCSEC, table

from csstsim.base import healpix, sphere
from csstsim.base.rng import stream
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks.merge import merge_brick

N_BRICKS = 12 * 256**2
POLE, SOUTH, WRAP = (int(healpix.brick_of(*position)) for position in ((45.0, 90.0), (10.0, -90.0), (0.0, 0.0)))
EIGHT_NEIGHBOURS, SEVEN = 123456, 65535  # SEVEN: at a corner where only three bricks meet
FRAMES, SCATTER, ERROR = 5, 0.02, 0.025  # arcsec on an axis; the error as measured


def border_sources(pix, rng):
    """Places (n, 3) on the border of a brick and its four corners, none closer than 1 arcsec to another."""
    sides = sphere.unit_vectors(*healpix.brick_corners(pix, step=40))  # 20 arcsec apart
    on = np.r_[np.arange(0, 160, 40), rng.choice(160, 12)]
    offset = np.radians(0.05 * ARCSEC) * rng.normal(size=(len(on), 3))
    return (sides[on] + offset)[np.unique(on, return_index=True)[1]]


def detections(sky, rng):
    """FRAMES tables of the sources, every detection scattered; half of the frames see only some."""
    tables = []
    for k in range(FRAMES):
        seen = np.flatnonzero(rng.uniform(size=len(sky)) < (1.0 if k < 2 else 0.7))
        moved = sky[seen] + np.radians(SCATTER * ARCSEC) * rng.normal(size=(len(seen), 3))
        snr = rng.uniform(5, 9, len(seen))
        found = table(*sphere.ra_dec(moved), obsid=str(k), band="ugriz"[k], snr=snr, pos_err=ERROR)
        tables.append(found.with_columns(number=seen.astype(np.int32)))  # which source it truly is
    return tables


def merged_everywhere(tables):
    """{brick: (sources, detections)} of every brick that a detection is in or next to."""
    near = np.unique(np.concatenate([healpix.brick_of(frame["ra"], frame["dec"]) for frame in tables]))
    around = np.unique(np.concatenate([near, *(healpy.get_all_neighbours(256, int(p), nest=True) for p in near)]))
    return {int(pix): merge_brick(int(pix), tables, BANDS) for pix in around[around >= 0]}


@settings(max_examples=12, deadline=None)
@given(st.integers(0, N_BRICKS - 1), st.integers(0, 10**6))
@example(POLE, 1)
@example(SOUTH, 2)
@example(WRAP, 3)
@example(EIGHT_NEIGHBOURS, 4)
@example(SEVEN, 5)
def test_a_source_on_the_border_is_in_one_brick_with_all_its_detections(pix, seed):
    rng = stream(seed, "border")
    sky = border_sources(pix, rng)
    tables = detections(sky, rng)
    seen = np.bincount(np.concatenate([frame["number"] for frame in tables]), minlength=len(sky))
    owners = np.zeros(len(sky), int)
    for brick, (sources, found) in merged_everywhere(tables).items():
        assert (healpix.brick_of(sources["ra"], sources["dec"]) == brick).all()
        for row in range(len(sources)):
            (source,) = set(found["number"][found["source"] == row])  # of one true source
            assert sources["n_detections"][row] == seen[source] == (found["source"] == row).sum()
            owners[source] += 1
            position = sphere.unit_vectors(sources["ra"][row], sources["dec"][row])
            off = np.degrees(np.linalg.norm(position - sky[source] / np.linalg.norm(sky[source]))) / ARCSEC
            assert off < 6 * SCATTER  # 6 sigma of one detection; two are the minimum
    assert (owners == 1).all()


@settings(max_examples=8, deadline=None)
@given(st.sampled_from([POLE, SOUTH, WRAP, EIGHT_NEIGHBOURS, SEVEN]), st.integers(0, 10**6), st.floats(0.5, 6.0))
def test_a_crowd_over_a_corner_is_shared_out_the_same_by_all_bricks(pix, seed, side):
    """Up to 300 detections on top of each other: each in one source of one brick; input in another order: the same."""
    rng = stream(seed, "corner")
    corner = sphere.unit_vectors(*healpix.brick_corners(pix))[rng.integers(4)]
    tables = []
    for k in range(6):
        positions = corner + np.radians(side / 2 * ARCSEC) * rng.uniform(-1, 1, (50, 3))
        snr = np.round(rng.uniform(5, 9, 50))  # many are equal
        tables.append(table(*sphere.ra_dec(positions), obsid=str(k), snr=snr, pos_err=0.02))
    merged = merged_everywhere(tables)
    keys = [(o, n) for _, found in merged.values() for o, n in zip(found["obsid"], found["number"], strict=True)]
    assert len(keys) == len(set(keys)) == 300
    shuffled = [tables[k].take(rng.permutation(50)) for k in rng.permutation(6)]
    for brick, (sources, found) in merged.items():
        again = merge_brick(brick, shuffled, BANDS)
        assert again[0] == sources and again[1] == found  # bit by bit
        one = merge_brick(brick, [ObjectTable.concat(tables)], BANDS)  # however the rows are dealt out into tables
        assert one[0] == sources and one[1] == found
        fate = sources.meta["detections"]
        assert fate["near"] == fate["merged"] + fate["elsewhere"] and fate["merged"] == len(found)
