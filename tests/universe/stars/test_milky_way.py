"""Density laws and the galactic frame, against astropy and closed forms."""

import numpy as np
import pytest
from astropy.coordinates import SkyCoord

from csstsim.base.shipped import SHIPPED
from csstsim.base.sphere import ra_dec
from csstsim.instrument.load import read_data
from csstsim.universe.stars.milky_way import GALACTIC, components, density, direction, equatorial

NUMBERS = read_data(SHIPPED / "universe" / "stars.yaml")
BY_NAME = {component.name: component for component in components(NUMBERS)}
R0, Z_SUN = NUMBERS["sun"]["r0"], NUMBERS["sun"]["z"]


def test_galactic_frame_against_astropy():
    rng = np.random.default_rng(1)
    ra = np.concatenate([[0.0, 360.0, 192.85948, 266.405], rng.uniform(0, 360, 200)])
    dec = np.concatenate([[90.0, -90.0, 27.12825, -28.936], np.degrees(np.arcsin(rng.uniform(-1, 1, 200)))])
    reference = SkyCoord(ra, dec, unit="deg").galactic
    computed = direction(ra, dec)
    assert np.abs(computed - reference.cartesian.xyz.value).max() < 1e-6  # 0.2 arcsec
    back = SkyCoord(*equatorial(*ra_dec(computed.T)), unit="deg")
    assert back.separation(SkyCoord(ra, dec, unit="deg")).arcsec.max() < 0.01
    np.testing.assert_allclose(GALACTIC @ GALACTIC.T, np.eye(3), atol=1e-15)


@pytest.mark.parametrize("name", [name for name in BY_NAME if name != "bulge"])
def test_density_is_one_at_the_sun_and_even_about_the_plane(name):
    assert density(BY_NAME[name], np.zeros(3), NUMBERS) == pytest.approx(1.0, rel=1e-12)
    up, down = (density(BY_NAME[name], np.array([1.0, 2.0, z - Z_SUN]), NUMBERS) for z in (0.7, -0.7))
    assert up == pytest.approx(down, rel=1e-12)


def test_thick_disc_far_out_is_exponential_and_smooth_where_the_laws_meet():
    def at(z, x=0.0):
        return density(BY_NAME["thick"], np.array([x, 0.0, z - Z_SUN]), NUMBERS)

    scale, hz, xl = NUMBERS["laws"]["thick"]
    assert at(3.0) / at(2.0) == pytest.approx(np.exp(-1 / hz))
    assert at(1.0, x=1.0) / at(1.0) == pytest.approx(np.exp(1 / scale))
    assert at(xl - 1e-9) == pytest.approx(at(xl + 1e-9), rel=1e-7)
    slopes = [(at(xl + d) - at(xl)) / d for d in (-1e-6, 1e-6)]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-4)


def test_halo_is_a_power_law_with_a_core_and_an_edge():
    def at(x, y, z=0.0):  # from the centre
        return density(BY_NAME["halo"], np.array([R0 + x, y, z - Z_SUN]), NUMBERS)

    power, core, edge, steep = NUMBERS["laws"]["halo"]
    eps = BY_NAME["halo"].eps
    assert at(0, 20) / at(0, 0, 10 * eps) == pytest.approx(2.0**power)
    assert at(0, 0) == at(0.9 * core, 0)
    assert at(0, 2 * edge) / at(0, edge) == pytest.approx(2.0**steep)
    assert at(0, edge * 0.99999) == pytest.approx(at(0, edge * 1.00001), rel=1e-3)


def test_older_thin_discs_are_thicker():
    position = np.array([0.0, 0.0, 0.5])
    densities = [density(BY_NAME[f"thin{k}"], position, NUMBERS) for k in range(1, 8)]
    assert densities[0] < 1e-6  # a gas layer's thickness
    assert (np.diff(densities) > 0).all()
    # The scale height of exp(-sqrt(1/4 + a2 / h2)), a2 = R^2 + (z / eps)^2, 1 kpc from the plane
    eps, h = BY_NAME["thin7"].eps, NUMBERS["laws"]["disc"][0]
    height = eps**2 * h**2 * np.sqrt(0.25 + (R0**2 + (1.0 / eps) ** 2) / h**2)
    assert 0.15 < height < 0.30  # kpc; published old discs: 0.2 to 0.3 (Juric et al. 2008, Robin et al. 2003)
    a, b = (density(BY_NAME["thin7"], np.array([0, 0, z - Z_SUN]), NUMBERS) for z in (0.9, 1.1))
    assert 0.2 / np.log(a / b) == pytest.approx(height, rel=0.01)


