"""The galaxy population against closed forms and published counts, mass functions, colours and sizes."""

import copy
import itertools
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from scipy import integrate, optimize, stats
from scipy.special import gamma
from support import galaxy_sample

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.galaxies.galaxies import ARCMIN2_PER_DEG2, cumulative_counts
from csstsim.universe.galaxies.galaxy_shapes import (
    bulge_fraction,
    bulge_radius,
    disk_radius,
    draw_ellipticity,
    ellipticity_density,
    equal_area,
    to_arcsec,
    velocity_dispersion,
)
from csstsim.universe.galaxies.mass_function import TYPES, double_schechter, mass_function, smoothed_schechter
from csstsim.universe.galaxies.star_formation import (
    attenuation,
    cosmic_age,
    main_sequence,
    mean_age,
    mixture,
    young_fractions,
)

AREA = 0.04  # deg2 of the sample
PUBLISHED = read_data(Path(__file__).parents[1] / "published_galaxies.yaml")


@cache
def sample():
    return galaxy_sample.sample(AREA)


@cache
def bright():
    """Columns and magnitudes of the sample's galaxies with i < 26."""
    keep = sample()["i"] < 26
    columns = {name: values[keep] for name, values in sample().items()}
    return columns, galaxy_sample.magnitudes(columns)


@cache
def even():
    """(columns, galaxies per deg2 each stands for), evenly over the cells of the mass grid: bright ones known too."""
    model = galaxy_sample.population()
    cells = np.argwhere(model.grid.density > 0).T
    positions = model.grid.draw_in_cells(stream(9, "place"), *cells)
    return model.properties(lambda name: stream(9, name), *positions), model.grid.density[tuple(cells)]


def test_double_schechter_holds_the_integral_of_its_formula():
    log_mass = np.linspace(2, 13, 20001)
    phi = double_schechter(log_mass, 10.5, 1e-3, -0.4, 2e-4, 0.3)
    assert np.trapezoid(phi, log_mass) == pytest.approx(1e-3 * gamma(0.6) + 2e-4 * gamma(1.3), rel=1e-4)


@pytest.mark.parametrize("spread", [0.1, 0.2])
def test_smoothing_is_the_convolution(spread):
    log_mass, law = np.array([9.5, 10.5, 11.2, 11.5]), (10.69, 0.07e-3, 0.17, 0.4e-3, -1.5)
    step = np.linspace(-8 * spread, 8 * spread, 4001)
    kernel = stats.norm.pdf(step, scale=spread)
    expected = [np.trapezoid(double_schechter(m + step, *law) * kernel, step) for m in log_mass]
    np.testing.assert_allclose(smoothed_schechter(log_mass, *law, spread), expected, rtol=1e-3)
    np.testing.assert_array_equal(smoothed_schechter(log_mass, *law, 0.0), double_schechter(log_mass, *law))


@pytest.mark.parametrize("kinds", [TYPES, ("quiescent",)])
def test_mass_functions_against_published_points(kinds):
    """0.15 dex or three of their sigmas. Muzzin's point at 1e11.4, z < 0.5, is above Baldry's at z = 0: 0.45."""
    numbers = galaxy_sample.numbers()["mass_function"]
    for entry in PUBLISHED["mass_functions" if len(kinds) == 2 else "quiescent"]:
        log_mass, log_phi, sigma = np.transpose(entry["points"])
        phi = sum(mass_function(log_mass, np.mean(entry["z"]), kind, numbers, 70.0) for kind in kinds)
        limit = np.where((log_mass > 11.3) & (entry["z"] == [0.2, 0.5]), 0.45, np.maximum(3 * sigma, 0.15))
        assert (np.abs(np.log10(phi) - log_phi) < limit).all(), entry["name"]


def test_mass_function_scales_with_the_hubble_constant():
    numbers = galaxy_sample.numbers()["mass_function"]
    shifted = mass_function(np.array([9.5]) - 2 * np.log10(0.8 / 0.7), 1.0, "quiescent", numbers, 80.0)
    assert shifted == pytest.approx(mass_function([9.5], 1.0, "quiescent", numbers, 70.0) * (8 / 7) ** 3)


def test_drawn_masses_follow_the_mass_function_in_comoving_volume():
    grid, cosmology = galaxy_sample.population().grid, galaxy_sample.cosmology()
    count = 200_000
    z, log_mass, kind = grid.draw(stream(4, "mass"), count)
    numbers = galaxy_sample.numbers()["mass_function"]
    for (z0, z1), (m0, m1), k in itertools.product(((0.5, 0.52), (1.5, 1.52)), ((9.0, 9.5), (10.5, 11.0)), (0, 1)):
        m = np.linspace(m0, m1, 201)
        phi = mass_function(m, 0.5 * (z0 + z1), TYPES[k], numbers, cosmology.h0)
        expected = np.trapezoid(phi, m) * cosmology.volume(z0, z1) * count / grid.total
        found = ((z >= z0) & (z < z1) & (log_mass >= m0) & (log_mass < m1) & (kind == k)).sum()
        assert abs(found - expected) < 5 * np.sqrt(expected) + 0.03 * expected + 1, (z0, m0, k)


