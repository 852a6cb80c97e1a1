"""Sums of kernels in single precision and from tables, beside those in double precision and in closed form."""

import healpy
import numpy as np
import pytest
from universe.structure.small_matter import coarse

from csstsim.universe.lensing.potential_field import Kernels, splat
from csstsim.universe.lensing.tangent_grid import TangentGrid
from csstsim.universe.structure.kernels import add_density, add_lensing

TOLERANCE = 2e-5  # of the largest value of a map


@pytest.mark.parametrize(("order", "sigma", "pix"), [(6, 0.02, 20000), (2, 0.5, 30), (6, 0.02, 4095)])
def test_tables_are_the_closed_form(order, sigma, pix):
    grid = TangentGrid.around(order, pix, sigma / 3, 1)
    points = np.stack(healpy.pix2vec(2**order, np.r_[pix - 5 : pix + 6], nest=True), axis=1)
    deviates = np.random.default_rng(1).standard_normal((11, 5))
    reach = min(4.5 * sigma, np.pi)
    kernels = Kernels(points, grid.boxes(points, reach), deviates, sigma**-2, reach)
    single = kernels._replace(deviates=deviates.astype(np.float32))
    exact = np.zeros((*grid.shape, 3, 5))
    splat(exact, grid.frames, kernels)
    lensing, density = np.zeros(exact.shape, np.float32), np.zeros((*grid.shape, 5), np.float32)
    add_lensing(lensing, grid.frames, single)
    add_density(density, grid.frames.direction, single)
    largest = np.abs(exact).max()
    assert largest > 1
    np.testing.assert_allclose(lensing, exact, atol=TOLERANCE * largest)
    np.testing.assert_allclose(density, exact[:, :, 0], atol=TOLERANCE * largest)


def test_sources_between_distances_and_beyond_the_last():
    """The smooth part alone: linear in distance between neighbours of shells.sources, constant beyond the last."""
    matter = coarse(5, False)
    step, (ra, dec) = matter.shells.sources[1], healpy.pix2ang(1 << 29, (100000 << 42) + 7, nest=True, lonlat=True)
    z = np.interp(step * np.array([4.0, 4.25, 5.0]), *matter.shells.distances)
    kappa = matter.lens(100000, np.full(5, ra), np.full(5, dec), [*z, 3.5, 9.0])[0].tolist()
    assert kappa[1] == pytest.approx(0.75 * kappa[0] + 0.25 * kappa[2], abs=1e-3 * abs(kappa[2] - kappa[0]))
    assert kappa[3] == kappa[4] != 0
