"""The random field: its derivatives against closed forms and harmonics, its spectrum, its seams, its edges."""

import healpy
import numpy as np
import pytest
from scipy.special import ive

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.lensing.lensing_field import LensingField
from csstsim.universe.lensing.potential_field import Kernels, kernel_power, splat
from csstsim.universe.lensing.tangent_grid import TangentGrid, interpolate

COSMOLOGY, NUMBERS = (read_data(SHIPPED / "universe" / f"{name}.yaml") for name in ("cosmology", "lensing"))
POLE, WRAP, COMMON = 65535, int(healpy.ang2pix(256, 0.0, 20.0, nest=True, lonlat=True)), 100000
COARSE = NUMBERS | {"l_max": 1000}  # twenty times as fast
# Limber integrals over CAMB 2.0.5's P(k, z) (halofit_version takahashi), sources at z_s, at these l.
ELL = np.array([20, 100, 300, 1000, 3000, 10000])
CAMB = {
    1: [3.3978e-08, 7.9109e-09, 1.847e-09, 4.3251e-10, 9.7003e-11, 1.0525e-11],
    2: [6.6837e-08, 2.2249e-08, 5.5159e-09, 1.1122e-09, 2.7113e-10, 3.8095e-11],
    3: [8.7527e-08, 3.4874e-08, 9.1864e-09, 1.728e-09, 4.1118e-10, 6.3466e-11],
}


@pytest.fixture(scope="module")
def field():
    return LensingField(5, COSMOLOGY, NUMBERS)


@pytest.fixture(scope="module")
def coarse():
    return LensingField(5, COSMOLOGY, COARSE)


def inside(pix, count, seed=1):
    """Return ra, dec of random positions in a brick."""
    children = np.random.default_rng(seed).integers(0, 1 << 42, count)
    return healpy.pix2ang(1 << 29, (pix << 42) + children, nest=True, lonlat=True)


def one_lens(grid, point, sigma, reach):
    """Return the maps (rows, columns, 3, 1) of psi = -exp(-(1 - n . p) / sigma^2): an overdensity."""
    values, points = np.zeros((*grid.shape, 3, 1)), np.atleast_2d(point)
    splat(values, grid.frames, Kernels(points, grid.boxes(points, reach), np.full((1, 1), -1.0), sigma**-2, reach))
    return values


@pytest.mark.parametrize("pix", [COMMON, POLE, WRAP])
def test_images_are_stretched_around_an_overdensity(pix):
    """Gaussian lens in the plane: kappa = (1 - t^2 / 2 s^2) K / s^2, gamma_t = mean kappa inside - kappa."""
    sigma = np.radians(1 / 60)
    grid = TangentGrid.pyramid(pix, sigma / 8)[-1]
    values = one_lens(grid, grid.centre, sigma, 6 * sigma)
    ra, dec = inside(pix, 200)
    kappa, gamma1, gamma2 = interpolate(values, grid.coordinates(ra, dec), np.ones((200, 1))).T
    gamma1, gamma2 = grid.to_east_north(ra, dec, gamma1, gamma2)
    n = healpy.ang2vec(ra, dec, lonlat=True)
    theta = 2 * np.arcsin(0.5 * np.linalg.norm(n - grid.centre, axis=1))
    towards = grid.centre - n
    a, d = np.radians(ra), np.radians(dec)
    east = towards @ np.eye(3)[1] * np.cos(a) - towards @ np.eye(3)[0] * np.sin(a)
    up = np.stack([-np.sin(d) * np.cos(a), -np.sin(d) * np.sin(a), np.cos(d)], axis=1)
    phi = np.arctan2(np.einsum("nk,nk->n", towards, up), east)
    tangential = -gamma1 * np.cos(2 * phi) - gamma2 * np.sin(2 * phi)
    cross = gamma1 * np.sin(2 * phi) - gamma2 * np.cos(2 * phi)
    x2 = (theta / sigma) ** 2
    peak = np.exp(-x2 / 2) / sigma**2
    np.testing.assert_allclose(kappa, (1 - x2 / 2) * peak, atol=1e-5 / sigma**2)
    np.testing.assert_allclose(tangential, x2 / 2 * peak, atol=1e-5 / sigma**2)
    np.testing.assert_allclose(cross, 0.0, atol=1e-5 / sigma**2)
    assert tangential[x2 < 4].min() > 0