@pytest.mark.parametrize("rate_age", [1e-6, 0.02, 0.999999, 1.0, 1.5, 30.0, 500.0])
def test_ages_against_the_numerical_integral(rate_age):
    age, edges = 8e9, np.array([1e7, 1e9, 5e9, 2e10])
    fractions = young_fractions(np.log10([rate_age / age]), [age], edges)[0]
    assert fractions.sum() == pytest.approx(1) and (fractions >= 0).all() and fractions[-1] == 0
    a = np.concatenate([[0.0], np.geomspace(1.0, age, 400_001)])
    # tau from the definition: the rate now over the mass formed is rate_age / age.
    x = np.linspace(-600, 40, 640_001)[1::2]
    x = x[np.argmin(np.abs(np.log(x / np.expm1(x)) - np.log(rate_age)))]
    mass = integrate.cumulative_trapezoid(np.exp(np.clip(x * (a / age - (x > 0)), -700, 0)), a, initial=0)
    expected = np.diff(np.interp(edges, a, mass / mass[-1]), prepend=0, append=1)
    np.testing.assert_allclose(fractions, expected, atol=2e-3)


@pytest.mark.parametrize("rate_age", [1e-6, 0.02, 0.999999, 1.0, 1.000001, 1.5, 30.0, 500.0])
def test_the_mean_age_against_the_numerical_integral(rate_age):
    age = 8e9
    found = mean_age(np.log10([rate_age / age]), [age])[0]
    # Mass formed with exp(-u / t) of look-back u over the age: the rate now over the mass is rate_age / age.
    x = optimize.brentq(lambda x: np.log(x / np.expm1(x) if abs(x) > 1e-9 else 1 - x / 2) - np.log(rate_age), -600, 40)
    u = np.concatenate([[0.0], np.geomspace(1e-7, 1.0, 200_001)])
    mass = np.exp(np.clip(x * (u - (x > 0)), -700, 0))
    assert found / age == pytest.approx(np.trapezoid(u * mass, u) / np.trapezoid(mass, u), rel=3e-3, abs=1e-9)


def test_the_rate_is_that_of_the_ultraviolet_light():
    """Kennicutt (1998) with a Chabrier function, without dust: medians within 12% at any rate, before `shift`.

    The rate counts per mass that lives, the history per mass formed; the table of light makes up for the difference.
    """
    numbers = copy.deepcopy(galaxy_sample.numbers())
    numbers["dust"] |= {"cubic": [0.0] * 4, "quiescent": 0.0}
    model = galaxy_sample.population(numbers)
    z, log_mass, kind = model.grid.draw(stream(5, "mass"), 4000)
    columns = model.properties(lambda name: stream(9, name), z, log_mass, kind)
    wave = np.linspace(1450.0, 1550.0, 21)
    coefficients = np.transpose([columns[f"coeff{k}"] for k in range(20)])
    one = np.ones(len(z))
    photons = model.seds.spectra(0 * one, coefficients, one, 0 * one, wavelength=wave, igm=False)  # at 10 pc
    parsec_m, planck, light = 3.0857e16, 6.626e-27, 2.998e18
    luminosity = (photons * planck * light / wave).mean(axis=1) * 4 * np.pi * (10 * parsec_m) ** 2  # erg / s / A
    ratio = luminosity / 1.5e40 / columns["sfr"]
    rate = np.log10(columns["sfr"])
    for low, high in ((-9, -1), (-1, 0), (0, 1), (1, 3)):
        some = (kind == 0) & (rate > low) & (rate <= high)
        assert some.sum() > 30 and np.median(ratio[some]) == pytest.approx(1, abs=0.12)


def test_metallicity_is_the_mean_over_living_stars():
    """Two templates, by hand; a mixture of one has its own."""
    seds = galaxy_sample.seds()
    surviving, metals = seds.templates["surviving"], seds.templates["metals"]
    mix = np.array([[1.0, 0, 0, 0, 0], [0, 0, 3.0, 0, 1.0]])
    both = (3 * surviving[2] * metals[2] + surviving[4] * metals[4]) / (3 * surviving[2] + surviving[4])
    np.testing.assert_allclose(seds.metallicity(mix), [metals[0], both], rtol=1e-6)
    assert seds.metallicity(mix).min() > 0.005 and seds.metallicity(mix).max() <= 0.0501


def test_ages_and_rates_are_those_of_their_types():
    columns = sample()
    quiescent = columns["gal_type"] == 1
    assert (columns["stellarage"] > 0).all()
    assert (columns["stellarage"] * 1e9 < 0.95 * cosmic_age(columns["z"], galaxy_sample.cosmology())).all()
    assert np.median(columns["stellarage"][quiescent]) > 3 * np.median(columns["stellarage"][~quiescent])
    specific = columns["sfr"] / (columns["bulgemass"] + columns["diskmass"])
    for low, high, rate in ((0.0, 0.2, -11.5), (0.7, 3.0, -11.0)):
        some = quiescent & (columns["z"] > low) & (columns["z"] < high)
        assert np.median(np.log10(specific[some])) == pytest.approx(rate, abs=0.12)
    assert np.median(np.log10(specific[~quiescent])) > -9.5


