"""Smooth matter and haloes together: spectra, lensing, density, tides; edges and errors."""

import healpy
import numpy as np
import pytest
from universe.lensing.test_lensing_field import CAMB, ELL
from universe.structure.small_matter import COARSE, COSMOLOGY, FEW, NUMBERS, coarse, shipped

from csstsim.universe.structure.halo_spectra import HaloSpectra
from csstsim.universe.structure.matter_field import MatterField

COMMON, POLE = 100000, 65535


def inside(pix, count, seed=1):
    """Return ra, dec of random positions in a brick."""
    children = np.random.default_rng(seed).integers(0, 1 << 42, count)
    return healpy.pix2ang(1 << 29, (pix << 42) + children, nest=True, lonlat=True)


@pytest.mark.parametrize("haloes", [True, False])
def test_spectrum_with_haloes_is_halofit(haloes):
    matter, ell = shipped(haloes), np.array([30, 100, 300, 1000, 3000, 10000, 20000])
    for z, camb in CAMB.items():
        np.testing.assert_allclose(matter.spectrum(ell, z), matter.shells.limber(ell, z), rtol=0.025)
        np.testing.assert_allclose(matter.spectrum(ELL, z), camb, rtol=0.03)
    assert (matter.amplitude >= 0).all()


def test_haloes_part_by_brute_force():
    """C_1h of a shell, from its definition, at single multipoles."""
    matter = shipped()
    spectra, haloes, shell = matter.spectra, matter.mass_function, 13
    near, far = matter.shells.edges[shell : shell + 2]
    chi = 0.5 * (near + far)
    z = float(np.interp(chi, *matter.shells.distances))
    mass = np.geomspace(3e12, 5e15, 400)
    numbers = NUMBERS["haloes"]
    r200 = haloes.virial_radius(mass)
    shape = numbers["compensation"]
    disc = np.interp(np.log(mass), np.log(shape["mass"]), shape["ratio"]) * haloes.lagrangian_radius(mass)
    c = matter.haloes.mean_concentration(mass, z)
    y, cuts = np.linspace(0, 1, 2001)[1:], np.array(numbers["cuts"])
    r = np.linspace(0, cuts[-1], 4001)[1:]  # over the virial radius
    fraction = (r < cuts[:, None]).mean(axis=0)  # of the density that is left there
    from scipy.special import j0

    for ell in (700, 4000):
        k = (ell + 0.5) / chi
        parts = []
        for radius, d, at in zip(r200, disc, c, strict=True):
            shell_mass = at * r / (1 + at * r) ** 2 * fraction * at / (np.log1p(at) - at / (1 + at))
            u, mass_left = (np.trapezoid(shell_mass * f, r) for f in (np.sinc(k * radius * r / np.pi), 1.0))
            parts.append(u - mass_left * np.trapezoid(8 * y * (1 - y**2) ** 3 * j0(k * d * y), y))
        power = np.trapezoid(haloes.dn_dlnm(mass, z) * (mass / haloes.density) ** 2 * np.square(parts), np.log(mass))
        expected = (far - near) * matter.shells.strength(z) ** 2 * power
        assert spectra.one_halo(np.array([ell]))[shell, 0] == pytest.approx(expected, rel=0.05)  # scatter of c: 3 %


def test_lensing_is_the_smooth_part_and_the_haloes():
    """Without haloes on the same smooth field the difference is theirs, and its mean over the sky is zero."""
    matter = coarse()
    ra, dec = inside(COMMON, 300)
    z = np.full(300, 2.5)
    smooth = matter._interpolated(COMMON, ra, dec, matter.shells.weights(z))
    whole = matter.lens(COMMON, ra, dec, z)
    from csstsim.universe.structure.halo_lensing import halo_shear

    chi = matter.shells.source_distance(z)
    for a, b, c in zip(whole, smooth, halo_shear(matter.lens_haloes(COMMON), ra, dec, chi), strict=True):
        assert c.any()
        np.testing.assert_allclose(a, b + c, atol=1e-7)


@pytest.mark.thorough
@pytest.mark.parametrize("pix", [COMMON, POLE])
def test_no_seam_between_bricks(pix):
    other = int(healpy.get_all_neighbours(256, pix, nest=True)[0])
    border, theirs = (healpy.boundaries(256, p, step=40, nest=True).T for p in (pix, other))
    ra, dec = healpy.vec2ang(border[np.linalg.norm(border[:, None] - theirs, axis=2).min(axis=1) < 1e-8], lonlat=True)
    assert len(ra) == 41
    for a, b in zip(*(coarse().lens(p, ra, dec, np.full(41, 3.0)) for p in (pix, other)), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-5)


@pytest.mark.thorough
def test_a_subset_in_any_order_is_the_same_to_the_bit():
    ra, dec = inside(COMMON, 60)
    z, some = np.linspace(0, 4, 60), [59, 0, 42]
    fresh = MatterField(5, COSMOLOGY, COARSE, FEW)
    fresh.lens(POLE, *inside(POLE, 3), np.ones(3))
    for a, b in zip(fresh.lens(COMMON, ra[some], dec[some], z[some]), coarse().lens(COMMON, ra, dec, z), strict=True):
        np.testing.assert_array_equal(a, b[some])


