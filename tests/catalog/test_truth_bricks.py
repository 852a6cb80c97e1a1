"""Bricks: exact tiling, determinism, densities against the anchors, damaged or foreign files refused."""

import shutil
from types import SimpleNamespace

import healpy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.csst import BANDS
from support.embedded_sky import DENSITY, SEED, brick, key, shipped, universe_folder
from support.own_bands import instrument_folder

from csstsim.base.errors import InputError
from csstsim.base.healpix import NSIDE
from csstsim.base.units import SOLAR_RADIUS_PC
from csstsim.campaign.sections import Lensing
from csstsim.catalog import truth_bricks as module
from csstsim.catalog.flags import STRONG_LENSING
from csstsim.catalog.light.embedded_spectra import rates
from csstsim.catalog.light.photometry import rate_to_mag, subband_weights
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable, columns_with
from csstsim.catalog.truth_bricks import (
    AREA_DEG2,
    _band_rates,
    brick_meta,
    make_brick,
    read_brick,
    with_magnitudes,
    write_brick,
)
from csstsim.instrument.camera import load_camera
from csstsim.universe.lensing.potential_field import Lensed
from csstsim.universe.parameters import load_universe

POLE, WRAP, COMMON = 65535, int(healpy.ang2pix(256, 0.0, 20.0, nest=True, lonlat=True)), 100000


@pytest.mark.thorough
@pytest.mark.parametrize("pix", [0, POLE, WRAP, COMMON, 786431])
def test_every_object_lies_in_its_own_brick(pix):
    table = brick(pix)
    assert (healpy.ang2pix(NSIDE, table["ra"], table["dec"], nest=True, lonlat=True) == pix).all()
    assert (table["ra"] >= 0).all() and (table["ra"] < 360).all()
    assert (table["_healpix_29"] >> 42 == pix).all()


def test_a_brick_across_the_meridian_has_objects_on_both_sides():
    ra = brick(WRAP)["ra"]
    assert (ra < 1).any() and (ra > 359).any()


def test_positions_are_uniform_on_the_brick():
    table = brick(POLE)
    counts = np.bincount(
        healpy.ang2pix(4 * NSIDE, table["ra"], table["dec"], nest=True, lonlat=True) - 16 * POLE, minlength=16
    )
    expected = len(table) / 16
    assert abs((((counts - expected) ** 2) / expected).sum() - 15) < 5 * np.sqrt(
        30
    )  # chi2, 15 degrees of freedom, 5 sigma


def test_content_does_not_depend_on_order_or_neighbours():
    _, camera = shipped()
    fresh = load_universe(universe_folder())  # no cached table, no brick made before
    assert make_brick(SEED, COMMON, fresh, camera, Lensing(), "none") == brick(COMMON)


def test_bands_that_are_not_the_shipped_ones_are_summed_without_tables():
    """Edges may be sharp there. A camera with another number, but the shipped bands, has the same magnitudes."""
    universe, _ = shipped()
    table = brick(COMMON)
    same = with_magnitudes(table, universe, load_camera({"detector.read_noise": 20.0}))
    np.testing.assert_array_equal(same["mag_u"], table["mag_u"])
    larger = load_camera({"telescope.diameter_m": 4.0})
    other = with_magnitudes(table, universe, larger)
    weights = np.stack([subband_weights(f, larger.telescope).sum(axis=0) for f in larger.bands.values()])
    exact = rates(universe, table, weights)[:, list(larger.bands).index("u")]
    expected = rate_to_mag(exact, larger.bands["u"], larger.telescope).astype(np.float32)
    np.testing.assert_array_equal(other["mag_u"], expected)
    assert _band_rates(universe, load_camera({"detector.read_noise": 20.0})) is not None
    assert _band_rates(universe, larger) is None


def test_galaxies_are_the_same_for_every_camera(tmp_path):
    """With the i band in the place of r, too: as many of each type, redshift and mass as counts in CSST's i ask for."""
    universe, camera = shipped()
    own = load_camera(instrument_folder(tmp_path, "i", "r"))
    assert own.bands["i"].pivot < 7000 < camera.bands["i"].pivot
    usual, other = (module._population(universe, one) for one in (camera, own))
    np.testing.assert_array_equal(usual.grid.density, other.grid.density)
    np.testing.assert_array_equal(usual.grid.log_mass, other.grid.log_mass)


