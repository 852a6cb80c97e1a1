"""Haloes: numbers, positions, bias, and the same haloes in every brick."""

import healpy
import numpy as np
import pytest
from scipy.stats import kstest, spearmanr
from universe.structure.small_matter import NUMBERS, coarse, shipped

from csstsim.base.healpix import BRICKS, brick_of
from csstsim.base.sphere import angle, unit_vectors
from csstsim.universe.structure.density import cell_order
from csstsim.universe.structure.haloes import COLUMNS, Haloes, concentration, tier_orders

COMMON, POLE, WRAP = 100000, 65535, int(healpy.ang2pix(256, 0.0, 20.0, nest=True, lonlat=True))


def fresh(matter):
    return Haloes(matter.seed, matter.shell_density, matter.mass_function, matter.numbers)


CLUSTERS, ORDERS = 1, (6, 8, 9)  # the tier that is sampled, in its nearer shells
PATCHES = np.arange(6) * 32 + 3  # of order 2, all over the sky


@pytest.fixture(scope="module")
def drawn():
    """The columns of all clusters of some shells in the patches, with delta / (b sigma^2) at their positions."""
    haloes, found = coarse().haloes, {name: [] for name in (*COLUMNS, "delta")}
    for order in set(haloes._depths[CLUSTERS]) & set(ORDERS):
        cells = 4 ** (cell_order(order) - 2)
        for cell in (PATCHES[:, None] * cells + np.arange(cells)).ravel():
            some = haloes.cell(CLUSTERS, order, int(cell))
            for name in COLUMNS:
                found[name].append(some[name])
            shell, _ = haloes.density.field._shell(some["z"])
            delta = haloes.density.at(some["ra"], some["dec"], shell, haloes._orders[CLUSTERS])
            bias = haloes.mass_function.bias(10 ** some["log_mass"], some["z"])
            found["delta"].append(delta / (bias * haloes._variance[CLUSTERS][shell]))
    return {name: np.concatenate(values) for name, values in found.items()}


def expected_number(haloes, low, high, orders):
    """Haloes on the whole sky of log mass low..high in the shells of these orders, by integration over z and mass."""
    z = np.linspace(haloes.numbers["z_min"], haloes.numbers["z_max"], 400)
    mass = np.geomspace(10**low, 10**high, 60)
    density = np.trapezoid(haloes.mass_function.dn_dlnm(mass, z[:, None]), np.log(mass), axis=1)
    chi = haloes.mass_function.cosmology.comoving_distance(z)
    shell = np.searchsorted(haloes.density.field.shells.edges, chi) - 1
    return 4 * np.pi * np.trapezoid(density * np.isin(shell, orders) * chi**2, chi)


@pytest.mark.thorough
def test_number_of_clusters_is_that_of_the_mass_function(drawn):
    haloes = coarse().haloes
    shells = np.concatenate([s for order, (s, _, _) in haloes._depths[CLUSTERS].items() if order in ORDERS])
    for low, high in ((14.0, 14.3), (14.3, 15.5)):
        found = ((drawn["log_mass"] >= low) & (drawn["log_mass"] < high)).sum()
        wanted = len(PATCHES) / 192 * expected_number(haloes, low, high, shells)
        assert wanted > 500
        assert abs(found - wanted) < 5 * 1.5 * np.sqrt(wanted)  # 1.5: haloes of a patch are not independent


def test_masses_follow_the_mass_function(drawn):
    near = abs(drawn["z"] - 0.3) < 0.05
    mass = np.geomspace(1e14, 5e15, 300)
    number = coarse().mass_function.dn_dlnm(mass, 0.3)
    below = np.concatenate([[0], np.cumsum(0.5 * (number[1:] + number[:-1]))])
    assert near.sum() > 300
    assert kstest(drawn["log_mass"][near], lambda m: np.interp(m, np.log10(mass), below / below[-1])).pvalue > 1e-4


def test_haloes_sit_where_matter_is_dense(drawn):
    """The mean overdensity at haloes is b sigma^2, exactly, for an intensity exp(b delta - b^2 sigma^2 / 2)."""
    error = drawn["delta"].std() / np.sqrt(len(drawn["delta"]) / 4)  # 4: those of a cell share their overdensity
    assert abs(drawn["delta"].mean() - 1) < 5 * error < 0.25


def test_concentrations_scatter_about_the_relation(drawn):
    haloes = coarse().haloes
    ratio = np.log10(drawn["concentration"] / haloes.mean_concentration(10 ** drawn["log_mass"], drawn["z"]))
    assert abs(ratio.mean()) < 5 * 0.14 / np.sqrt(len(ratio))
    assert ratio.std() == pytest.approx(0.14, rel=5 / np.sqrt(2 * len(ratio)))


def test_keys_are_unique(drawn):
    assert len(np.unique(drawn["key"])) == len(drawn["key"]) and drawn["key"].dtype == np.uint64