def test_redshifts_at_the_edges():
    ra, dec = (np.repeat(v, 7) for v in inside(COMMON, 1))
    z = [np.nan, -1.0, 0.0, 1e-9, 3.5, 3.6, 1100.0]
    for column in coarse().lens(COMMON, ra, dec, z):
        assert not column[:3].any() and abs(column[3]) < 1e-9 and (column[5:] == column[4]).all()
    delta, variance = coarse().density(ra, dec, [np.nan, -1.0, 0.0, 1e-9, 3.9, 4.1, 1100.0])
    assert not delta[[0, 1, 2, 5, 6]].any() and not variance[[0, 1, 2, 5, 6]].any()
    assert (variance[[3, 4]] > 0).all() and delta[[3, 4]].all()
    tides = coarse().tidal(COMMON, ra, dec, [np.nan, -1.0, 0.0, 1e-9, 3.4, 4.1, 1100.0])
    for column in tides:
        assert not column[[0, 1, 2, 5, 6]].any() and column[[3, 4]].all()


def test_tides_add_to_the_smooth_shear():
    matter = coarse()
    (ra,), (dec,) = inside(COMMON, 1)
    z = np.interp(0.5 * (matter.shells.edges[1:] + matter.shells.edges[:-1])[: matter.lenses], *matter.shells.distances)
    at = np.full(matter.lenses, ra), np.full(matter.lenses, dec)
    tides = np.stack(matter.tidal(COMMON, *at, z))
    weights = matter.shells.weights(np.array([2.0]))
    smooth = matter._interpolated(COMMON, at[0][:1], at[1][:1], weights)[1:]
    found = tides @ (weights[0, : matter.lenses] * matter.shells.kernel()[: matter.lenses])
    np.testing.assert_allclose(found, np.ravel(smooth), rtol=1e-9)


def test_field_without_haloes_is_another_field():
    field = coarse(5, False)
    assert field.haloes is None and field.spectra is None
    ra, dec = inside(COMMON, 5)
    assert not np.isin(field.lens(COMMON, ra, dec, np.ones(5))[0], coarse().lens(COMMON, ra, dec, np.ones(5))[0]).any()


@pytest.mark.parametrize(
    "wrong",
    [
        {"shells": {"thickness": 1, "z_end": 4.0}}, {"shells": {"thickness": 600, "z_end": 3.0}}, {"galaxy_scale": 0.0},
        *({"haloes": FEW["haloes"] | one} for one in (
            {"z_min": 0.0}, {"z_max": 9.0}, {"tiers": [1e14, 1e13]}, {"tiers": [1e14]}, {"lens_mass": 2e13},
            {"placement": np.nan}, {"placement": [0.7]}, {"finest": 0.1}, {"finest": 1e9},
            {"cuts": []}, {"cuts": [1.0] * 5}, {"cuts": [0.1]}, {"cuts": [1.0, 2.6]},
            {"compensation": {"mass": [1e13, 1e14], "ratio": [2.0]}},
            {"compensation": {"mass": [1e13], "ratio": [0.0]}},
            {"compensation": {"mass": [1e14, 1e13], "ratio": [2.0, 2.0]}},
        )),
    ],
)  # fmt: skip
def test_numbers_that_make_no_matter(wrong):
    with pytest.raises(ValueError, match=r"needs|lens_mass"):
        MatterField(1, COSMOLOGY, COARSE, FEW | wrong)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("cosmology", "thickness"), [({}, 40), ({"omega_m": 0.1, "omega_lambda": 0.9}, 150)], ids=["thin", "empty"]
)
def test_matter_that_cannot_have_the_spectrum_is_refused(cosmology, thickness):
    numbers = NUMBERS | {"shells": NUMBERS["shells"] | {"thickness": thickness}}
    with pytest.raises(ValueError, match=r"spectrum of matter is [27]\d% off halofit's"):
        MatterField(1, COSMOLOGY | cosmology, COARSE | {"l_max": 20000}, numbers)


def test_matter_about_haloes_adds_up_to_the_spectrum():
    """The smooth part's spectrum with all matter, and the haloes' by tier, are C_l less C_1h."""
    matter, ell, shell = shipped(), np.array([30, 100, 200, 400, 800, 2000]), 8
    spectra, strength = matter.spectra, matter.amplitude[shell] ** 2
    smooth = strength * matter.powers(ell) * np.sqrt(spectra.factors(ell)[shell])
    total = smooth.sum(axis=1)
    biases = spectra._clustering.bias
    for tier, bias in enumerate(biases[shell]):
        about = spectra.around(ell, matter.amplitude, shell, tier, bias)
        total += spectra.response(ell)[shell, tier] / bias * about * matter.shells.kernel()[shell] ** 2
    wanted = (strength * matter.powers(ell) * spectra.factors(ell)[shell]).sum(axis=1)
    wanted += spectra.lognormal(ell, matter.amplitude)[shell]
    np.testing.assert_allclose(total, wanted, rtol=0.005)  # biases within a tier differ


def test_haloes_spectra_end_with_the_haloes():
    spectra = HaloSpectra(coarse(), coarse().mass_function, FEW)
    one = spectra.one_halo(np.array([1000]))[:, 0]
    beyond = coarse().shells.edges[:-1] > coarse().shells.cosmology.comoving_distance(FEW["haloes"]["z_max"])
    assert beyond.any() and not one[beyond].any() and (one[~beyond] > 0).all()