def test_a_constant_rate_makes_fractions_proportional_to_time():
    np.testing.assert_allclose(young_fractions([-10.0], [1e10], [1e9, 4e9])[0], [0.1, 0.3, 0.6], atol=1e-4)


def test_mixture_is_per_solar_mass_that_survives():
    numbers = {"light": [[2.0, 0.0], [0.0, 0.5]], "surviving": [0.9, 0.5]}
    np.testing.assert_allclose(
        mixture(np.array([[1.0, 0.0], [0.5, 0.5]]), numbers), [[2 / 0.9, 0], [1 / 0.7, 0.25 / 0.7]]
    )


def test_cosmic_age_against_astropy():
    from astropy.cosmology import FlatLambdaCDM

    cosmology, z = galaxy_sample.cosmology(), np.array([0.0, 0.5, 1.0, 3.0, 7.0])
    expected = FlatLambdaCDM(cosmology.h0, cosmology.omega_m, Tcmb0=0).age(z).to_value("yr")
    np.testing.assert_allclose(cosmic_age(z, cosmology), expected, rtol=1e-5)


def test_main_sequence_of_schreiber_and_nearby():
    numbers = galaxy_sample.numbers()["star_formation"]
    m, r = 10.5 + 0.24 - 9.0, np.log10(2.0)  # Schreiber et al. (2015), equation 9, at z = 1
    expected = m - 0.5 + 1.5 * r - 0.3 * max(0, m - 0.36 - 2.5 * r) ** 2 - (9 + m)
    assert main_sequence(10.5, 1.0, numbers) == pytest.approx(expected)
    for log_mass in (9.0, 9.5, 10.0, 10.5):  # Renzini & Peng (2015): log SFR = 0.76 log M - 7.64
        assert main_sequence(log_mass, 0.05, numbers) == pytest.approx(-0.24 * log_mass - 7.64, abs=0.25)


def test_faint_limit_gives_the_papers_density():
    mag, total = cumulative_counts(galaxy_sample.numbers())
    assert total[-1] / ARCMIN2_PER_DEG2 == pytest.approx(552)
    assert mag[-1] == pytest.approx(29.93, abs=0.01) and (np.diff(mag) > 0).all() and (np.diff(total) > 0).all()
    slope = np.log10(np.interp(28.5, mag, np.gradient(total, mag)) / np.interp(26.5, mag, np.gradient(total, mag))) / 2
    assert slope == pytest.approx(0.175, abs=1e-3)


def test_unreachable_density_is_refused():
    with pytest.raises(ValueError, match="not reached"):
        cumulative_counts(galaxy_sample.numbers() | {"density": 1e9})


def test_number_of_galaxies_is_the_papers():
    expected = 552 * ARCMIN2_PER_DEG2 * AREA
    assert abs(len(sample()["i"]) - expected) < 5 * np.sqrt(expected) + 0.01 * expected
    assert sample()["i"].max() < cumulative_counts(galaxy_sample.numbers())[0][-1]


def test_i_counts_follow_the_table():
    columns, weight = even()
    mag, total = cumulative_counts(galaxy_sample.numbers())
    for m in np.arange(17.5, 28.6, 1.0):
        expected = np.diff(np.interp([m - 0.5, m + 0.5], mag, total))[0]
        inside = np.abs(columns["i"] - m) < 0.5
        noise = np.sqrt((weight[inside] ** 2).sum())
        assert abs(weight[inside].sum() - expected) < 0.1 * expected, (m, weight[inside].sum(), expected, noise)


def log_counts(mag, weight, centres):
    """log10 of galaxies per deg2 and magnitude, in bins of half a magnitude."""
    return np.log10([weight[np.abs(mag - m) < 0.25].sum() / 0.5 for m in centres])


def test_counts_beside_published_ones():
    """i, r, z to 15% of COSMOS2020 from 19 to 24.5 (0.06 dex, and 0.03 for this sample); r to 20% of bright surveys."""
    columns, weight = even()
    keep = columns["i"] < 27
    columns, weight = {name: values[keep] for name, values in columns.items()}, weight[keep]
    m = galaxy_sample.magnitudes(columns, ("r", "i", "z"))
    mag, i = np.transpose(PUBLISHED["i_counts"])
    assert np.abs(log_counts(m["i"], weight, mag) - i).max() < 0.09
    mag, r, z = np.transpose(PUBLISHED["cosmos"])
    assert np.abs(log_counts(m["r"], weight, mag) - r).max() < 0.12  # the field is 5-10% dense
    assert np.abs(log_counts(m["z"], weight, mag) - z).max() < 0.09
    for limit, number in PUBLISHED["r_cumulative"]:
        assert weight[m["r"] < limit].sum() == pytest.approx(number, rel=0.2), limit


