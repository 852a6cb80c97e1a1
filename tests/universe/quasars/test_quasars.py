"""Quasars: their number, brightness and host galaxies."""

from functools import cache

import numpy as np
import pytest
from scipy import integrate, stats

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.light.photometry import rate_to_mag, subband_weights
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID
from csstsim.instrument.load import read_data
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.dust.extinction import odonnell
from csstsim.universe.lensing.cosmology import Cosmology
from csstsim.universe.quasars.quasar_sed import QuasarSeds
from csstsim.universe.quasars.quasars import cumulative_counts, draw_quasars, luminosity_function, match_hosts

NUMBERS = read_data(SHIPPED / "universe" / "quasars.yaml")
COSMOLOGY = Cosmology(read_data(SHIPPED / "universe" / "cosmology.yaml"))
NOBODY = {"z": np.zeros(0), "bulgemass": np.zeros(0)}


def draw(area, galaxies=NOBODY, seed=11):
    return draw_quasars(lambda name: stream(seed, "test quasars", name), area, galaxies, NUMBERS, COSMOLOGY)


@cache
def sample():
    """10 deg2 of quasars without hosts."""
    return draw(10.0)


@cache
def galaxies():
    rng = np.random.default_rng(3)
    z = np.append(rng.gamma(3, 0.4, 40_000), np.nan).astype(np.float32)
    return {"z": z, "bulgemass": np.append(10 ** rng.normal(9, 1, 40_000), 1e11).astype(np.float32)}


# Binned luminosity functions: log10 of quasars per Mpc3 and magnitude at (z, M1450).
@pytest.mark.parametrize(
    ("z", "m1450", "published", "tolerance"),
    [
        (4.9, -25.35, -7.36, 0.25), (4.9, -24.25, -7.14, 0.35),  # McGreer et al. 2013, ApJ 768, 105, faint sample
        (4.9, -26.45, -7.9, 0.35), (4.9, -27.55, -8.51, 0.35),
    ],
)  # fmt: skip
def test_luminosity_function_beside_published_points(z, m1450, published, tolerance):
    assert np.log10(luminosity_function(m1450, z, NUMBERS)) == pytest.approx(published, abs=tolerance)


@pytest.mark.parametrize("chosen", ["published", "simqso"])
def test_luminosity_function_is_a_double_power_law(chosen):
    numbers = NUMBERS | {"luminosity_function": chosen}
    for z, part in ((1.0, "low"), (3.0, "high")):
        law = numbers[chosen][part]
        faint, bright = ([m, m + 0.1] for m in (-10.0, -45.0))
        alpha = law["alpha"][0][1] if isinstance(law["alpha"], list) else law["alpha"]  # of z up to 1
        for pair, slope in ((faint, alpha), (bright, law["beta"])):
            gained = np.diff(np.log10(luminosity_function(pair, z, numbers)))[0]
            assert gained == pytest.approx(-0.04 * (slope + 1), rel=1e-3)
    # At the break both terms are 1: half of phi*.
    at_break = luminosity_function(-26.49 + 1.486, 2.2, numbers)
    assert np.log10(at_break) == pytest.approx(-5.83 - np.log10(2), abs=1e-9)


def test_the_two_pieces_meet():
    m1450 = np.linspace(-28, -20, 50)
    step = np.log10(luminosity_function(m1450, 2.2, NUMBERS) / luminosity_function(m1450, 2.2 - 1e-9, NUMBERS))
    assert np.abs(step).max() < 0.06  # dex


def test_counts_are_the_integral_over_volume():
    edges, total = cumulative_counts(NUMBERS, COSMOLOGY)

    def per_z(z):
        m1450 = np.linspace(*NUMBERS["m1450"], 2001)
        volume = COSMOLOGY.volume(z - 1e-4, z + 1e-4) / 2e-4
        return integrate.simpson(luminosity_function(m1450, z, NUMBERS), x=m1450) * volume

    found = np.interp(2.0, edges, total)
    assert found == pytest.approx(integrate.quad(per_z, 0.1, 2.0, limit=100)[0], rel=2e-4)
    assert edges[0] == 0.1 and edges[-1] == 6.0 and (np.diff(total) > 0).all()


def test_draws_follow_the_luminosity_function():
    quasars = sample()
    edges, total = cumulative_counts(NUMBERS, COSMOLOGY)
    assert abs(len(quasars["z"]) - 10 * total[-1]) < 5 * np.sqrt(10 * total[-1])
    assert stats.kstest(quasars["z"], lambda z: np.interp(z, edges, total / total[-1])).pvalue > 1e-4
    m1450 = np.linspace(*NUMBERS["m1450"], 1301)
    some = np.abs(quasars["z"] - 2.0) < 0.1
    phi = luminosity_function(m1450, 2.0, NUMBERS)
    cdf = integrate.cumulative_trapezoid(phi, m1450, initial=0)
    assert some.sum() > 200
    assert stats.kstest(quasars["m1450"][some], lambda m: np.interp(m, m1450, cdf / cdf[-1])).pvalue > 1e-4
    assert quasars["m1450"].max() <= -18.0


