"""Cycle-9 input catalogues, on small files written here in their format."""

import shutil
from pathlib import Path

import h5py
import healpy
import numpy as np
import pytest
import speclite.filters
from astropy import units as u
from support.own_bands import instrument_folder

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.base import CatalogBase
from csstsim.catalog.c9 import C9Catalog, _quasars
from csstsim.catalog.contract import check, sky_region
from csstsim.catalog.light.photometry import ab_mag
from csstsim.catalog.table import GALAXY
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID
from csstsim.universe.dust.extinction import odonnell
from csstsim.universe.parameters import load_universe

RA, DEC = 60.0, -40.0
REGION = sky_region(RA, DEC, 0.05)
REST = 600.0 + 2.9 * np.arange(3587)  # 600-11000 A
BANDS = ("nuv", "u", "g", "r", "i", "z", "y", "GU", "GV", "GI")


def grouped(file, root, ra, dec, columns):
    """Append columns to the groups `root`, one for each NSIDE-128 ring pixel, of an HDF5 file."""
    pixels = healpy.ang2pix(128, ra, dec, lonlat=True)
    for pixel in np.unique(pixels):
        for name, values in columns.items():
            file[f"{root}/{pixel}/{name}"] = np.asarray(values)[pixels == pixel]


def write_stars(path, ra, dec, **changes):
    n = len(ra)
    columns = {
        "RA": ra, "DEC": dec, "app_sdss_g": np.linspace(18, 20, n), "teff": np.log10(np.linspace(3500, 9000, n)),
        "grav": np.full(n, 4.3), "z_met": np.full(n, 0.02), "AV": np.linspace(0, 1, n), "DM": np.full(n, 10.0),
        "mass": np.full(n, 1.0), "pmra": np.full(n, 5.0), "pmdec": np.full(n, -3.0), "RV": np.full(n, 20.0),
        "parallax": np.full(n, 1.0),
    } | changes  # fmt: skip
    with h5py.File(path, "w") as file:
        grouped(file, "star_catalog", ra, dec, {k: v for k, v in columns.items() if v is not None})
    return str(path)


def write_galaxies(folder, ra, dec, **changes):
    n, rng = len(ra), np.random.default_rng(5)
    coeff = np.zeros((n, 20))
    coeff[:, 0], coeff[:, 1] = 1.0, 0.2
    columns = {
        "ra": ra, "dec": dec, "redshift": np.linspace(0.2, 1.0, n), "size": np.full(n, 0.5, np.float32),
        "ellipticity_true": rng.normal(0, 0.1, (n, 2)), "shear": rng.normal(0, 0.02, (n, 2)), "detA": np.ones(n),
        "kappa": rng.normal(0, 0.02, n), "bulgemass": np.full(n, 1e9), "diskmass": np.full(n, 3e9),
        "type": np.zeros(n, np.int32), "veldisp": np.full(n, 120.0), "qsoindex": np.full(n, -1, np.int32),
        "coeff": coeff.astype(np.float32), **{f"mag_csst_{b}": np.full(n, 21.5, np.float32) for b in BANDS},
    } | changes  # fmt: skip
    folder.mkdir(exist_ok=True)
    bundles = healpy.ang2pix(16, ra, dec, lonlat=True)  # independent of the reader's way through nested numbers
    for bundle in np.unique(bundles):
        some = bundles == bundle
        with h5py.File(folder / f"galaxies_C6_bundle{bundle:06d}.h5", "w") as file:
            cut = {k: np.asarray(v)[some] for k, v in columns.items() if v is not None}
            grouped(file, "galaxies", ra[some], dec[some], cut)
    return str(folder)


def write_basis(path, shape=(20, 3587)):
    """Component 0: flat; 1: an emission line at 3727 A; the others 0. f_lambda."""
    components = np.zeros((20, 3587))
    components[0] = 1.0
    components[1] = 50.0 * np.exp(-0.5 * ((REST - 3727.0) / 6.0) ** 2)
    with h5py.File(path, "w") as file:
        file["wavelength"], file["components"] = REST, components[: shape[0], : shape[1]]
    return str(path)