@pytest.mark.thorough
def test_seed_and_number_change_everything():
    a, b, c = brick(COMMON), brick(COMMON + 1), brick(COMMON, seed=SEED + 1)
    for other in (b, c):
        assert not np.intersect1d(a["mag_i"][-100:], other["mag_i"][-100:]).size
    assert not np.intersect1d(a["id"], b["id"]).size
    assert len(np.unique(a["id"])) == len(a)


def test_galaxies_are_as_dense_as_asked():
    total = sum((brick(pix)["obj_type"] == 1).sum() for pix in (0, POLE, WRAP, COMMON))
    expected = 4 * DENSITY * 3600 * AREA_DEG2
    assert abs(total - expected) < 5 * np.sqrt(expected)


def test_all_values_are_finite_and_in_range():
    table = brick(COMMON)
    unknown = {name for name, (_, default, _) in columns_with(BANDS).items() if np.isnan(default)}
    for name in set(table) - unknown | {"ra", "dec"}:
        assert np.isfinite(table[name]).all(), name
    galaxy = table["obj_type"] == 1
    assert (np.hypot(table["e1"], table["e2"]) < 1).all()
    assert (table["size_disk"][galaxy] > 0).all() and (table["size_bulge"][galaxy] > 0).all()
    assert table["bulge_frac"].min() >= 0 and table["bulge_frac"].max() <= 1


def test_brick_that_does_not_exist():
    with pytest.raises(InputError, match=r"0\.\.786431"):
        make_brick(pix=12 * NSIDE**2, **key())


def test_file_round_trip_is_exact(tmp_path):
    path = tmp_path / "Npix=5.parquet"
    options = key(Lensing(field="constant", gamma1=0.02))
    write_brick(path, 5, **options)
    table = read_brick(path, brick_meta(pix=5, **options))
    assert table == make_brick(pix=5, **options)
    star = table["obj_type"] == 0
    assert (table["gamma1"][~star] == np.float32(0.02)).all() and not table["gamma1"][star].any()
    assert [p.name for p in tmp_path.iterdir()] == ["Npix=5.parquet"]