@pytest.mark.parametrize("pix", [COMMON, POLE, 0])
def test_wide_kernel_against_harmonics_of_spin_2(pix):
    """By healpy: kappa_lm = -l (l + 1) / 2 psi_lm, gamma_lm = sqrt((l + 2)! / (l - 2)!) / 2 psi_lm."""
    sigma, lmax, nside = 0.4, 40, 64
    ell, u = np.arange(lmax + 1), 0.4**-2
    point = healpy.ang2vec(40.0, 60.0, lonlat=True)
    legendre = 4 * np.pi * np.sqrt(np.pi / (2 * u)) * ive(ell + 0.5, u)
    kernel = np.exp(u * (np.stack(healpy.pix2vec(nside, np.arange(12 * nside**2)), axis=1) @ point - 1))
    psi = healpy.map2alm(-kernel, lmax=lmax, iter=10)
    spin = np.sqrt((ell + 2.0) * (ell + 1) * ell * np.maximum(ell - 1, 0)) / 2

    grid = TangentGrid.pyramid(pix, 3e-4)[-1]
    values = one_lens(grid, point, sigma, np.pi)
    pixels = healpy.query_disc(512, grid.centre, np.radians(0.12))
    ra, dec = healpy.pix2ang(512, pixels, lonlat=True)
    kappa, *gamma = interpolate(values, grid.coordinates(ra, dec), np.ones((len(pixels), 1))).T
    gamma = grid.to_east_north(ra, dec, *gamma)
    expected = healpy.alm2map(healpy.almxfl(psi, -ell * (ell + 1) / 2), 512, lmax=lmax)[pixels]
    np.testing.assert_allclose(kappa, expected, atol=1e-4 / sigma**2)
    # healpy's Q + iU = - sum E Y_2 along (south, east); a quarter turn to (east, north) changes the sign of both.
    q, v = healpy.alm2map_spin([healpy.almxfl(psi, -spin), 0 * psi], 512, 2, lmax)
    np.testing.assert_allclose(gamma[0], -q[pixels], atol=1e-4 / sigma**2)
    np.testing.assert_allclose(gamma[1], -v[pixels], atol=1e-4 / sigma**2)
    np.testing.assert_allclose(kernel_power(ell, sigma), (ell * (ell + 1) / 2 * legendre) ** 2)


def test_spectrum_is_halofit(field):
    ell = np.array([3, 10, 30, 100, 300, 1000, 3000, 10000, 20000])
    for z, expected in CAMB.items():
        limber = field.shells.limber(ell, z)
        np.testing.assert_allclose(field.spectrum(ell, z), limber, rtol=0.03, err_msg=f"z = {z}")
        np.testing.assert_allclose(field.shells.limber(ELL, z), expected, rtol=0.03, err_msg=f"z = {z}")
    assert field.spectrum(np.array([25000]), 1.0) > 0.5 * field.shells.limber(np.array([25000]), 1.0)  # 0.43 arcmin


def test_variance_of_the_draw_is_that_of_the_spectrum(coarse):
    """At 40 points all over the sky, a brick each: mean squares within 5 sigma of chi^2."""
    ell = np.arange(1, 4000)
    expected = ((2 * ell + 1) / (4 * np.pi) * coarse.spectrum(ell, 1.0)).sum()
    found = []
    for pix in healpy.ang2pix(256, *healpy.pix2ang(2, np.arange(40), lonlat=True), nest=True, lonlat=True):
        ra, dec = inside(int(pix), 1)
        found.append(np.stack(coarse.lens(int(pix), ra, dec, 1.0))[:, 0])
    kappa2, gamma12, gamma22 = (np.array(found) ** 2).mean(axis=0) / expected
    for ratio, fraction in ((kappa2, 1.0), (gamma12, 0.5), (gamma22, 0.5)):
        assert abs(ratio / fraction - 1) < 5 * np.sqrt(2 / 40)


