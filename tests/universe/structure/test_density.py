"""The smoothed overdensity: sums of kernels by brute force, cells that fit together, variance."""

import healpy
import numpy as np
import pytest
from universe.structure.small_matter import coarse

from csstsim.base.sphere import ra_dec, unit_vectors
from csstsim.universe.lensing.potential_field import WIDTHS, pixel
from csstsim.universe.lensing.tangent_grid import TangentGrid
from csstsim.universe.structure.density import ShellDensity, angular_order, cell_order, kernel_order, kernel_weights

SHELL = 4
PLACES = {"common": (200.0, -35.0), "RA 0": (0.0, 5.0), "pole": (10.0, 89.99), "polar cap": (90.0, 60.0)}


def brute(matter, position, order):
    """Return delta of SHELL: every deviate of the sky within 4.5 sigma, summed in closed form."""
    n, total = unit_vectors(*position), 0.0
    for s, (o, sigma) in enumerate(matter.widths):
        if o <= order:
            pixels = healpy.query_disc(2**o, n, min(6 * sigma, np.pi), nest=True)
            bits = 2 * min(o, 4)
            drawn = np.array([matter._block(s, int(p) >> bits)[p & ((1 << bits) - 1), SHELL] for p in pixels])
            gap = 1 - np.stack(healpy.pix2vec(2**o, pixels, nest=True), axis=1) @ n
            u = sigma**-2
            kappa = u * np.exp(-u * gap) * (0.5 * u * (1 - (1 - gap) ** 2) - (1 - gap))
            total += matter.spectra.weights[SHELL, s] * matter.amplitude[SHELL, s] * (drawn * kappa).sum()
    return total / matter.shells.kernel()[SHELL]


@pytest.mark.parametrize("name", PLACES)
@pytest.mark.parametrize("order", [4, 6, 8])
def test_delta_is_the_sum_of_its_kernels(name, order):
    density, position = coarse().shell_density, PLACES[name]
    orders = np.full(coarse().shells.count, order)
    delta = density.at([position[0]], [position[1]], [SHELL], orders)[0]
    sigma = np.sqrt(density.variance(orders)[SHELL])
    assert delta == pytest.approx(brute(coarse(), position, order), abs=0.02 * sigma)


def test_cells_agree_where_they_meet():
    density, order = coarse().shell_density, 8
    cell = healpy.ang2pix(2 ** cell_order(order), 45.0, 41.0, nest=True, lonlat=True)
    other = int(healpy.get_all_neighbours(2 ** cell_order(order), cell, nest=True)[0])
    border = healpy.boundaries(2 ** cell_order(order), cell, step=20, nest=True).T
    neighbour = healpy.boundaries(2 ** cell_order(order), other, step=20, nest=True).T
    shared = border[np.linalg.norm(border[:, None] - neighbour, axis=2).min(axis=1) < 1e-9]
    assert len(shared) == 21
    values = []
    for one in (cell, other):
        grid, maps = density.maps(order, int(one))
        from csstsim.universe.structure.density import interpolate_one

        values.append(interpolate_one(maps, grid.vector_coordinates(shared), np.full(21, SHELL)))
    sigma = np.sqrt(density.variance(np.full(coarse().shells.count, order))[SHELL])
    np.testing.assert_allclose(*values, atol=0.02 * sigma)


@pytest.mark.parametrize("order", [3, 5, 8])
def test_grids_of_cells_fit_into_those_around_them(order):
    rng, count = np.random.default_rng(2), 12 * 4**order
    poles = healpy.ang2pix(2**order, np.arange(0, 360, 15.0), np.tile([89.9, -89.9], 12), nest=True, lonlat=True)
    for cell in (*rng.integers(0, count, 60), *poles):
        fine, wide = (
            TangentGrid.around(o, int(c), WIDTHS[-1] * pixel(o + 4) / 2, 2)
            for o, c in ((order, cell), (order - 1, cell >> 2))
        )
        wide.vector_coordinates(fine.frames.direction[[0, -1]].reshape(-1, 3), 4)  # ValueError if one lies outside
        wide.vector_coordinates(fine.frames.direction[:, [0, -1]].reshape(-1, 3), 4)


