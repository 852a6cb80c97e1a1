"""Cycle-9 catalogues exactly as the public converters of github DUT-astro/make_c9_star_cat write them.

Each writer below states the layout that one of its scripts has: groups, names, types, filters and fill values. What a
script puts in for the unknown (0, -1, the epoch of Gaia) must not be taken for a value.
"""

import h5py
import healpy
import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.time import Time
from catalog.test_c9 import write_basis

from csstsim.base.errors import InputError
from csstsim.catalog.c9 import C9Catalog
from csstsim.catalog.contract import check, sky_region
from csstsim.catalog.table import GALAXY, STAR

RA, DEC = 90.0, 20.0
REGION = sky_region(RA, DEC, 0.05)
STARS = (
    "RA", "DEC", "app_sdss_g", "teff", "grav", "z_met", "AV", "DM", "mass", "pmra", "pmdec", "RV", "parallax",
)  # fmt: skip
Z_SUN = 0.02


def append(path, columns):
    """As csv_to_c9h5.py, gaia_fits_to_c9h5_v2.py and hst-hugs.py: float64, resizable, behind what is there."""
    ring = healpy.ang2pix(128, columns["RA"], columns["DEC"], lonlat=True, nest=False)
    with h5py.File(path, "a") as file:
        for pixel in np.unique(ring):
            group = file.require_group(f"star_catalog/{pixel}")
            for name, values in columns.items():
                some = np.asarray(values, "f8")[ring == pixel]
                if name in group:
                    old = len(group[name])
                    group[name].resize((old + len(some),))
                    group[name][old:] = some
                else:
                    group.create_dataset(name, data=some, maxshape=(None,), chunks=True)


def gaia(n=12, seed=1):
    """What gaia_fits_to_c9h5_v2.py makes of Gaia's stars: AV, DM, RV 0; a parallax may be 0 or negative."""
    rng = np.random.default_rng(seed)
    values = {
        "RA": RA + rng.uniform(-0.05, 0.05, n), "DEC": DEC + rng.uniform(-0.05, 0.05, n),
        "app_sdss_g": rng.uniform(16, 21, n), "teff": np.log10(rng.uniform(3500, 9000, n)), "grav": np.full(n, 4.4),
        "z_met": Z_SUN * 10 ** rng.uniform(-1, 0.3, n), "AV": np.zeros(n), "DM": np.zeros(n), "mass": np.ones(n),
        "pmra": rng.normal(0, 400, n), "pmdec": rng.normal(0, 400, n), "RV": np.zeros(n),
        "parallax": rng.normal(0.5, 1.0, n),
    }  # fmt: skip
    values["parallax"][:2] = 0.0, -0.8
    assert tuple(values) == STARS
    return values


def hugs(n=5):
    """What hst-hugs.py appends: magnitudes of HST, and one fallback value for everything else."""
    rng = np.random.default_rng(2)
    places = {"RA": RA + rng.uniform(-0.01, 0.01, n), "DEC": DEC + rng.uniform(-0.01, 0.01, n)}
    fallback = {"teff": np.log10(5000.0), "grav": 4.5, "z_met": Z_SUN * 10**-0.2, "mass": 1.0}
    rest = dict.fromkeys(("AV", "DM", "pmra", "pmdec", "RV", "parallax"), 0.0) | fallback
    return places | {"app_sdss_g": rng.uniform(20, 25, n)} | {name: np.full(n, v) for name, v in rest.items()}