def test_density_on_the_sky():
    """About 100 deg-2 at g < 22 and 300 to 400 at g < 24 (CSST g, no Milky Way dust), each +-35% + 3 sigma."""
    quasars, camera = sample(), load_camera(SHIPPED / "instrument")
    seds = QuasarSeds(NUMBERS, read_data(SHIPPED / "universe" / "galaxies.yaml")["igm"], odonnell(GRID))
    own = np.column_stack([quasars[f"coeff{k}"] for k in range(COEFFICIENTS)])
    keep = slice(0, 3000)
    area = 10.0 * min(1.0, 3000 / len(own))
    g = camera.filters["g"]
    weights = subband_weights(g, camera.telescope).sum(axis=0)[None]
    rates = seds.rates(quasars["z"][keep], own[keep], np.zeros(len(own[keep])), weights)[:, 0]
    mag = rate_to_mag(rates * quasars["sed_scale"][keep], g, camera.telescope)
    for limit, low, high in ((22.0, 100, 100), (24.0, 300, 400)):
        found = (mag < limit).sum() / area
        sigma = np.sqrt(found / area)
        assert 0.65 * low - 3 * sigma < found < 1.35 * high + 3 * sigma, (limit, found)


def test_density_below_redshift_one():
    """Palanque-Delabrouille et al. (2016), table 7, PLE+LEDE, z < 1, summed from the brightest; 12% and 3 sigma."""
    quasars, camera = sample(), load_camera(SHIPPED / "instrument")
    near = quasars["z"] < 1
    seds = QuasarSeds(NUMBERS, read_data(SHIPPED / "universe" / "galaxies.yaml")["igm"], odonnell(GRID))
    own = np.column_stack([quasars[f"coeff{k}"][near] for k in range(COEFFICIENTS)])
    r = camera.filters["r"]
    weights = subband_weights(r, camera.telescope).sum(axis=0)[None]
    rates = seds.rates(quasars["z"][near], own, np.zeros(len(own)), weights)[:, 0] * quasars["sed_scale"][near]
    mag = rate_to_mag(rates, r, camera.telescope)
    for limit, expected in ((20, 7.9), (21, 18.0), (22, 34.0), (23, 59.0), (24, 97.6)):
        found = (mag < limit).sum() / 10.0
        assert abs(found - expected) < 0.12 * expected + 3 * np.sqrt(expected / 10.0), (limit, found)


def test_faint_slope_as_a_table():
    """Rows of z and alpha: linear between, constant outside; one number is the same at all redshifts."""
    law = NUMBERS["simqso"] | {"low": NUMBERS["simqso"]["low"] | {"alpha": [[0.5, -1.6], [1.5, -1.2]]}}
    numbers = NUMBERS | {"luminosity_function": "simqso", "simqso": law}
    for z, alpha in ((0.2, -1.6), (1.0, -1.4), (2.0, -1.2)):
        law["high"] = law["low"] | {"alpha": alpha}
        one = NUMBERS | {"luminosity_function": "simqso", "simqso": law | {"low": law["high"]}}
        assert luminosity_function(-21.0, z, numbers) == pytest.approx(luminosity_function(-21.0, z, one))


def test_apparent_brightness_is_that_at_the_distance():
    quasars = sample()
    # f_nu at 1450 (1 + z) A is (1 + z) L_nu / (4 pi d_L^2); at 10 pc L_nu gives M1450.
    distance = COSMOLOGY.luminosity_distance(quasars["z"].astype(float)) / 1e-5
    flux = (1 + quasars["z"].astype(float)) * 10 ** (-0.4 * quasars["m1450"].astype(float)) / distance**2
    np.testing.assert_allclose(quasars["sed_scale"], flux, rtol=1e-5)


def test_hosts_are_distinct_galaxies_of_the_same_bin_in_order_of_luminosity():
    quiet = NUMBERS | {"hosts": NUMBERS["hosts"] | {"scatter": 0.0}}
    rng = np.random.default_rng(1)
    z, m1450 = rng.uniform(0.1, 3.0, 300), rng.uniform(-28, -20, 300)
    host = match_hosts(rng, z, m1450, galaxies(), quiet)
    assert (host >= 0).all() and len(np.unique(host)) == 300
    host_bin = np.floor(galaxies()["z"][host].astype(float) / 0.1)
    assert (host_bin == np.floor(z / 0.1)).all()
    for this in np.unique(host_bin):
        some = host_bin == this
        mass = galaxies()["bulgemass"][host[some]]
        assert (np.diff(mass[np.argsort(m1450[some])]) <= 0).all()
        others = np.setdiff1d(np.flatnonzero(np.floor(galaxies()["z"].astype(float) / 0.1) == this), host)
        assert galaxies()["bulgemass"][others].max() <= mass.min()  # the heaviest bulges are the hosts
    scattered = match_hosts(np.random.default_rng(2), z, m1450, galaxies(), NUMBERS)
    assert 0.3 < stats.spearmanr(-m1450, np.log(galaxies()["bulgemass"][scattered]))[0] < 1


