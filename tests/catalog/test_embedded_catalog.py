"""The embedded sky as a catalogue: which rows of its bricks, what varies, what is added, which tables are refused."""

import shutil

import numpy as np
import pytest
from support.csst import BANDS
from support.embedded_sky import brick, key, shipped

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.base.sphere import unit_vectors
from csstsim.campaign.sections import CatalogConfig
from csstsim.catalog.changing.motion import Interval
from csstsim.catalog.changing.visitors import visitors
from csstsim.catalog.contract import sky_region
from csstsim.catalog.embedded import EmbeddedCatalog, SceneCatalog
from csstsim.catalog.galaxy_shapes.component_light import ComponentLight
from csstsim.catalog.galaxy_shapes.full_components import full_components
from csstsim.catalog.light.photometry import subband_fluxes
from csstsim.catalog.open import open_catalog
from csstsim.catalog.table import GALAXY, QUASAR, SATELLITE, STAR, ObjectTable
from csstsim.instrument.filter import GRID
from csstsim.universe.changing import variable_quasars, variable_stars
from csstsim.universe.changing.numbers import numbers_of
from csstsim.universe.dust.extinction import odonnell

PIX = 100000
INTERVAL = Interval(51600.0, 3000.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bricks")
    brick(PIX).write(folder / f"{PIX}.parquet")
    return folder


@pytest.fixture(scope="module")
def region():
    """The inner part of one brick."""
    table = brick(PIX)
    centre = unit_vectors(table["ra"], table["dec"]).mean(axis=0)
    ra, dec = np.degrees(np.arctan2(centre[1], centre[0])) % 360, np.degrees(np.arcsin(centre[2]))
    made = sky_region(float(ra), float(dec), 0.05, BANDS)
    return type(made)(made.ra, made.dec, (PIX,), BANDS)


def opened(folder, region, **options):
    return EmbeddedCatalog({"brick_file": lambda pix: folder / f"{pix}.parquet", **key(), **options}, region)


def test_the_rows_of_a_region_are_those_of_its_bricks(folder, region):
    table, whole = opened(folder, region).table, brick(PIX)
    inside = region.contains(whole["ra"], whole["dec"])
    assert 0.05 < inside.mean() < 0.6 and table == whole.take(inside)
    assert opened(folder, region).truth_hash == opened(folder, region).truth_hash


def test_the_hash_knows_the_bricks_and_the_file_of_a_scene(folder, region, tmp_path):
    """Another seed is another sky; so are other rows of one brick, and not the same rows under another name."""
    brick(PIX, seed=8).write(tmp_path / f"{PIX}.parquet")
    assert opened(tmp_path, region, seed=8).truth_hash != opened(folder, region).truth_hash
    for name, rows in (("one", [0, 5]), ("other", [0, 6]), ("again", [0, 5])):
        brick(PIX).take(np.array(rows)).write(tmp_path / f"{name}.parquet")
    one, other, again = (
        SceneCatalog({"file": str(tmp_path / f"{name}.parquet")}, None) for name in ("one", "other", "again")
    )
    assert one.truth_hash == again.truth_hash != other.truth_hash and one.table.meta == other.table.meta


def test_bricks_of_other_inputs_are_refused(folder, region):
    for name, value in (("seed", 8), ("structure", "field"), ("bright_stars", np.array([[1.0, 2, 3, 4]]))):
        with pytest.raises(InputError, match=f"{name}: the brick was made for another configuration"):
            opened(folder, region, **{name: value})


def test_stars_and_quasars_vary_by_their_laws_and_galaxies_do_not(folder, region, camera):
    """Those kinds that are asked for, at the middle of the exposure and the band's mean wavelength."""
    kinds, filter_ = ("variable_stars", "variable_quasars"), camera.filters["g"]
    table, seed = opened(folder, region).table, key()["seed"]
    rows = np.concatenate([np.flatnonzero(table["obj_type"] == kind)[-400:] for kind in (QUASAR, GALAXY, STAR)])
    wavelength = np.trapezoid(filter_.throughput * filter_.wavelength) / np.trapezoid(filter_.throughput)
    wanted = {}
    for kind, number, law in (
        (kinds[0], STAR, variable_stars.star_changes), (kinds[1], QUASAR, variable_quasars.quasar_changes)
    ):  # fmt: skip
        some, numbers = np.flatnonzero(table["obj_type"][rows] == number), numbers_of(shipped()[0].folder, kind)
        wanted[kind] = np.zeros(len(rows))
        wanted[kind][some] = law(seed, table.take(rows[some]), [51600.0 + 1500 / 86400], wavelength, numbers)[:, 0]
        assert np.count_nonzero(wanted[kind]) > 2
    catalog = opened(folder, region)
    for asked in ((kinds[0],), (kinds[1],), kinds):
        catalog.options["varying"] = asked
        found = catalog.dimming(rows, INTERVAL, filter_)
        assert found == pytest.approx(sum(wanted[kind] for kind in asked), abs=1e-9)
    for asked in ((), ("asteroids",)):
        catalog.options["varying"] = asked
        assert catalog.dimming(rows, INTERVAL, filter_) is None
    assert opened(folder, region).dimming(rows, INTERVAL, filter_) is None


def test_wrong_numbers_of_what_varies_name_their_file(folder, region, camera, monkeypatch):
    catalog = opened(folder, region, varying=("variable_stars",))
    monkeypatch.setattr("csstsim.catalog.embedded.numbers_of", lambda *_: {"classes": {}})
    with pytest.raises(InputError, match=r"variable_stars\.yaml: a number is missing or wrong: KeyError"):
        catalog.dimming(np.arange(3), INTERVAL, camera.filters["g"])


def test_visitors_come_after_the_bricks_rows(folder, region, camera, make_pointing, observe):
    """Rows of the sky stand still; the truth's hash knows who visits."""
    universe, pointing = shipped()[0], make_pointing()
    none = visitors((), 1, universe, camera, pointing, observe(pointing), INTERVAL)
    row = {name: np.zeros(1, none[name].dtype) for name in none}
    row |= {"id": np.array([1 << 52]), "obj_type": np.array([SATELLITE], np.int8), "rate_ra": np.array([3e5])}
    one, plain = ObjectTable(row), opened(folder, region)
    for more in ({}, {"components": "full"}):
        catalog = opened(folder, region, visitors=one, **more)
        table, count = catalog.table, len(plain.table)
        assert len(table) == count + 1 and table["id"][:count].tolist() == plain.table["id"].tolist()
        assert (table["id"][-1], table["obj_type"][-1], table["rate_ra"][-1]) == (1 << 52, SATELLITE, 3e5)
        assert not table["rate_ra"][:count].any() and not table["trail_width"][:count].any()
        assert np.isnan(table["rate_mjd"][:count]).all()
        if more:
            assert (table["n_disk"][-1], table["n_bulge"][-1], table["knots"][-1]) == (1.0, 4.0, 0)
    other = opened(folder, region, visitors=one.with_columns(ra=np.array([1.0])))
    hashes = {catalog.truth_hash for catalog in (plain, opened(folder, region, visitors=one), other)}
    assert len(hashes) == 3


def test_full_components_have_their_indices_and_colours(folder, region, camera):
    plain, full = opened(folder, region), opened(folder, region, components="full")
    assert full.table == full_components(plain.table) and full.truth_hash != plain.truth_hash
    assert plain.component_shares(np.arange(3), camera.filters["g"]) is None
    rows = np.flatnonzero(plain.table["obj_type"] == GALAXY)[[20, 3, 11]]
    for band in ("NUV", "y"):
        shares = full.component_shares(rows, camera.filters[band])
        light = ComponentLight(shipped()[0]).through(camera.filters[band], full.table.take(rows))
        assert set(shares) == {"bulge_frac", "knots_frac"}
        np.testing.assert_allclose(shares["bulge_frac"], light[:, 0], rtol=1e-6)
        np.testing.assert_allclose(shares["knots_frac"], light[:, 2], rtol=1e-6)


@pytest.mark.parametrize("components", ["simple", "full"])
def test_a_campaign_has_the_components_that_it_asks_for(folder, region, components):
    config = CatalogConfig(components=components)
    found = open_catalog(config, region, lambda pix: folder / f"{pix}.parquet", key())
    assert found.table == opened(folder, region, components=components).table
    assert ("n_disk" in found.table) == (components == "full")


def test_a_scene_is_cut_out_of_bricks(tmp_path, camera):
    """The same light in samples, bands and bins, in the order of the rows asked for."""
    whole = brick(PIX)
    some = whole.take(
        np.concatenate([np.flatnonzero(whole["obj_type"] == kind)[:3] for kind in (GALAXY, STAR, QUASAR)])
    )
    some.write(tmp_path / "scene.parquet")
    scene = SceneCatalog({"file": str(tmp_path / "scene.parquet")}, None)
    assert scene.table == some and [obj.id for obj in scene.objs] == some["id"].tolist()
    rows = np.array([7, 0, 4])
    seds = scene.load_seds(rows)
    for sed, row in zip(seds, rows, strict=True):
        np.testing.assert_allclose(scene.load_sed(scene.objs[row])["FLUX"], sed, rtol=1e-9)
    direct = subband_fluxes(seds, camera.filters["i"], camera.telescope)
    found = scene.load_fluxes(rows, camera.filters["i"], camera.telescope)
    np.testing.assert_allclose(found, direct, rtol=6e-3, atol=2e-3 * direct.max())
    edges = GRID[8000:12001:400]
    means = scene.load_binned(rows, edges)
    np.testing.assert_allclose(
        means.sum(axis=1), seds[:, 8000:12000].reshape(3, 10, 400).mean(axis=2).sum(axis=1), rtol=2e-3
    )
    assert len(scene.truth_hash) == 16 and scene.load_norm_filt(scene.objs[0]) is None


def test_a_scene_has_the_spectra_of_the_universe_that_is_named(tmp_path):
    """Twice as much dust to a colour excess dims a star of the same A(V) by another curve."""
    whole = brick(PIX)
    star = np.flatnonzero((whole["obj_type"] == STAR) & (whole["av"] > 0.01))[:1]
    whole.take(star).with_columns(av=np.full(1, 2.0, np.float32)).write(tmp_path / "s.parquet")
    own = shutil.copytree(SHIPPED / "universe", tmp_path / "universe")
    dust = (own / "dust.yaml").read_text()
    assert "r_v: {value: 3.1," in dust
    (own / "dust.yaml").write_text(dust.replace("r_v: {value: 3.1,", "r_v: {value: 5.5,"))
    options = {"file": str(tmp_path / "s.parquet")}
    usual, other = (SceneCatalog(options | more, None).load_seds([0])[0] for more in ({}, {"universe": str(own)}))
    curves = (odonnell(GRID, r_v) for r_v in (3.1, 5.5))
    np.testing.assert_allclose(usual / other, 10 ** (-0.8 * np.subtract(*curves)), rtol=1e-6)


def test_scenes_that_are_none(tmp_path):
    brick(PIX).take([0, 1]).write(tmp_path / "s.parquet")
    two = ObjectTable({name: v[:2] for name, v in brick(PIX).items() if name != "coeff7"}, {"product": "truth brick"})
    two.write(tmp_path / "t.parquet")
    for options, message in (
        ({"file": "s.parquet", "fiel": 1}, "unknown key .*'fiel'.*allowed: file, universe"),
        ({}, r"catalog\.options\.file: required key is missing"),
        ({"file": str(tmp_path / "t.parquet")}, r"t\.parquet: coeff7: not a table of the embedded universe"),
        ({"file": str(tmp_path / "none.parquet")}, r"none\.parquet"),
    ):
        with pytest.raises(InputError, match=message):
            SceneCatalog(options, None)
