"""Stamp sizes: the closed forms of lost light, and the limits."""

import numpy as np
import pytest
from csst import BANDS
from scipy import integrate, special

from csstsim.catalog.selection.reach import POINT_MAX, POINT_MIN, galaxy_radius, point_reach, wing_reach
from csstsim.catalog.table import ObjectTable
from csstsim.optics.scatter.scattered_light import scattered_light
from csstsim.profiles.sersic import light_beyond

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
