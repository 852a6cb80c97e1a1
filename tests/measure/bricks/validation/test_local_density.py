"""Completeness and purity by local density: a clump whose members are half lost, in a sparse field that is whole."""

import numpy as np
import pytest

from csstsim.catalog.table import STAR, ObjectTable
from csstsim.measure.bricks.validation.density import EDGES, by_density

INFO = {"zeropoint": 30.0, "n_eff": 10.0, "rms": 10.0}  # S/N 20 at mag 22.8
CLUMP, FIELD = 30, 100  # stars within 6 arcsec; on a lattice of 60 arcsec
ARCSEC = 1 / 3600.0


def scene(dec, faint=0):
    """Return (truth, sources, match, real): every second star of the clump has a source; `faint` ones are unseen."""
    rng = np.random.default_rng(5)
    angle, radius = 2 * np.pi * rng.random(CLUMP), 6 * np.sqrt(rng.random(CLUMP))
    x = np.concatenate([radius * np.cos(angle), 300 + 60.0 * (np.arange(FIELD) % 10), 10 * rng.random(faint)])
    y = np.concatenate([radius * np.sin(angle), 60.0 * (np.arange(FIELD) // 10), 10 * rng.random(faint)])
    n, ra = len(x), (359.95 + x * ARCSEC / np.cos(np.radians(dec))) % 360.0
    mag = np.concatenate([np.full(CLUMP + FIELD, 20.0), np.full(faint, 29.0)])
    truth = ObjectTable({
        "id": np.arange(n), "obj_type": np.full(n, STAR), "ra_epoch": ra, "dec_epoch": dec + y * ARCSEC, "mag_r": mag,
        "half_light_px": np.zeros(n),
    })  # fmt: skip
    has = np.concatenate([np.arange(CLUMP) % 2 == 0, np.ones(FIELD, bool), np.zeros(faint, bool)])
    match = np.where(has, np.cumsum(has) - 1, -1)
    false = np.array([3, 4])  # two false sources, 3 arcsec from the clump's centre
    sources = {
        "ra": np.append(ra[has], (359.95 + np.array([3.0, -3.0]) * ARCSEC / np.cos(np.radians(dec))) % 360.0),
        "dec": np.append(truth["dec_epoch"][has], [dec, dec]),
    }  # fmt: skip
    return truth, sources, match, np.append(np.ones(has.sum(), bool), np.zeros(len(false), bool))


@pytest.mark.parametrize("dec", [0.0, -80.0])
@pytest.mark.parametrize("faint", [0, 50])
def test_a_clump_loses_half_and_the_field_nothing(dec, faint):
    got = by_density(*scene(dec, faint), {"r": [INFO]})
    dense = np.digitize((CLUMP - 1) / (np.pi * 0.25**2), EDGES[1:-1])
    assert got["objects"][0] == got["found"][0] == got["sources"][0] == got["real"][0] == FIELD
    assert sum(got["objects"]) == CLUMP + FIELD  # objects too faint for a single exposure are not asked for
    assert got["objects"][dense] > 0.7 * CLUMP and sum(got["found"][1:]) == CLUMP / 2
    assert sum(got["sources"][1:]) == CLUMP / 2 + 2 and sum(got["real"][1:]) == CLUMP / 2


def test_of_nothing_there_is_nothing():
    truth, sources, match, real = scene(0.0)
    none = np.zeros(0, int)
    for some in ((truth.take(none), sources, match[none], real), (truth, {"ra": [], "dec": []}, match, real[none])):
        got = by_density(*some, {"r": [INFO]})
        assert all(len(got[name]) == len(EDGES) - 1 for name in got)
    assert sum(by_density(truth, sources, match, real, {})["objects"]) == 0


@pytest.mark.parametrize(("stars", "place"), [(4, 0), (5, 1)])
def test_an_object_is_no_neighbour_of_its_own(stars, place):
    """Three neighbours within 15 arcsec are 15.3 per arcmin2, four 20.4."""
    truth, _, match, real = scene(0.0)
    some = np.arange(CLUMP, CLUMP + stars)
    near = truth.take(some).with_columns(ra_epoch=10 + 2 * ARCSEC * np.arange(stars), dec_epoch=np.zeros(stars))
    got = by_density(near, {"ra": [], "dec": []}, match[some], real[:0], {"r": [INFO]})
    assert got["objects"][place] == stars == sum(got["objects"])
