"""Close sources, each measured without the light of the others: colours, models, fluxes of pairs."""

import math

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.measure import source_columns
from csstsim.measure.light import neighbours
from csstsim.measure.light.neighbours import LINK, Neighbours, _colours, _Models
from csstsim.measure.light.photometry import HALF, psf_model
from csstsim.measure.light.profile_tables import BULGES, SIZES, profile_tables

galsim = pytest.importorskip("galsim")

SIGMA = 5.0
SIDE = 121


def colours(x, y, half_light=2.0, flux=None):
    x, y = np.array(x, float), np.array(y, float)
    order = np.arange(len(x)) if flux is None else np.argsort(-np.array(flux, float))
    return _colours(x, y, np.broadcast_to(half_light, x.shape).astype(float), order).tolist()


def test_neighbours_have_different_colours_and_others_none():
    assert colours([], []) == [] and colours([5.0], [5.0]) == [-1]
    assert colours([0, LINK + 0.1], [0, 0]) == [-1, -1] and colours([0, LINK - 0.1], [0, 0]) == [0, 1]
    assert colours([0, 10, 20], [0, 0, 0]) == [0, 1, 0]
    assert colours([0, 10, 20], [0, 0, 0], flux=[1, 9, 5]) == [1, 0, 1]
    assert colours([0, 3, 0], [0, 0, 3], flux=[1, 2, 3]) == [2, 1, 0]
    assert colours([4, 4], [4, 4], flux=[1, 2]) == [1, 0]


def test_a_large_source_has_neighbours_further_away():
    assert colours([0, 19], [0, 0], half_light=[10.0, 1.0]) == [0, 1]
    assert colours([0, 21], [0, 0], half_light=[10.0, 1.0]) == [-1, -1]
    assert colours([0, 61], [0, 0], half_light=[1e9, np.nan]) == [-1, -1]


def test_colours_of_a_crowd():
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, 300, (2, 2000))
    colour = np.array(colours(x, y, flux=rng.uniform(1, 2, 2000)))
    near = (np.hypot(x[:, None] - x, y[:, None] - y) < LINK) & ~np.eye(2000, dtype=bool)
    assert ((colour[:, None] == colour) & near).sum() == 0
    assert (near.any(axis=1) == (colour >= 0)).all()
    assert all(set(range(colour[k])) <= set(colour[near[k]].tolist()) for k in range(2000))


def one_model(fabricate, tables, **changes):
    """Return the Neighbours of one source at 60.3, 59.8 with a model."""
    psf = psf_model(fabricate.psf, (0, 0), (SIDE, SIDE)).at(np.array([60.3]), np.array([59.8]))
    model = {
        "x": 60.3, "y": 59.8, "flux": 5000.0, "profile": tables.galaxy[0, 0, :, 100], "point": False, "e1": 0.0,
        "e2": 0.0,
    } | changes  # fmt: skip
    columns = {name: np.array([value]) for name, value in model.items()}
    models = _Models(**columns | {"nodes": tables.nodes, "profile": columns["profile"].astype(float)})
    return Neighbours(np.zeros((SIDE, SIDE), np.float32), np.array([0]), models, psf)


@pytest.fixture(scope="module")
def tables(fabricate):
    return profile_tables(fabricate.psf, (0, 0), (SIDE, SIDE), 0.074, (BULGES,))[0]


def test_a_point_is_the_psf(fabricate, tables):
    one = one_model(fabricate, tables, profile=tables.point[0, :, 0], point=True, e1=0.4)
    one.restore()
    wanted = np.zeros((SIDE, SIDE))
    fabricate.add_stars(wanted, [60.3], [59.8], [5000.0])
    stamp = (slice(60 - HALF, 61 + HALF),) * 2
    assert one.image[stamp] == pytest.approx(wanted[stamp], abs=2e-3 * wanted.max())
    assert np.abs(one.image - wanted).max() < 2e-3 * wanted.max()


