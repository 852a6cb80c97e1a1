"""Stamp sizes: the closed forms of lost light, and the limits."""

import numpy as np
import pytest
from scipy import integrate, special
from support.csst import BANDS

from csstsim.catalog.profiles.sersic import light_beyond
from csstsim.catalog.selection.reach import POINT_MAX, POINT_MIN, galaxy_radius, parts_radius, point_reach, wing_reach
from csstsim.catalog.table import ObjectTable
from csstsim.optics.scatter.scattered_light import scattered_light

VARIANCE = 60.0  # electron^2, of a pixel in r


@pytest.mark.parametrize("n", [1, 4])
def test_light_beyond_against_numerical_integration(n):
    b_n = special.gammaincinv(2 * n, 0.5)
    for radius in (0.0, 0.4, 1.0, 3.0, 12.0):
        inside = integrate.quad(lambda r: 2 * np.pi * r * np.exp(-b_n * r ** (1 / n)), 0, radius)[0]
        total = 2 * np.pi * n * special.gamma(2 * n) / b_n ** (2 * n)
        assert light_beyond(np.array([2 * radius]), np.array([2.0]), n)[0] == pytest.approx(
            1 - inside / total, abs=1e-6
        )


def galaxy(**columns):
    base = {"obj_type": [1], "size_disk": [0.5], "size_bulge": [0.3], "bulge_frac": [0.2]}
    return ObjectTable.complete(base | {name: [value] for name, value in columns.items()}, BANDS)


def radius(electrons, **columns):
    return galaxy_radius(galaxy(**columns), np.array([electrons]), VARIANCE, 0.074)[0][0]


@pytest.mark.parametrize("electrons", [1e2, 1e4, 1e6, 1e9])
def test_what_a_round_galaxy_loses_is_what_the_noise_allows(electrons):
    r, allowed = (v[0] for v in galaxy_radius(galaxy(), np.array([electrons]), VARIANCE, 0.074))
    lost = 0.8 * light_beyond(r, 0.5 / 0.074, 1) + 0.2 * light_beyond(r, 0.3 / 0.074, 4)
    assert lost == pytest.approx(allowed, rel=1e-3)
    if electrons >= 1e9:
        assert allowed == 1e-4
    if electrons <= 1e2:
        assert allowed == 5e-3


def test_a_bright_bulge_keeps_its_wings():
    r = radius(1e9, bulge_frac=1.0, size_disk=np.nan)
    assert light_beyond(r, 0.3 / 0.074, 4) == pytest.approx(1e-4, rel=1e-3)
    disk_only = radius(1e9, bulge_frac=0.0, size_bulge=np.nan)
    assert light_beyond(disk_only, 0.5 / 0.074, 1) == pytest.approx(1e-4, rel=1e-3)


def test_brighter_larger_and_stretched_need_more():
    assert radius(1e6) > radius(1e3) > 0
    assert radius(1e4, size_disk=1.0, bulge_frac=0.0) > radius(1e4, bulge_frac=0.0)
    # e = (a - b)/(a + b) at constant area: a / r = sqrt((1 + e)/(1 - e)); noise area is that of the longest axis too
    assert radius(1e9, e1=0.5) == pytest.approx(np.sqrt(3) * radius(1e9), rel=1e-3)
    assert radius(1e9, kappa=0.1, gamma2=0.1) == pytest.approx(radius(1e9) / 0.8, rel=1e-3)
    assert radius(1e9, kappa=1.5) == pytest.approx(radius(1e9))  # strong: not drawn, and no infinite stamp


def test_point_reach_grows_with_flux_within_its_limits(camera):
    electrons = np.array([0.0, 10.0, 1e4, 1e9])
    reach = point_reach(electrons, VARIANCE, camera.filters["r"], camera.telescope)
    assert (np.diff(reach) >= 0).all() and reach[0] == reach[1] == POINT_MIN and reach[-1] == POINT_MAX


def test_wing_reach_is_where_the_profile_is_a_thousandth_of_the_noise(camera):
    wing = scattered_light(camera, camera.filters["r"]).wing
    electrons = np.array([0.0, 1e4, 1e7, 1e10])
    reach = wing_reach(electrons, VARIANCE, wing)
    assert reach[0] == 0 and (np.diff(reach) > 0).all()
    level = electrons[1:] * wing.profile(reach[1:]).mean(axis=0)
    assert level == pytest.approx(1e-3 * np.sqrt(VARIANCE), rel=0.01)
    assert not wing_reach(electrons, VARIANCE, None).any()


