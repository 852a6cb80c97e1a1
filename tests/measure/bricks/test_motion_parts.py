"""Parts of the search for sources that move, by hand: which groups are looked at, linked, straight, seen."""

import numpy as np
import pytest

from csstsim.base.sphere import unit_vectors
from csstsim.catalog.table import ObjectTable
from csstsim.measure.bricks import motion
from csstsim.measure.bricks.motion import (
    SOLAR,
    STAR,
    _Groups,
    _isolated,
    _median,
    _on_one_line,
    _wide_enough,
    _without_pieces,
)

RA, DEC, YEAR = 40.0, 60.0, 365.25


def groups_of(positions, times, source=None, **columns):
    """Return _Groups of detections at offsets (n, 2) [arcsec] and MJDs, each alone and in a frame of its own."""
    positions, n = np.array(positions, float), len(positions)
    found = {
        "pos_err": np.full(n, 0.01), "mjd": np.array(times, float), "exptime": np.full(n, 150.0), "frame": np.arange(n),
        "snr": np.full(n, 50.0), "filter": np.full(n, "r"), "zeropoint": np.full(n, 30.0),
        "flux_kron": np.full(n, 1000.0), "flux_psf": np.full(n, 500.0),
    }  # fmt: skip
    found = ObjectTable(found | {name: np.asarray(values) for name, values in columns.items()})
    vectors = unit_vectors(RA + positions[:, 0] / 3600 / np.cos(np.radians(DEC)), DEC + positions[:, 1] / 3600)
    source = np.arange(n) if source is None else np.array(source)
    return _Groups(found, vectors, source, int(source.max()) + 1)


def test_faint_detections_next_to_a_single_bright_one_are_groups_of_their_own():
    """S/N 20 with 5.9 and 3; 12 with 6; 9.9 with 4: only the first is bright enough and alone."""
    found = {"snr": np.array([20.0, 5.9, 3.0, 12.0, 6.0, 9.9, 4.0])}
    source, host = _isolated(found, np.array([0, 0, 0, 1, 1, 2, 2]))
    assert source.tolist() == [0, 3, 4, 1, 1, 2, 2] and host.tolist() == [0, 0]


def test_groups_have_the_weighted_position_and_time_and_the_best_snr():
    """Errors of 0 and sqrt(3) floors: weights 1 and 1/4."""
    error = motion.FLOOR * np.array([0.0, np.sqrt(3.0), 0.0])
    groups = groups_of([(0, 0), (0.5, 0), (9, 9)], [100.0, 110.0, 200.0], [0, 0, 1], pos_err=error, snr=[3.0, 30, 5])
    assert groups.time.tolist() == pytest.approx([102.0, 200.0]) and groups.snr.tolist() == [30, 5]
    wanted = unit_vectors(RA + 0.1 / 3600 / np.cos(np.radians(DEC)), DEC)
    assert groups.position[0] == pytest.approx(wanted, abs=1e-10) and groups.size.tolist() == [2, 1]
    assert groups.rows([1, 0]).tolist() == [2, 0, 1] and groups.rows(0).tolist() == [0, 1]


def test_pairs_are_within_a_distance_and_of_no_common_frame():
    """Numbers 2 and 66 of frames have one bit of two words, 3 and 35 two of one; of one frame, 66, are two objects."""
    n = 70
    frame = np.arange(n)
    frame[[10, 11]] = 66
    positions = np.column_stack([100.0 * np.arange(n), np.zeros(n)])
    positions[68], positions[10], positions[11] = (
        positions[2] + [0.9, 0],
        positions[20] + [0, 0.9],
        positions[20] + [0.5, 0.5],
    )
    positions[37] = positions[3] + [0.7, 0]
    groups = groups_of(positions, np.arange(n), frame=frame)
    a, b = groups.pairs(np.arange(n), 1.0)
    assert sorted(zip(a.tolist(), b.tolist(), strict=True)) == [(2, 68), (3, 37), (10, 20), (11, 20)]
    assert len(groups.pairs(np.arange(n), 0.8)[0]) == 2


def test_in_a_crowd_the_closest_pairs_are_kept(monkeypatch):
    monkeypatch.setattr(motion, "_PAIRS_MAX", 2)
    groups = groups_of([(0, 0), (0.5, 0), (3.0, 0), (3.3, 0), (0, 0.9)], np.arange(5))
    a, b = groups.pairs(np.arange(5), 1.5)
    assert sorted(zip(a.tolist(), b.tolist(), strict=True)) == [(0, 1), (2, 3)]


def test_a_median_is_of_what_is_known():
    assert _median(np.array([np.nan, 3.0, 1.0, 8.0])) == 3.0 and np.isnan(_median(np.full(2, np.nan)))
    assert np.isnan(_median(np.zeros(0)))


@pytest.mark.parametrize(("kron", "speed", "exptime", "wide"), [
    (575.0, 30.0, 150.0, True), (570.0, 30.0, 150.0, False),  # 1.15 of the PSF's flux
    (500.0, 9.5, 150.0, True), (500.0, 9.7, 150.0, False), (500.0, 9.7, 140.0, True),  # 0.4 arcsec
])  # fmt: skip
def test_a_trail_is_as_wide_as_its_speed_says(kron, speed, exptime, wide):
    groups = groups_of([(0, 0), (9, 9)], [0, 1], flux_kron=[1.0, kron], exptime=[1.0, exptime])
    assert _wide_enough(groups, np.array([1]), np.array([speed])).tolist() == [wide]