@pytest.mark.thorough
def test_keys_are_unique_among_tiers_and_depths():
    """Of all haloes near a brick, of both tiers and of shells that follow maps of different orders."""
    haloes = coarse().haloes
    near = haloes.near(COMMON, lambda z, log_mass: 0.05 + 0 * (z + log_mass))
    light, shell = near["log_mass"] < 14, haloes.density.field._shell(near["z"])[0]
    assert min(light.sum(), (~light).sum()) > 20 and len(np.unique(np.ceil(haloes._orders[1][shell]))) > 3
    assert len(np.unique(near["key"])) == len(near["key"])
    for name in ("z", "concentration"):
        assert len(np.unique(near[name])) == len(near[name]), name


@pytest.mark.thorough
@pytest.mark.parametrize("pix", [COMMON, POLE, WRAP, 0, BRICKS - 1])
def test_neighbours_see_the_same_haloes(pix):
    """In any order, to the bit, and in one order; each brick sees all that lie within the reach."""
    haloes, reach = coarse().haloes, coarse().disc_angle
    other = int(healpy.get_all_neighbours(256, pix, nest=True)[[1, 0][int(pix == 0)]])
    first, second = haloes.near(pix, reach), fresh(coarse()).near(other, reach)
    common, here, there = np.intersect1d(first["key"], second["key"], return_indices=True)
    assert len(common) > 20
    assert (np.diff(np.argsort(np.argsort(here))[np.argsort(there)]) == 1).all()
    for name in COLUMNS:
        np.testing.assert_array_equal(first[name][here], second[name][there])
    # What only the neighbour sees is out of reach here.
    only = ~np.isin(second["key"], first["key"])
    border = healpy.boundaries(256, pix, step=64, nest=True).T
    v = unit_vectors(second["ra"][only], second["dec"][only])
    apart = np.radians(angle(v[:, None], border[None]).min(axis=1))
    assert (apart > reach(second["z"][only], second["log_mass"][only]) * 0.999).all()


def test_no_reach_leaves_the_brick_s_own(pix=COMMON):
    haloes = coarse().haloes
    own = haloes.near(pix, lambda z, log_mass: 0 * z + 0 * log_mass)
    assert (brick_of(own["ra"], own["dec"]) == pix).all()
    wide = haloes.near(pix, lambda z, log_mass: 0 * z + 0 * log_mass + 0.002)
    inside = brick_of(wide["ra"], wide["dec"]) == pix
    np.testing.assert_array_equal(np.sort(wide["key"][inside]), np.sort(own["key"]))
    heavy = haloes.near(pix, lambda z, log_mass: 0 * z + 0 * log_mass + 0.002, lowest=13.5)
    np.testing.assert_array_equal(heavy["key"], wide["key"][wide["log_mass"] >= 13.5])


@pytest.mark.thorough
def test_a_reach_that_is_largest_within_a_tier_finds_all(pix=COMMON):
    """Discs of 3e14 are wider than those of 4e14. Beside all haloes near, chosen by their distance from the border."""
    haloes = coarse().haloes

    def reach(z, log_mass):
        return 0.06 * np.exp(-((log_mass - 14.3) ** 2) / 0.02) + 0 * z

    found, near = (haloes.near(pix, one, lowest=14.0) for one in (reach, lambda z, m: 0.06 + 0 * (z + m)))
    border = healpy.boundaries(256, pix, step=64, nest=True).T
    apart = np.radians(angle(unit_vectors(near["ra"], near["dec"])[:, None], border[None]).min(axis=1))
    due = near["key"][(apart < 0.999 * reach(near["z"], near["log_mass"])) & (apart > 0.004)]
    assert len(due) > 20 and np.isin(due, found["key"]).all()


def test_redshifts_and_masses_keep_their_limits(drawn):
    numbers = coarse().haloes.numbers
    assert drawn["z"].min() >= numbers["z_min"] and drawn["z"].max() <= numbers["z_max"]
    assert drawn["log_mass"].min() >= 14 and drawn["log_mass"].max() <= np.log10(5e15)


@pytest.mark.thorough
def test_another_seed_makes_other_haloes():
    some = coarse(6).haloes.near(COMMON, coarse().disc_angle)
    assert not np.isin(some["ra"], coarse().haloes.near(COMMON, coarse().disc_angle)["ra"]).any()


def test_lensing_haloes_follow_no_finer_field_than_said():
    """1.3 pixels of 1.718 arcmin are 2.233 arcmin; lighter haloes follow finer kernels."""
    numbers = NUMBERS | {"haloes": NUMBERS["haloes"] | {"finest": 1.3 * 1.718}}
    orders, usual = (tier_orders(shipped(), shipped().mass_function, n) for n in (numbers, NUMBERS))
    assert orders[1:].max() == pytest.approx(11.0, abs=1e-3) and orders[0].max() > 12
    np.testing.assert_array_equal(orders[0], usual[0])
    assert (orders[1:] <= usual[1:]).all() and (orders[1:, 0] == usual[1:, 0]).all()