def test_brightness_is_remapped_in_order_and_by_little():
    i, shift = np.transpose(galaxy_sample.numbers()["shift"])
    assert (np.diff(i + shift) > 0).all()
    assert np.abs(shift[(i >= 18) & (i <= 26)]).max() < 0.55


def test_no_galaxy_above_the_limit_is_left_out():
    faint = {name: values[sample()["i"] > 29] for name, values in sample().items()}
    model = galaxy_sample.population()
    mass = np.log10(faint["bulgemass"] + faint["diskmass"])
    z = np.linspace(0.02, 6.5, 40)  # instead of the floor, 0.05 dex higher: fewer than 0.4% of the faintest magnitude
    floor = np.interp(faint["z"], z, model._lightest_mass(z)) + 0.05
    assert (mass < floor).mean() < 4e-3


def test_magnitude_is_that_of_the_spectrum():
    columns, magnitudes = bright()
    np.testing.assert_allclose(magnitudes["i"], columns["i"], atol=2.5e-3)  # 2e-3 of the light


def test_median_colours():
    """0.07 mag, and 0.03 for this sample: r - z of COSMOS2020 in HSC's bands, F450W - F814W of the Hubble Deep Field.

    At i = 24 anchors on the red side, 0.1.
    """
    columns, weight = even()
    keep = columns["i"] < 26.5
    columns, weight = {name: values[keep] for name, values in columns.items()}, weight[keep]
    m = galaxy_sample.magnitudes(columns)

    def median(colour, near):
        order = np.argsort(colour := colour[near])
        total = np.cumsum(weight[near][order])
        return np.interp(0.5 * total[-1], total, colour[order])

    cosmos = PUBLISHED["r_z"]
    r_z = galaxy_sample.top_hat(columns, *cosmos["r"]) - galaxy_sample.top_hat(columns, *cosmos["z"])
    for z, colour in cosmos["medians"]:
        assert median(r_z, np.abs(m["z"] - z) < 0.5) == pytest.approx(colour, abs=0.1), z
    deep = PUBLISHED["hubble_deep_field"]
    blue_red = galaxy_sample.top_hat(columns, *deep["f450w"]) - galaxy_sample.top_hat(columns, *deep["f814w"])
    for i, colour, _ in deep["medians"]:
        assert median(blue_red, np.abs(columns["i"] - i) < 0.5) == pytest.approx(colour, abs=0.1), i
    near = np.abs(columns["i"] - 24) < 0.5
    for a, b, colour in (("r", "i", 0.4), ("i", "z", 0.25), ("z", "y", 0.1), ("g", "i", 0.9)):
        assert median(m[a] - m[b], near) == pytest.approx(colour, abs=0.1), (a, b)


def test_widths_of_halpha():
    """At 1e10 solar masses, with [NII], which grisms do not resolve: 20% on average over redshift, 45% at each.

    The templates' own are 2.2 to 3.7 times as wide. With redshift they grow more slowly than the published ones.
    """
    published = PUBLISHED["line_widths"]
    found = [galaxy_sample.line_width(z, published["log_mass"], 6510, 6630) for z in published["z"]]
    excess = np.log([width / (published["per_rate"][0] * rate) for width, rate in found])
    assert abs(excess.mean()) < np.log(1.2) and (np.abs(excess) < np.log(1.45)).all()


def test_balmer_lines_without_dust():
    """The two templates with strong lines: Halpha / Hbeta 2.86 (case B, 1e4 K); [NII] 6584 A 0.18, 0.32 of Halpha."""
    with fits.open(SHIPPED / "universe" / "galaxy_spectra.fits") as file:
        lines = file["LINES"].data[1:3, 0] @ file["BASIS"].data  # (template, wavelength), photons
    wavelength = galaxy_sample.seds().wavelength
    alpha, beta = (
        (lines / wavelength)[:, np.abs(wavelength - line) < half].sum(axis=1) for line, half in ((6565, 50), (4862, 15))
    )
    nitrogen = 4 / 3 * np.array([0.18, 0.32])  # with the line at 6548 A
    assert alpha / beta == pytest.approx(2.86 * (1 + nitrogen), rel=0.05)


def test_ultraviolet_counts():
    columns, weight = even()
    keep = columns["i"] < 27  # u - i of galaxies is above -1
    columns, weight = {name: values[keep] for name, values in columns.items()}, weight[keep]
    u = galaxy_sample.magnitudes(columns, ("u",))["u"]
    for mag, log in PUBLISHED["u_counts"][1:6]:  # brighter ones are up to 0.3 dex above its half a square degree
        inside = np.abs(u - mag) < 0.5
        assert np.log10(weight[inside].sum()) == pytest.approx(log, abs=0.18), mag


def test_colours_of_near_galaxies_reach_from_red_to_blue():
    columns, m = bright()
    near = (columns["z"] < 0.35) & (columns["i"] < 22.5)
    red = near & (columns["gal_type"] == 1)
    assert 1.4 < np.median((m["u"] - m["g"])[red]) < 1.8 and (m["u"] - m["g"])[red].max() > 1.65
    assert 0.75 < np.median((m["g"] - m["r"])[red]) < 1.3
    blue = near & (columns["gal_type"] == 0)
    assert np.median((m["u"] - m["g"])[blue]) < 1.0 and np.quantile((m["g"] - m["r"])[blue], 0.1) < 0.4


