"""Evaluation of merged bricks against closed forms: objects found, colours, stars separated from galaxies."""

from pathlib import Path

import numpy as np
import pytest

from csstsim.catalog.table import GALAXY, STAR, ObjectTable

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
N = 40  # stars, and galaxies


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import merged_completeness

    return merged_completeness


def true_objects(script, snr=20.0):
    """Return N stars and N galaxies, 22 mag in r; each band 0.3 mag brighter than the one before; no u frame."""
    mags = {f"mag_{band}": np.full(2 * N, 22.6 - 0.3 * k) for k, band in enumerate(script.BANDS)}
    snr = {f"snr_{band}": np.full(2 * N, np.nan if band == "u" else snr) for band in script.BANDS}
    snr |= {f"visits_{band}": np.full(2 * N, 0 if band == "u" else 2) for band in script.BANDS}
    kind = np.repeat([STAR, GALAXY], N)
    return ObjectTable({"obj_type": kind, "blended": np.zeros(2 * N, bool), **mags, **snr})


def merged(script, truth, red=0.0, **columns):
    """Return sources like the truth, their g - r too large by `red`."""
    mags = {f"kron_mag_{band}": truth[f"mag_{band}"] - 0.1 for band in script.BANDS}
    mags["kron_mag_g"] = mags["kron_mag_g"] + red
    return ObjectTable({"star": np.where(truth["obj_type"] == STAR, 0.9, 0.1), **mags, **columns})


def test_fraction_found_and_goals(script, capsys):
    """A galaxy in twenty lost is a goal missed; a faint star lost does not count."""
    truth = true_objects(script)
    truth["snr_g"][:2] = truth["snr_r"][:2] = truth["snr_i"][:2] = 9.0
    match = np.arange(2 * N)
    match[[0, N, N + 1]] = -1
    rows = {name: (fraction, n, goal) for name, fraction, n, goal in script.completeness(truth, match)}
    assert rows["galaxies found, S/N > 10"] == (95.0, N, 97.0)
    assert rows["stars found, S/N > 10"] == (100.0, N - 2, 99.0)
    assert rows["stars found, S/N 10 - 15"] == (None, 0, None)
    assert rows["stars found, joint S/N of all frames 15 - 30"] == (50.0, 2, None)  # 9 x sqrt(6)


def test_colours_of_galaxies_alone(script):
    """Stars, and bands without a frame, do not count; magnitudes meant for colours come before Kron's."""
    truth = true_objects(script)
    red = np.where(truth["obj_type"] == GALAXY, 0.07, 5.0)
    rows = script.colours(truth, merged(script, truth, red), np.arange(2 * N))
    assert [row[2] for row in rows] == [0, N, N]
    assert rows[1][1]["median"] == pytest.approx(0.07)
    assert rows[2][1]["median"] == pytest.approx(0.0, abs=1e-9)
    better = {f"total_mag_{band}": truth[f"mag_{band}"] for band in script.BANDS}
    rows = script.colours(truth, merged(script, truth, red, **better), np.arange(2 * N))
    assert rows[1][1]["median"] == pytest.approx(0.0, abs=1e-9)


def test_stars_told_from_galaxies(script):
    """Ten stars taken for galaxies and six galaxies for stars, all of 22 mag in r."""
    truth = true_objects(script)
    sources = merged(script, truth)
    sources["star"][:10], sources["star"][N : N + 6] = 0.0, 1.0
    rows = {name: values for name, *values in script.kinds(truth, sources, np.arange(2 * N))}
    assert rows["21 - 22"] == [pytest.approx(0.75), N, pytest.approx(30 / 36), 36]


def test_bricks_are_joined(script):
    """Rows of the second brick's sources follow those of the first."""
    truth = true_objects(script)
    sources = merged(script, truth)
    bricks = [
        (truth, sources, np.arange(2 * N), np.ones(2 * N, bool)),
        (truth, sources, np.full(2 * N, -1), np.zeros(2 * N, bool)),
    ]
    bricks[1][2][3] = 5
    every, found, match, real = script.joined(bricks)
    assert (len(every), len(found), real.sum()) == (4 * N, 4 * N, 2 * N)
    assert match[2 * N + 3] == 2 * N + 5
    assert (match[2 * N :] >= 0).sum() == 1
