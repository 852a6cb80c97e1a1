"""Sources that move, merged: one row for a star with proper motion, one for an asteroid; neighbours stay apart."""

import healpy
import numpy as np
import pytest
from csst import BANDS
from measured_table import table

from csstsim.base import healpix
from csstsim.base.rng import stream
from csstsim.bricks.merge import merge_brick
from csstsim.bricks.motion import SOLAR, STAR

PIX = int(healpix.brick_of(150.0, 2.0))
RA, DEC = healpy.pix2ang(healpix.NSIDE, PIX, nest=True, lonlat=True)
YEAR = 365.25


def frames(times, mover, *, exptime=150.0, snr=50.0, error=0.01, extra=(), wide=1.0, seed=1, hide=()):
    """Return measured tables at MJDs: 40 stars at rest within an arcmin, and one at offsets mover(t) [arcsec]."""
    rng = stream(seed, "field")
    rest = rng.uniform(-40.0, 40.0, (40, 2))
    rest = rest[np.hypot(*rest.T) > 8.0]
    made = []
    for k, t in enumerate(times):
        places = [*rest, *extra] + ([] if k in hide else [mover(t)])
        places = np.array(places) + error * rng.normal(size=(len(places), 2))
        found = table(
            RA + places[:, 0] / 3600 / np.cos(np.radians(DEC)), DEC + places[:, 1] / 3600, obsid=str(k + 1), chip=8,
            band="gr"[k % 2], snr=snr, pos_err=error,
        )  # fmt: skip
        light = np.ones(len(found))
        light[len(rest) + len(extra) :] = wide
        found = found.with_columns(
            mjd=np.full(len(found), t), exptime=np.full(len(found), exptime), flux_kron=found["flux_kron"] * light
        )
        made.append(found)
    return made, len(rest) + len(extra)


@pytest.mark.parametrize("speed", [(0.5, -0.2), (2.0, 3.0), (0.06, 0.0)])
def test_a_star_with_proper_motion_is_one_source(speed):
    """Six visits in three years; without the times it was many. The motion is found within four of its errors."""
    times = 61000.0 + YEAR * np.array([0.0, 0.02, 1.0, 1.5, 2.2, 3.0])
    tables, rest = frames(times, lambda t: np.array(speed) * (t - 61500.0) / YEAR)
    sources, _ = merge_brick(PIX, tables, BANDS)
    assert len(sources) == rest + 1
    moving = np.flatnonzero(sources["motion"])
    assert len(moving) == 1 and sources["motion"][moving[0]] == STAR and sources["n_detections"][moving[0]] == 6
    error = 1000 * 0.01 / np.sqrt(6) / np.std((times - times.mean()) / YEAR)  # mas / yr
    got = sources["pmra"][moving[0]], sources["pmdec"][moving[0]]
    assert np.abs(np.subtract(got, 1000 * np.array(speed))).max() < 4 * error
    # its place at its epoch is that of the motion
    at = np.array(speed) * (sources["epoch"][moving[0]] - 61500.0) / YEAR
    off = (
        (sources["ra"][moving[0]] - RA) * 3600 * np.cos(np.radians(DEC)) - at[0],
        (sources["dec"][moving[0]] - DEC) * 3600 - at[1],
    )
    assert np.hypot(*off) < 4 * 0.01
    unknown = [t.with_columns(mjd=np.full(len(t), np.nan)) for t in tables]
    if speed[0] > 0.1:
        assert len(merge_brick(PIX, unknown, BANDS)[0]) > rest + 1


def test_an_asteroid_is_one_source_of_its_own_kind():
    """Three exposures five minutes apart at 30 arcsec / hour, and a pair of them."""
    for count in (3, 2):
        times = 61000.0 + np.arange(count) * 300 / 86400
        tables, rest = frames(times, lambda t: np.array([0.6, 0.8]) * 30 * 24 * (t - 61000.0), wide=1.5)
        sources, _ = merge_brick(PIX, tables, BANDS)
        moving = np.flatnonzero(sources["motion"])
        assert len(sources) == rest + 1 and sources["motion"][moving].tolist() == [SOLAR]
        assert sources["n_detections"][moving[0]] == count
        rate = np.hypot(sources["pmra"][moving[0]], sources["pmdec"][moving[0]]) / 1000 / YEAR / 24
        assert rate == pytest.approx(30.0, abs=4 * 0.014 / (np.ptp(times) * 24))