def test_stars_of_gaia_and_hst_in_one_file(tmp_path):
    first, more = gaia(), hugs()
    append(tmp_path / "stars.h5", first)
    append(tmp_path / "stars.h5", more)
    catalog = C9Catalog({"stars": str(tmp_path / "stars.h5")}, REGION)
    table = catalog.table
    assert len(table) == 17 and (table["obj_type"] == STAR).all()
    order = [int(np.flatnonzero(table["ra"] == ra)[0]) for ra in (*first["RA"], *more["RA"])]
    joined = {name: np.concatenate([first[name], more[name]]) for name in STARS}
    for ours, theirs in (("dec", "DEC"), ("mag_norm", "app_sdss_g"), ("logg", "grav"), ("pmra", "pmra"), ("rv", "RV")):
        np.testing.assert_allclose(table[ours][order], joined[theirs], rtol=1e-6)
    np.testing.assert_allclose(table["teff"][order], 10 ** joined["teff"], rtol=1e-6)
    np.testing.assert_allclose(table["feh"][order], np.log10(joined["z_met"] / Z_SUN), atol=1e-6)
    assert not check(C9Catalog, {"stars": str(tmp_path / "stars.h5")}, REGION).faults


def test_the_csv_converter_may_leave_out_columns_and_mean_dex(tmp_path):
    """csv_to_c9h5.py: motions and parallax are optional, and its z_met is [Fe/H]."""
    values = {name: v for name, v in gaia().items() if name not in ("pmra", "pmdec", "RV", "parallax")}
    values["z_met"] = np.linspace(-2.0, 0.3, 12)
    append(tmp_path / "stars.h5", values)
    table = C9Catalog({"stars": str(tmp_path / "stars.h5"), "metallicity": "dex"}, REGION).table
    assert np.sort(table["feh"]) == pytest.approx(values["z_met"], abs=1e-6) and not table["pmra"].any()


def test_places_of_gaias_epoch_go_back_to_2000(tmp_path):
    """By astropy's space motion, to 0.01 mas; 16 years of 400 mas/yr are 6 arcsec."""
    values = gaia()
    append(tmp_path / "stars.h5", values)
    options = {"stars": str(tmp_path / "stars.h5")}
    plain, moved = (C9Catalog(options | more, REGION).table for more in ({}, {"epoch": 2016.0}))
    order = [int(np.flatnonzero(plain["ra"] == ra)[0]) for ra in values["RA"]]
    star = SkyCoord(
        values["RA"] * u.deg, values["DEC"] * u.deg, pm_ra_cosdec=values["pmra"] * u.mas / u.yr,
        pm_dec=values["pmdec"] * u.mas / u.yr, distance=10 * u.pc, obstime=Time(2016.0, format="jyear"),
    )  # fmt: skip
    there = star.apply_space_motion(Time(2000.0, format="jyear"))
    ours = SkyCoord(moved["ra"][order] * u.deg, moved["dec"][order] * u.deg)
    apart = ours.separation(SkyCoord(there.ra, there.dec)).to_value("mas")
    assert apart.max() < 0.01
    assert ours.separation(SkyCoord(star.ra, star.dec)).to_value("arcsec").max() > 5
    for wrong in (True, "2016", 1.0, np.nan):
        with pytest.raises(InputError, match=r"catalog.options.epoch: not an epoch.*1900 to 2100"):
            C9Catalog(options | {"epoch": wrong}, REGION)


def galaxies(n=30):
    rng = np.random.default_rng(3)
    bands = ("u", "g", "r", "i", "z", "y", "nuv", "GU", "GV", "GI")
    f4, coeff = np.float32, np.zeros((n, 20), np.float32)
    coeff[:, 0] = 1.0
    return {
        "ra": RA + rng.uniform(-1.5, 1.5, n), "dec": DEC + rng.uniform(-1.5, 1.5, n), "redshift": rng.uniform(0, 2, n),
        **{f"mag_csst_{band}": rng.uniform(20, 26, n).astype(f4) for band in bands},
        "size": rng.uniform(0.1, 1, n).astype(f4), "ellipticity_true": rng.normal(0, 0.1, (n, 2)).astype(f4),
        "shear": np.zeros((n, 2), f4), "kappa": np.zeros(n, f4), "detA": np.ones(n, f4),
        "bulgemass": rng.uniform(1e8, 1e10, n).astype(f4), "diskmass": rng.uniform(1e8, 1e10, n).astype(f4),
        "type": rng.integers(0, 3, n).astype(np.int32), "veldisp": rng.uniform(50, 200, n).astype(f4),
        "qsoindex": np.full(n, -1, np.int32), "coeff": coeff,
    }  # fmt: skip