def test_damaged_and_foreign_files_are_refused(tmp_path):
    path = tmp_path / "Npix=0.parquet"
    with pytest.raises(InputError, match=r"Npix=0\.parquet"):
        read_brick(path)
    brick(0).write(path)
    whole = path.read_bytes()
    for part in (whole[: len(whole) // 2], whole[:-1], b""):
        path.write_bytes(part)
        with pytest.raises(InputError, match=r"Npix=0.parquet: not a readable parquet file"):
            read_brick(path)
    pq.write_table(pa.table({"id": [1, 2]}), path)
    with pytest.raises(InputError, match="no metadata"):
        read_brick(path)
    ObjectTable.complete({"id": [1]}, BANDS).write(path)
    with pytest.raises(InputError, match="not a truth brick"):
        read_brick(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("seed", 8),
        ("brick", 1),
        ("camera", "0"),
        ("lensing", [0.1, 0, 0]),
        ("structure", "field"),
        ("universe", "0"),
        ("csstsim", "0"),
        ("bright_stars", "0"),
        ("product", "x"),
    ],
)
def test_brick_made_for_something_else_is_refused(tmp_path, name, value):
    path = tmp_path / "Npix=0.parquet"
    brick(0).write(path)
    with pytest.raises(InputError, match=f"{name}: the brick was made for another configuration"):
        read_brick(path, brick_meta(pix=0, **key()) | {name: value})


def test_errors_name_the_file_of_the_universe(tmp_path):
    folder = shutil.copytree(universe_folder(), tmp_path / "universe")
    galaxies = folder / "galaxies.yaml"
    text = galaxies.read_text(encoding="utf-8")
    galaxies.write_text("density: 552\n")
    with pytest.raises(InputError, match=r"galaxies.yaml: .*without source"):
        load_universe(folder)
    galaxies.write_text(text.replace("tau_alpha:", "tau_beta:"), encoding="utf-8")
    with pytest.raises(InputError, match=r"galaxies.yaml: igm.tau_alpha: missing"):
        load_universe(folder).check()
    galaxies.write_text(text.replace("z_max: 7.0", "z_max: 2000.0"), encoding="utf-8")
    with pytest.raises(InputError, match=r"galaxies.yaml: mass_function.z_max: .*up to 20"):
        load_universe(folder).check()
    galaxies.write_text(text, encoding="utf-8")
    stars = folder / "stars.yaml"
    text = stars.read_text(encoding="utf-8")
    for bad, word in (
        ("[9.5]", "2 numbers"),
        ("3", "must be a list"),
        ("ab", "must be a list"),
        ("[9.5, -0.1]", "0 to 10 per kpc"),
        ("[3.0, 0.1]", "a radius from 8.5"),
    ):
        stars.write_text(text.replace("flare: [9.5, 0.056]", f"flare: {bad}"), encoding="utf-8")
        with pytest.raises(InputError, match=rf"stars.yaml: laws.flare: .*{word}"):
            load_universe(folder).check()
    structure = folder / "structure.yaml"
    sound = structure.read_text(encoding="utf-8")
    for bad, word in (("[]", "needs 1 to 4 numbers"), ("[1.0, 9.0]", "0.2 to 2.5"), ("1.0", "must be a list")):
        structure.write_text(sound.replace("values: [0.84, 1.25, 1.86]", f"values: {bad}"), encoding="utf-8")
        with pytest.raises(InputError, match=rf"structure.yaml: .*cuts.*{word}"):
            load_universe(folder).check()
    structure.write_text(sound, encoding="utf-8")
    stars.write_text(text.replace("[thin2, disc,", "[thin2, dics,"), encoding="utf-8")
    with pytest.raises(InputError, match=r"stars.yaml: components: thin2 has no such law .*young, disc"):
        load_universe(folder).check()
    stars.write_text(text.replace("[5.0, 28.0]", "[28.0, 5.0]"), encoding="utf-8")
    with pytest.raises(InputError, match=r"stars.yaml: limits: .*two rising numbers"):
        load_universe(folder).check()
    galaxies.unlink()
    with pytest.raises(InputError, match=r"galaxies.yaml: cannot read the file"):
        load_universe(folder)


def test_quasars_live_in_the_galaxies_they_name():
    """The host has the quasar's place and redshift; each galaxy hosts one at most."""
    hosted = 0
    for pix in (0, POLE, WRAP, COMMON):
        table = brick(pix)
        row = {name: k for k, name in enumerate(table["id"].tolist())}
        quasars = np.flatnonzero((table["obj_type"] == QUASAR) & (table["host"] >= 0))
        for k in quasars:
            host = row[int(table["host"][k])]
            assert table["obj_type"][host] == GALAXY
            assert all(table[name][host] == table[name][k] for name in ("ra", "dec", "z"))
        assert len(np.unique(table["host"][quasars])) == len(quasars)
        hosted += len(quasars)
    assert hosted > 0


def test_stars_shine_by_their_surface_and_galaxies_lie_behind_all_dust():
    """Radius by gravity and mass, distance by parallax: light goes with the square of their ratio."""
    universe, _ = shipped()
    table = brick(COMMON)
    star = (table["obj_type"] == STAR) & (table["parallax"] > 0)
    sun_logg = 4.438
    radius2 = table["stellarmass"][star] / 10.0 ** (table["logg"][star].astype(float) - sun_logg)
    distance = 1000.0 / table["parallax"][star].astype(float)
    wanted = radius2 * (SOLAR_RADIUS_PC / distance) ** 2
    assert star.sum() > 100
    assert np.log10(table["sed_scale"][star] / wanted) == pytest.approx(np.zeros(star.sum()), abs=0.01)
    galaxy = table["obj_type"] == GALAXY
    dust = universe.r_v * universe.dust.ebv(table["ra"][galaxy], table["dec"][galaxy])
    assert table["av"][galaxy] == pytest.approx(dust, rel=1e-5)


def test_a_brick_made_before_a_column_was_added_is_refused(tmp_path):
    path, made = tmp_path / "Npix=0.parquet", brick(0)
    ObjectTable({name: made[name] for name in made if name != "sfr"}, made.meta).write(path)
    with pytest.raises(InputError, match=r"Npix=0\.parquet: sfr: .*remove it and make it again"):
        read_brick(path, brick_meta(pix=0, **key()))


def test_a_light_cone_s_columns_are_the_galaxies_own():
    table = brick(0)
    galaxy = table["obj_type"] == 1
    for name in ("sfr", "metallicity", "stellarage"):
        assert (table[name][galaxy] > 0).all() and np.isnan(table[name][~galaxy]).all(), name
    assert np.isnan(table["halomass"]).all()


def test_stars_lie_behind_the_dust_before_them_and_companions_are_stars():
    """The map's dust up to each star's distance by its parallax; temperature, gravity and area of a companion."""
    universe, _ = shipped()
    table = brick(COMMON)
    star = table.take((table["obj_type"] == STAR) & (table["parallax"] > 0))
    before = universe.r_v * universe.dust.star_ebv(star["ra"], star["dec"], 1000.0 / star["parallax"].astype(float))
    assert star["av"] == pytest.approx(before, rel=1e-5) and np.ptp(before) > 0.05 * before.max()
    paired = star["coeff0"] > 0
    assert 0.05 < paired.mean() < 0.5
    assert (star["coeff0"][paired] > 1900).all() and (star["coeff0"][paired] < 60000).all()
    assert (star["coeff1"][paired] < 9.5).all() and (star["coeff1"][paired] > 0).all()
    assert (star["coeff2"][paired] > 0).all() and np.median(star["coeff2"][paired]) < 1.5
    for name in ("coeff1", "coeff2"):
        assert not star[name][~paired].any()


def test_rows_are_numbered_stars_galaxies_quasars():
    table = brick(COMMON)
    np.testing.assert_array_equal(table["id"], (COMMON << 22) + np.arange(len(table)))
    assert (np.diff(table["obj_type"]) >= 0).all() and set(table["obj_type"]) == {STAR, GALAXY, QUASAR}
    lone = table["host"] < 0
    assert (table["host"][lone] == -1).all() and (lone[table["obj_type"] != QUASAR]).all()


class Field:
    """A field of lenses next to critical: redshift 1 is stretched by 19, 2 by 21, 3 by a strong lens."""

    def lens(self, pix, ra, dec, z):
        kappa = np.select([z == 1, z == 2, z == 3], [0.5, 0.5, 1.2], 0.1)
        gamma1 = np.select([z == 1, z == 2], [0.5 - 1 / 19, 0.5 - 1 / 21], 0.0)
        return Lensed(kappa, gamma1, np.zeros(len(z)))


@pytest.mark.parametrize(("structure", "field", "asked", "flagged"), [
    ("haloes", "cosmic", [("matter", True)], True), ("field", "cosmic", [("matter", False)], False),
    ("none", "cosmic", [("lensing", None)], False), ("haloes", "none", [], False),
])  # fmt: skip
def test_arcs_of_haloes_are_flagged(structure, field, asked, flagged):
    """Stretched by more than 20, or strongly lensed; by the matter of the structure asked for."""
    seen = []
    universe = SimpleNamespace(
        r_v=3.1, dust=SimpleNamespace(ebv=lambda ra, dec: 0.01 * ra + dec), numbers={"lensing": {"stretch_max": 20}},
        lensing_field=lambda seed: seen.append(("lensing", None)) or Field(),
        matter_field=lambda seed, haloes: seen.append(("matter", haloes)) or Field(),
    )  # fmt: skip
    columns = {"z": np.array([0.5, 1.0, 2.0, 3.0])}
    ra, dec, healpix = np.array([1.0, 2, 3, 4]), np.array([0.0, 0.1, 0.2, 0.3]), np.arange(4)
    positions = module.Positions(ra, dec, healpix)
    module._add_positions(columns, positions, 7, 5, universe, Lensing(field=field), structure)
    assert seen == asked
    np.testing.assert_allclose(columns["av"], 3.1 * (0.01 * ra + dec))
    assert columns["ra"] is ra and columns["dec"] is dec and columns["_healpix_29"] is healpix
    assert ("flags" in columns) == flagged
    if flagged:
        assert columns["flags"].tolist() == [0, 0, STRONG_LENSING, STRONG_LENSING]
    if field == "none":
        assert not columns["kappa"].any()


def test_a_brick_has_room_for_so_many_rows(monkeypatch):
    """With two bits for rows: three fit, four do not; hosts are rows of galaxies, which stand behind the stars."""
    universe, camera = shipped()
    whole = brick(COMMON)
    some = {kind: np.flatnonzero(whole["obj_type"] == kind) for kind in (STAR, GALAXY, QUASAR)}
    counts = {STAR: 1, GALAXY: 1, QUASAR: 1}

    def rows(kind):
        return lambda *_: whole.take(some[kind][: counts[kind]]).with_columns(
            host=np.full(counts[kind], 0 if kind == QUASAR else -1)
        )

    for name, kind in (("_stars", STAR), ("_galaxies", GALAXY), ("_quasars", QUASAR)):
        monkeypatch.setattr(module, name, rows(kind))
    monkeypatch.setattr(module, "ID_BITS", 2)
    table = make_brick(SEED, 9, universe, camera, Lensing(), "none")
    assert table["id"].tolist() == [36, 37, 38] and table["host"].tolist() == [-1, -1, 37]
    assert table.meta == brick_meta(SEED, 9, universe, camera, Lensing(), "none")
    counts[STAR] = 2
    with pytest.raises(InputError, match="a brick holds at most 3 objects"):
        make_brick(SEED, 9, universe, camera, Lensing(), "none")


def test_what_a_brick_is_made_of_is_recorded():
    universe, camera = shipped()
    lensing, stars = Lensing(field="constant", kappa=0.1), np.array([[1.0, 2.0, 3.0, 4.0]])
    meta = brick_meta(3, 8, universe, camera, lensing, "field", stars)
    assert meta["product"] == "truth brick" and (meta["seed"], meta["brick"], meta["structure"]) == (3, 8, "field")
    assert meta["universe"] == universe.digest and meta["camera"] == camera.digest_for("truth")
    assert meta["lensing"]["kappa"] == 0.1 and meta["lensing"]["field"] == "constant"
    assert meta["bright_stars"] != brick_meta(3, 8, universe, camera, lensing, "field", stars + 1)["bright_stars"]
    assert brick_meta(3, 8, universe, camera, lensing)["bright_stars"] is None
    assert brick_meta(3, 8, universe, camera, lensing)["structure"] == "haloes"


@pytest.mark.parametrize("pix", [-1, 786432])
def test_numbers_of_no_brick_are_refused(pix):
    with pytest.raises(InputError, match=rf"no such brick .*{pix}.*0\.\.786431"):
        make_brick(pix=pix, **key())


def test_quasars_stand_where_their_hosts_do_and_others_alone(monkeypatch):
    """Hosts are rows of galaxies, the first of them too; without galaxies, all stand alone."""
    hosts = np.array([2, -1, 0, -1, 1])
    monkeypatch.setattr(
        "csstsim.universe.quasars.quasars.draw_quasars", lambda *given: {"z": np.zeros(5), "host": hosts}
    )
    random = module.Positions(np.arange(5) + 50.0, np.arange(5) - 20.0, np.arange(5) + 500)
    monkeypatch.setattr(module, "random_positions", lambda pix, rng, count: random)
    seen = []
    monkeypatch.setattr(module, "_add_positions", lambda columns, at, *given: seen.append([v.tolist() for v in at]))
    monkeypatch.setattr(module, "_complete", lambda kind, columns, camera: kind)
    universe = SimpleNamespace(numbers={"quasars": {}}, cosmology=None)
    galaxies = ObjectTable({
        "ra": np.array([1.0, 2.0, 3.0]), "dec": np.array([7.0, 8.0, 9.0]), "_healpix_29": np.array([10, 20, 30])
    })  # fmt: skip
    for table in (galaxies, galaxies.take(np.zeros(3, bool))):
        assert module._quasars(SEED, 9, universe, None, table, Lensing(), "none") == QUASAR
    assert seen[0] == [[3.0, 51.0, 1.0, 53.0, 2.0], [9.0, -19.0, 7.0, -17.0, 8.0], [30, 501, 10, 503, 20]]
    assert seen[1] == [v.tolist() for v in random]
