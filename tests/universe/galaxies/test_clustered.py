"""Bricks with structure: seams, order, what the columns say. A halo's members are counted independently of bricks."""

from pathlib import Path
from types import SimpleNamespace

import healpy
import numpy as np
import pytest
from scipy.stats import kstest
from support.embedded_sky import SEED, brick, key, shipped, universe_folder

from csstsim.base.counter import object_keys
from csstsim.base.healpix import NSIDE
from csstsim.base.sphere import frames
from csstsim.campaign.sections import Lensing
from csstsim.catalog.table import GALAXY, QUASAR
from csstsim.catalog.truth_bricks import (
    AREA_DEG2,
    _clustered,
    _streams,
    brick_meta,
    make_brick,
    read_brick,
    write_brick,
)
from csstsim.instrument.load import read_data
from csstsim.universe.galaxies.clustered import ClusteredGalaxies
from csstsim.universe.galaxies.members import draw_members
from csstsim.universe.parameters import load_universe

PIX, NEXT = 100000, 100001
DARK = Lensing(field="none")
PUBLISHED = read_data(Path(__file__).parents[1] / "published_galaxies.yaml")


@pytest.fixture(scope="module")
def galaxies():
    universe, camera = shipped()
    return _clustered(SEED, universe, camera, "haloes")


@pytest.fixture(scope="module")
def samples(galaxies):
    return {pix: galaxies.sample(pix, _streams(SEED, pix, "galaxies"), AREA_DEG2) for pix in (NEXT, PIX)}


@pytest.mark.thorough
def test_no_member_is_lost_or_doubled_at_a_border(galaxies, samples):
    """All haloes within twice their radius of one brick, their members placed once: each brick holds those in it."""
    matter, occupation = galaxies.matter, galaxies.occupation
    radius, distance = matter.mass_function.virial_radius, galaxies.population.cosmology.comoving_distance
    haloes = matter.haloes.near(PIX, lambda z, m: 2 * radius(10.0 ** np.asarray(m)) / distance(z))
    radius = radius(10 ** haloes["log_mass"])
    members = draw_members(occupation, haloes["z"], haloes["log_mass"], haloes["concentration"], radius, haloes["key"])
    centre, east, north = frames(np.radians(haloes["ra"]), np.radians(haloes["dec"]))
    distance = distance(haloes["z"])
    x, y, outwards = members.offset.T
    position = centre[members.halo] * (distance[members.halo] + outwards)[:, None]
    position += east[members.halo] * x[:, None] + north[members.halo] * y[:, None]
    at = healpy.vec2pix(1 << 29, *position.T, nest=True)
    near = members.halo  # every halo that reaches into PIX is among them; those of NEXT that are far from PIX are not
    mine = samples[PIX]["_healpix_29"][samples[PIX]["satellite"] >= 0]
    np.testing.assert_array_equal(np.sort(at[at >> 42 == PIX]), np.sort(mine))
    theirs = set(samples[NEXT]["_healpix_29"][samples[NEXT]["satellite"] >= 0].tolist())
    assert set(at[at >> 42 == NEXT].tolist()) <= theirs
    # Some haloes have members on both sides of the border.
    sides = [np.unique(near[(at >> 42) == pix]) for pix in (PIX, NEXT)]
    assert len(np.intersect1d(*sides)) > 10


@pytest.mark.thorough
def test_a_brick_does_not_depend_on_those_made_before():
    universe, camera = load_universe(universe_folder()), shipped()[1]
    made = make_brick(SEED, PIX, universe, camera, DARK, "haloes")
    assert made == make_brick(pix=PIX, **key(DARK, structure="haloes"))


@pytest.mark.thorough
def test_columns_of_haloes():
    table = make_brick(pix=PIX, **key(DARK, structure="haloes"))
    galaxy, member = table["obj_type"] == GALAXY, table["satellite"] >= 0
    assert (healpy.ang2pix(NSIDE, table["ra"], table["dec"], nest=True, lonlat=True) == PIX).all()
    np.testing.assert_array_equal(member, np.isfinite(table["halomass"]))
    assert (table["halomass"][member] >= 0.99e11).all() and not member[~galaxy].any()
    assert 0.2 < (table["satellite"][member] == 1).mean() < 0.7
    assert (np.hypot(table["e1"], table["e2"]) < 1).all()
    centrals = table["satellite"] == 0
    stars = table["bulgemass"] + table["diskmass"]
    heavy = centrals & (table["halomass"] > 3e12)
    assert np.median(np.log10(stars[heavy])) == pytest.approx(10.8, abs=0.3)  # Moster et al. 2013
    hosted = table["host"][(table["obj_type"] == QUASAR) & (table["host"] >= 0)]
    assert np.isin(hosted, table["id"][galaxy]).all()


