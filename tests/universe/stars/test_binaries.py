"""Companions of stars: fractions, mass ratios and separations as published, flux and positions, borders of bricks."""

from functools import partial

import healpy
import numpy as np
import pytest
from scipy import stats
from support.embedded_sky import key, shipped

from csstsim.base.healpix import HATS_ORDER, NSIDE, ORDER
from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.base.sphere import angle, offsets, unit_vectors
from csstsim.catalog.light.binned_spectra import binned
from csstsim.catalog.light.embedded_spectra import rates, spectra
from csstsim.catalog.light.photometry import subband_weights
from csstsim.catalog.table import STAR
from csstsim.catalog.truth_bricks import make_brick, random_positions
from csstsim.instrument.load import read_data
from csstsim.universe.stars.binaries import Companions, companions, join, separations, wide
from csstsim.universe.stars.milky_way import equatorial
from csstsim.universe.stars.stars import draw_stars
from csstsim.universe.stars.stellar_evolution import living, stage_ends

NUMBERS = read_data(SHIPPED / "universe" / "stars.yaml")
LAW = NUMBERS["binaries"]
MANY = 40000


def _pairs(mass, seed=1):
    full = np.full(MANY, float(mass))
    return companions(np.random.default_rng(seed), full, 0.0 * full, 5.0 + 0.0 * full, NUMBERS)


@pytest.mark.parametrize(("mass", "share"), [(0.2, (0.20, 0.27)), (0.4, (0.26, 0.33)), (1.0, (0.43, 0.49))])
def test_shares_of_published_surveys(mass, share):
    """M dwarfs 0.27 (Winters et al. 2019), solar stars 0.44 to 0.46 (Raghavan et al. 2010; Moe & Di Stefano 2017)."""
    pair = _pairs(mass)
    assert share[0] < _share(mass) < share[1]
    probability = Companions(*pair).probability
    assert set(np.unique(probability)) <= {0.0, _share(mass)}  # brown dwarfs give no light
    assert (probability == 0).mean() == pytest.approx(_dark(mass), abs=4 * np.sqrt(0.25 / MANY))


def _share(mass):
    """The law as the file gives it."""
    return np.interp(np.log(mass), np.log(LAW["laws"]["mass"]), LAW["laws"]["share"])


def _dark(mass):
    """The fraction of mass ratios below the lightest star, from the integral of q^gamma between 0.1 and 1."""
    power = np.interp(np.log(mass), np.log(LAW["laws"]["mass"]), LAW["laws"]["gamma"]) + 1
    q = max(NUMBERS["masses"][0] / mass, 0.1)
    return (q**power - 0.1**power) / (1 - 0.1**power)


def test_mass_ratios_follow_their_power_law():
    pair = _pairs(1.0)
    q = Companions(*pair).stellarmass
    power = 0.3 + 1.0  # Duchene & Kraus 2013
    found = stats.kstest(q[q > 0.11], lambda x: (x**power - 0.11**power) / (1 - 0.11**power))
    assert found.pvalue > 0.001 and q.min() >= NUMBERS["masses"][0] and q.max() <= 1.0
    assert (np.diff(pair[1][np.argsort(q)]) < 0.5).all()  # M_V falls with mass, but for the age's effect


def test_separations_are_lognormal_and_have_an_end():
    pair, rng = _pairs(1.0), np.random.default_rng(2)
    au = 10.0 * separations(rng.random(MANY), np.zeros(MANY), pair, 10.0, LAW["widest"])
    assert au.max() <= LAW["widest"] * (1 + 1e-9)
    # Raghavan et al. 2010: median period 293 yr, which is 50 au for 1.5 solar masses; tails cut at `widest`
    assert np.median(np.log10(au)) == pytest.approx(1.65 - 0.08, abs=0.05)
    seen = separations(np.full(MANY, 0.5), rng.random(MANY), pair, 10.0, LAW["widest"])
    assert seen.mean() / seen.max() == pytest.approx(np.pi / 4, abs=0.01)  # mean of sqrt(1 - u^2)