@pytest.fixture(scope="module")
def sky(tmp_path_factory):
    """Options of a catalogue of 40 stars and 40 galaxies, two with quasars, in and around the region."""
    folder, rng = tmp_path_factory.mktemp("c9"), np.random.default_rng(6)
    ra, dec = RA + rng.uniform(-1.5, 1.5, 80), DEC + rng.uniform(-1.5, 1.5, 80)
    ra[:20], dec[:20] = RA + rng.uniform(-0.05, 0.05, 20), DEC + rng.uniform(-0.05, 0.05, 20)
    active = np.full(40, -1, np.int32)
    active[[2, 5]] = [1, 0]
    with h5py.File(folder / "quasars.h5", "w") as file:
        file["wavelength"], file["flux"] = np.linspace(1500.0, 12000.0, 500), np.full((2, 500), [[1e-17], [3e-17]])
    galaxies = (np.concatenate([ra[:10], ra[20:50]]), np.concatenate([dec[:10], dec[20:50]]))
    stars = (np.concatenate([ra[10:20], ra[50:]]), np.concatenate([dec[10:20], dec[50:]]))
    options = {
        "stars": write_stars(folder / "stars.h5", *stars), "basis": write_basis(folder / "basis.h5"),
        "galaxies": write_galaxies(folder / "galaxies", *galaxies, qsoindex=active),
        "quasars": str(folder / "quasars.h5"), "partial": True,
    }  # fmt: skip
    return options, stars, galaxies


@pytest.fixture(scope="module")
def catalog(sky):
    return C9Catalog(sky[0], REGION)


def test_the_objects_of_the_region_are_read(sky, catalog):
    """All objects of the NSIDE-128 pixels under the region's bricks, and no others; columns by their meaning."""
    _, (star_ra, star_dec), (ra, dec) = sky
    wanted = {healpy.nest2ring(128, b >> 2) for b in REGION.bricks}
    table, kinds = catalog.table, catalog.table["obj_type"]
    for kind, places in ((0, (star_ra, star_dec)), (1, (ra, dec))):
        inside = np.isin(healpy.ang2pix(128, *places, lonlat=True), list(wanted))
        assert 10 <= inside.sum() < 40 and set(table["ra"][kinds == kind]) == set(places[0][inside])
    assert len(set(table["id"])) == len(table) and (kinds == 2).sum() == 2
    star = table.take(np.flatnonzero(table["ra"] == star_ra[3]))
    assert star["teff"][0] == pytest.approx(3500 + 5500 * 3 / 39, rel=1e-5) and star["feh"][0] == pytest.approx(0.0)
    assert [star[n][0] for n in ("logg", "pmra", "pmdec", "rv", "parallax", "stellarmass")] == pytest.approx(
        [4.3, 5.0, -3.0, 20.0, 1.0, 1.0]
    )
    galaxy = table.take(np.flatnonzero((table["ra"] == ra[4]) & (kinds == 1)))
    assert galaxy["z"][0] == pytest.approx(0.2 + 0.8 * 4 / 39) and galaxy["bulge_frac"][0] == 0.25
    assert galaxy["size_disk"][0] == galaxy["size_bulge"][0] == 0.5 and galaxy["mag_g"][0] == np.float32(21.5)
    rng = np.random.default_rng(5)
    e, shear = rng.normal(0, 0.1, (40, 2))[4], rng.normal(0, 0.02, (40, 2))[4]
    assert [galaxy[n][0] for n in ("e1", "e2", "gamma1", "gamma2")] == pytest.approx([*e, *shear], rel=1e-6)
    quasar = table.take(np.flatnonzero(kinds == 2))
    hosts = {i: table["ra"][table["id"] == i][0] for i in quasar["host"]}
    assert [hosts[i] for i in quasar["host"]] == list(quasar["ra"])