def test_bulge_is_longest_towards_positive_longitude_this_side():
    def at(l, kpc):  # noqa: E741
        l = np.radians(l)  # noqa: E741
        return density(BY_NAME["bulge"], np.array([kpc * np.cos(l), kpc * np.sin(l), -Z_SUN]), NUMBERS)

    assert at(0, R0) == pytest.approx(1.0)
    assert at(2, R0 - 0.9) > at(-2, R0 - 0.9)
    assert at(-2, R0 + 0.9) > at(2, R0 + 0.9)
    assert at(90, 1.0) < 1e-12


@pytest.mark.parametrize("name", ["thin3", "thick"])
def test_a_flaring_disc_keeps_the_stars_of_a_column(name):
    """Beyond the flare's start a disc is wider by 1 + slope (R - start), and thinner in its middle by as much."""
    start, slope = NUMBERS["laws"]["flare"]
    flat = NUMBERS | {"laws": NUMBERS["laws"] | {"flare": [start, 0.0]}}
    z = np.linspace(-8.0, 8.0, 32001)
    for radius in (start - 0.5, start + 4.0):
        position = np.stack([0 * z + R0 - radius, 0 * z, z - Z_SUN])
        flaring, level = (density(BY_NAME[name], position, numbers) for numbers in (NUMBERS, flat))
        assert flaring.sum() == pytest.approx(level.sum(), rel=1e-3)
        wider = 1 + slope * max(radius - start, 0.0)
        height = [np.sqrt((rho * z**2).sum() / rho.sum()) for rho in (flaring, level)]
        assert height[0] / height[1] == pytest.approx(wider, rel=5e-3)
    assert wider > 1.2


def test_the_bulge_along_its_axes_and_beyond_its_cut():
    """exp(-r_s^2 / 2), r_s^4 = ((a / x0)^2 + (b / y0)^2)^2 + (z / z0)^4, with a Gaussian edge (Robin et al. 2003)."""
    x0, y0, z0, cut, width, angle = NUMBERS["laws"]["bulge"]
    near = np.radians(angle)

    def at(a, b, z):
        turn = np.pi / 2 - near
        x, y = -a * np.cos(turn) + b * np.sin(turn), a * np.sin(turn) + b * np.cos(turn)
        return density(BY_NAME["bulge"], np.array([R0 + x, y, z - Z_SUN]), NUMBERS)

    for a, b, z in ((0.7, 0, 0), (0, 0.3, 0), (0, 0, 0.4), (0.9, -0.35, 0.25), (-1.1, 0.2, -0.5)):
        law = ((a / x0) ** 2 + (b / y0) ** 2) ** 2 + (z / z0) ** 4
        assert at(a, b, z) == pytest.approx(np.exp(-0.5 * np.sqrt(law)), rel=1e-9)
    far = cut + 0.8 * width
    assert at(far, 0, 0) == pytest.approx(np.exp(-0.5 * (far / x0) ** 2 - 0.5 * 0.8**2), rel=1e-9)


@pytest.mark.parametrize(("name", "law", "first"), [("thin1", "young", 0.0), ("thin4", "disc", 0.25)])
def test_thin_discs_have_a_hole_in_their_middle(name, law, first):
    """exp(-a^2 / h^2) less that of the hole for the youngest, exp(-sqrt(1 / 4 + a^2 / h^2)) for others."""
    outer, inner = NUMBERS["laws"][law]
    eps, start = BY_NAME[name].eps, NUMBERS["laws"]["flare"][0]
    assert BY_NAME[name].law == law and start > R0

    def shape(r, z):
        a2 = r**2 + (z / eps) ** 2
        if law == "young":
            return np.exp(-a2 / outer**2) - np.exp(-a2 / inner**2)
        return np.exp(-np.sqrt(first + a2 / outer**2)) - np.exp(-np.sqrt(first + a2 / inner**2))

    for x, y, z in ((3.0, 2.0, 0.03), (R0 - 1.0, 0.0, 0.0), (-0.5, 0.4, -0.05)):
        found = density(BY_NAME[name], np.array([x, y, z - Z_SUN]), NUMBERS)
        assert found == pytest.approx(shape(np.hypot(x - R0, y), z) / shape(R0, Z_SUN), rel=1e-9)


def test_the_thick_disc_is_a_parabola_near_the_plane():
    _, hz, xl = NUMBERS["laws"]["thick"]

    def at(z):
        return density(BY_NAME["thick"], np.array([0.0, 0.0, z - Z_SUN]), NUMBERS)

    assert at(0.5 * xl) / at(0.0) == pytest.approx(1 - 0.25 * xl / (2 * hz + xl), rel=1e-9)
    assert at(-0.5 * xl) == pytest.approx(at(0.5 * xl), rel=1e-12)