def _columns(count=3):
    pix = 1000
    ra, dec, healpix = random_positions(pix, np.random.default_rng(3), count)
    star = {"teff": 5772.0, "logg": 4.4, "stellarmass": 1.0, "radius": 1.0}
    own = {name: np.full(count, value) for name, value in star.items()}
    return pix, {"ra": ra, "dec": dec, "_healpix_29": healpix} | own


def test_close_pairs_wide_pairs_and_single_stars():
    pix, columns = _columns()
    pair = np.tile(np.array([1.0, 8.0, 4000.0, 4.7, 0.6, 0.6, 1.6, 1.5])[:, None], 3)
    far = np.array([0.01, 3.0, np.inf])
    join(columns, pair, far, NUMBERS)
    assert columns["teff2"].tolist() == [4000.0, 0.0, 0.0]
    assert columns["area2"][0] == pytest.approx(0.36)
    new = wide(columns, pair, far, np.array([0.1, 0.25, 0.3]), pix, np.ones(3, bool), NUMBERS)
    assert len(new["ra"]) == 1 and new["teff"][0] == 4000.0 and new["area2"][0] == 0.0
    apart = healpy.rotator.angdist([columns["ra"][1], columns["dec"][1]], [new["ra"][0], new["dec"][0]], lonlat=True)
    assert np.degrees(apart[0]) * 3600 == pytest.approx(3.0, abs=1e-3)
    east = (new["ra"][0] - columns["ra"][1]) * np.cos(np.radians(new["dec"][0])) * 3600
    assert east == pytest.approx(3.0, abs=1e-3)  # a quarter of a turn is east
    assert len(wide(columns, pair, far, np.zeros(3), pix, np.zeros(3, bool), NUMBERS)["ra"]) == 0


def test_a_companion_beyond_the_border_stands_on_the_other_side():
    pix, columns = _columns(2000)
    pair = np.tile(np.array([1.0, 8.0, 4000.0, 4.7, 0.6, 0.6, 1.6, 1.5])[:, None], 2000)
    far, turn = np.full(2000, 200.0), np.random.default_rng(4).random(2000)  # a quarter of a brick's side
    columns |= {name: np.zeros(2000) for name in ("teff2", "logg2", "area2")}
    new = wide(columns, pair, far, turn, pix, np.ones(2000, bool), NUMBERS)
    assert (new["_healpix_29"] >> 2 * (HATS_ORDER - ORDER) == pix).all()
    apart = unit_vectors(columns["ra"], columns["dec"]), unit_vectors(new["ra"], new["dec"])
    seconds = 3600 * angle(*apart)
    stays = seconds < 1e-3
    np.testing.assert_allclose(seconds[~stays], 200.0, atol=0.01)
    assert 0 < stays.mean() < 0.05  # in the corners
    wanted = np.degrees(np.arctan2(*offsets(new["ra"], new["dec"], columns["ra"], columns["dec"])))
    turned = np.abs((wanted - 360 * turn + 180) % 360 - 180)[~stays]
    assert ((turned < 1) | (turned > 179)).all() and 0.2 < (turned > 179).mean() < 0.5


def test_a_companion_too_faint_to_matter_is_left_out():
    _, columns = _columns(1)
    join(columns, np.array([[1.0], [14.0], [2900.0], [5.0], [0.12], [0.14], [1.6], [1.5]]), np.array([0.001]), NUMBERS)
    assert columns["teff2"][0] == 0.0


def _brick(lon, lat, seed=1):
    pix = healpy.ang2pix(NSIDE, *map(float, equatorial(lon, lat)), nest=True, lonlat=True)
    return pix, draw_stars(lambda name: stream(seed, "test", pix, name), pix, partial(random_positions, pix), NUMBERS)


@pytest.mark.parametrize("spot", [(90, 30), (123, 27.2), (303, -27.2), (97, -60)])  # the celestial poles and RA 0 too
def test_wide_companions_stay_in_their_brick(spot):
    pix, stars = _brick(*spot)
    assert (stars["_healpix_29"] >> 2 * (HATS_ORDER - ORDER) == pix).all()
    pixels = healpy.ang2pix(1 << HATS_ORDER, stars["ra"], stars["dec"], nest=True, lonlat=True)
    assert (pixels == stars["_healpix_29"]).all()
    _, first, many = np.unique(stars["pmra"], return_index=True, return_counts=True)
    assert (many <= 2).all() and (many == 2).sum() > 0.02 * len(first)  # a pair moves together
    assert 0.10 < (stars["teff2"] > 0).mean() < 0.30