def test_every_galaxy_accretes_at_a_rate_of_its_own():
    """Of galaxies with one bulge mass those of a quasar are any, and the order of their rows is none."""
    equal = {"z": np.full(2000, 1.05), "bulgemass": np.full(2000, 1e10)}
    host = match_hosts(np.random.default_rng(4), np.full(500, 1.02), np.linspace(-28, -20, 500), equal, NUMBERS)
    assert stats.kstest(host / 2000, "uniform").pvalue > 1e-3
    assert abs(stats.spearmanr(np.arange(500), host)[0]) < 5 / np.sqrt(500)


def test_quasars_take_the_redshift_of_their_hosts():
    found = draw(0.3, galaxies())
    matched = found["host"] >= 0
    assert matched.mean() > 0.9
    assert (found["z"][matched] == galaxies()["z"][found["host"][matched]]).all()
    unmatched = draw(0.3)
    assert (unmatched["host"] == -1).all() and np.abs(found["z"] - unmatched["z"]).max() < 0.1
    np.testing.assert_array_equal(found["m1450"], unmatched["m1450"])  # hosts change no other draw


def test_more_quasars_than_galaxies_and_galaxies_without_bulge():
    few = {"z": np.array([1.05, 1.06, 1.07, 1.08]), "bulgemass": np.array([1e9, 1e11, np.nan, 0.0])}
    z, m1450 = np.array([1.01, 1.02, 1.03]), np.array([-22.0, -25.0, -23.0])
    quiet = NUMBERS | {"hosts": NUMBERS["hosts"] | {"scatter": 0.0}}
    assert list(match_hosts(np.random.default_rng(0), z, m1450, few, quiet)) == [-1, 1, 0]
    assert len(match_hosts(np.random.default_rng(0), z[:0], m1450[:0], few, quiet)) == 0


def test_columns_repeat_and_have_their_types():
    first, again, other = draw(1.0), draw(1.0), draw(1.0, seed=12)
    assert list(first) == ["z", "m1450", "sed_scale", *(f"coeff{k}" for k in range(COEFFICIENTS)), "host"]
    for name, values in first.items():
        assert values.dtype == (np.int64 if name == "host" else np.float32)
        assert np.isfinite(values).all() and (values == again[name]).all()
    assert len(other["z"]) != len(first["z"]) or (other["z"] != first["z"]).any()
    assert len(draw(0.0)["z"]) == 0
    spread = np.std([sample()[f"coeff{k}"] for k in range(1, 5)], axis=1)
    np.testing.assert_allclose(spread, NUMBERS["continuum"]["scatter"], rtol=0.06)
    assert (sample()["coeff19"] == 0).all() and (sample()["coeff0"] == sample()["m1450"]).all()


def test_lines_scatter_by_family_and_draws_are_apart():
    """In the order of the families; slopes and strengths know nothing of each other."""
    names = [name for name in NUMBERS["families"] if name != "m1450"]
    scatter = [NUMBERS["families"][name]["scatter"] for name in names]
    assert names[10] == "narrow" and scatter[10] == 0.25 and len(names) == 12
    own = np.array([sample()[f"coeff{k}"] for k in range(1, 17)], dtype=float)
    n = own.shape[1]
    np.testing.assert_allclose(own[4:].std(axis=1), scatter, rtol=5 / np.sqrt(2 * n))
    assert (np.abs(own.mean(axis=1)) < 5 * own.std(axis=1) / np.sqrt(n)).all()
    assert np.abs(np.corrcoef(own) - np.eye(16)).max() < 5 / np.sqrt(n)


@pytest.mark.parametrize("z, value", [(0.5, -1.42), (1.6, -1.36), (5.0, -1.3)])
def test_a_number_of_the_luminosity_function_at_a_redshift(z, value):
    """Of the shipped one, whose faint slope is a table; by two magnitudes far below the break."""
    numbers = NUMBERS | {"luminosity_function": "simqso"}
    gained = np.diff(np.log10(luminosity_function([-5.0, -4.0], z, numbers)))[0]
    assert gained == pytest.approx(-0.4 * (value + 1), abs=1e-4)


def test_the_break_moves_with_redshift():
    """Both terms are equal at M*(z) in closed form; their number falls beyond the switch."""
    for z, chosen in ((1.0, "low"), (3.0, "high")):
        law = NUMBERS["simqso"][chosen]
        step = z - law["pivot"]
        at = law["m_star"] + 1.486 - 2.5 * (law["k1"] * step + law["k2"] * step**2)
        wanted = law["log_phi"] + law["log_phi_slope"] * step - np.log10(2)
        assert np.log10(luminosity_function(at, z, NUMBERS)) == pytest.approx(wanted, abs=1e-9)