def test_galaxies_are_of_haloes_that_are_drawn_or_of_the_field(galaxies):
    """The tables leave to the field what the haloes of the matter do not hold: lighter, nearer and farther ones."""
    haloes, tables, z = galaxies.matter.haloes, galaxies.occupation, galaxies.population.grid.z
    share = np.divide(tables._drawn, tables._density, out=np.zeros(tables._drawn.shape), where=tables._density > 0)
    lightest, step = haloes.edges[0] / np.log(10), tables.mass[1] - tables.mass[0]
    low, high = haloes.numbers["z_min"], haloes.numbers["z_max"]
    inside, outside = (z[:-1] >= low) & (z[1:] <= high), (z[1:] <= low) | (z[:-1] >= high)
    heavy = (tables.mass > lightest + step) & (tables._density[inside] > 0).all(axis=0)
    assert inside.sum() > 50 and outside.sum() > 2 and heavy.sum() > 50
    np.testing.assert_allclose(share[np.ix_(inside, heavy)], 1.0)
    assert not share[outside].any() and not share[:, tables.mass < lightest - step].any()


def test_as_many_galaxies_as_without_structure(samples, galaxies):
    """Two neighbouring bricks at z = 0.3 to 3; their numbers scatter by some 10%, four sigma are allowed."""
    grid = galaxies.population.grid
    z = 0.5 * (grid.z[1:] + grid.z[:-1])
    found = sum(((s["z"] > 0.3) & (s["z"] < 3.0)).sum() for s in samples.values())
    wanted = grid.density[:, (z > 0.3) & (z < 3.0)].sum() * 2 * AREA_DEG2
    assert found == pytest.approx(wanted, rel=0.4)


@pytest.mark.thorough
@pytest.mark.parametrize("structure", ["field", "none"])
def test_without_haloes_there_is_no_mass(structure, tmp_path):
    """Out of the file of the brick, which says how it was made."""
    table, path, asked = brick(PIX), tmp_path / "brick.parquet", key(DARK, structure=structure)
    if structure == "field":
        write_brick(path, PIX, **asked)
        table = read_brick(path, brick_meta(pix=PIX, **asked))
    assert np.isnan(table["halomass"]).all() and (table["satellite"] == -1).all()
    assert (table["obj_type"] == GALAXY).sum() == pytest.approx(30.0 * 3600 * AREA_DEG2, rel=0.3)


def test_shapes_follow_haloes_and_the_tidal_field(galaxies, samples):
    """By type: star-forming galaxies keep their shapes, centrals of groups turn, quiescent ones get a small mean."""
    sample, rng = samples[PIX], np.random.default_rng(4)
    e = 0.3 * rng.random(len(sample["z"])) * np.exp(2j * np.pi * rng.random(len(sample["z"])))
    columns = {"e1": e.real, "e2": e.imag} | {name: sample[name] for name in ("ra", "dec", "z")}
    after = galaxies._aligned(PIX, _streams(SEED, PIX, "galaxies"), columns, sample)
    numbers = galaxies.occupation.numbers["alignment"]
    turned = (sample["satellite"] == 0) & (sample["halomass"] >= 10 ** numbers["central_from"])
    blue = (sample["gal_type"] == 0) & ~turned
    np.testing.assert_allclose(after[blue], e[blue], atol=1e-15)
    angle = np.angle(after[turned]) - 2 * np.arctan2(sample["axis"][turned, 1], sample["axis"][turned, 0])
    wanted = np.exp(-2 * np.radians(numbers["central_angle"]) ** 2)
    assert turned.sum() > 20 and abs(np.cos(angle).mean() - wanted) < 4 * 0.5 / np.sqrt(turned.sum()) + 0.02
    pointing = (sample["satellite"] == 1) & ~blue
    outwards = sample["offset"][pointing, 0] + 1j * sample["offset"][pointing, 1]
    towards = ((after - e)[pointing] * np.conj((outwards / np.abs(outwards)) ** 2)).mean()
    assert towards == pytest.approx(numbers["radial"], rel=0.1)
    tidal = ~blue & ~pointing & ~turned
    assert 1e-5 < np.abs((after - e)[tidal]).mean() < 0.02


