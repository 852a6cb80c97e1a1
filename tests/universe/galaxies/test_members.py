"""Members of haloes: the mass functions drawn, the NFW profile, velocities, the ellipsoid, the same members always."""

import numpy as np
import pytest
from scipy.stats import chi2, kstest
from support.embedded_sky import shipped
from test_occupation import PowerLawHaloes

from csstsim.base import counter as counter_module
from csstsim.base.counter import object_keys
from csstsim.base.units import C_KM_S
from csstsim.universe.galaxies import members as members_module
from csstsim.universe.galaxies.mass_function import MassGrid
from csstsim.universe.galaxies.members import draw_members, nfw_radius, redshift
from csstsim.universe.galaxies.occupation import Occupation

G = 4.300917e-9  # Mpc (km / s)^2 / solar mass
NAMES = ("satellite", "log_mass", "kind", "offset", "speed", "axis")


@pytest.fixture(scope="module")
def tables():
    universe = shipped()[0]
    numbers = universe.numbers["galaxies"]["mass_function"] | {"z_max": 1.0}
    grid = MassGrid(numbers, universe.cosmology, lambda z: np.full(len(z), 8.5))
    return Occupation(universe.numbers["occupation"], grid, PowerLawHaloes(), (11.0, 0.02, 1.0))


def haloes(count, z=0.5, log_mass=13.5, seed=1):
    keys = object_keys(np.uint64(seed), np.arange(count))
    mass = np.full(count, float(log_mass))
    return np.full(count, float(z)), mass, np.full(count, 5.0), np.full(count, 1.0), keys


@pytest.mark.parametrize("concentration", [1.0, 5.0, 40.0])
def test_mass_within_the_radius_is_the_share(concentration):
    fraction = np.concatenate([[0.0], np.geomspace(1e-9, 1.0, 200)])
    y = concentration * np.array([nfw_radius(s, concentration) for s in fraction])
    total = np.log1p(concentration) - concentration / (1 + concentration)
    np.testing.assert_allclose((np.log1p(y) - y / (1 + y)) / total, fraction, rtol=1e-6, atol=1e-15)
    assert y[0] == 0.0 and y[-1] == pytest.approx(concentration)


def test_members_have_the_mass_functions_of_the_tables(tables):
    """Haloes of one redshift row, as many in each bin of mass, weighted to the mass function; by type and mass."""
    row, per_bin = 30, 60
    bins = np.flatnonzero((tables.mass > 11) & (tables.mass < 14.2))
    mass = np.repeat(tables.mass[bins], per_bin) + 0.025 * (np.random.default_rng(3).random(len(bins) * per_bin) - 0.5)
    z = np.full(len(mass), tables.grid.z[row : row + 2].mean())
    keys = object_keys(np.uint64(5), np.arange(len(mass)))
    members = draw_members(tables, z, mass, np.full(len(z), 5.0), np.ones(len(z)), keys)
    weight = np.repeat(tables._drawn[row, bins] / per_bin, per_bin)[members.halo]
    haloes_of_row = tables._drawn[row].copy()
    haloes_of_row[np.setdiff1d(np.arange(len(haloes_of_row)), bins)] = 0.0
    for kind in (0, 1):
        found, wanted, error = _by_mass(tables, members, kind, weight, row, haloes_of_row)
        assert chi2.sf((((found - wanted) / error) ** 2).sum(), len(found)) > 1e-4, kind


def test_satellites_lie_on_the_profile_in_a_prolate_ellipsoid(tables):
    members = draw_members(tables, *haloes(400, log_mass=14.5))
    satellite = members.satellite == 1
    numbers = tables.numbers["satellites"]
    offset, axis = members.offset[satellite], members.axis[satellite]
    along = np.einsum("ni,ni->n", offset, axis)
    across = np.sqrt(np.maximum((offset**2).sum(axis=1) - along**2, 0.0))
    q = numbers["axis_ratio"]
    radius = np.hypot(along * q ** (2 / 3), across * q ** (-1 / 3))  # of the sphere that was squeezed
    c = numbers["concentration"] * 5.0
    y = radius * c
    fraction = (np.log1p(y) - y / (1 + y)) / (np.log1p(c) - c / (1 + c))
    assert radius.max() <= 1.0 + 1e-9 and satellite.sum() > 5000
    assert kstest(fraction, "uniform").pvalue > 1e-4
    assert kstest(along * q ** (2 / 3) / radius, "uniform", (-1, 2)).pvalue > 1e-4
    assert not members.offset[~satellite].any() and not members.speed[~satellite].any()


def test_satellites_move_with_the_dispersion_of_their_halo(tables):
    members = draw_members(tables, *haloes(400, log_mass=14.5))
    speed = members.speed[members.satellite == 1]
    wanted = tables.numbers["satellites"]["dispersion"] * np.sqrt(G * 10**14.5 / (2 * 1.0 / 1.5))
    assert kstest(speed / wanted, "norm").pvalue > 1e-4
    assert redshift(0.5, C_KM_S / 100) == pytest.approx(0.5 + 0.015)


