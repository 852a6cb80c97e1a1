"""Galaxies' spectra: the fast integral against the sum over the grid, positions of breaks and lines."""

from pathlib import Path

import galsim
import numpy as np
import pytest
from support.embedded_sky import shipped

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.light.photometry import subband_weights
from csstsim.instrument.filter import GRID
from csstsim.instrument.load import read_data
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.dust.extinction import odonnell
from csstsim.universe.galaxies.galaxy_sed import GalaxySeds, distance_scale

OLD, YOUNG = 3, 1  # of the five templates: no stars younger than 1 Gyr; all younger than 300 Myr


@pytest.fixture(scope="module")
def seds():
    return shipped()[0].galaxy_seds


def _galaxies(seds, count, seed=1):
    """Random galaxies: redshifts 0 to 6, all templates, dust and Milky Way extinction."""
    rng = np.random.default_rng(seed)
    masses = rng.dirichlet(np.full(5, 0.4), count)
    mix = seds.coefficients(masses, rng.exponential(0.6, count), rng.lognormal(0, 0.5, count))
    return rng.uniform(0, 6, count), mix, rng.uniform(0, 1, count)


def _old(seds, lines=0.0):
    return seds.coefficients(np.eye(5)[[OLD]], [0.0], [lines])


@pytest.mark.parametrize("band", ["NUV", "u", "g", "r", "i", "z", "y"])
def test_rates_are_the_sum_over_the_grid(seds, camera, band):
    """1e-4 of the light that arrives, or 1e-5 of what would without the intergalactic medium."""
    z, mix, av = _galaxies(seds, 120)
    weights = subband_weights(camera.filters[band], camera.telescope)
    direct = seds.spectra(z, mix, np.ones(len(z)), av) @ weights.T
    clear = seds.spectra(z, mix, np.ones(len(z)), av, igm=False) @ weights.T
    error = np.abs(seds.rates(z, mix, av, weights) - direct)
    assert (error <= 1e-4 * direct + 1e-5 * clear).all()
    assert (direct > 0.1 * clear).sum() > 100


def test_edges_of_the_input(seds, camera):
    weights = subband_weights(camera.filters["g"], camera.telescope)
    assert seds.rates(np.zeros(0), np.zeros((0, COEFFICIENTS)), np.zeros(0), weights).shape == (0, 4)
    z, mix, av = (part[:1] for part in _galaxies(seds, 1))
    assert np.isnan(seds.rates(z, mix * np.nan, av, weights)).all()
    beside = seds.rates(np.repeat(z, 2), np.repeat(mix, 2, axis=0), np.array([av[0], np.nan]), weights)
    assert np.isnan(beside[1]).all() and beside[:1] == pytest.approx(seds.rates(z, mix, av, weights), rel=1e-12)
    thick = seds.rates(np.array([0.5]), mix, np.array([5.0]), weights)
    direct = seds.spectra(np.array([0.5]), mix, [1.0], [5.0]) @ weights.T
    assert thick == pytest.approx(direct, rel=1e-4)
    assert not seds.rates(np.array([30.0]), mix, av, weights).any()  # all below 600 A at rest
    assert not seds.rates(z, mix, av, np.zeros((2, len(GRID)))).any()


def test_coefficients_are_linear_in_mass_and_never_extrapolate_dust(seds):
    mix = np.random.default_rng(2).random((4, 5))
    dust, lines = np.array([0.0, 0.33, 3.0, 9.0]), np.array([0.0, 1.0, 2.0, 1.0])
    once = seds.coefficients(mix, dust, lines)
    assert seds.coefficients(3 * mix, dust, lines) == pytest.approx(3 * once)
    assert seds.coefficients(mix[3:], [3.0], lines[3:]) == pytest.approx(once[3:])


@pytest.mark.parametrize("dust", [0.3, 1.0])
def test_dust_dims_as_the_steep_curve_of_calzetti(seds, dust):
    """Calzetti et al. (2000, equation 4) by hand, times (lambda / 5500 A)^slope (Salim et al. 2018): 0.02 mag."""
    slope = read_data(SHIPPED / "universe" / "galaxies.yaml")["dust"]["slope"]
    mix = [seds.coefficients(np.eye(5)[[YOUNG]], [a], [0.0]) for a in (dust, 0.0)]
    bands = ((1500, 10.33), (2300, 8.21), (3000, 6.93), (4400, 5.06), (5500, 4.05), (8000, 2.57))
    for at, k in bands:  # k = 2.659 (-2.156 + 1.509 x - 0.198 x^2 + 0.011 x^3) + 4.05 below 6300 A, x in 1 / micrometre
        wave = np.linspace(at - 30.0, at + 30.0, 61)
        dim, clear = (seds.spectra([0.0], m, [1.0], [0.0], wavelength=wave, igm=False).sum() for m in mix)
        assert -2.5 * np.log10(dim / clear) == pytest.approx(dust * k / 4.05 * (at / 5500) ** slope, abs=0.02), at


