"""Tables of profiles against closed forms: quadrature, nodes, Gaussians of any axis ratio, parts of a frame."""

import numpy as np
import pytest
from scipy.special import j0

from csstsim.catalog.profiles.sersic import light_beyond
from csstsim.measure.light import profile_tables as module
from csstsim.measure.light.profile_tables import (
    AXIS_RATIOS,
    BULGES,
    FAMILIES,
    GAAP_FWHM,
    SERSIC,
    SIZES,
    ProfileTables,
)


def test_nodes_grow_by_a_third_in_steps_of_a_half():
    nodes = module._nodes(100.0)
    assert nodes[:4].tolist() == [0.0, 0.5, 1.0, 1.5] and nodes[-2] < 100 <= nodes[-1]
    assert (np.diff(nodes) >= 0.5).all() and (2 * nodes % 1 == 0).all()
    far = nodes[nodes > 20]
    assert far[1:] / far[:-1] == pytest.approx(np.full(len(far) - 1, 1.33), abs=0.015)


@pytest.mark.parametrize("radius", [0.0, 3.0, 60.0, 128.0])
def test_a_hankel_transform_of_a_gaussian_is_one(radius):
    k, weight = module._wavenumbers(128.0)
    for sigma in (1.5, 30.0):
        found = (np.exp(-0.5 * (k * sigma) ** 2) * k * weight) @ j0(k * radius)
        assert found == pytest.approx(np.exp(-0.5 * (radius / sigma) ** 2) / sigma**2, abs=1e-6 / sigma**2)


def test_what_is_linear_in_the_squared_radius_is_kept():
    nodes = module._nodes(90.0)
    r, matrix = module._projection(nodes)
    at = nodes[np.searchsorted(nodes, 10.0)]
    assert matrix @ (3.0 - 0.2 * r**2) == pytest.approx(3.0 - 0.2 * nodes)
    assert matrix @ np.minimum(r**2, at) == pytest.approx(np.minimum(nodes, at))


@pytest.mark.parametrize(("disc", "bulge", "fraction"), BULGES.kinds + SERSIC.kinds)
def test_half_of_the_light_is_within_the_half_light_radius(disc, bulge, fraction):
    large, small = module._component_sizes(disc, bulge, fraction)
    beyond = (1 - fraction) * light_beyond(1.0, large, disc) + fraction * light_beyond(1.0, small, bulge)
    assert beyond == pytest.approx(0.5, abs=1e-4)
    assert small / large == pytest.approx(1.0 if fraction in (0, 1) else 0.5)


def test_gaussians_of_any_axis_ratio_are_closed_forms():
    """The first kind of either family is one: its light within the Gaussian aperture, its transform."""
    assert {family.kinds[0] for family in FAMILIES} == {(0.5, 4.0, 0.0)}
    k, weight = module._wavenumbers(128.0)
    transforms = module._galaxy_transforms(k, BULGES.kinds[:1])
    sigma = GAAP_FWHM / 0.074 / 2.354820045
    variance = sigma**2
    fractions = transforms[:, :, 0] @ (variance * np.exp(-0.5 * variance * k**2) * k * weight)
    s = SIZES / 1.17741
    q = AXIS_RATIOS[:, None]
    wanted = 1 / np.sqrt((1 + s**2 * q / variance) * (1 + s**2 / q / variance))
    assert fractions == pytest.approx(wanted, abs=1.5e-3)
    assert transforms[:, :, :, 0] == pytest.approx(np.ones(transforms.shape[:3]), abs=2e-3)
    assert transforms[0, 20, 0] == pytest.approx(np.exp(-0.5 * (s[20] * k) ** 2), abs=2e-3)


def test_parts_of_a_frame_are_rows_of_columns():
    """Of 3 x 3 parts of 1000 x 500 px of a frame whose corner is at (200, -100); outside, the nearest."""
    tables = ProfileTables(BULGES, None, None, None, None, 0.074, (200, -100), (1000.0, 500.0), 3)
    x = np.array([200.0, 1199.0, 1201.0, 2500.0, -50.0, 9999.0, np.nan])
    y = np.array([-100.0, 399.0, 401.0, -99.0, 950.0, 9999.0, 450.0])
    assert tables.part(x, y).tolist() == [0, 0, 4, 2, 6, 8, 3]


def test_psfs_are_taken_in_the_middles_of_parts(monkeypatch):
    """A frame of 3000 x 1000 px: two parts either way, columns first."""
    asked = []

    def transforms(psf, positions, k):
        for n, position in enumerate(positions):
            asked.append(position)
            yield np.full(k.size, 1.0 + n)

    monkeypatch.setattr(module, "_psf_transforms", transforms)

    def galaxies(k, kinds):
        return len(kinds) * np.exp(-np.arange(1, 7)[:, None, None, None] * k**2)

    monkeypatch.setattr(module, "_galaxy_transforms", galaxies)
    families = [BULGES._replace(kinds=BULGES.kinds[:count]) for count in (1, 3)]
    tables, thrice = module.profile_tables(None, (100, 50), (1000, 3000), 0.074, families)
    assert (tables.family, thrice.family) == tuple(families)
    assert thrice.galaxy == pytest.approx(3 * tables.galaxy, rel=1e-4, abs=1e-7)
    assert thrice.gaap == pytest.approx(3 * tables.gaap)
    assert asked == [(850.0, 300.0), (2350.0, 300.0), (850.0, 800.0), (2350.0, 800.0)]
    assert tables.part(np.array([v[0] for v in asked]), np.array([v[1] for v in asked])).tolist() == [0, 1, 2, 3]
    for n in range(1, 4):
        assert tables.point[n] == pytest.approx((1 + n) * tables.point[0], rel=1e-4)
        assert tables.galaxy[n, 3] == pytest.approx((1 + n) * tables.galaxy[0, 3], rel=1e-3, abs=1e-6)
    radius = np.sqrt(tables.nodes[5:15])
    for ratio in (0, 3):  # exp(-b k^2) is that of a Gaussian of variance 2 b
        wanted = np.exp(-(radius**2) / (4 * (ratio + 1))) / (4 * np.pi * (ratio + 1))
        assert tables.galaxy[0, ratio, 5:15, 0] == pytest.approx(wanted, abs=5e-4)