def write_bundles(folder, columns, **extra):
    """As csv_to_c9_galaxies_h5.py: a bundle a file, gzip with shuffle and fletcher32; extra: further columns."""
    folder.mkdir()
    ring = healpy.ang2pix(128, columns["ra"], columns["dec"], lonlat=True, nest=False)
    bundle = healpy.nest2ring(16, healpy.ring2nest(128, ring) >> 6)
    for number in np.unique(bundle):
        with h5py.File(folder / f"galaxies_C6_bundle{number:06d}.h5", "w") as file:
            for pixel in np.unique(ring[bundle == number]):
                group = file.require_group(f"galaxies/{pixel}")
                for name, values in (columns | extra).items():
                    some = np.asarray(values)[ring == pixel]
                    group.create_dataset(name, data=some, compression="gzip", shuffle=True, fletcher32=True)
    return bundle


def test_galaxies_in_bundles(tmp_path):
    """The folder is named as in the converter's README; official bundles have columns that no one describes."""
    columns, folder = galaxies(), tmp_path / "ga_test_01.h5"
    columns["ra"][:10], columns["dec"][:10] = RA + np.linspace(-0.05, 0.05, 10), DEC + np.linspace(-0.04, 0.04, 10)
    older = {f"mag_csst_{name}": np.full(30, 22.0, np.float32) for name in ("wf", "wh", "wi")}
    bundle = write_bundles(folder, columns, unknown=np.zeros((30, 3)), **older)
    assert len(np.unique(bundle)) > 1
    options = {"galaxies": str(folder), "basis": write_basis(tmp_path / "basis.h5"), "quasars": None}
    catalog = C9Catalog(options, REGION)
    table = catalog.table
    under = [healpy.nest2ring(128, brick >> 2) for brick in REGION.bricks]
    under = [healpy.nest2ring(128, brick >> 2) for brick in REGION.bricks]
    wanted = np.isin(healpy.ang2pix(128, columns["ra"], columns["dec"], lonlat=True), under)
    assert 10 <= wanted.sum() == len(table) < 30 and (table["obj_type"] == GALAXY).all()
    order = [int(np.flatnonzero(table["ra"] == ra)[0]) for ra in columns["ra"][wanted]]
    given = {name: values[wanted] for name, values in columns.items()}
    for ours, theirs in (("z", "redshift"), ("size_disk", "size"), ("mag_g", "mag_csst_g"), ("gal_type", "type")):
        np.testing.assert_allclose(table[ours][order], given[theirs], rtol=1e-6)
    np.testing.assert_array_equal(table["e2"][order], given["ellipticity_true"][:, 1])
    share = given["bulgemass"] / (given["bulgemass"].astype(float) + given["diskmass"])
    np.testing.assert_allclose(table["bulge_frac"][order], share, rtol=1e-6)
    detA = (1 - table["kappa"]) ** 2 - table["gamma1"] ** 2 - table["gamma2"] ** 2
    np.testing.assert_array_equal(detA[order], given["detA"])
    assert not check(C9Catalog, options, REGION, most=3).faults


def test_damage_under_the_checksum_is_an_error_of_the_file(tmp_path):
    """fletcher32 tells of a flipped byte in a column: one line with the file, no wrong galaxy."""
    columns = galaxies()
    columns["ra"][:], columns["dec"][:] = RA, DEC
    write_bundles(tmp_path / "g", columns)
    [file] = (tmp_path / "g").iterdir()
    with h5py.File(file) as h5:
        [group] = h5["galaxies"].values()
        chunk = group["coeff"].id.get_chunk_info(0)
    with open(file, "r+b") as raw:
        raw.seek(chunk.byte_offset + chunk.size // 2)
        byte = raw.read(1)
        raw.seek(-1, 1)
        raw.write(bytes([byte[0] ^ 0xFF]))
    with pytest.raises(InputError, match=file.name):
        C9Catalog({"galaxies": str(tmp_path / "g"), "quasars": None}, REGION)