def test_every_width_is_isotropic_and_normalised(coarse):
    """The expected variance at random points, summed over pixels by brute force, level by level."""
    ell, rng = np.arange(0, 60000), np.random.default_rng(3)
    for order, sigma in coarse.widths[6:10]:
        p = np.stack(healpy.pix2vec(2**order, np.arange(12 * 4**order)), axis=1)
        expected = ((2 * ell + 1) / (4 * np.pi) * kernel_power(ell, sigma)).sum() * 12 * 4**order / (4 * np.pi)
        for n in rng.standard_normal((8, 3)):
            c = p @ n / np.linalg.norm(n)
            kappa = np.exp((c - 1) / sigma**2) / sigma**2 * ((1 - c**2) / (2 * sigma**2) - c)
            assert (kappa**2).sum() == pytest.approx(expected, rel=5e-3)


def test_no_b_mode_in_apertures(field):
    """Aperture masses of tangential and cross shear separate E and B exactly on a disc (Schneider et al. 1998)."""
    ra0, dec0 = healpy.pix2ang(256, COMMON, nest=True, lonlat=True)
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 41)])
    t, phi = np.hypot(x, y), np.arctan2(y, x)
    weight = np.where(t < 1, t**2 * (1 - np.minimum(t, 1) ** 2) ** 3, 0.0)
    rng = np.random.default_rng(2)
    aperture, cross = [], []
    ra, dec, centres = [], [], rng.uniform(-3, 3, (25, 2)) / 60
    for cx, cy in centres:
        dec.append(dec0 + cy + y / 60)
        ra.append(ra0 + cx + x / 60 / np.cos(np.radians(dec0 + cy + y / 60)))
    _, gamma1, gamma2 = field.lens(COMMON, np.ravel(ra), np.ravel(dec), np.full(np.size(ra), 2.0))
    for g1, g2 in zip(*(g.reshape(-1, 41, 41) for g in (gamma1, gamma2)), strict=True):
        aperture.append((weight * (-g1 * np.cos(2 * phi) - g2 * np.sin(2 * phi))).sum())
        cross.append((weight * (g1 * np.sin(2 * phi) - g2 * np.cos(2 * phi))).sum())
    assert np.var(cross) < 1e-4 * np.var(aperture)


@pytest.mark.parametrize(("which", "pix"), [("field", COMMON), ("coarse", POLE), ("coarse", WRAP)])
def test_no_seam_between_bricks(request, which, pix):
    field = request.getfixturevalue(which)
    border = healpy.boundaries(256, pix, step=40, nest=True).T
    ra, dec = healpy.vec2ang(border, lonlat=True)
    other = int(healpy.get_all_neighbours(256, pix, nest=True)[0])
    neighbour = healpy.boundaries(256, other, step=40, nest=True).T
    shared = np.linalg.norm(border[:, None] - neighbour, axis=2).min(axis=1) < 1e-8
    assert shared.sum() == 41
    z = np.full(41, 3.0)
    for a, b in zip(*(field.lens(p, ra[shared], dec[shared], z) for p in (pix, other)), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-5)


def test_no_seam_at_the_meridian(coarse):
    ra = np.array([359.9999999, 0.0, 1e-7, 360.0])
    for column in coarse.lens(WRAP, ra, np.full(4, healpy.pix2ang(256, WRAP, True, True)[1]), np.full(4, 2.0)):
        np.testing.assert_allclose(column, column[0], rtol=0, atol=1e-7)


