"""Sources that move, merged: one row for a star with proper motion, one for an asteroid; neighbours stay apart."""

import healpy
import numpy as np
import pytest
from support.csst import BANDS
from support.measured_table import table

from csstsim.base import healpix
from csstsim.base.rng import stream
from csstsim.base.sphere import unit_vectors
from csstsim.measure.bricks.merge import merge_brick
from csstsim.measure.bricks.motion import MAG_DIFFERENCE_MAX, SOLAR, STAR, fit_motion

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
        positions = [*rest, *extra] + ([] if k in hide else [mover(t)])
        positions = np.array(positions) + error * rng.normal(size=(len(positions), 2))
        found = table(
            RA + positions[:, 0] / 3600 / np.cos(np.radians(DEC)), DEC + positions[:, 1] / 3600, obsid=str(k + 1),
            chip=8, band="gr"[k % 2], snr=snr, pos_err=error,
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
    # its position at its epoch is that of the motion
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


def test_a_position_outside_the_other_frame_joins_nothing():
    """A star that only the first frame covers and another that only the second covers are no moving star."""
    rng = stream(3, "halves")
    left, right = rng.uniform((-40, -30), (-3, 30), (30, 2)), rng.uniform((3, -30), (40, 30), (30, 2))
    left[0], right[0] = (-2.0, 0.0), (2.0, 0.0)
    tables = []
    for k, positions in enumerate((left, right)):
        found = table(
            RA + positions[:, 0] / 3600 / np.cos(np.radians(DEC)), DEC + positions[:, 1] / 3600, obsid=str(k), snr=50.0
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
        found, rest = frames([t], lambda _, position=pair[0]: np.array(position), error=0.005, extra=pair[1:], seed=4)
        tables.append(found[0].with_columns(obsid=np.full(len(found[0]), str(k))))
    sources, _ = merge_brick(PIX, tables, BANDS)
    rest -= len(pair) - 1
    assert len(sources) == rest + 2
    moving = sources["motion"] == STAR
    assert sources["n_detections"][moving].tolist() == [4]


def test_a_line_through_positions_is_numpys():
    """Weighted slopes to the east and north at declination 60, residuals, and the mean time."""
    rng = stream(6, "line")
    time, error = 61000.0 + YEAR * np.array([0.0, 0.4, 1.0, 2.5]), np.array([0.01, 0.02, 0.05, 0.01])
    east, north = 0.3 * (time - 61000.0) / YEAR, -0.7 * (time - 61000.0) / YEAR
    east, north = east + error * rng.normal(size=4), north + error * rng.normal(size=4)
    vectors = unit_vectors(200.0 + east / 3600 / np.cos(np.radians(60.0)), 60.0 + north / 3600)
    _, speed, off, when = fit_motion(vectors, error, time)
    assert when == pytest.approx(np.average(time, weights=error**-2.0), abs=1e-6)
    for k, position in enumerate((east, north)):
        slope, start = np.polyfit((time - when) / YEAR, position, 1, w=1 / error)
        assert speed[k] == pytest.approx(slope, abs=1e-4)
        assert off[:, k] == pytest.approx(position - start - slope * (time - when) / YEAR, abs=1e-4)
    still = fit_motion(vectors, error, np.full(4, 61000.0))
    assert still.speed.tolist() == [0.0, 0.0] and still.epoch == 61000.0


def rows_of_a_star(tables):
    return merge_brick(PIX, tables, BANDS)[0]


@pytest.mark.parametrize(("change", "joined"), [(0.9 * MAG_DIFFERENCE_MAX, 1), (1.1 * MAG_DIFFERENCE_MAX, 0)])
def test_groups_of_unlike_magnitudes_are_two(change, joined):
    """A position seen in the first year and another a second on in the third; both bands in both."""
    times = 61000.0 + YEAR * np.array([0.0, 0.001, 2.0, 2.001])
    tables, rest = frames(times, lambda t: np.array([1.0 * (t > 61100.0), 0.0]))
    fainter = 10 ** (-0.4 * change)
    for one in tables[2:]:
        one["flux_kron"][-1] *= fainter
    sources = rows_of_a_star(tables)
    assert len(sources) == rest + (1 if joined else 2) and sources["motion"].sum() == joined * STAR


@pytest.mark.parametrize(("speed", "joined"), [(4.8, 1), (5.3, 0)])
def test_no_star_is_faster_than_five_arcsec_a_year(speed, joined):
    times = 61000.0 + YEAR * np.array([0.0, 0.001, 1.0, 1.001])
    tables, rest = frames(times, lambda t: np.array([0.6, 0.8]) * speed * np.round((t - 61000.0) / YEAR))
    sources = rows_of_a_star(tables)
    assert (len(sources) == rest + 1) == bool(joined) and sources["motion"].sum() == joined * STAR


@pytest.mark.parametrize(("rate", "linked"), [(0.8, 1), (110.0, 1), (130.0, 0)])
def test_objects_of_the_solar_system_have_a_speed(rate, linked):
    """110 arcsec an hour for half a minute is 0.9 arcsec."""
    times = 61000.0 + np.arange(3) * (1200 if rate < 1 else 30) / 86400
    tables, rest = frames(times, lambda t: np.array([0.6, 0.8]) * rate * 24 * (t - 61000.0), wide=1.5, error=0.003,
                          exptime=20.0)  # fmt: skip
    sources = rows_of_a_star(tables)
    assert sources["motion"].sum() == linked * SOLAR and len(sources) == rest + (1 if linked else 3)


def test_pieces_of_a_trail_are_members_without_flux_or_weight():
    """Each trail is cut in two, 0.8 arcsec apart: the brighter piece stands for both."""
    times = 61000.0 + np.arange(3) * 300 / 86400
    tables, rest = frames(times, lambda t: np.array([0.6, 0.8]) * 30 * 24 * (t - 61000.0), wide=1.5)
    cut = []
    for one in tables:
        piece = one.take([len(one) - 1])
        piece = piece.with_columns(
            dec=piece["dec"] + 0.8 / 3600, number=piece["number"] + 1, flux_kron=0.5 * piece["flux_kron"],
            flux_psf=0.4 * piece["flux_psf"],
        )  # fmt: skip
        cut.append(type(one).concat([one, piece]))
    whole, sources = rows_of_a_star(tables), rows_of_a_star(cut)
    assert len(sources) == len(whole) == rest + 1
    a, b = (table.take(table["motion"] == SOLAR) for table in (whole, sources))
    assert (a["n_detections"].tolist(), b["n_detections"].tolist()) == ([3], [6])
    for name in ("ra", "dec", "epoch", "pmra", "pmdec", "flux_g", "kron_flux_r", "flux_err_g"):
        assert b[name][0] == pytest.approx(a[name][0], rel=1e-4), name


def test_a_light_with_two_followers_is_none_of_theirs():
    """Any two lie on a line: an asteroid and two trails five minutes on, each as fast, are three sources."""
    times = 61000.0 + np.arange(2) * 300 / 86400
    tables, rest = frames(times, lambda t: np.array([2.5, 0.0]) * (t > 61000.001), wide=1.5)
    assert rows_of_a_star(tables)["motion"].sum() == SOLAR
    other = tables[1].take([len(tables[1]) - 1])
    other = other.with_columns(ra=np.array([RA]), dec=np.array([DEC - 2.5 / 3600]), number=other["number"] + 1)
    both = [tables[0], type(other).concat([tables[1], other])]
    sources = rows_of_a_star(both)
    assert not sources["motion"].any() and len(sources) == rest + 3


@pytest.mark.parametrize("order", [1, -1])
def test_a_star_whose_second_position_one_frame_does_not_cover_is_two(order):
    """A frame of the left half sees a light at its edge, one of the whole field another, beyond that edge."""
    rest = stream(3, "rest").uniform((-40, -30), (40, 30), (60, 2))
    rest = rest[np.abs(rest[:, 0]) > 14]
    for covered, sources in ((-3.0, 2), (3.0, 1)):
        tables = []
        half = rest[rest[:, 0] < covered], [(covered, 25.0), (covered, -25.0), (-2.5, 0.0)]
        for k, positions in enumerate([np.vstack(half), np.vstack([rest, [(2.5, 0.0)]])][::order]):
            found = table(
                RA + positions[:, 0] / 3600 / np.cos(np.radians(DEC)),
                DEC + positions[:, 1] / 3600,
                obsid=str(k),
                snr=50.0,
            )
            n = len(found)
            tables.append(found.with_columns(mjd=np.full(n, 61000.0 + k * YEAR * 2), exptime=np.full(n, 150.0)))
        merged, _ = merge_brick(PIX, tables, BANDS)
        x = (merged["ra"] - RA) * 3600 * np.cos(np.radians(DEC))
        y = (merged["dec"] - DEC) * 3600
        lights = np.flatnonzero((np.abs(y) < 0.1) & (np.abs(x) < 2.9))
        assert len(lights) == sources and merged["motion"][lights].any() == (sources == 1)
