"""Two-pass detection on a fabricated frame of galaxies: Kron flux, one row per galaxy, stars next to galaxies."""

import math

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.measure.detection.background import masked_background

galsim = pytest.importorskip("galsim")

PIXEL = 0.074  # arcsec
STEP = 150  # px


@pytest.fixture(scope="module")
def galaxies(fabricate):
    """49 galaxies, half-light radii 0.3-0.8 arcsec, S/N 20-200; 1 in 7 with a de Vaucouleurs profile.

    S/N = F / sqrt(F + (4 pi sigma^2 + 9 r_e^2) variance): optimal photometry of a disc (validation.validate).
    """
    side = 7
    rng = stream(40, "galaxies")
    centre = 80 + STEP * np.arange(side)
    x, y = (v.ravel() + rng.uniform(-0.5, 0.5, side**2) for v in np.meshgrid(centre, centre))
    radius, snr = rng.uniform(0.3, 0.8, x.size) / PIXEL, 10.0 ** rng.uniform(math.log10(20), math.log10(200), x.size)
    noise = (4 * math.pi * fabricate.SIGMA**2 + 9 * radius**2) * fabricate.VARIANCE
    flux = 0.5 * snr * (snr + np.sqrt(snr**2 + 4 * noise))
    image = galsim.ImageD(STEP * (side - 1) + 160, STEP * (side - 1) + 160, xmin=0, ymin=0)
    bulge = np.arange(x.size) % 7 == 3
    for k in range(x.size):
        kind = galsim.DeVaucouleurs if bulge[k] else galsim.Exponential
        shape = kind(half_light_radius=radius[k], flux=flux[k])
        shape = shape.shear(q=rng.uniform(0.4, 1.0), beta=rng.uniform(0, 180) * galsim.degrees)
        stamp = galsim.Convolve(shape, galsim.Gaussian(sigma=fabricate.SIGMA)).drawImage(
            nx=141, ny=141, scale=1.0, center=galsim.PositionD(x[k], y[k])
        )
        bounds = stamp.bounds & image.bounds
        image[bounds] += stamp[bounds]
    table = fabricate.measure(fabricate.add_noise(image.array, 41))
    distance = np.hypot(table["x"] - x[:, None], table["y"] - y[:, None])
    return flux, radius, snr, bulge, table, distance


def test_kron_magnitudes_of_galaxies(galaxies):
    """Of a disc, the Kron radius is 2 h, and 5 h hold 1 - 6 exp(-5) = 96.0 % of the light: +0.045 mag."""
    flux, _, _, bulge, table, distance = galaxies
    residual = -2.5 * np.log10(table["flux_kron"][distance.argmin(axis=1)] / flux)
    expected = -2.5 * math.log10(1.0 - 6.0 * math.exp(-5.0))
    assert abs(np.median(residual) - expected) < 0.06 and abs(np.median(residual)) < 0.10
    assert np.median(residual[bulge]) < 0.35  # extended wings: 10 % beyond 2.5 Kron radii, more below the noise
    assert 1.4826 * np.median(np.abs(residual - np.median(residual))) < 0.12


def test_galaxies_are_one_row_each(galaxies):
    _, radius, _, _, table, distance = galaxies
    assert (distance.min(axis=1) < 2.5).mean() > 0.95
    assert ((distance < radius[:, None]).sum(axis=1) == 1).mean() > 0.95
    # Noise peaks in the outskirts are not sources either: within 3 r_e at S/N > 5 there is the galaxy only.
    close = (distance < 3 * radius[:, None]) & (table["snr"] > 5)
    assert (close.sum(axis=1) <= 1).mean() > 0.95
    assert not table["star"][distance.argmin(axis=1)].all()


def test_sersic_galaxies_are_fitted_with_sersic_profiles(fabricate):
    """Of n = 2, half-light radii 4 to 8 px, S/N 60 to 120; fitted with discs with bulges they would be 4% too faint."""
    step, side = 150, 5
    places = 80 + step * np.stack(np.meshgrid(np.arange(side), np.arange(side))).reshape(2, -1)
    image, flux = np.zeros((step * (side - 1) + 160,) * 2), np.geomspace(2e4, 4e4, side**2)
    for k, (x, y) in enumerate(places.T):
        shape = galsim.Sersic(2.0, half_light_radius=4.0 + k % 5, flux=flux[k]).shear(g1=0.1, g2=0.1)
        stamp = galsim.Convolve(shape, galsim.Gaussian(sigma=fabricate.SIGMA)).drawImage(nx=141, ny=141, scale=1.0)
        image[y - 70 : y + 71, x - 70 : x + 71] += stamp.array
    table = fabricate.measure(fabricate.add_noise(image, 43))
    nearest = np.hypot(table["x"] - places[0][:, None], table["y"] - places[1][:, None]).argmin(axis=1)
    light = np.median(table["flux_total"][nearest] / flux)
    assert table.meta["profiles"] == "Sersic" and abs(light - fabricate.LIGHT) < 0.015, light