def test_quiescent_galaxies_point_to_the_overdensity_that_they_surround(galaxies):
    """A ring of round ones in a tangential tide; star-forming galaxies and satellites among them do not count."""
    phi, n = np.repeat(np.linspace(0.1, 3.0, 12), 3), 36
    kind, satellite = np.tile([1, 0, 1], 12), np.tile([-1, -1, 1], 12)
    asked = []

    def tidal(pix, ra, dec, z):
        asked.append((pix, ra.tolist(), dec.tolist(), z.tolist()))
        return -np.cos(2 * phi[::3]), -np.sin(2 * phi[::3])

    own = ClusteredGalaxies(galaxies.population, galaxies.occupation, SimpleNamespace(tidal=tidal))
    columns = {"e1": np.zeros(n), "e2": np.zeros(n), "ra": phi, "dec": phi + 10, "z": np.linspace(0.1, 2.0, n)}
    sample = {"gal_type": kind, "satellite": satellite, "halomass": np.full(n, np.nan), "axis": np.zeros((n, 3)),
              "offset": np.zeros((n, 3))}  # fmt: skip
    e = own._aligned(PIX, _streams(SEED, PIX, "galaxies"), columns, sample)
    assert not e[1::3].any() and not e[2::3].any()
    np.testing.assert_allclose(e[::3] / np.abs(e[::3]), np.exp(2j * phi[::3]), atol=1e-12)
    assert asked == [(PIX, *(columns[name][::3].tolist() for name in ("ra", "dec", "z")))]
    assert (np.diff(np.abs(e[::3])) > 0).all()  # 1 / growth


def test_satellites_move_about_the_redshift_of_their_central(samples, galaxies):
    """Members of one halo have its mass to the bit; speeds over its dispersion are normal deviates, centrals rest."""
    sample = samples[PIX]
    order = np.lexsort((sample["satellite"], sample["halomass"]))
    order = order[np.isfinite(sample["halomass"][order])]
    mass, z = sample["halomass"][order], sample["z"][order]
    first = np.maximum.accumulate(np.where(np.r_[True, mass[1:] != mass[:-1]], np.arange(len(mass)), 0))
    pairs = np.flatnonzero((first < np.arange(len(mass))) & (sample["satellite"][order[first]] == 0))
    speed = 299792.458 * (z[pairs] - z[first[pairs]]) / (1 + z[first[pairs]])
    radius = galaxies.matter.mass_function.virial_radius(mass[pairs])
    sigma = np.sqrt(4.300917e-9 * mass[pairs] * (1 + z[first[pairs]]) / (2 * radius))
    sigma *= galaxies.occupation.numbers["satellites"]["dispersion"]
    assert len(pairs) > 200
    assert kstest(speed / sigma, "norm").pvalue > 1e-4


@pytest.mark.parametrize("log_mass", [13.5, 14.0, 14.5])
def test_satellites_by_halo_mass_are_those_of_the_sdss(galaxies, log_mass):
    """Drawn satellites at z = 0.1 above the mass that has the number density of Zehavi et al. (2011): 20%, and 3 sigma.

    Their masses are scaled to our larger density of matter.
    """
    occupation, count, z = galaxies.occupation, 150, 0.1
    published, grid, h = PUBLISHED["satellites"], galaxies.population.grid, galaxies.population.cosmology.h0 / 100
    row = np.searchsorted(grid.z, z) - 1
    above = np.cumsum(grid.density.sum(axis=0)[row, ::-1])[::-1] / grid.volume[row]  # of the columns' lower edges
    mass = np.full(count, log_mass)
    radius = galaxies.matter.mass_function.virial_radius(10**mass)
    keys = object_keys(np.uint64(3), np.arange(count))
    members = draw_members(occupation, np.full(count, z), mass, np.full(count, 5.0), radius, keys)
    smaller = 10**log_mass * published["omega_m"] / galaxies.population.cosmology.omega_m * h
    for magnitude, m0, m1, alpha, density, _ in published["rows"]:
        least = np.interp(-density * h**3, -above, grid.log_mass)
        found = ((members.satellite == 1) & (members.log_mass > least)).sum() / count
        wanted = ((smaller - 10**m0) / 10**m1) ** alpha
        assert abs(found - wanted) < 0.2 * wanted + 3 * np.sqrt(wanted / count), magnitude