def test_magnitudes_are_the_files(catalog, camera):
    """Stars through SDSS g by speclite (2 mmag), galaxies through CSST's i (0.1 mmag)."""
    seds = catalog.load_seds(range(len(catalog.objs)))
    table = catalog.table
    star, galaxy = table["obj_type"] == 0, table["obj_type"] == 1
    band = speclite.filters.load_filter("sdss2010-g")
    wave = GRID * u.AA
    energy = (seds[star] * u.ph / (u.s * u.m**2 * u.AA)).to("erg / (s cm2 AA)", u.spectral_density(wave))
    mags = [band.get_ab_magnitude(sed, wave) for sed in energy]
    assert mags == pytest.approx(table["mag_norm"][star], abs=2e-3)
    mags = ab_mag(seds[galaxy], GRID, camera.filters["i"].at(GRID))
    assert mags == pytest.approx(np.full(galaxy.sum(), 21.5), abs=1e-4)


def test_spectra_are_the_models(catalog):
    table, seds = catalog.table, catalog.load_seds(range(len(catalog.objs)))
    universe = load_universe(SHIPPED / "universe")
    row = np.flatnonzero((table["obj_type"] == 0) & (table["av"] > 0.2))[0]
    model = universe.star_seds.surface(table["teff"][row], table["logg"][row], table["feh"][row])[0]
    ratio = seds[row] / (model * 10 ** (-0.4 * float(table["av"][row]) * universe.extinction))
    assert np.ptp(ratio) < 1e-6 * ratio.mean()
    for row in np.flatnonzero(table["obj_type"] == 1)[:5]:  # the line stands where the redshift puts it, f_lambda flat
        near = np.abs(GRID / (1 + table["z"][row]) - 3727.0) < 40
        assert abs(GRID[near][seds[row][near].argmax()] - 3727.0 * (1 + table["z"][row])) < 4.0  # angstrom
        assert seds[row][GRID == 10000.0] / seds[row][GRID == 9000.0] == pytest.approx(10 / 9, rel=1e-6)
    quasars = np.flatnonzero(table["obj_type"] == 2)
    for row in quasars:  # photons of 5000 A: 3.9729e-12 erg
        flux = 1e4 * (3e-17 if table["qsoindex"][row] == 1 else 1e-17) / 3.97289e-12
        assert seds[row][GRID == 5000.0] == pytest.approx(flux, rel=1e-5)