def test_no_false_source_of_high_signal(galaxies):
    *_, table, distance = galaxies
    far = distance.min(axis=0) > 40
    kron = table["flux_kron"] / table["flux_kron_err"]
    assert (far & (table["snr"] > 5.0)).sum() <= 2
    assert (far & (kron > 6.0) & (table["snr"] > 2.5)).sum() <= 2


def test_a_star_next_to_a_galaxy_is_its_own_source(fabricate):
    n, step = 640, 160
    image = np.zeros((n, n))
    shape = galsim.Exponential(half_light_radius=8.0, flux=30000.0)
    stamp = galsim.Convolve(shape, galsim.Gaussian(sigma=fabricate.SIGMA)).drawImage(nx=141, ny=141, scale=1.0).array
    positions = [(80 + step * i, 80 + step * j) for i in range(4) for j in range(4)]
    stars = []
    for k, (x, y) in enumerate(positions):
        image[y - 70 : y + 71, x - 70 : x + 71] += stamp
        stars.append((x + 14.3 * math.cos(k), y + 14.3 * math.sin(k)))
    fabricate.add_stars(image, *zip(*stars, strict=True), [2500.0] * len(stars))  # S/N 40 off the galaxy
    table = fabricate.measure(fabricate.add_noise(image, 42))
    for where in (stars, positions):
        gap = np.array([np.hypot(table["x"] - x, table["y"] - y).min() for x, y in where])
        assert (gap < 1.5).mean() > 0.9


def test_stars_in_the_halo_of_a_bright_one_are_sources_and_few_parts_of_its_spikes_are(fabricate):
    """A halo that falls as r^-2.5 with four spikes of twice its light; stars of S/N 13 and more stand in it.

    The PSF has no such spikes, so that they are not taken out.
    """
    n = 900
    y, x = np.mgrid[:n, :n] - 0.5 * n
    r = np.hypot(x, y) + 3.0
    spike = 1.0 + 2.0 * np.exp(-0.5 * (np.minimum(abs(x + 0.1 * y), abs(y - 0.1 * x)) / 2.0) ** 2)
    image = 1.5e6 * r**-2.5 * spike
    rng, angle = stream(44, "halo"), math.tau * np.arange(12) / 12 + 0.3
    radius = np.linspace(130.0, 230.0, 12)
    stars = [0.5 * n + radius * f(angle) + rng.uniform(-0.5, 0.5, 12) for f in (np.cos, np.sin)]
    fabricate.add_stars(image, *stars, [500.0] * 12)
    table = fabricate.measure(fabricate.add_noise(image, 45))
    gap = np.hypot(table["x"][:, None] - stars[0], table["y"][:, None] - stars[1])
    assert (gap.min(axis=0) < 0.8).all()
    off = (gap.min(axis=1) > 3.0) & (np.hypot(table["x"] - 0.5 * n, table["y"] - 0.5 * n) > 30.0)
    assert (off & (table["snr"] > 5.0)).sum() <= 30


def test_a_star_away_from_the_middle_of_a_faint_galaxy_keeps_its_position(fabricate):
    n, step = 480, 80
    image = np.zeros((n, n))
    galaxy = galsim.Convolve(
        galsim.Exponential(half_light_radius=7.0, flux=4000.0), galsim.Gaussian(sigma=fabricate.SIGMA)
    ).drawImage(nx=61, ny=61, scale=1.0).array  # fmt: skip
    stars = []
    for k in range(25):
        x, y = 80 + step * (k % 5), 80 + step * (k // 5)
        image[y - 30 : y + 31, x - 30 : x + 31] += galaxy
        stars.append((x + 6.2 * math.cos(k), y + 6.2 * math.sin(k)))
    fabricate.add_stars(image, *zip(*stars, strict=True), [900.0] * 25)  # S/N 20 off the galaxy
    table = fabricate.measure(fabricate.add_noise(image, 46))
    gap = np.array([np.hypot(table["x"] - x, table["y"] - y).min() for x, y in stars])
    assert (gap < 0.8).mean() > 0.9


def test_the_background_of_whole_numbers_is_the_mean():
    """A gain of 1.6 electron per DN: the mode of the pixels is off by up to an electron, their mean is not."""
    rng = stream(43, "background")
    true = np.linspace(5.0, 9.0, 600)[:, None] + np.zeros((600, 700))
    raw = np.rint((rng.poisson(true) + rng.normal(0.0, 5.0, true.shape)) / 1.6 + 0.3) - 0.3
    image = (raw * 1.6).astype(np.float32)
    mask, unusable = np.zeros((300, 350), bool), np.zeros(image.shape, np.uint8)
    image[100:160, 100:160] += 500.0
    mask[47:83, 47:83] = True
    mesh = masked_background(image, mask, unusable, box=150)
    level, of_sums = image.copy(), mesh.noise(mask.shape)
    mesh.subtract_from(level)
    level = image - level
    inside = np.s_[75:525]
    assert np.abs(level - true)[inside].max() < 5 * 5.7 / 150 + 0.05  # electron
    assert np.median(of_sums) == pytest.approx(2.0 * math.sqrt(7.0 + 25.0 + 1.6**2 / 12), rel=0.03)
    assert masked_background(image, np.ones_like(mask), unusable) is None