def test_a_subset_in_any_order_is_the_same_to_the_bit(coarse):
    ra, dec = inside(COMMON, 100)
    z = np.linspace(0, 4, 100)
    fresh = LensingField(5, COSMOLOGY, COARSE)
    fresh.lens(POLE, *inside(POLE, 3), np.ones(3))
    some = [99, 0, 42]
    for a, b in zip(coarse.lens(COMMON, ra, dec, z), fresh.lens(COMMON, ra[some], dec[some], z[some]), strict=True):
        np.testing.assert_array_equal(a[some], b)
    assert not np.isin(LensingField(6, COSMOLOGY, COARSE).lens(COMMON, ra, dec, z)[0][z > 1], a).any()


def test_redshifts_at_the_edges(coarse):
    ra, dec = (np.repeat(v, 9) for v in inside(COMMON, 1))
    z = [np.nan, -1.0, 0.0, 1e-9, 1e-3, 3.5, 3.6, 1100.0, np.inf]
    for column in coarse.lens(COMMON, ra, dec, z):
        assert not column[:3].any() and abs(column[3]) < 1e-12 and abs(column[4]) < 1e-5
        assert column[5] != 0 and (column[6:] == column[5]).all()
    near = coarse.lens(COMMON, ra[0].repeat(701), dec[0].repeat(701), np.linspace(0, 3.5, 701))
    assert np.abs(np.diff(near)).max() < 2e-3  # continuous through every shell
    assert (np.diff([coarse.spectrum(np.array([500]), z)[0] for z in (0.05, 0.2, 0.5, 1, 2, 3.5)]) > 0).all()


@pytest.mark.parametrize("wrong", [{"shells": 0}, {"l_max": 10}, {"l_max": 1e6}, {"z_max": -1}, {"z_max": np.nan}])
def test_numbers_that_make_no_field(wrong):
    with pytest.raises(ValueError, match="lensing: needs"):
        LensingField(1, COSMOLOGY, NUMBERS | wrong)


def test_positions_at_the_edges(coarse):
    assert all(column.shape == (0,) for column in coarse.lens(COMMON, [], [], []))
    pole = coarse.lens(POLE, [12.0, 57.0], [90.0, 90.0], [1.0, 1.0])
    assert np.isfinite(pole).all()
    assert pole[1][1] == pytest.approx(pole[2][0], abs=1e-6)  # axes turned by 45 deg: gamma1' = gamma2
    for ra, dec in ((0.0, 0.0), (np.nan, 0.0)):
        with pytest.raises(ValueError, match="outside the brick"):
            coarse.lens(COMMON, [ra], [dec], [1.0])


def test_kernels_and_weights_of_shells(coarse):
    """K by an integral through each shell; weights give the spectrum at l = 1000, and none to shells behind."""
    shells, cosmology = coarse.shells, coarse.shells.cosmology
    z = np.linspace(0.0, 3.5, 40001)
    chi = cosmology.comoving_distance(z)
    q = 1.5 * 0.3111 * (67.66 / 299792.458) ** 2 * (1 + z) * chi
    running = np.concatenate([[0.0], np.cumsum(0.5 * (q[1:] + q[:-1]) * np.diff(chi))])
    np.testing.assert_allclose(shells.kernel(), np.diff(np.interp(shells.edges, chi, running)), rtol=1e-5)
    ell = np.array([1000.0])
    for source in (0.4, 1.0, 3.0):
        weights = shells.weights(np.array([source]))[0]
        assert weights**2 @ shells.spectra(ell)[:, 0] == pytest.approx(shells.limber(ell, source)[0], rel=5e-3)
        behind = shells.edges[:-1] >= cosmology.comoving_distance(source)
        assert behind.any() == (source < 3) and not weights[behind].any() and (weights[~behind] > 0).all()
    assert len(shells.edges) == NUMBERS["shells"] + 1 and shells.edges[-1] == pytest.approx(chi[-1])
    near = np.diff(shells.edges)
    assert (np.diff(near) > 0).all() and near.sum() == pytest.approx(chi[-1])