@pytest.mark.parametrize(("e1", "e2"), [(0.0, 0.0), (0.4, 0.0), (-0.2, 0.3)])
def test_a_galaxy_is_its_profile_on_an_ellipse(fabricate, tables, e1, e2):
    """Against GalSim: a disc of half-light radius 4 px, whose convolution with the PSF is nearly round or elongated."""
    size = int(np.argmin(np.abs(SIZES - 4.0)))
    profile = tables.galaxy[0, 0].reshape(len(tables.nodes), len(SIZES), -1)[:, size, 2]
    one = one_model(fabricate, tables, profile=profile, e1=e1, e2=e2)
    one.restore()
    assert one.image.sum() == pytest.approx(5000.0 * fabricate.LIGHT, rel=0.01)
    y, x = np.mgrid[:SIDE, :SIDE]
    xx, yy, xy = ((one.image * w).sum() for w in ((x - 60.3) ** 2, (y - 59.8) ** 2, (x - 60.3) * (y - 59.8)))
    assert ((xx - yy) / (xx + yy), 2 * xy / (xx + yy)) == pytest.approx((e1, e2), abs=0.01)
    disc = galsim.Exponential(half_light_radius=SIZES[size], flux=5000.0 * fabricate.LIGHT)
    psf = galsim.Gaussian(sigma=fabricate.SIGMA)
    image = galsim.Convolve(disc.shear(e1=e1, e2=e2), psf).drawImage(
        nx=SIDE, ny=SIDE, scale=1.0, center=galsim.PositionD(61.3, 60.8)
    )
    assert np.abs(one.image - image.array).sum() < (0.02 if e1 == e2 == 0 else 0.1) * 5000


def test_models_come_and_go(fabricate, tables):
    """At the edge, beyond it, without flux; what is added and subtracted leaves the image."""
    for place in ((0.0, 0.0), (120.4, 60.0), (-3.0, 500.0)):
        one = one_model(fabricate, tables, x=place[0], y=place[1])
        one.restore()
        before = one.image.copy()
        seen = []
        one.each_colour(lambda rows, one=one, seen=seen: seen.append((rows.tolist(), one.image.sum())))
        assert seen[0][0] == [0] and seen[0][1] == pytest.approx(2 * before.sum(), rel=1e-5)
        assert one.image == pytest.approx(before, abs=1e-4)
    for flux in (0.0, np.nan):
        dark = one_model(fabricate, tables, flux=flux)
        dark.restore()
        assert not dark.image.any()