def test_point_reach_in_closed_form(camera):
    """By the wing's level per pixel where noise is low, by the light beyond where an object's own noise decides."""
    wave_over_d = 6180.3e-10 / 2.0 * 206264.806 / 0.074  # px
    wing = 4 * wave_over_d / np.pi**3  # electron / px^2 per electron, times r^3
    by_pixel = (1e6 * wing / (0.1 * np.sqrt(1e9))) ** (1 / 3)
    pixels = 4 * np.pi / (2 * np.log(2)) * 1.2**2
    by_light = 1e4 * 2 * np.pi * wave_over_d / np.pi**3 / (0.1 * np.sqrt(1e4 + pixels * 1e4))
    reach = [
        point_reach(np.array([light]), variance, camera.filters["r"], camera.telescope, box=500)[0]
        for light, variance in ((1e4, 1e4), (1e3, 60.0), (1e9, 60.0))
    ]
    assert reach[0] == pytest.approx(by_light, rel=1e-4) and reach[1] == pytest.approx(41.3337, rel=1e-4)
    assert reach[2] == 500 and by_pixel < by_light
    dark = point_reach(np.array([100.0]), 1e-6, camera.filters["r"], camera.telescope, box=500)[0]
    assert dark == pytest.approx((100 * wing / (0.1 * 1e-3)) ** (1 / 3), rel=1e-4)
    dim = point_reach(np.array([3e3]), 1e8, camera.filters["r"], camera.telescope, box=500)[0]
    assert dim == POINT_MIN
    narrow = point_reach(np.array([1e4]), 1e4, camera.filters["NUV"], camera.telescope, box=500)[0]
    assert narrow / reach[0] == pytest.approx(camera.filters["NUV"].pivot / camera.filters["r"].pivot, rel=1e-3)


def test_a_galaxy_may_lose_a_fiftieth_of_its_noise():
    """Noise of the light itself and of the pixels that it covers, disk, bulge and PSF; by hand."""
    electrons = np.array([3e3])
    table = galaxy(bulge_frac=0.25)
    size2 = 0.75 * (0.5 / 0.074) ** 2 + 0.25 * (0.3 / 0.074) ** 2 + 1.2**2
    noise = np.sqrt(3e3 + 4 * np.pi / (2 * np.log(2)) * size2 * VARIANCE)
    assert 1e-4 < 0.02 * noise / 3e3 < 5e-3
    assert galaxy_radius(table, electrons, VARIANCE, 0.074)[1] == pytest.approx([0.02 * noise / 3e3])


def test_knots_and_images_reach_as_far_as_they_are_stretched():
    """Knots to 98% of the disk's light; an image to its corners, whatever its ellipticity, through the lens."""
    columns = {
        "obj_type": [1, 1, 1, 1, 1], "size_disk": 0.5, "e1": [0.0, 0.2, 0.2, 0.2, 0.0], "kappa": [0.0, 0, 0, 0.1, 0.1],
        "gamma2": [0.0, 0, 0, 0.1, 0.1], "knots": [5, 5, 0, 0, 0], "knots_frac": [0.3, 0.3, 0.3, 0, 0],
        "image_file": ["", "", "", "a.fits", "b.fits"], "image_radius": [0.0, 0, 0, 3.0, 2.0],
    }  # fmt: skip
    table = ObjectTable.complete(columns, BANDS)
    known = np.array([1.0, 1.0, 7.0, 1000.0, 1.0])
    found = parts_radius(table, known.copy(), 0.1)
    b = special.gammaincinv(2.0, 0.5)
    last = special.gammaincinv(2.0, 0.98) / b * 0.5 / 0.1
    wanted = [last, last * np.sqrt(1.2 / 0.8), 7.0, 30.0 / 0.8, 20.0 / 0.8]
    assert found == pytest.approx(wanted, rel=2e-3)
    assert parts_radius(table, np.full(5, 900.0), 0.1)[:3].tolist() == [900.0] * 3
    pointed = table.with_columns(n_disk=np.full(5, 0.5, np.float32))
    b = special.gammaincinv(1.0, 0.5)
    assert parts_radius(pointed, known.copy(), 0.1)[0] == pytest.approx(np.sqrt(np.log(50) / b) * 5.0, rel=5e-3)
