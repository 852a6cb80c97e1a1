"""Scores of catalogues against closed forms: completeness and its chance rate, false sources, magnitudes, positions."""

from pathlib import Path

import numpy as np
import pytest
from support.csst import PIXEL

from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.measure.source_columns import SHARP

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
SIDE, STEP = 20, 100  # objects along an axis of the lattice, px between them
INFO = {"n_eff": 9.0, "rms": 8.0, "zeropoint": 31.0, "filter": "r", "window": [0, STEP * SIDE, 0, STEP * SIDE]}
STARS = "points, S/N > 30 (200)"


@pytest.fixture
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import catalogue_scores

    return catalogue_scores


def lattice(electrons=1e4):
    """Return the truth: rows of stars and of galaxies in turn."""
    x, y = (0.5 * STEP + STEP * v.ravel() for v in np.meshgrid(np.arange(SIDE), np.arange(SIDE)))
    n = x.size
    kind = np.where(np.arange(n) // SIDE % 2, GALAXY, STAR)
    zeros = np.zeros(n)
    return ObjectTable({
        "x": x, "y": y, "obj_type": kind, "electrons": np.full(n, electrons), "flags": np.zeros(n, np.int32),
        "mag_r": np.full(n, 21.0), "size_disk": 0.2 * (kind == GALAXY), "size_bulge": zeros, "bulge_frac": zeros,
    })  # fmt: skip


def judge_of(scripts, truth):
    return scripts.Judge(truth, INFO, 10_000, PIXEL)


def catalogue(x, y, flux=1e4, snr=50.0):
    return ObjectTable({"x": x, "y": y, "flux": np.full(len(x), flux), "snr": np.full(len(x), snr)})


def test_all_found_in_place_with_known_errors(scripts):
    """Light 1% too much everywhere, positions 0.3 px off in x."""
    truth = lattice()
    rows = scripts.scores(judge_of(scripts, truth), catalogue(truth["x"] + 0.3, truth["y"], 1.01e4))
    assert rows[STARS]["value"] == 100.0
    assert rows["galaxies, S/N 30 - 500 (200)"]["value"] == 100.0
    assert rows["galaxies, 19 to 23 mag (200)"]["value"] == 100.0
    for kind in ("stars", "galaxies"):
        assert rows[f"{kind}: magnitude bias"]["value"] == pytest.approx(-2.5 * np.log10(1.01), abs=1e-9)
        assert rows[f"{kind}: magnitude scatter"]["value"] == pytest.approx(0.0, abs=1e-9)
        assert rows[f"{kind}: position error [mas]"]["value"] == pytest.approx(300 * PIXEL)
    assert rows["false, claimed S/N > 5"]["value"] == 0


def test_thirds_of_galaxies_have_their_own_magnitudes(scripts):
    """Light too much in proportion to the size, or to the bulge's fraction; unfound ones shrink their own third."""
    truth = lattice()
    galaxies = np.flatnonzero(truth["obj_type"] == GALAXY)
    size, bulge = np.zeros(len(truth)), np.zeros(len(truth))
    size[galaxies] = np.repeat([0.2, 0.25, 0.3], [67, 67, 66])
    bulge[galaxies] = np.resize([0.1, 0.5, 0.9], len(galaxies))
    truth = truth.with_columns(size_disk=size, size_bulge=size, bulge_frac=bulge)
    third = "galaxies, S/N 20 - 500, {} third by {}: magnitude bias"
    for quantity, light in (("half-light radius", 1.0 + size), ("bulge", 1.0 + 0.1 * bulge)):
        found = catalogue(truth["x"], truth["y"], 1e4 * light)
        rows = scripts.scores(judge_of(scripts, truth), found.take(np.arange(len(truth)) != galaxies[-1]))
        wanted = np.unique(light[galaxies])
        for name, factor in zip(("smallest", "middle", "largest"), wanted, strict=True):
            found_here = rows[third.format(name, quantity)]["value"]
            assert found_here == pytest.approx(-2.5 * np.log10(factor), abs=1e-6), (name, quantity)
        assert rows["galaxies, S/N 8 - 13: magnitude bias"]["text"] == "-"
    snr = "galaxies, S/N 60 - 500: magnitude bias", "galaxies, S/N 60 - 500: position error [mas]"
    assert rows[snr[0]]["value"] == pytest.approx(-2.5 * np.log10(np.median(light[galaxies])), abs=1e-6)
    assert rows[snr[1]]["value"] == 0.0


def test_what_is_found_by_chance_does_not_count(scripts):
    """Half of the objects at their positions; detections 30 px to the left of all make a quarter found by chance."""
    truth = lattice()
    half = np.arange(len(truth)) % 2 == 0
    x, y = np.concatenate([truth["x"][half], truth["x"] - 30.0]), np.concatenate([truth["y"][half], truth["y"]])
    row = scripts.scores(judge_of(scripts, truth), catalogue(x, y))[STARS]
    assert row["value"] == pytest.approx(100 * (0.5 - 0.25) / (1 - 0.25))
    assert row["text"].endswith("(25.0)")


def test_false_sources_by_claimed_sn_and_place(scripts):
    """Of 40 false detections, 10 claim an S/N of 6; 3 are next to a bright star; one object is detected twice."""
    truth = lattice()
    truth["electrons"][truth["obj_type"] == STAR] = np.where(np.arange(200) == 0, 2e6, 1e4)
    away = np.flatnonzero(truth["y"] > 1000)[:37]
    beside, twice = truth["x"][0] + np.array([20.0, 22.0, 24.0]), truth["x"][50] + np.array([0.0, 1.0])
    x = np.concatenate([truth["x"][away] + 20, beside, twice])
    y = np.concatenate([truth["y"][away], np.repeat(truth["y"][0], 3), np.repeat(truth["y"][50], 2)])
    table = catalogue(x, y).with_columns(snr=np.where(np.arange(42) < 10, 6.0, np.where(np.arange(42) < 20, 4.0, 20.0)))
    rows = scripts.scores(judge_of(scripts, truth), table)
    assert rows["false, claimed S/N > 5"]["text"] == "30 of 32, 93.8%"
    assert rows["false, claimed S/N 5 - 7"]["value"] == 10
    assert rows["false, claimed S/N > 5, within 200 px of bright stars"]["value"] == 3
    assert rows["second detections of an object, claimed S/N > 5"]["value"] == 1


def test_own_catalogue_has_total_fluxes_and_no_sharp_source(scripts):
    own = {"x": np.arange(3.0), "y": np.zeros(3), "snr": np.ones(3), "flux_total": np.array([1.0, 20.0, 3.0])}
    found = scripts.own_catalogue(ObjectTable(own | {"flags": np.array([0, 0, SHARP])}))
    assert found["flux"].tolist() == [1.0, 20.0]


def test_no_detection_at_all(scripts):
    rows = scripts.scores(judge_of(scripts, lattice()), catalogue(np.zeros(0), np.zeros(0)))
    assert rows[STARS]["value"] == 0.0
    assert rows["stars: magnitude bias"]["text"] == "-"


def test_chart_of_codes(scripts, tmp_path):
    from catalogue_chart import draw

    truth = lattice()
    rows = scripts.scores(judge_of(scripts, truth), catalogue(truth["x"], truth["y"] + 0.1))
    draw(
        tmp_path / "chart.png", {code: {"cost": {"cpu": cpu}, "scores": rows} for code, cpu in (("a", 2.0), ("b", 7.0))}
    )
    assert (tmp_path / "chart.png").stat().st_size > 10_000
