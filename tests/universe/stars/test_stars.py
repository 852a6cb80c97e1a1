"""Stars of a brick: counts, limits, seams, local densities, against integrals, published numbers and Gaia's counts."""

from functools import partial
from itertools import pairwise

import healpy
import numpy as np
import pytest
from astropy.table import Table
from fit_star_counts import TABLE, G, counts, places, steps
from scipy import stats
from scipy.integrate import quad
from star_count_model import StarCounts

from csstsim.base.errors import InputError
from csstsim.base.healpix import NSIDE
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.truth_bricks import AREA_DEG2, random_positions
from csstsim.instrument.load import read_data
from csstsim.universe.parameters import load_universe
from csstsim.universe.stars import stars as module
from csstsim.universe.stars.binaries import Companions
from csstsim.universe.stars.milky_way import density, direction, equatorial
from csstsim.universe.stars.star_sed import StarSeds
from csstsim.universe.stars.stars import draw_stars, expected_counts, galaxy
from csstsim.universe.stars.stellar_evolution import living

NUMBERS = read_data(SHIPPED / "universe" / "stars.yaml")
COLUMNS = {
    "ra", "dec", "_healpix_29", "teff", "logg", "feh", "stellarmass", "radius", "distance", "parallax", "pmra", "pmdec",
    "rv", "teff2", "logg2", "area2",
}  # fmt: skip


def _brick(pix, seed=1, numbers=NUMBERS):
    return draw_stars(lambda name: stream(seed, "test", pix, name), pix, partial(random_positions, pix), numbers)


def _pix(l, b):  # noqa: E741
    return healpy.ang2pix(NSIDE, *map(float, equatorial(l, b)), nest=True, lonlat=True)


@pytest.fixture(scope="module")
def stars():
    return _brick(_pix(90, 30))


@pytest.fixture(scope="module")
def gaia():
    """Gaia's counts and ours in directions that were not fitted; fewer types of stars than usual, to 2%."""
    table = Table.read(TABLE, format="ascii.csv", comment="#")
    table = table[table["use"] == "tested"]
    limits, seen = counts(table)
    model = StarCounts(NUMBERS | {"binning": [12, 80]}, load_universe(), *G)
    return seen, steps(model, *places(table), limits)


def test_counts_of_gaia_in_directions_that_were_not_fitted(gaia):
    seen, computed = gaia
    ratio = computed.cumsum(axis=1) / seen.cumsum(axis=1)  # brighter than G = 12.1, 13.1 ... 20
    assert np.abs(ratio - 1).max() < 0.15, ratio
    assert (np.abs(ratio - 1) > 0.10).any(axis=1).sum() <= 1, ratio  # l = 180, b = 30, where dust is thick
    assert np.abs(np.log(computed / seen)).mean() < 0.06  # single steps: sampling noise 2 to 4%


@pytest.mark.parametrize(
    ("band", "limit", "stars", "arcmin2", "place_", "low", "high"),
    [  # Pirzkal et al. 2005: 25 stars i < 27 in the HUDF; Groenewegen et al. 2002: at least 1200 R < 23 in 0.3 deg2
        ("sdss2010-i", 27.0, 25, 11.97, (53.16, -27.79), 0.7, 1.5),
        ("bessell-R", 22.79, 1200, 1080, (53.16, -27.79), 0.95, 1.6),  # AB - Vega = 0.21
    ],
)
def test_counts_fainter_than_gaia(band, limit, stars, arcmin2, place_, low, high):
    model = StarCounts(NUMBERS | {"binning": [12, 80]}, load_universe(), band, beam=0.1)
    assert low < model.brighter(*place_, [limit])[0, 0] * arcmin2 / 3600 / stars < high


def test_counts_grow_towards_the_centre_and_the_plane():
    ra, dec = equatorial(np.array([0, 90, 180, 90, 90]), np.array([40, 40, 40, 20, 80]))
    centre, side, away, low, high = expected_counts(ra, dec, NUMBERS, 22.0)
    assert centre > 1.2 * side > 1.2 * away
    assert low > 2 * side > 2 * high