@pytest.mark.thorough
@pytest.mark.parametrize("order", [6, 6.4])
def test_variance_at_random_places(order):
    """Mean squares at 48 positions, many kernels apart; within 5 sigma of chi^2."""
    density = coarse().shell_density
    orders = np.full(coarse().shells.count, order)
    ra, dec = ra_dec(np.stack(healpy.pix2vec(2, np.arange(48)), axis=1))
    delta = density.at(ra, dec, np.full(len(ra), SHELL), orders)
    assert abs((delta**2).mean() / density.variance(orders)[SHELL] - 1) < 5 * np.sqrt(2 / len(ra))


@pytest.mark.thorough
@pytest.mark.parametrize(("order", "fraction"), [(8, 1.0), (8, 0.6)])
def test_variance_is_that_of_the_maps(order, fraction, count=300):
    """Compared with sums of the kernels at the same positions; with their variance haloes would be too few."""
    density, rng = coarse().shell_density, np.random.default_rng(1)
    orders = np.full(coarse().shells.count, order - 1 + fraction)
    ra, dec = rng.uniform(200, 207, count), rng.uniform(-36, -30, count)
    found = (density.at(ra, dec, np.full(count, SHELL), orders) ** 2).sum()
    sums = [[brute(coarse(), position, o) for o in (order - 1, order)] for position in zip(ra, dec, strict=True)]
    found /= sum(((1 - fraction) * wide + fraction * narrow) ** 2 for wide, narrow in sums)
    whole = (density._scale**2 * density._variances * kernel_weights(coarse(), orders) ** 2).sum(axis=1)[SHELL]
    assert found == pytest.approx(density.variance(orders)[SHELL] / whole, abs=0.005)
    assert density.variance(orders)[SHELL] < 0.993 * whole


def test_order_of_the_work_does_not_matter():
    matter = coarse()
    fresh = ShellDensity(matter, matter.shell_density._finest, matter.spectra.weights)
    orders = kernel_order(matter, 10.0)
    ra, dec = np.array([10.0, 200.0, 10.01, 10.0]), np.array([5.0, -70.0, 5.02, 5.0])
    shell = np.array([3, 5, 3, 6])
    first = matter.shell_density.at(ra, dec, shell, orders)
    again = fresh.at(ra[::-1], dec[::-1], shell[::-1], orders)[::-1]
    np.testing.assert_array_equal(first, again)
    assert fresh.at([], [], np.zeros(0, int), orders).shape == (0,)


def test_scales_become_orders():
    """The width of that order is the scale at the middle of the shell."""
    matter = coarse()
    middle = 0.5 * (matter.shells.edges[1:] + matter.shells.edges[:-1])
    orders = kernel_order(matter, 12.0)
    inside = (orders > 3) & (orders < matter.orders)
    assert inside.sum() > 4
    np.testing.assert_allclose(WIDTHS[-1] * pixel(orders[inside]) * middle[inside], 12.0, rtol=1e-12)


@pytest.mark.parametrize(("low", "high"), [(3, 4), (5, 6), (7, 8)])
def test_a_fraction_of_an_order_is_that_fraction_of_its_kernels(low, high, fraction=0.3):
    """At 40 positions, to 1% of the standard deviation: maps of lower orders are interpolated once more."""
    density, rng = coarse().shell_density, np.random.default_rng(3)
    ra, dec, count = rng.uniform(100, 110, 40), rng.uniform(20, 25, 40), coarse().shells.count
    one, between, two = (
        density.at(ra, dec, np.full(40, SHELL), np.full(count, order)) for order in (low, low + fraction, high)
    )
    sigma = np.sqrt(density.variance(np.full(count, high))[SHELL])
    np.testing.assert_allclose(between, one + fraction * (two - one), atol=0.01 * sigma)
    assert np.std(two - one) > 0.1 * sigma


def test_weights_of_kernels_by_order():
    """Order 5.3: in full up to 5, 0.3 of those of order 6, none beyond; cells are four orders wider, from 1 on."""
    matter = coarse()
    weights = kernel_weights(matter, np.full(matter.shells.count, 5.3))
    for s, (order, _) in enumerate(matter.widths):
        assert weights[:, s] == pytest.approx(np.full(len(weights), 1.0 if order <= 5 else 0.3 if order == 6 else 0.0))
    assert [cell_order(order) for order in (3, 5, 6, 9)] == [1, 1, 2, 5]
    ends = angular_order(matter, np.array([9.0, WIDTHS[-1] * pixel(4), 1e-9]))
    assert ends.tolist() == [3.0, 4.0, matter.orders - 1]