def pairs(fabricate, distance, galaxy, seed):
    """Return (positions of 36 primaries, of their secondaries, table): fluxes 6000 and 2500 electrons."""
    rng, step, side = stream(seed, "pairs", galaxy), 90, 6
    n = step * side
    first = np.array([(45 + step * (k % side), 45 + step * (k // side)) for k in range(side**2)], float)
    first += rng.uniform(-0.5, 0.5, first.shape)
    angle = rng.uniform(0, math.tau, len(first))
    second = first + distance * np.column_stack([np.cos(angle), np.sin(angle)])
    image = np.zeros((n, n))
    fabricate.add_stars(image, *second.T, [2500.0] * len(second))
    if galaxy:
        psf = galsim.Gaussian(sigma=fabricate.SIGMA, flux=fabricate.LIGHT)
        for x, y in first:
            disc = galsim.Exponential(half_light_radius=3.5, flux=6000.0).shear(
                q=0.7, beta=rng.uniform(0, 180) * galsim.degrees
            )
            stamp = galsim.Convolve(disc, psf).drawImage(nx=81, ny=81, scale=1.0, center=galsim.PositionD(x, y))
            part = stamp.bounds & galsim.BoundsI(0, n - 1, 0, n - 1)
            image[part.ymin : part.ymax + 1, part.xmin : part.xmax + 1] += stamp[part].array
    else:
        fabricate.add_stars(image, *first.T, [6000.0] * len(first))
    return first, second, fabricate.measure(fabricate.add_noise(image, seed + 1))


def no_neighbours(x, *_):
    return np.full(len(x), -1)


def fluxes(table, places, column):
    """Return (flux over error and flux) of the sources nearest to places; NaN where none is within 1 px."""
    distance = np.hypot(table["x"] - places[:, :1], table["y"] - places[:, 1:])
    row = distance.argmin(axis=1)
    found = distance.min(axis=1) < 1.0
    assert found.mean() > 0.9
    return table[column][row][found], table[f"{column}_err"][row][found]


@pytest.mark.parametrize("distance", [5.0, 7.0])
def test_fluxes_of_close_stars_are_their_own(fabricate, distance):
    first, second, table = pairs(fabricate, distance, False, 51)
    for places, given in ((first, 6000.0), (second, 2500.0)):
        flux, error = fluxes(table, places, "flux_psf")
        pull = (flux - given) / error
        assert abs(np.mean(pull)) < SIGMA / np.sqrt(len(pull)) and np.std(pull) < 1.6


def test_a_star_in_a_galaxy_and_the_galaxy_have_their_own_fluxes(fabricate, monkeypatch):
    """7 px apart. Without models of each other the star has twice its flux, as a galaxy or a point."""
    first, second, table = pairs(fabricate, 7.0, True, 53)
    for places, given, limit in ((first, 6000.0, 0.06), (second, 2500.0, 0.1)):
        flux, _ = fluxes(table, places, "flux_total")
        assert np.median(flux) / given == pytest.approx(1.0, abs=limit)
    monkeypatch.setattr(neighbours, "_colours", no_neighbours)
    *_, second, table = pairs(fabricate, 7.0, True, 53)
    flux, _ = fluxes(table, second, "flux_total")
    assert np.median(flux) > 1.3 * 2500


def test_stars_of_a_crowd_have_their_own_fluxes_and_are_no_cosmic_rays(fabricate):
    """900 stars of 300 to 30,000 electrons, one on 160 px, on a sky that is 3 electrons too bright.

    If wings of models could be that light, half of the faint stars would be too faint by half, or sharp.
    """
    n, count, rng = 380, 900, stream(57, "crowd")
    x, y = rng.uniform(14, n - 15, (2, count))
    flux = 10 ** rng.uniform(2.5, 4.5, count)
    image = np.full((n, n), 3.0)
    fabricate.add_stars(image, x, y, flux)
    table = fabricate.measure(fabricate.add_noise(image, 58))
    distance = np.hypot(table["x"] - x[:, None], table["y"] - y[:, None])
    row = distance.argmin(axis=1)
    for low, high, limit in ((1e3, 5e3, 0.05), (5e3, 4e4, 0.03)):
        some = (distance.min(axis=1) < 1.0) & (flux > low) & (flux < high)
        assert some.sum() > 100
        assert np.median(table["flux_psf"][row[some]] / flux[some]) == pytest.approx(1.0, abs=limit)
        assert np.median(table["flux_total"][row[some]] / flux[some]) == pytest.approx(1.0, abs=limit)
        assert ((table["flags"][row[some]] & source_columns.SHARP) > 0).mean() < 0.05


def test_a_single_source_is_measured_as_ever(fabricate, monkeypatch):
    image = np.zeros((160, 160))
    fabricate.add_stars(image, [40.2, 120.0], [60.1, 90.4], [3000.0, 900.0])
    frame = fabricate.add_noise(image, 55)
    table = fabricate.measure(frame.copy())
    monkeypatch.setattr(neighbours, "_colours", no_neighbours)
    again = fabricate.measure(frame)
    alone = np.hypot(table["x"][:, None] - table["x"], table["y"][:, None] - table["y"])
    np.fill_diagonal(alone, np.inf)
    far = alone.min(axis=1) > 60
    assert far.any()
    for name in ("x", "y", "flux_psf", "flux_total", "flux_kron", "point"):
        assert (table[name][far] == again[name][far]).all()