def test_colours_at_high_redshift_drop_out():
    columns, m = bright()
    z = columns["z"]
    assert np.median((m["u"] - m["g"])[(z > 3.1) & (z < 3.6)]) > 2
    assert np.median((m["g"] - m["r"])[(z > 4.2) & (z < 5.0)]) > 1.2
    gone = np.quantile(m["nuv"][(z > 2.2) & (z < 2.6)], 0.5) - np.median(m["u"][(z > 2.2) & (z < 2.6)])
    assert gone > 2  # nuv may be infinite


def test_redshifts():
    z = sample()["z"]
    assert 0.97 <= np.median(z[sample()["i"] < 26]) <= 1.13  # anchor 1.0 to 1.1; 1 sigma of this sample is 0.012
    assert z.min() > 0 and z.max() < 7.1
    medians = [np.median(z[sample()["i"] < m]) for m in (22, 24, 26, 28)]
    assert (np.diff(medians) > 0.1).all()


def test_sizes_beside_miller():
    """Semi-major axes of discs: Miller et al. (2013) is a fit at i < 25; ours within 1.3 of its scatter in ln r."""
    columns = sample()
    e = np.hypot(columns["e1"], columns["e2"])
    for i in range(21, 29):
        near = (np.abs(columns["i"] - i) < 0.25) & (columns["bulge_frac"] < 0.5)
        miller = np.log(1.678347) - 1.145 - 0.269 * (i - 23)
        axis = columns["size_disk"][near] * np.sqrt((1 + e) / (1 - e))[near]
        assert abs(np.median(np.log(axis)) - miller) < 0.45, i


def test_sizes_beside_hst():
    """Medians within 10% and two sigma of the 29 and 59 HST galaxies; this sample has a thousand."""
    columns = sample()
    half = galaxy_sample.half_light(columns)
    for low, high, radius, sigma in PUBLISHED["hst_sizes"]:
        some = (columns["i"] > low) & (columns["i"] < high)
        assert abs(np.median(half[some]) - radius) < 0.1 * radius + 2 * sigma, low


def test_disc_sizes_of_van_der_wel():
    """At 5e10 solar masses and the centres of their bins; half-way between them the mean of the logarithms."""
    numbers = galaxy_sample.numbers()["size"]["disk"]
    np.testing.assert_allclose(
        np.log10(disk_radius(10.7, np.array([0.25, 1.25, 1.5, 9.0]), numbers)), [0.86, 0.70, 0.675, 0.27]
    )
    assert np.log10(disk_radius(9.7, 0.25, numbers)) == pytest.approx(0.61)


def test_the_circle_of_equal_area():
    a, e = 2.0, np.array([0.0, 0.2, 0.6])
    b = a * (1 - e) / (1 + e)
    np.testing.assert_allclose(np.pi * equal_area(a, e) ** 2, np.pi * a * b)


def test_flat_galaxies_are_small_at_their_axis():
    """The semi-major axis does not depend on the outline: medians of round and flat discs of one mass and redshift."""
    columns = galaxy_sample.population().properties(
        lambda name: stream(6, name), np.full(20_000, 0.8), np.full(20_000, 10.0), np.zeros(20_000, np.int8)
    )
    e = np.hypot(columns["e1"], columns["e2"])
    axis = columns["size_disk"] * np.sqrt((1 + e) / (1 - e))
    assert np.median(axis[e < 0.15]) == pytest.approx(np.median(axis[e > 0.4]), rel=0.03)
    assert np.median(columns["size_disk"][e < 0.15]) > 1.4 * np.median(columns["size_disk"][e > 0.4])


def test_ellipticities_follow_the_prior_and_have_no_direction():
    numbers = galaxy_sample.numbers()["ellipticity"]
    disc = draw_ellipticity(stream(5, "disc"), np.zeros(40_000, bool), numbers)
    grid = np.linspace(0, numbers["e_max"], 4001)
    cdf = integrate.cumulative_trapezoid(ellipticity_density(grid, numbers), grid, initial=0)
    assert stats.kstest(np.abs(disc), lambda x: np.interp(x, grid, cdf / cdf[-1])).pvalue > 1e-6
    round_ = draw_ellipticity(stream(5, "round"), np.ones(40_000, bool), numbers)
    assert np.abs(round_).max() <= numbers["round_max"]
    ratio = (1 - np.abs(round_)) / (1 + np.abs(round_))
    assert (
        ratio.mean() == pytest.approx(0.68, abs=0.02)
        and ratio.mean() > ((1 - np.abs(disc)) / (1 + np.abs(disc))).mean()
    )
    for e in (disc, round_):
        assert abs(e.mean()) < 5 * np.abs(e).std() / np.sqrt(len(e)) + 5 * np.abs(e).mean() / np.sqrt(2 * len(e))