def test_the_papers_methods_give_the_same_spectra(catalog):
    rows = [0, len(catalog.objs) // 2, len(catalog.objs) - 1, int(np.flatnonzero(catalog.table["obj_type"] == 2)[0])]
    np.testing.assert_allclose(CatalogBase.load_seds(catalog, rows), catalog.load_seds(rows), rtol=1e-6)


def test_it_keeps_the_contract(sky, camera):
    report = check(C9Catalog, sky[0], REGION, camera, most=5)
    assert not report.faults, report
    assert all("mag_" in line or "does not cover" in line for line in report.warnings), report  # the test's are made up


def test_metallicity_in_dex(sky):
    table = C9Catalog({"stars": sky[0]["stars"], "metallicity": "dex"}, REGION).table
    assert table["feh"] == pytest.approx(np.full(len(table), 0.02))


def test_without_optional_columns_and_in_two_files(sky, tmp_path):
    _, (ra, dec), _ = sky
    other = write_stars(tmp_path / "more.h5", ra, dec, pmra=None, pmdec=None, RV=None, parallax=None)
    table = C9Catalog({"stars": [sky[0]["stars"], other]}, REGION).table
    assert len(set(table["id"])) == len(table) and set(table["pmra"]) == {0.0, 5.0}


def test_an_empty_region(sky):
    catalog = C9Catalog(sky[0], sky_region(200.0, 50.0, 0.05))
    assert len(catalog.table) == 0 and catalog.load_seds([]).shape == (0, 18001)


def test_a_star_without_temperature_is_dark_and_hurts_no_other(sky, tmp_path):
    _, (ra, dec), _ = sky
    teff = np.full(len(ra), 3.75)
    teff[3] = np.nan
    catalog = C9Catalog({"stars": write_stars(tmp_path / "s.h5", ra, dec, teff=teff)}, REGION)
    useless = np.isnan(catalog.load_seds(range(len(catalog.objs)))).all(axis=1)
    assert list(np.flatnonzero(useless)) == list(np.flatnonzero(catalog.table["ra"] == ra[3]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"stars": "/nowhere.h5"}, ["/nowhere.h5", "No such file"]),
        ({"stars": None, "galaxies": None}, ["catalog.options", "stars, galaxies or both"]),
        ({"star": "x"}, ["catalog.options", "unknown key", "'star'", "stars"]),
        ({"metallicity": "percent"}, ["metallicity", "percent", "dex"]),
        ({"partial": False, "galaxies": "/nowhere"}, ["galaxies_C6_bundle", "No such file"]),
        ({"basis": None}, ["catalog.options.basis", "required"]),
        ({"quasars": ...}, ["catalog.options.quasars", "required", "null"]),
    ],
)
def test_options_that_do_not_work(sky, change, words):
    options = {name: value for name, value in (sky[0] | change).items() if value is not ...}
    with pytest.raises(InputError) as caught:
        catalog = C9Catalog(options, REGION)
        catalog.load_seds(range(len(catalog.objs)))
    assert all(word in str(caught.value) for word in words), caught.value


def test_files_that_do_not_work(sky, tmp_path):
    options, (ra, dec), (gal_ra, gal_dec) = sky
    cases = {
        "no_g.h5": (write_stars(tmp_path / "no_g.h5", ra, dec, app_sdss_g=None), "star_catalog/.*/app_sdss_g: dataset"),
        "text.h5": (write_stars(tmp_path / "text.h5", ra, dec, AV=np.array([b"1"] * len(ra))), "/AV: must be numbers"),
        "basis.h5": (options["basis"], "star_catalog: not a Cycle-9 catalogue|group is missing"),
    }
    for name, (file, message) in cases.items():
        with pytest.raises(InputError, match=message) as caught:
            C9Catalog({"stars": file}, REGION)
        assert name in str(caught.value)
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(Path(options["stars"]).read_bytes()[:2000])
    with pytest.raises(InputError, match=r"damaged\.h5: cannot read"):
        C9Catalog({"stars": str(damaged)}, REGION)
    folder = write_galaxies(tmp_path / "g", gal_ra, gal_dec, coeff=np.zeros((len(gal_ra), 19)))
    with pytest.raises(InputError, match=r"bundle.*/coeff: wrong shape .*19.*20"):
        C9Catalog({"galaxies": folder, "partial": True}, REGION)
    basis = write_basis(tmp_path / "short.h5", (19, 3587))
    catalog = C9Catalog(options | {"basis": basis}, REGION)
    with pytest.raises(InputError, match=r"short.h5: components: wrong shape .*20 x 3587"):
        catalog.load_seds(range(len(catalog.objs)))


def test_quasars_have_the_spectra_that_their_galaxies_name():
    """Whatever the order: index 5 before 2, and galaxies without one between."""
    columns = {name: np.arange(4.0) for name in ("ra", "dec", "redshift", "kappa")}
    columns |= {"shear": np.zeros((4, 2)), "qsoindex": np.array([5, -1, -1, 2])}
    host = 4 * np.arange(4, dtype=np.int64) + GALAXY
    table = _quasars(columns, host, columns["qsoindex"] >= 0)
    assert table["qsoindex"].tolist() == [5, 2] and table["ra"].tolist() == [0.0, 3.0]
    assert table["host"].tolist() == host[[0, 3]].tolist() and len(set(table["id"]) | set(host)) == 6


