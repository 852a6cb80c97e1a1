"""Rank matching: the mass functions by type come back exactly, whatever the haloes; extremes; members as drawn."""

import numpy as np
import pytest
from support.embedded_sky import shipped

from csstsim.base.errors import InputError
from csstsim.universe.galaxies.mass_function import MassGrid
from csstsim.universe.galaxies.occupation import Occupation, quenching
from csstsim.universe.parameters import Universe


class PowerLawHaloes:
    """A mass function with a slope and a cut-off like the real one."""

    def dn_dlnm(self, mass, z):
        return 4e-4 * (mass / 1e13) ** -0.9 * np.exp(-mass / 2e14) / (1 + z)

    def bias(self, mass, z):
        return 0.5 + (mass / 1e13) ** 0.3 * (1 + z)


@pytest.fixture(scope="module")
def grid():
    universe = shipped()[0]
    numbers = universe.numbers["galaxies"]["mass_function"] | {"z_max": 3.0}
    return MassGrid(numbers, universe.cosmology, lambda z: 7.5 + 0.5 * z)


@pytest.fixture(scope="module")
def make(grid):
    numbers = shipped()[0].numbers["occupation"]
    return lambda drawn=(11.0, 0.02, 2.0), **changes: Occupation(numbers | changes, grid, PowerLawHaloes(), drawn)


def test_galaxies_and_haloes_above_matched_values_are_as_many(make, grid):
    """The defining property of F at a few proxies, counted from the two tables."""
    tables = make()
    row = 60
    haloes = sum(tables._counts(tables._density))[row]
    above = np.cumsum(grid.density.sum(axis=0)[row, ::-1])[::-1]
    for proxy in (11.5, 12.0, 13.5):
        k = np.argmin(np.abs(tables.proxies - proxy))
        galaxies = np.interp(tables.log_mass[row, k], grid.log_mass, above)
        assert galaxies == pytest.approx(haloes[k], rel=1e-6)
    assert (np.diff(tables.log_mass, axis=1) >= 0).all()


def test_nothing_is_lost_between_haloes_and_field(make, grid):
    tables = make()
    total = tables.in_drawn + tables.remainder
    np.testing.assert_allclose(total, grid.density, rtol=1e-9, atol=1e-9 * grid.density.max())
    assert (tables.in_drawn >= -1e-9).all()
    z = 0.5 * (grid.z[1:] + grid.z[:-1])
    near, far = z < 0.015, z > 2.05
    assert not tables.in_drawn[:, near].any() and not tables.in_drawn[:, far].any()
    heavy = grid.log_mass > 11.0
    assert tables.remainder[:, (z > 0.1) & (z < 1.9)][:, :, heavy].sum() < 1e-3 * grid.density[:, :, heavy].sum()


def test_all_quiescent_galaxies_are_centrals_or_satellites(make, grid):
    """Over all haloes, drawn or not, the quiescent fraction of each mass is that of the mass functions."""
    tables = make(drawn=(7.0, 0.0, 3.0))
    np.testing.assert_allclose(tables.in_drawn[1].sum(), grid.density[1].sum(), rtol=1e-3)
    row = 60
    shown = grid.density[:, row].sum(axis=0) > 1e-3
    np.testing.assert_allclose(tables.in_drawn[1, row, shown], grid.density[1, row, shown], rtol=1e-6, atol=1e-9)
    assert ((tables.quiescent_central >= 0) & (tables.quiescent_central <= tables.quiescent + 1e-12)).all()


def test_satellites_of_massive_haloes_are_redder_and_less_so_long_ago():
    numbers = shipped()[0].numbers["occupation"]["quenching"]
    assert quenching(12.0, 0.0, numbers) == pytest.approx(0.2)
    assert quenching(14.0, 0.0, numbers) == pytest.approx(0.54) and quenching(14.0, 3.0, numbers) == pytest.approx(0.27)
    assert quenching(9.0, 0.0, numbers) == 0.0 and quenching(17.0, 0.0, numbers) == 0.8


def test_without_drawn_haloes_all_galaxies_remain(make, grid):
    tables = make(drawn=None)
    np.testing.assert_array_equal(tables.remainder, grid.density)
    assert (tables.bias > 0.5).all()
    assert (tables.bias[20:] > make().bias[20:])[: len(grid.z) // 3].all()  # massive haloes are biased


def test_a_mass_function_without_galaxies(make):
    universe = shipped()[0]
    empty = MassGrid(universe.numbers["galaxies"]["mass_function"], universe.cosmology, lambda z: np.full(len(z), 12.0))
    empty.density[:] = 0.0
    tables = Occupation(universe.numbers["occupation"], empty, PowerLawHaloes(), (11.0, 0.02, 2.0))
    assert not tables.in_drawn.any() and not tables.remainder.any() and np.isfinite(tables.bias).all()


@pytest.mark.parametrize(("section", "name", "value"), [("satellites", "axis_ratio", 0), ("surviving", "most", 1.5)])
def test_impossible_numbers_are_refused(section, name, value):
    universe = shipped()[0]
    numbers = universe.numbers["occupation"]
    changed = universe.numbers | {"occupation": numbers | {section: numbers[section] | {name: value}}}
    with pytest.raises(InputError, match=rf"occupation.yaml: {section}.{name}: .*up to 1"):
        Universe(universe.folder, changed).check()


def test_rows_and_bins_that_are_drawn_in_part(make, grid):
    """Between redshifts that cut two rows, above a mass that halves a bin: fractions of the volume and of the bin."""
    row, last = 20, 40
    z = grid.z
    near, far = z[row] + 0.25 * (z[row + 1] - z[row]), z[last] + 0.5 * (z[last + 1] - z[last])
    tables = make(drawn=(12.0, near, far))
    step = tables.mass[1] - tables.mass[0]
    fraction = tables._drawn / np.where(tables._density > 0, tables._density, 1.0)
    volume = grid.cosmology.volume
    heavy = tables.mass > 12.0 + step
    assert fraction[row, heavy] == pytest.approx(volume(near, z[row + 1]) / volume(z[row], z[row + 1]), rel=1e-9)
    assert fraction[last, heavy] == pytest.approx(volume(z[last], far) / volume(z[last], z[last + 1]), rel=1e-9)
    assert fraction[row + 1 : last, heavy] == pytest.approx(np.ones((last - row - 1, heavy.sum())))
    assert not fraction[:row].any() and not fraction[last + 1 :].any()
    inside = np.clip((tables.mass + 0.5 * step - 12.0) / step, 0, 1)  # of a bin about its middle
    assert fraction[row + 1] == pytest.approx(inside, abs=1e-9) and 0 <= inside.min() < inside.max() == 1


def test_the_bias_of_the_remainder_is_the_mean_over_its_haloes(make):
    """Galaxies above the lightest: centrals and surviving satellites of each halo that is not drawn."""
    tables = make()
    row = 10
    k = np.searchsorted(tables.proxies, tables.lightest_proxy[row])
    x = (tables.lightest_proxy[row] - tables.proxies[k - 1]) / (tables.proxies[k] - tables.proxies[k - 1])
    each = sum(
        part * ((1 - x) * table[:, k - 1] + x * table[:, k])
        for part, table in ((1.0, tables.central), (tables.surviving[row], tables.satellite))
    )
    number = (tables._density - tables._drawn)[row] * each
    z = 0.5 * (tables.grid.z[row] + tables.grid.z[row + 1])
    bias = 0.5 + (10**tables.mass / 1e13) ** 0.3 * (1 + z)
    assert tables.bias[row] == pytest.approx((number * bias).sum() / number.sum(), rel=1e-6)