def test_sizes_in_arcsec_against_astropy():
    from astropy.cosmology import FlatLambdaCDM

    cosmology, z = galaxy_sample.cosmology(), np.array([0.01, 0.5, 2.0, 6.0])
    peer = FlatLambdaCDM(cosmology.h0, cosmology.omega_m, Tcmb0=0).arcsec_per_kpc_proper(z).value
    np.testing.assert_allclose(to_arcsec(3.0, z, cosmology), 3 * peer, rtol=1e-6)


def test_velocity_dispersion_of_a_massive_elliptical():
    assert velocity_dispersion(11.0, 5.0, galaxy_sample.numbers()["virial"]) == pytest.approx(200, rel=0.1)


def test_bulges_masses_and_types():
    columns = sample()
    quiescent = columns["gal_type"] == 1
    assert set(np.unique(columns["gal_type"])) == {0, 1}
    massive = columns["bulgemass"] + columns["diskmass"] > 10**10.5
    assert columns["bulge_frac"][massive & quiescent].mean() > columns["bulge_frac"][massive & ~quiescent].mean() + 0.1
    assert 0.3 < quiescent[massive & (columns["z"] < 1)].mean() < 0.7
    np.testing.assert_allclose(
        columns["bulgemass"], columns["bulge_frac"] * (columns["bulgemass"] + columns["diskmass"]), rtol=1e-5
    )


def test_all_values_are_finite_and_in_range():
    columns = sample()
    assert all(np.isfinite(values).all() for values in columns.values())
    for name in ("size_disk", "size_bulge", "sed_scale", "veldisp", "z"):
        assert (columns[name] > 0).all(), name
    assert (columns["bulge_frac"] > 0).all() and (columns["bulge_frac"] <= 1).all()
    assert np.hypot(columns["e1"], columns["e2"]).max() < 0.81
    assert columns["coeff19"].dtype == np.float32 and columns["i"].dtype == np.float64


def test_streams_are_apart():
    """Another stream for the sizes changes the sizes and nothing else; the same streams give the same galaxies."""
    model = galaxy_sample.population()

    def draw(seed):
        return model.draw(lambda name: stream(seed if name == "size" else 1, name), 5e-4)

    one, same, other = draw(1), draw(1), draw(2)
    for name, values in one.items():
        np.testing.assert_array_equal(values, same[name])
        if name not in ("size_disk", "size_bulge", "veldisp"):
            np.testing.assert_array_equal(values, other[name])
    assert not np.intersect1d(one["size_disk"], other["size_disk"]).size


def test_no_area_no_galaxies():
    columns = galaxy_sample.population().draw(lambda name: stream(1, name), 0.0)
    assert all(len(values) == 0 for values in columns.values()) and "coeff19" in columns


def test_sizes_of_early_types_bend_and_shrink():
    """Slopes above and below 10^10.3, joined there; 8 kpc at 10^11.01 today; (1 + z)^-1.3."""
    numbers = galaxy_sample.numbers()["size"]["bulge"]
    assert bulge_radius(11.01, 0.0, numbers) == pytest.approx(8.0)
    mass = np.array([11.51, 10.3, 9.3, 8.3])
    wanted = 8.0 * 10 ** np.array([0.28, 0.56 * -0.71, 0.56 * -0.71 - 0.1, 0.56 * -0.71 - 0.2])
    np.testing.assert_allclose(bulge_radius(mass, 0.0, numbers), wanted)
    np.testing.assert_allclose(bulge_radius(mass, np.full(4, 1.0), numbers), wanted * 2**-1.3)


def test_shares_of_bulges_by_type_and_mass():
    """Log-normal about 10^-0.635 and 10^-0.276 at 1e10; nothing is more than all bulge."""
    numbers, kind = galaxy_sample.numbers()["bulge"], np.array([0, 1, 0, 1, 1, 0])
    mass, normal = np.array([10.0, 10.0, 11.0, 9.0, 11.0, 10.0]), np.array([0.0, 0.0, 0.0, 0.0, 3.0, -2.0])
    wanted = 10 ** np.array([-0.635, -0.276, -0.365, -0.376, 0.0, -1.035])
    np.testing.assert_allclose(bulge_fraction(mass, kind, normal, numbers), wanted)


def test_dust_of_the_mass_and_the_redshift():
    """A cubic of log mass, held beyond 1.5 dex; (1 + z)^0.3."""
    numbers = galaxy_sample.numbers()["dust"]
    assert attenuation(10.0, 0.0, numbers) == pytest.approx(0.345)
    assert attenuation(11.0, 0.0, numbers) == pytest.approx(0.345 + 0.165 - 0.07 - 0.03)
    assert attenuation(9.0, 0.0, numbers) == pytest.approx(0.345 - 0.165 - 0.07 + 0.03)
    low, high = 0.345 - 0.2475 - 0.1575 + 0.10125, 0.345 + 0.2475 - 0.1575 - 0.10125
    np.testing.assert_allclose(attenuation([8.5, 7.0, 11.5, 13.0], 0.0, numbers), [low, low, high, high])
    assert attenuation(10.0, 1.0, numbers) == pytest.approx(0.345 * 2**0.3)