@pytest.mark.parametrize(("gap", "rows"), [(36, 1), (42, 1), (44, 4), (72, 4), (144, 4)])
def test_an_asteroid_is_linked_over_43_minutes_at_most(gap, rows):
    """Four exposures `gap` minutes apart: links make one row of a chain of hours; longer gaps leave rows at rest."""
    times = 61000.0 + np.arange(4) * gap / 1440
    tables, rest = frames(times, lambda t: np.array([0.6, 0.8]) * 10 * 24 * (t - 61000.0), wide=1.5)
    sources, _ = merge_brick(PIX, tables, BANDS)
    moving = sources["motion"] == SOLAR
    assert len(sources) == rest + rows and moving.sum() == (rows == 1)
    if rows == 1:
        rate = np.hypot(sources["pmra"][moving][0], sources["pmdec"][moving][0]) / 1000 / YEAR / 24
        assert sources["n_detections"][moving][0] == 4
        assert rate == pytest.approx(10.0, abs=4 * 0.01 / np.sqrt(4) / (np.std(times) * 24))


def test_two_untrailed_lights_are_no_asteroid():
    times = 61000.0 + np.arange(2) * 300 / 86400
    tables, rest = frames(times, lambda t: np.array([0.6, 0.8]) * 30 * 24 * (t - 61000.0), wide=1.0)
    sources, _ = merge_brick(PIX, tables, BANDS)
    assert len(sources) == rest + 2 and not sources["motion"].any()


def test_neighbours_at_rest_stay_two():
    """Seen together in one frame of four, they are two; so are faint ones that are seen in turn by chance."""
    times = 61000.0 + YEAR * np.arange(4)
    tables, rest = frames(times, lambda t: np.array([1.0, 0.0]), extra=([(0.0, 0.0)]), hide=(1, 3))
    sources, _ = merge_brick(PIX, tables, BANDS)
    assert len(sources) == rest + 1 and not sources["motion"].any()
    tables, rest = frames(times, lambda t: np.array([2.0 * (t > 61500), 0.0]), snr=7.0)
    sources, _ = merge_brick(PIX, tables, BANDS)
    assert len(sources) == rest + 2 and not sources["motion"].any()


def test_a_place_outside_the_other_frame_joins_nothing():
    """A star that only the first frame covers and another that only the second covers are no moving star."""
    rng = stream(3, "halves")
    left, right = rng.uniform((-40, -30), (-3, 30), (30, 2)), rng.uniform((3, -30), (40, 30), (30, 2))
    left[0], right[0] = (-2.0, 0.0), (2.0, 0.0)
    tables = []
    for k, places in enumerate((left, right)):
        found = table(
            RA + places[:, 0] / 3600 / np.cos(np.radians(DEC)), DEC + places[:, 1] / 3600, obsid=str(k), snr=50.0
        )
        tables.append(found.with_columns(mjd=np.full(30, 61000.0 + k * YEAR * 2), exptime=np.full(30, 150.0)))
    sources, _ = merge_brick(PIX, tables, BANDS)
    assert len(sources) == 60 and not sources["motion"].any()


def test_two_lights_of_a_frame_are_never_one_star():
    """A close pair in the first year, one of them seen a year later: the star moved, its neighbour did not join it."""
    times = 61000.0 + YEAR * np.array([0.0, 0.01, 1.0, 1.01])
    tables = []
    for k, t in enumerate(times):
        pair = ((0.0, 0.0), (0.05, 0.0)) if k < 2 else ((1.0, 0.0),)
        found, rest = frames([t], lambda _, place=pair[0]: np.array(place), error=0.005, extra=pair[1:], seed=4)
        tables.append(found[0].with_columns(obsid=np.full(len(found[0]), str(k))))
    sources, _ = merge_brick(PIX, tables, BANDS)
    rest -= len(pair) - 1
    assert len(sources) == rest + 2
    moving = sources["motion"] == STAR
    assert sources["n_detections"][moving].tolist() == [4]