def test_each_column_of_a_galaxy_and_its_quasar_comes_from_its_own(sky, tmp_path):
    """Values that all differ; of the quasar, place, redshift, lens and host are the galaxy's."""
    rng = np.random.default_rng(8)
    names = {"size": "size_disk", "kappa": "kappa", "bulgemass": "bulgemass", "diskmass": "diskmass",
             "veldisp": "veldisp", "redshift": "z"}  # fmt: skip
    given = {name: rng.uniform(0.1, 0.4, 3) for name in names} | {"type": np.array([0, 1, 1], np.int32)}
    given |= {f"mag_csst_{band}": rng.uniform(20, 25, 3).astype(np.float32) for band in BANDS}
    given |= {"shear": rng.normal(0, 0.02, (3, 2)), "ellipticity_true": rng.normal(0, 0.1, (3, 2))}
    given |= {"coeff": rng.random((3, 20)).astype(np.float32), "qsoindex": np.array([-1, 1, -1], np.int32)}
    ra, dec = RA + np.array([-0.01, 0.0, 0.01]), DEC + np.array([0.01, 0.02, -0.01])
    options = {"galaxies": write_galaxies(tmp_path / "g", ra, dec, **given), "partial": True}
    table = C9Catalog(sky[0] | options | {"stars": None}, REGION).table
    galaxy = table.take(table["obj_type"] == GALAXY)
    galaxy = galaxy.take(np.argsort(galaxy["ra"]))
    columns = {ours: given[theirs] for theirs, ours in names.items()} | {"size_bulge": given["size"]}
    columns |= {f"mag_{band}": given[f"mag_csst_{band}"] for band in ("nuv", "u", "g", "r", "i", "z", "y")}
    columns |= {"mag_norm": given["mag_csst_i"], "gal_type": given["type"], "ra": ra, "dec": dec}
    columns |= {f"coeff{k}": given["coeff"][:, k] for k in range(20)}
    for k, part in enumerate(("1", "2")):
        columns |= {f"e{part}": given["ellipticity_true"][:, k], f"gamma{part}": given["shear"][:, k]}
    for name, values in columns.items():
        np.testing.assert_allclose(galaxy[name], values, rtol=1e-6, err_msg=name)
    quasar = table.take(table["obj_type"] == 2)
    assert len(quasar) == 1 and quasar["host"][0] == galaxy["id"][1] != quasar["id"][0] and quasar["qsoindex"][0] == 1
    for name in ("ra", "dec", "z", "kappa", "gamma1", "gamma2"):
        assert quasar[name][0] == galaxy[name][1], name
    assert (galaxy["qsoindex"] == -1).all() and (galaxy["host"] == -1).all()


def test_the_sun_s_metals_are_an_option_and_masses_and_dust_are_the_files(sky, tmp_path):
    _, (ra, dec), _ = sky
    changes = {"z_met": np.geomspace(1e-4, 0.04, len(ra)), "mass": np.linspace(0.2, 3.0, len(ra))}
    changes |= {"RV": np.linspace(-90, 90, len(ra)), "parallax": np.linspace(0.1, 9.0, len(ra))}
    file = write_stars(tmp_path / "s.h5", ra, dec, **changes)
    for options, solar in (({}, 0.02), ({"solar_z": 0.0134}, 0.0134)):
        table = C9Catalog({"stars": file} | options, REGION).table
        order = [int(np.flatnonzero(ra == one)[0]) for one in table["ra"]]
        assert table["feh"] == pytest.approx(np.log10(changes["z_met"][order] / solar), abs=1e-5)
    wanted = {"stellarmass": changes["mass"], "av": np.linspace(0, 1, len(ra)), "rv": changes["RV"],
              "parallax": changes["parallax"], "mag_norm": np.linspace(18, 20, len(ra)), "dec": dec}  # fmt: skip
    for name, values in wanted.items():
        np.testing.assert_allclose(table[name], values[order], rtol=1e-6, atol=1e-6, err_msg=name)