def test_the_old_template_breaks_at_4000_angstrom(seds):
    """D4000 (Bruzual 1983: mean f_nu of 4050-4250 over 3750-3950 A) : old 1.7 to 2.4, young near 1."""

    def d4000(mix):
        photons = seds.spectra([0.0], mix, [1.0], [0.0])[0]
        f_nu = photons * GRID  # to a constant
        red, blue = ((low < GRID) & (high > GRID) for low, high in ((4050, 4250), (3750, 3950)))
        return f_nu[red].mean() / f_nu[blue].mean()

    assert 1.7 < d4000(_old(seds)) < 2.4
    assert 0.8 < d4000(seds.coefficients(np.eye(5)[[YOUNG]], [0.0], [0.0])) < 1.25


@pytest.mark.parametrize(("line", "z"), [(6565, 0.2), (5008, 0.5), (3728, 1.0)])
def test_emission_lines_stand_at_their_redshifted_place(seds, line, z):
    mix = [seds.coefficients(np.eye(5)[[YOUNG]], [0.0], [strength]) for strength in (1.0, 0.0)]
    with_lines, without = (seds.spectra([z], m, [1.0], [0.0])[0] for m in mix)
    near = np.abs(GRID - line * (1 + z)) < 40 * (1 + z)
    excess = (with_lines - without)[near]
    assert np.average(GRID[near], weights=np.maximum(excess, 0)) == pytest.approx(line * (1 + z), abs=6 * (1 + z))
    assert excess.max() > 0.3 * without[near].mean()


def test_light_below_the_lyman_limit_is_gone_and_the_break_moves(seds):
    mix = seds.coefficients(np.eye(5)[[YOUNG]], [0.0], [0.0])
    for z in (2.5, 4.0):
        sed = seds.spectra([z], mix, [1.0], [0.0])[0]
        below, above = (np.abs(GRID - at * (1 + z)) < 30 for at in (880, 1300))
        assert sed[below].mean() < 0.02 * sed[above].mean()


@pytest.mark.parametrize("pair", ["gr", "ri", "iz"])
def test_colours_of_an_old_galaxy_follow_the_observed_elliptical(seds, camera, pair):
    """Against the elliptical of Coleman, Wu & Weedman (1980, ApJS 43, 393; GalSim's copy) at z = 0 to 0.5: 0.15 mag."""
    file = Path(galsim.meta_data.share_dir) / "SEDs" / "CWW_E_ext.sed"
    wave, flam = np.loadtxt(file).T
    filters = [camera.filters[band] for band in pair]
    weights = [subband_weights(f, camera.telescope).sum(axis=0) for f in filters]
    zero = filters[0].zeropoint(camera.telescope) - filters[1].zeropoint(camera.telescope)
    for z in (0.0, 0.1, 0.2, 0.3, 0.4, 0.5):
        observed = np.interp(GRID / (1 + z), wave, wave * flam)
        computed = seds.rates([z], _old(seds, 0.3), [0.0], np.stack(weights))[0]
        reference = [(observed * w).sum() for w in weights]
        colour, published = (zero - 2.5 * np.log10(light[0] / light[1]) for light in (computed, reference))
        assert colour == pytest.approx(published, abs=0.15), z


def test_metallicity_is_that_of_living_stars(seds):
    """One template has its own, whatever its mass; of two, the mass in living stars is the weight."""
    metals, surviving = seds.templates["metals"], seds.templates["surviving"]
    assert seds.metallicity(np.diag([1.0, 2.0, 1e9, 4.0, 5.0])) == pytest.approx(metals, rel=1e-12)
    first, last = int(metals.argmin()), int(metals.argmax())
    assert abs(surviving[first] - surviving[last]) > 0.05, "templates that tell formed from living stars"
    mix = np.zeros((1, 5))
    mix[0, [first, last]] = 3.0, 7.0
    masses = 3.0 * surviving[first], 7.0 * surviving[last]
    expected = (masses[0] * metals[first] + masses[1] * metals[last]) / (masses[0] + masses[1])
    assert seds.metallicity(mix) == pytest.approx([expected], rel=1e-12)


def test_distance_scale_is_the_inverse_square():
    assert distance_scale(1e-5) == pytest.approx(1.0)
    assert distance_scale([100.0, 200.0]) == pytest.approx([1e-14, 2.5e-15])


def test_a_damaged_file_is_refused(tmp_path):
    path = tmp_path / "galaxy_spectra.fits"
    path.write_bytes(b"SIMPLE")
    with pytest.raises(InputError, match=r"galaxy_spectra\.fits"):
        GalaxySeds(path, {}, odonnell(GRID))