def test_luminosity_function_of_the_solar_neighbourhood():
    types = [t for t in galaxy(NUMBERS).types if t.component.law != "bulge"]
    living, white = types[: len(types) // 2], types[len(types) // 2 :]
    edges = np.arange(3.5, 18.0, 1.0)
    near = sum(np.diff(t.brighter(edges)) for t in living)  # stars / pc3 / mag at M_V 4, 5, ...
    near += sum(np.histogram(t.pair[1], edges, weights=np.diff(t.total) * t.pair[0])[0] for t in living)
    assert near[0] == pytest.approx(0.003, rel=0.25)
    assert near[1] == pytest.approx(0.004, rel=0.25)
    assert abs(edges[near.argmax()] + 0.5 - 12) <= 1
    assert 0.010 < near.max() < 0.015
    assert sum(t.total[-1] for t in living) == pytest.approx(0.1, rel=0.3)
    assert sum(t.total[-1] for t in white) == pytest.approx(0.005, rel=1e-9)
    # White dwarfs: few hot ones, a rise to M_V 15-16, where the age of the disc ends it (Harris et al. 2006).
    edges = np.arange(10.0, 18.0)
    near = sum(np.diff(t.brighter(edges)) for t in white)
    assert near[:2].sum() < 0.15 * near.sum()
    assert edges[near.argmax()] in (14.0, 15.0)


def test_local_mass_of_each_component_is_its_density():
    for types in galaxy(NUMBERS).types[:9]:
        mass = np.einsum("n,n->", np.diff(types.total), types.table[4] + types.pair[0] * types.pair[4])
        assert mass == pytest.approx(types.component.density / 1000, rel=1e-9)


def test_sight_line_integral_against_fine_steps():
    ra, dec = equatorial(120, 45)
    model = galaxy(NUMBERS)
    modulus = np.arange(-5, 26, 0.001)
    parsec = 10 ** (0.2 * modulus + 1)
    for types, rate in zip(model.types, model.rates([ra], [dec], 22.0), strict=True):
        near = types.brighter(22.0 - modulus) - types.brighter(NUMBERS["limits"][0] - modulus)
        law = density(types.component, direction(ra, dec)[:, None] * parsec / 1000, NUMBERS)
        fine = (law * near * parsec**3).sum() * 0.001 * 0.2 * np.log(10) * (np.pi / 180) ** 2
        assert rate.sum() == pytest.approx(fine, rel=0.005, abs=0.05), types.component.name


def test_columns_and_their_bounds(stars):
    assert set(stars) == COLUMNS
    assert len({len(column) for column in stars.values()}) == 1
    assert all(np.isfinite(column).all() for column in stars.values())
    assert stars["_healpix_29"].dtype == np.int64 and stars["ra"].dtype == np.float64
    assert stars["teff"].min() >= 1900 and stars["teff"].max() < 60000
    np.testing.assert_allclose(stars["parallax"] * stars["distance"], 1000.0)
    # log g is that of mass and radius (nominal solar 4.438).
    dense = 4.438 + np.log10(stars["stellarmass"]) - 2 * np.log10(stars["radius"])
    np.testing.assert_allclose(stars["logg"], dense, atol=1e-3)


def test_drawn_number_is_the_expected_one():
    pix = _pix(60, 40)
    corners = module._corners(pix)
    expected = expected_counts(*corners, NUMBERS, 28.0).mean() * AREA_DEG2  # bilinear: the mean of the corners
    drawn = [len(np.unique(_brick(pix, seed)["pmra"])) for seed in range(20)]  # wide pairs move together
    assert abs(np.mean(drawn) - expected) < 4 * np.sqrt(expected / 20)


def test_distances_and_populations_follow_the_integral():
    pix = _pix(200, 35)
    rates = sum(np.array(list(galaxy(NUMBERS).rates(*module._corners(pix), 28.0))).sum(axis=1))
    drawn = np.concatenate([_brick(pix, seed)["distance"] for seed in range(10)])
    total = np.concatenate([[0], np.cumsum(rates)])
    found = stats.kstest(5 * np.log10(drawn / 10), lambda m: np.interp(m, module._MODULUS, total / total[-1]))
    assert found.statistic < 0.01 + 1.5 / np.sqrt(len(drawn))  # 0.01: the cumulative is bent within its steps


def test_surface_density_has_no_seam():
    """Along a border the density comes from the two shared corners alone, so both bricks have the same."""
    pix = _pix(0, 30)
    for neighbour in healpy.get_all_neighbours(NSIDE, pix, nest=True)[::2]:  # those that share an edge
        computed, reference = (np.round(np.array(module._corners(p)).T, 9) for p in (pix, neighbour))
        shared = [corner for corner in computed.tolist() if corner in reference.tolist()]
        assert len(shared) == 2


@pytest.mark.parametrize(
    "spot", [(0.0, 89.99), (0.0, -89.99), (0.001, 20.0), (45.0, 41.81), (45.0, 0.0), (200.0, -60.0)]
)
def test_weights_of_the_corners_give_the_position_back(spot):
    """At the poles, where right ascension wraps, and where HEALPix changes its law (41.8 deg)."""
    pix = healpy.ang2pix(NSIDE, *spot, nest=True, lonlat=True)
    ra, dec, healpix = random_positions(pix, np.random.default_rng(2), 500)
    weights = module._bilinear(healpix)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    corners = direction(*module._corners(pix))
    there = np.einsum("nc,ic->in", weights, corners)
    assert np.abs(there - direction(ra, dec)).max() < 5e-4  # rad; a brick is 4e-3 across, its grid a little bent


def test_brick_depends_on_seed_pixel_and_numbers_only(stars):
    again = _brick(_pix(90, 30))
    assert all((again[name] == stars[name]).all() for name in COLUMNS)
    assert len(_brick(_pix(90, 30), seed=2)["ra"]) != len(stars["ra"])
    assert (healpy.ang2pix(NSIDE, stars["ra"], stars["dec"], nest=True, lonlat=True) == _pix(90, 30)).all()


@pytest.fixture(scope="module")
def seds():
    return StarSeds(SHIPPED / "universe" / "star_spectra.fits", np.zeros(18001))


def _apparent_v(seds, stars):
    """V of the spectra: Bessell 1990 passband, AB (0.02 mag from Vega)."""
    from csstsim.base.units import SOLAR_RADIUS_PC, ab_photon_density
    from csstsim.instrument.filter import GRID

    knots = [4700, 4800, 4900, 5000, 5100, 5200, 5300, 5400, 5500, 5700, 5900, 6100, 6300, 6500, 6700, 7000]
    shape = [0, 0.03, 0.163, 0.458, 0.78, 0.967, 1, 0.973, 0.898, 0.684, 0.461, 0.27, 0.135, 0.045, 0.017, 0]
    band = np.interp(GRID, knots, shape)
    light = seds.rates(stars["teff"], stars["logg"], stars["feh"], 0.0, band[None])[:, 0]
    light = light * (stars["radius"] * SOLAR_RADIUS_PC / stars["distance"]) ** 2
    return -2.5 * np.log10(light / np.einsum("w,w->", band, ab_photon_density(GRID)))


def test_v_of_the_spectra_lies_within_the_limits(seds):
    """Stars are chosen by M_V + distance modulus; their spectra x (radius / distance)^2 must agree."""
    limits = NUMBERS["limits"]
    stars = _brick(_pix(90, 25))
    v = _apparent_v(seds, stars)
    assert limits[0] - 0.6 < v.min() and v.max() < limits[1] + 0.6
    assert ((v > limits[0] - 0.15) & (v < limits[1] + 0.15)).mean() > 0.985


def test_absolute_magnitudes_are_those_of_the_spectra(seds):
    rng = np.random.default_rng(4)
    for types in galaxy(NUMBERS).types[:9]:
        pick = rng.choice(types.table.shape[1], 500)
        m_v, teff, logg, feh, _, radius = types.table[:, pick]
        off = _apparent_v(seds, {"teff": teff, "logg": logg, "feh": feh, "radius": radius, "distance": 10.0}) - m_v
        dwarf = (logg > 3.9) & (teff > 3000)
        assert abs(np.median(off[dwarf])) < 0.1, types.component.name
        assert np.percentile(np.abs(off[dwarf]), 68) < 0.15, types.component.name


def test_nothing_between_equal_limits():
    empty = _brick(5, numbers=NUMBERS | {"limits": [20.0, 20.0]})
    assert set(empty) == COLUMNS and len(empty["ra"]) == 0


def test_expected_counts_keep_their_shape():
    assert expected_counts(10.0, 20.0, NUMBERS, 20.0).shape == ()
    ra = np.array([[0.0, 360.0, 359.999999], [10.0, 370.0, 10.0]])
    counts = expected_counts(ra, 5.0, NUMBERS, 20.0)
    assert counts.shape == (2, 3)
    np.testing.assert_allclose(counts, counts[:, :1] * np.ones(3), rtol=1e-6)
    assert expected_counts(np.zeros(0), np.zeros(0), NUMBERS, 20.0).shape == (0,)
    assert expected_counts(0.0, 0.0, NUMBERS, 5.0) == 0


def test_missing_and_wrong_numbers_are_named():
    without = {key: value for key, value in NUMBERS.items() if key != "giant"}
    with pytest.raises(InputError, match="giant"):
        expected_counts(0.0, 0.0, without, 20.0)
    with pytest.raises(InputError):
        expected_counts(0.0, 0.0, NUMBERS | {"masses": ["a", "b"]}, 20.0)


def test_metals_follow_the_radius_and_distances_the_volume():
    """A type's [Fe/H] plus gradient times (R - R0); the far half of a step has more of its stars."""
    model, rng = galaxy(NUMBERS), np.random.default_rng(3)
    kind = np.full(400, next(k for k, t in enumerate(model.types) if t.component.gradient != 0))
    r0, distance = NUMBERS["sun"]["r0"], np.full(400, 1000.0)
    here, there = np.zeros((3, 400)), np.zeros((3, 400))
    there[0], there[1] = 3.0, -2.0

    def metals(position):
        return module._draw_types(lambda name: stream(4, name), kind, distance, position, model)[0]["feh"]

    gradient = model.types[kind[0]].component.gradient
    change = gradient * (np.hypot(3.0 - r0, 2.0) - r0)
    assert abs(change) > 0.05
    np.testing.assert_allclose(metals(there) - metals(here), change, atol=1e-12)
    del rng


def test_companions_have_the_place_and_the_limits_of_stars():
    """Wide ones at the end of the columns, within the limits of V at their star's distance; the others are lost."""
    n, pix = 60, _pix(90, 30)
    ra, dec, healpix = random_positions(pix, np.random.default_rng(5), n)
    columns = {"ra": ra, "dec": dec, "_healpix_29": healpix, "distance": np.full(n, 100.0)}
    columns |= {"teff": np.full(n, 5800.0), "logg": np.full(n, 4.4), "stellarmass": np.ones(n), "radius": np.ones(n)}
    m_v = np.tile([-1.0, 10.0, 24.0], n // 3)  # V of 4, 15 and 29: too bright, seen, too faint
    own = [np.ones(n), m_v, np.full(n, 4000.0), np.full(n, 4.7), np.full(n, 0.6), np.full(n, 0.6)]
    pair = np.stack([*own, np.full(n, 3.0), np.full(n, 0.01)])  # 1000 au: 10 arcsec
    made = module._add_companions(lambda name: stream(6, name), columns, pair, pix, NUMBERS)
    more = made["ra"][n:]
    assert len(more) == n // 3 and (made["teff"][n:] == 4000.0).all() and (made["distance"][n:] == 100.0).all()
    np.testing.assert_allclose(more, ra[1::3], atol=0.02)
    np.testing.assert_array_equal(made["ra"][:n], ra)
    none = module._add_companions(lambda name: stream(6, name), columns, pair * 0 + 1e-9, pix, NUMBERS)
    assert len(none["ra"]) == n and not none["teff2"].any()


def test_types_have_the_metals_and_the_masses_of_their_component():
    """[Fe/H] by its mean and scatter over draws of equal weight; masses by the slopes of the component's law."""
    for types in galaxy(NUMBERS).types[:10]:
        weight, (feh, mass) = np.diff(types.total), types.table[[3, 4]]
        mean = np.average(feh, weights=weight)
        component = types.component
        assert mean == pytest.approx(component.feh, abs=0.06 * max(component.feh_sd, 0.1) + 0.02), component.name
        spread = np.sqrt(np.average((feh - mean) ** 2, weights=weight))
        assert spread == pytest.approx(component.feh_sd, rel=0.12), component.name
        edges = [0.1, 0.25, 0.5]
        counts = np.histogram(mass, edges, weights=weight)[0]
        power = component.imf[0] + 1
        wanted = np.diff(np.power(edges, power))
        assert counts[0] / counts[1] == pytest.approx(wanted[0] / wanted[1], rel=0.05), component.name


def test_the_mass_function_is_three_power_laws_that_join():
    """By quad over cells that straddle the breaks; one at the last break."""
    from csstsim.universe.stars.star_types import _imf

    component = next(t.component for t in galaxy(NUMBERS).types if len(set(t.component.imf)) == 3)
    (a, b), (s0, s1, s2) = NUMBERS["imf_breaks"], component.imf

    def law(m):
        if m >= b:
            return (m / b) ** s2
        return (m / b) ** s1 if m >= a else (a / b) ** s1 * (m / a) ** s0

    edges = np.array([0.1, 0.3, 0.7, 0.9, 1.5, 6.0])
    wanted = [quad(law, low, high, points=[a, b])[0] for low, high in pairwise(edges)]
    np.testing.assert_allclose(_imf(component, edges, NUMBERS["imf_breaks"]), wanted, rtol=1e-7)


def test_companions_have_the_metals_of_their_stars():
    """Temperatures of dwarfs below half a solar mass, which have hardly aged, in a bulge, discs and a halo."""
    for types in galaxy(NUMBERS).types[:10]:
        companion = Companions(*types.pair)
        some = (companion.stellarmass < 0.5) & (companion.probability > 0)
        feh = types.table[3][some]
        young = living(companion.stellarmass[some], feh, np.zeros(len(feh)), np.zeros(len(feh)), NUMBERS)
        assert len(feh) > 100
        assert np.median(companion.teff[some] / young.teff) == pytest.approx(1.0, abs=0.01), types.component.name
        assert np.std(companion.teff[some] / young.teff) < 0.01, types.component.name


def test_a_type_is_chosen_within_the_limits_by_numbers():
    """Of types of M_V 1 to 5: quantiles of those between; the next one if there is none; the last one beyond."""
    from csstsim.universe.stars.star_types import Types

    table = np.zeros((6, 5))
    table[0] = np.arange(1.0, 6.0)
    types = Types(None, table, np.zeros((8, 5)), np.array([0.0, 1.0, 3.0, 6.0, 10.0, 15.0]))
    assert types.brighter(np.array([0.5, 1.0, 3.5, 9.0])).tolist() == [0.0, 0.0, 6.0, 15.0]
    u = np.array([0.0, 0.39, 0.41, 0.999, 0.5, 0.5])
    low, high = np.array([1.5, 1.5, 1.5, 1.5, 2.1, 7.0]), np.array([3.5, 3.5, 3.5, 3.5, 2.9, 8.0])
    assert types.choose(u, low, high).tolist() == [1, 1, 2, 2, 2, 4]