def test_a_quasar_beyond_the_table_of_spectra_is_named(sky, tmp_path):
    ra, dec = np.array([RA]), np.array([DEC])
    folder = write_galaxies(tmp_path / "g", ra, dec, qsoindex=np.array([2], np.int32))
    catalog = C9Catalog(sky[0] | {"galaxies": folder, "stars": None}, REGION)
    row = int(np.flatnonzero(catalog.table["obj_type"] == 2)[0])
    with pytest.raises(InputError, match=r"quasars\.h5: flux: has too few rows .*row 2"):
        catalog.load_seds([row])


def test_negative_sums_of_components_are_dark(sky, tmp_path):
    """A line taken away that is deeper than the light around it: nothing is left of it, and the rest stays."""
    coeff = np.zeros((1, 20), np.float32)
    coeff[0, :2] = 1.0, -1.0
    folder = write_galaxies(tmp_path / "g", np.array([RA]), np.array([DEC]), coeff=coeff, redshift=np.array([0.5]))
    [sed] = C9Catalog(sky[0] | {"galaxies": folder, "stars": None}, REGION).load_seds([0])
    assert (sed >= 0).all() and not sed[np.abs(GRID - 1.5 * 3727.0) < 15].any() and sed[GRID == 7000.0] > 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wavelength": REST[::-1]}, "wavelength: must rise"), ({"wavelength": REST[:1]}, "wavelength: must rise"),
        ({"wavelength": np.where(REST > 5000, np.nan, REST)}, "wavelength: must be finite"),
        ({"wavelength": REST[None]}, "wavelength: must be finite and have 1 axes"),
        ({"components": np.full((20, 3587), np.inf)}, "components: must be finite"),
        ({"components": np.ones((20, 3586))}, "components: wrong shape"),
    ],
)  # fmt: skip
def test_spectra_that_are_none_are_refused_by_name(sky, tmp_path, change, message):
    with h5py.File(tmp_path / "basis.h5", "w") as file:
        for name, values in ({"wavelength": REST, "components": np.ones((20, 3587))} | change).items():
            file[name] = values
    folder = write_galaxies(tmp_path / "g", np.array([RA]), np.array([DEC]))
    catalog = C9Catalog(sky[0] | {"galaxies": folder, "stars": None, "basis": str(tmp_path / "basis.h5")}, REGION)
    with pytest.raises(InputError, match=rf"basis\.h5: {message}"):
        catalog.load_seds([0])


def test_spectra_are_those_of_the_universe_and_the_camera_that_are_named(sky, tmp_path):
    """Dust of R_V 5.5 before the stars; galaxies' magnitudes through a camera whose i band is that of r."""
    own = shutil.copytree(SHIPPED / "universe", tmp_path / "universe")
    dust = (own / "dust.yaml").read_text()
    assert "r_v: {value: 3.1," in dust
    (own / "dust.yaml").write_text(dust.replace("r_v: {value: 3.1,", "r_v: {value: 5.5,"))
    instrument = instrument_folder(tmp_path, "i", "r")
    catalog = C9Catalog(sky[0] | {"universe": str(own), "instrument": instrument}, REGION)
    table, seds = catalog.table, catalog.load_seds(range(len(catalog.objs)))
    galaxy = table["obj_type"] == GALAXY
    mags = ab_mag(seds[galaxy], GRID, load_camera(instrument).filters["i"].at(GRID))
    assert mags == pytest.approx(np.full(galaxy.sum(), 21.5), abs=1e-4)
    row = np.flatnonzero((table["obj_type"] == 0) & (table["av"] > 0.2))[0]
    model = load_universe().star_seds.surface(table["teff"][row], table["logg"][row], table["feh"][row])[0]
    ratio = seds[row] / (model * 10 ** (-0.4 * float(table["av"][row]) * odonnell(GRID, 5.5)))
    assert np.ptp(ratio) < 1e-6 * ratio.mean()