@cache
def alike(kind, log_mass=10.0, z=0.9, count=6000):
    """Columns of galaxies of one type, mass and redshift."""
    full = np.full(count, 1.0)
    return galaxy_sample.population().properties(
        lambda name: stream(7, name), z * full, log_mass * full, np.full(count, kind, np.int8)
    )


def spread(values):
    """Return mean and standard deviation; for normal values that of 6000 is good to 4% within 5 sigma."""
    return values.mean(), values.std()


def test_galaxies_of_one_mass_scatter_as_their_laws_say():
    """Rates, sizes and bulges, of both types; medians of their laws, and nothing of one in the other."""
    numbers, age = galaxy_sample.numbers(), cosmic_age(0.9, galaxy_sample.cosmology())
    formation = numbers["star_formation"]
    for kind, middle in ((0, main_sequence(10.0, 0.9, formation)), (1, -11.0)):
        columns = alike(kind)
        rate = np.log10(columns["sfr"].astype(float)) - 10.0
        assert spread(rate) == pytest.approx((middle, 0.3), rel=0.04)
        e = np.hypot(columns["e1"], columns["e2"])
        axis = np.log10(columns["size_disk"] / to_arcsec(1.0, 0.9, galaxy_sample.cosmology()))
        axis += 0.5 * np.log10((1 + e) / (1 - e))
        law = np.log10(disk_radius(10.0, 0.9, numbers["size"]["disk"]))
        assert spread(axis)[1] == pytest.approx(0.18, rel=0.04) and axis.mean() == pytest.approx(law, abs=0.012)
        fraction = np.log10(columns["bulge_frac"].astype(float))
        line = numbers["bulge"]["quiescent" if kind else "star_forming"][0]
        assert np.median(fraction) == pytest.approx(line, abs=0.015)
        low, _ = np.percentile(fraction, [15.87, 50])
        assert line - low == pytest.approx(0.2, abs=0.02)
        assert abs(np.corrcoef(rate, axis)[0, 1]) < 5 / np.sqrt(6000)
        np.testing.assert_allclose(columns["bulgemass"] + columns["diskmass"], 1e10, rtol=1e-5)
        radius = columns["bulge_frac"] * columns["size_bulge"] + (1 - columns["bulge_frac"]) * columns["size_disk"]
        radius = radius * np.sqrt((1 + e) / (1 - e)) / to_arcsec(1.0, 0.9, galaxy_sample.cosmology())
        np.testing.assert_allclose(columns["veldisp"], velocity_dispersion(10.0, radius, numbers["virial"]), rtol=1e-4)
    history = columns["stellarage"].astype(float) * 1e9  # of old galaxies it grows with the age, 0.6 to 0.95
    ends = [mean_age(rate, part * age * np.ones(6000)) for part in (0.6, 0.95)]
    position = (history - ends[0]) / (ends[1] - ends[0])
    assert -0.01 < position.min() < 0.02 and 0.98 < position.max() < 1.01 and 0.4 < np.median(position) < 0.6


def test_bulges_of_disks_are_smaller_than_these():
    """At most 0.6 of the disk's size where the disk has most light; an elliptical's size is that of its law."""
    columns = alike(1, 10.9)
    size, fraction = columns["size_bulge"] / columns["size_disk"], columns["bulge_frac"]
    assert size[fraction <= 0.5].max() <= 0.6 * (1 + 1e-5) and (size[fraction > 0.5] > 0.6).mean() > 0.3
    e = np.hypot(columns["e1"], columns["e2"])
    some = fraction > 0.5
    axis = np.log10(columns["size_bulge"] * np.sqrt((1 + e) / (1 - e)) / to_arcsec(1.0, 0.9, galaxy_sample.cosmology()))
    law = np.log10(bulge_radius(10.9, 0.9, galaxy_sample.numbers()["size"]["bulge"]))
    assert axis[some].std() == pytest.approx(0.2, rel=0.06) and axis[some].mean() == pytest.approx(law, abs=0.02)
    assert e[some].max() <= 0.55 < e[~some].max()