def test_the_brightest_piece_of_a_trail_stands_for_those_next_to_it():
    """Three 1 arcsec apart of flux 8, 10 and 6, one too far, one of another frame: the first and the third are two."""
    positions = [(0, 0), (1, 0), (2, 0), (0, 1.6), (0.5, 0.5)]
    groups = groups_of(positions, np.zeros(5), frame=[0, 0, 0, 0, 1], flux_kron=[8.0, 10.0, np.nan, 20.0, 30.0])
    assert _without_pieces(groups, np.arange(5)).tolist() == [1, 3, 4]
    assert [(int(a), int(b)) for a, b in groups.pieces] == [(1, 0), (1, 2)]
    chain = groups_of([(0, 0), (1, 0), (2, 0)], np.zeros(3), frame=[0, 0, 0], flux_kron=[10.0, 8.0, 6.0])
    assert _without_pieces(chain, np.arange(3)).tolist() == [0, 2]  # what is a part itself stands for none


@pytest.mark.parametrize(("which", "times", "pace", "off", "straight"), [
    (STAR, np.arange(3) * YEAR, 1.0, 0.148, True),  # two thirds of it within 5 x 0.0141 + 0.03
    (STAR, np.arange(3) * YEAR, 1.0, 0.154, False),
    (SOLAR, np.arange(3) / 240, 3.0, 0.72, True),  # 30 arcsec / hour, trails of 1.25: 5 x 0.0141 + 0.05 + 0.375
    (SOLAR, np.arange(3) / 240, 3.0, 0.77, False),
    (SOLAR, np.arange(3) * 0.24, 9.0, 0.0, True),  # half a day at most
    (SOLAR, np.arange(3) * 0.26, 9.0, 0.0, False),
])  # fmt: skip
def test_members_lie_on_a_line_within_their_errors(which, times, pace, off, straight):
    positions = [(0.6 * pace * k, 0.8 * pace * k) for k in range(3)]
    positions[1] = positions[1][0] - 0.8 * off, positions[1][1] + 0.6 * off
    assert _on_one_line(groups_of(positions, times), [0, 1, 2], which) is straight


def test_a_frame_covers_what_its_detections_surround_and_an_arcsec_more():
    corners = [(-50, -40), (50, -40), (50, 40), (-50, 40)]
    others = [(50.8, 0), (51.2, 0), (0, -40.8), (0, 41.2), (0, 0)]
    groups = groups_of(corners + others, np.zeros(9), frame=[0] * 4 + [1, 2, 3, 4, 5])
    assert [groups.covers(0, k) for k in range(4, 9)] == [True, False, True, False, True]
    assert not groups.covers(4, 0)  # of one detection: no area


def test_magnitudes_agree_in_every_common_band():
    """Half a magnitude in g and 0.4 in r; a band of one alone does not count; an unknown one does not agree."""
    flux = 1000 * 10 ** (-0.4 * np.array([0.0, 0.0, 0.4, 9.0, 0.4, 0.51]))
    source = [0, 0, 1, 1, 2, 2]
    groups = groups_of(np.zeros((6, 2)), np.zeros(6), source, filter=list("grriRg"), flux_kron=flux)
    assert groups.magnitudes_agree(0, 1) and not groups.magnitudes_agree(0, 2)
    dark = groups_of(np.zeros((2, 2)), np.zeros(2), flux_kron=[1.0, -5.0])
    assert not dark.magnitudes_agree(0, 1)


def test_star_pairs_are_no_faster_than_five_arcsec_a_year_nearest_first():
    """Five a year and the parallax of two positions; faint and undated groups are not looked at."""
    times = YEAR * np.array([0.0, 1.0, 0.5, 1.0, 1.0, np.nan])
    positions = [(0, 0), (5.0, 0), (0, 2.6), (0, -2.0), (1.0, 1.0), (0.5, 0)]
    groups = groups_of(positions, times, snr=[50, 50, 50, 10.0, 9.9, 50])
    pairs = motion._star_pairs(groups).tolist()
    apart = {(0, 1): 5.0, (0, 3): 2.0, (0, 2): 2.6, (2, 3): 4.6, (1, 3): 29**0.5, (1, 2): (25 + 2.6**2) ** 0.5}
    span = {(0, 1): 1.0, (0, 3): 1.0, (0, 2): 0.5, (2, 3): 0.5, (1, 3): 0.0, (1, 2): 0.5}
    wanted = [pair for pair in apart if apart[pair] <= 5 * span[pair] + 0.06]
    assert pairs == [list(pair) for pair in sorted(wanted, key=apart.get)] == [[0, 3], [0, 1]]


def test_solar_pairs_are_soonest_first_and_neither_slow_nor_late():
    """Single detections within 43 minutes, 0.5 to 120 arcsec an hour; not what a star already has."""
    hours = np.array([0.0, 0.51, 0.26, 0.1, 0.8, 0.003, 0.5])
    positions = [(0, 0), (10, 0), (5, 0), (0, 12.5), (20, 0), (0, 3.0), (10.2, 0)]
    free = np.ones(7, bool)
    free[6] = False
    pairs = motion._solar_pairs(groups_of(positions, hours / 24), free).tolist()
    wanted = {}
    for a in range(6):
        for b in range(a + 1, 6):
            apart, gap = np.hypot(*np.subtract(positions[a], positions[b])), abs(hours[a] - hours[b])
            if 0 < gap <= 0.72 and 0.5 <= apart / gap <= 120:
                wanted[a, b] = gap, apart
    assert [tuple(pair) for pair in pairs] == sorted(wanted, key=wanted.get)
    assert [0, 3] not in pairs and [0, 4] not in pairs and [0, 5] not in pairs and [0, 2] in pairs
    slow = groups_of([(0, 0), (0.2, 0), (0, 0.3)], np.array([0.0, 0.5, 0.5]) / 24)
    assert motion._solar_pairs(slow, np.ones(3, bool)).tolist() == [[0, 2]]