def test_a_halo_has_the_same_members_whatever_is_drawn_with_it(tables):
    z, mass, concentration, radius, keys = haloes(50)
    together = draw_members(tables, z, mass, concentration, radius, keys)
    order = np.arange(50)[::-1][::3]
    some = draw_members(tables, *(v[order] for v in (z, mass, concentration, radius, keys)))
    for name in NAMES:
        parts = [getattr(together, name)[together.halo == k] for k in order]
        np.testing.assert_array_equal(np.concatenate(parts), getattr(some, name))
    assert len(np.unique(together.log_mass)) == len(together.log_mass)


def test_no_haloes_and_the_largest(tables):
    none = draw_members(tables, *haloes(0))
    assert all(len(getattr(none, name)) == 0 for name in NAMES)
    huge = draw_members(tables, *haloes(2, log_mass=15.7))
    assert len(huge.halo) > 500 and huge.log_mass.max() < 12.3 and set(huge.kind) == {0, 1}


def _by_mass(tables, members, kind, weight, row, haloes_of_row):
    """Galaxies found, wanted and the error by half a decade of mass; both of `haloes_of_row`."""
    edges = np.arange(8.5, 12.0, 0.5)
    rows = members.kind == kind
    found = np.histogram(members.log_mass[rows], edges, weights=weight[rows])[0]
    haloes = np.zeros(tables._drawn.shape)
    haloes[row] = haloes_of_row
    central, satellite = (tables._in_columns(v)[row] for v in tables._counts(haloes))
    quenched = tables._in_columns(tables._counts(haloes, tables.eps)[1])[row]
    f = tables.quiescent[row]
    red = tables.quiescent_central[row] * central + f * satellite + (1 - f) * tables.scale[row] * quenched
    wanted = np.histogram(tables.grid.log_mass + 0.025, edges, weights=red if kind else central + satellite - red)[0]
    square = np.histogram(members.log_mass[rows], edges, weights=weight[rows] ** 2)[0]
    used = square > 0
    return found[used], wanted[used], np.hypot(np.sqrt(square[used]), 3e-3 * wanted[used])


def test_tables_of_members_are_linear_and_held_at_their_ends():
    table = np.array([8.0, 5.0, 5.0, 1.0])
    for at, value in ((-1.0, 8.0), (0.0, 8.0), (0.25, 7.25), (1.5, 5.0), (2.75, 2.0), (3.0, 1.0), (9.0, 1.0)):
        assert members_module._at.py_func(table, at) == pytest.approx(value)


@pytest.mark.parametrize(
    ("number", "lowest", "at"),
    [(8.0, 0.0, 0.0), (7.25, 0.0, 0.25), (2.0, 0.0, 2.75), (1.0, 0.0, 3.0), (7.9, 0.5, 0.5), (6.0, 0.5, 2 / 3)],
)
def test_the_place_of_a_number_in_a_falling_table(number, lowest, at):
    """8, 5, 5, 1: the inverse of the table above the lowest index."""
    assert members_module._index_of.py_func(np.array([8.0, 5.0, 5.0, 1.0]), number, lowest) == pytest.approx(at)


def test_centrals_are_quiescent_by_their_own_share_and_satellites_by_their_haloes(tables):
    """One redshift, 14 in log mass: fractions of both kinds in half a decade of stellar mass, to 4 sigma."""
    members = draw_members(tables, *haloes(1500, log_mass=14.0))
    row = np.searchsorted(tables.grid.z, 0.5, side="right") - 1
    column = np.rint((members.log_mass - tables.grid.log_mass[0]) / tables.grid.step - 0.5).astype(int)
    column = np.clip(column, 0, tables.quiescent.shape[1] - 1)
    bin_ = np.argmin(np.abs(tables.mass - 14.0))
    f = tables.quiescent[row, column]
    raised = f + (1 - f) * tables.scale[row, column] * tables.eps[row, bin_]
    wanted = np.where(members.satellite == 1, raised, tables.quiescent_central[row, column])
    for satellite in (0, 1):
        some = (members.satellite == satellite) & (members.log_mass > 9.5)
        error = np.sqrt((wanted * (1 - wanted))[some].sum()) / some.sum()
        assert abs(members.kind[some].mean() - wanted[some].mean()) < 4 * error + 0.01, satellite
    assert abs(raised - f)[members.satellite == 1].mean() > 0.1


def test_each_random_number_is_used_once(tables, monkeypatch):
    """The words that a halo's central and satellites request, recorded in the functions before compiling."""
    some = haloes(3, log_mass=14.5)
    compiled = draw_members(tables, *some)
    used = []

    def word(key, counter):
        used.append((int(key), int(counter)))
        return np.uint64(counter_module.word(np.uint64(key), np.uint64(counter)))

    def poisson(mean, key, counter):
        number, after = counter_module.poisson(mean, key, np.uint64(counter))
        used.extend((int(key), k) for k in range(int(counter), int(after)))
        return number, np.uint64(after)

    monkeypatch.setattr(members_module, "word", word)
    monkeypatch.setattr(members_module, "poisson", poisson)
    for name in ("_fill", "_draw_halo", "_normal", "_direction"):
        monkeypatch.setattr(members_module, name, getattr(members_module, name).py_func)
    found = draw_members(tables, *some)
    assert all(np.allclose(getattr(found, name), getattr(compiled, name)) for name in NAMES)
    assert found.satellite.sum() > 20 and len(used) > 7 * found.satellite.sum()
    assert len(set(used)) == len(used)