def test_dust_and_lines_of_galaxies_scatter():
    """As the seds are given them: dust grows with the inclination of star-forming ones, up to 3 mag."""
    model, count = galaxy_sample.population(), 6000
    numbers, full = model.numbers["dust"], np.ones(6000)
    for kind in (0, 1):
        e = np.repeat([0.0, 0.5], count // 2)
        mix, dust, lines, _ = model._stars(
            lambda name: stream(8, name), 0.9 * full, 10.0 * full, np.full(count, kind), e
        )
        face, edge = (np.log10(part) for part in np.split(dust, 2))
        middle = numbers["quiescent"] if kind else attenuation(10.0, 0.9, numbers)
        assert spread(face) == pytest.approx((np.log10(middle), 0.2), abs=0.02)
        assert np.median(edge) - np.median(face) == pytest.approx(0 if kind else 0.5 * np.log10(3.0), abs=0.025)
        assert np.median(np.log10(lines)) == pytest.approx(0.0, abs=0.015)
        assert np.log10(lines).std() == pytest.approx(0.2, rel=0.05)
        assert abs(np.corrcoef(np.log10(lines), np.log10(dust))[0, 1]) < 5 / np.sqrt(count)
        assert mix.shape == (count, 5)
    dusty = model._stars(lambda name: stream(8, name), 6.0 * full, 11.3 * full, np.zeros(count, int), 0.8 * full)[1]
    assert dusty.max() == 3.0


@pytest.mark.parametrize("z, rate", [(0.0, -11.6), (0.15, -11.5), (0.45, -11.2), (2.0, -11.0)])
def test_quiescent_galaxies_form_few_stars(z, rate):
    columns = alike(1, 10.0, max(z, 1e-3), 400)
    assert np.median(np.log10(columns["sfr"].astype(float))) - 10 == pytest.approx(rate, abs=0.08)


def test_the_lightest_mass_is_that_of_a_blue_galaxy_at_the_limit():
    """A galaxy 2 sigma above the main sequence at that mass and the margin is as faint as the faint limit."""
    model = galaxy_sample.population()
    z = np.array([0.1, 1.0, 3.0])
    formation, mass = model.numbers["star_formation"], model._lightest_mass(z) + model.numbers["margin"]["dex"]
    rate = main_sequence(np.full(3, 7.0), z, formation) + 2 * formation["scatter"]
    age = cosmic_age(z, galaxy_sample.cosmology()) * 0.775
    mix = mixture(young_fractions(rate, age, formation["edges"]), formation) * 10 ** mass[:, None]
    coefficients = model.seds.coefficients(mix, attenuation(np.full(3, 7.0), z, model.numbers["dust"]), np.ones(3))
    scale = (galaxy_sample.cosmology().luminosity_distance(z) / 1e-5) ** -2.0
    model_i = model._magnitude(z, coefficients, scale)
    shift = np.interp(model_i, *np.transpose(model.numbers["shift"]))
    assert model_i + shift == pytest.approx(np.full(3, model.limit), abs=0.01)


@pytest.mark.parametrize(
    ("kind", "z0", "z1", "wide"), [("star_forming", 1.3, 1.75, (0.1, 0.15)), ("quiescent", 0.35, 0.65, (0, 0))]
)
def test_mass_functions_are_the_table_s_rows_and_their_geometric_mean(kind, z0, z1, wide):
    """At a row's redshift the smoothed function of that row; half way between two, the root of both."""
    numbers, mass = galaxy_sample.numbers()["mass_function"], np.array([9.3, 10.4, 11.3])
    rows = {row[0]: row[1:] for row in numbers[kind]}
    one, other = (smoothed_schechter(mass, *rows[z], spread) for z, spread in zip((z0, z1), wide, strict=True))
    np.testing.assert_allclose(mass_function(mass, z0, kind, numbers, 70.0), one, rtol=1e-9)
    np.testing.assert_allclose(
        mass_function(mass, 0.5 * (z0 + z1), kind, numbers, 70.0), np.sqrt(one * other), rtol=1e-9
    )


@pytest.mark.parametrize(("z", "slope"), [(0.0, -1.45), (1.25, -1.475), (3.0, -1.575), (7.0, -1.9)])
def test_mass_functions_go_on_as_power_laws_below_the_pivot(z, slope):
    numbers = galaxy_sample.numbers()["mass_function"]
    low, at, high = mass_function([8.0, 9.0, 9.0001], z, "star_forming", numbers, 70.0)
    assert np.log10(low / at) == pytest.approx(-(1 + slope)) and high == pytest.approx(at, rel=1e-2)


def test_dust_of_the_milky_way_and_the_scale_multiply_a_galaxy_s_light():
    seds = galaxy_sample.seds()
    mix = seds.coefficients(np.eye(5)[[1, 3]], [0.2, 0.0], [1.0, 1.0])
    dusty, clear = (
        seds.spectra([0.3, 1.0], mix, scale, av) for scale, av in (([2.0, 5.0], [0.7, 0.2]), ([1, 1], [0, 0]))
    )
    factor = np.array([[2.0], [5.0]]) * 10 ** (-0.4 * np.array([[0.7], [0.2]]) * seds.extinction)
    np.testing.assert_allclose(dusty, factor * clear, rtol=1e-9)


def test_light_moves_and_thins_with_redshift():
    """Photon densities: what leaves at rest wavelength arrives stretched by 1 + z; without the medium's absorption."""
    seds = galaxy_sample.seds()
    mix = seds.coefficients(np.eye(5)[[3]], [0.0], [0.0])
    wave = np.linspace(3000.0, 5000.0, 41)
    here = seds.spectra([0.0], mix, [1.0], [0.0], wave, igm=False)[0]
    there = seds.spectra([0.8], mix, [1.0], [0.0], 1.8 * wave, igm=False)[0]
    np.testing.assert_allclose(there, here, rtol=1e-9)