def test_the_light_of_a_pair_is_the_sum_of_two_stars():
    universe, camera = shipped()
    table = make_brick(pix=100000, **key())
    stars = table.take(table["obj_type"] == STAR)
    some = stars.take(np.flatnonzero(stars["coeff0"] > 0)[:20])
    none = np.zeros(len(some), np.float32)
    first = some.with_columns(coeff0=none)
    second = some.with_columns(
        teff=some["coeff0"], logg=some["coeff1"], sed_scale=some["sed_scale"] * some["coeff2"], coeff0=none
    )
    weights = subband_weights(camera.bands["z"], camera.telescope)
    edges = np.arange(6000.0, 8000.0, 50.0)
    for light in (
        partial(spectra, universe),
        lambda t: rates(universe, t, weights),
        lambda t: binned(universe, t, edges),
    ):
        np.testing.assert_allclose(light(some), light(first) + light(second), rtol=1e-5)
    assert (light(some) > light(first)).all()


@pytest.mark.parametrize(("ratio", "close"), [(1.02, True), (0.98, False)])
def test_a_companion_counts_from_a_share_of_all_light_on(ratio, close):
    """Of radius times temperature squared, squared: `faintest` of the star's; within `resolved`, inclusive."""
    _, columns = _columns(3)
    columns["radius"][:], columns["teff"][:] = 2.0, 5000.0
    radius = 2.0 * np.sqrt(ratio * LAW["faintest"]) * (5000.0 / 4000.0) ** 2
    pair = np.tile(np.array([1.0, 8.0, 4000.0, 4.7, 0.6, radius, 1.6, 1.5])[:, None], 3)
    join(columns, pair, np.array([0.0, LAW["resolved"], 1.001 * LAW["resolved"]]), NUMBERS)
    for name, value in (("teff2", 4000.0), ("logg2", 4.7), ("area2", (radius / 2) ** 2)):
        assert columns[name] == pytest.approx([value * close, value * close, 0.0]), name


def test_separations_by_hand():
    """Medians and one sigma of orbits cut at `widest`, foreshortened by their tilt, at 20 pc."""
    pair = np.zeros((len(Companions._fields), 4))
    pair[6], pair[7] = 1.6, 0.5
    widest = 10.0 ** (1.6 + 0.5)  # one sigma
    share = stats.norm.cdf(1.0)
    u = np.array([0.5, stats.norm.cdf(-1.0), 0.5, 1.0]) / np.array([share, share, share, 1.0])
    found = separations(u, np.array([0.0, 0.0, 0.6, 0.0]), pair, 20.0, widest)
    assert found == pytest.approx(np.array([10**1.6, 10**1.1, 0.8 * 10**1.6, widest]) / 20.0)


def test_a_pair_is_of_one_age_and_metallicity_and_none_has_left_the_main_sequence():
    """Of a solar star and of one as old as may be; the companion is that of its own mass; none of a dead star."""
    mass = np.full(200, 1.0)
    for age, feh in ((1.0, 0.0), (9.0, -0.5)):
        pair = companions(np.random.default_rng(6), mass, np.full(200, feh), np.full(200, age), NUMBERS)
        second = Companions(*pair).stellarmass
        stage = np.minimum(age / stage_ends(second, np.full(200, feh), NUMBERS)[0], 1.0)
        assert stage.max() > 0.1 * age / 9.0
        teff, logg, radius, m_v = living(second, np.full(200, feh), stage, np.zeros(200), NUMBERS)
        for name, values in (("teff", teff), ("logg", logg), ("radius", radius), ("m_v", m_v)):
            np.testing.assert_allclose(getattr(Companions(*pair), name), values, rtol=1e-12)
        for name in ("log_a", "spread"):
            law = np.interp(0.0, np.log(LAW["laws"]["mass"]), LAW["laws"][name])
            np.testing.assert_allclose(getattr(Companions(*pair), name), law)