def test_redshifts_follow_numbers_and_volumes_within_a_shell(drawn):
    """The shell with most clusters: by integration over mass, volume and depth."""
    haloes, shells = coarse().haloes, coarse().shells
    chi = haloes.mass_function.cosmology.comoving_distance(drawn["z"])
    shell = np.searchsorted(shells.edges, chi) - 1
    most = np.bincount(shell).argmax()
    low, high = np.interp(shells.edges[most : most + 2], *shells.distances)
    z = np.linspace(max(low, haloes.numbers["z_min"]), min(high, haloes.numbers["z_max"]), 200)
    mass = np.geomspace(1e14, 5e15, 60)
    number = np.trapezoid(haloes.mass_function.dn_dlnm(mass, z[:, None]), np.log(mass), axis=1)
    distance = haloes.mass_function.cosmology.comoving_distance(z)
    density = number * distance**2 * np.gradient(distance, z)
    below = np.concatenate([[0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    near = drawn["z"][shell == most]
    assert len(near) > 300 and kstest(near, lambda at: np.interp(at, z, below / below[-1])).pvalue > 1e-4


def test_concentrations_have_their_pivot_and_slopes():
    """Amplitude at 2e12 / h today; the powers of mass and of 1 + z; of a halo with the Hubble constant of its own."""
    law = {"amplitude": 10.0, "pivot_h": 2e12, "mass_slope": -0.1, "redshift_slope": -1.0}
    found = concentration([2e12 / 0.7, 2e13 / 0.7, 2e12 / 0.7], [0.0, 0.0, 1.0], law, 0.7)
    np.testing.assert_allclose(found, [10.0, 10 * 10**-0.1, 5.0])


def test_haloes_of_a_tier_are_counted_from_the_nearest_on():
    """Cumulative numbers per sr against an integral; and back, to 1e-3; none before the minimum redshift."""
    haloes, cosmology = coarse().haloes, coarse().mass_function.cosmology
    table, mass = haloes._tables[0], np.geomspace(1e13, 1e14, 200)
    for z in (0.4, 1.1):
        at = np.linspace(haloes.numbers["z_min"], z, 600)
        number = np.trapezoid(coarse().mass_function.dn_dlnm(mass, at[:, None]), np.log(mass), axis=1)
        chi = cosmology.comoving_distance(at)
        wanted = np.trapezoid(number * chi**2, chi)
        assert np.interp(z, table.fine_z, table.cumulative) == pytest.approx(wanted, rel=2e-3)
        assert table.redshift(wanted) == pytest.approx(z, abs=2e-3)
    assert table.cumulative[0] == 0 and table.redshift(0.0) == pytest.approx(haloes.numbers["z_min"])
    low, high = table.mass(np.full(4, 0.6), np.full(4, 0.5), np.array([0.0, 0.3, 0.9, 1.0]))
    assert low[0] == pytest.approx(np.log(1e13)) and low[-1] == pytest.approx(np.log(1e14)) and (np.diff(low) > 0).all()
    assert high == pytest.approx(coarse().mass_function.bias(np.exp(low), 0.6), rel=1e-3)


def test_draws_of_a_halo_know_nothing_of_each_other(drawn):
    """Place in right ascension, depth in the shell, mass and scatter of the concentration: no rank correlation."""
    haloes = coarse().haloes
    chi = haloes.mass_function.cosmology.comoving_distance(drawn["z"])
    depth = chi % coarse().shells.edges[1]
    ratio = drawn["concentration"] / haloes.mean_concentration(10 ** drawn["log_mass"], drawn["z"])
    place = (drawn["key"] % 2**20, (drawn["ra"] * 1e4) % 1.0, (drawn["dec"] * 1e4) % 1.0)
    near = abs(drawn["z"] - 0.4) < 0.2  # masses and depths depend on redshift, by less within a few shells
    values = np.stack([*place[1:], depth, drawn["log_mass"], ratio])[:, near]
    found = spearmanr(values, axis=1).statistic - np.eye(len(values))
    assert near.sum() > 1000 and np.abs(found).max() < 5 / np.sqrt(near.sum())


@pytest.mark.parametrize("fraction", [0.2, 0.7])
def test_masses_between_nodes_of_redshift_are_a_mixture_of_both(fraction, tier=CLUSTERS):
    """Numbers are linear in redshift from node to node, so masses are drawn of each node as often as it has haloes."""
    table = coarse().haloes._tables[tier]
    node = 14
    z = table.nodes[node] + fraction * table.nodes[1]
    choice, u = np.meshgrid((np.arange(60) + 0.5) / 60, (np.arange(4000) + 0.5) / 4000)
    ln_mass, _ = table.mass(np.full(choice.size, z), choice.ravel(), u.ravel())
    mass = np.geomspace(1e14, 5e15, 2000)
    near, far = coarse().mass_function.dn_dlnm(mass, table.nodes[node : node + 2, None])
    number = (1 - fraction) * near + fraction * far
    below = np.concatenate([[0], np.cumsum(0.5 * (number[1:] + number[:-1]))])
    assert kstest(np.exp(ln_mass), lambda m: np.interp(m, mass, below / below[-1])).statistic < 1.5e-3
