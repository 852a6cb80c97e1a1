"""Images and spectra that rows of a table name: what they give, and the error by row for each that cannot be used."""

import h5py
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.galaxy_shapes.images import NEGATIVE, read_image, sky_of
from csstsim.catalog.light.file_spectra import read_spectrum
from csstsim.catalog.light.photometry import ab_mag, subband_weights
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.object_table import read_table
from csstsim.catalog.own_table import TableCatalog
from csstsim.instrument.filter import GRID

REGION = Region((10.0, 11.0, 11.0, 10.0), (0.0, 0.0, 1.0, 1.0), (0,), BANDS)
MAG = 1e-4


def gaussian(side=41, sigma=4.0):
    axis = np.arange(side) - (side - 1) / 2
    return np.exp(-0.5 * (axis**2 + axis[:, None] ** 2) / sigma**2)


@pytest.fixture
def folder(tmp_path):
    fits.writeto(tmp_path / "g.fits", gaussian())
    with h5py.File(tmp_path / "two.h5", "w") as file:
        file["a"], file["c"], file["deep/b"] = gaussian(), gaussian(5), gaussian(21)
    wave = np.array([4000.0, 4990.0, 5000.0, 5010.0, 9000.0])
    Table({"WAVELENGTH": wave, "FLUX": [1.0, 1.0, 9.0, 1.0, 2.0]}).write(tmp_path / "line.csv")
    Table({"WAVELENGTH": [3000.0, 3500.0], "FLUX": [1.0, 1.0]}).write(tmp_path / "blue.csv")
    return tmp_path


HC, C = 1.98644586e-8, 2.99792458e18  # erg angstrom, angstrom / s
OF_PHOTONS = {  # from photon / s / cm2 / angstrom at a wavelength [angstrom]
    "FLAM": lambda n, w: n * HC / w,
    "fnu": lambda n, w: n * HC * w / C,
    "PHOTLAM": lambda n, _: n,
    "photnu": lambda n, w: n * w**2 / C,
    "Jy": lambda n, w: n * HC * w / C * 1e23,
    "mJy": lambda n, w: n * HC * w / C * 1e26,
    "ABMAG": lambda n, w: -2.5 * np.log10(n * HC * w / C) - 48.60,
    "stmag": lambda n, w: -2.5 * np.log10(n * HC / w) - 21.10,
    "erg / (s cm2 Angstrom)": lambda n, w: n * HC / w,
}


@pytest.mark.parametrize(
    "wave_unit, length", [("ANGSTROMS", 1.0), ("Angstrom", 1.0), ("nanometers", 0.1), ("MICRONS", 1e-4)]
)
@pytest.mark.parametrize("unit", OF_PHOTONS)
@pytest.mark.parametrize("form", ["fits", "ecsv"])
def test_spectra_in_the_units_of_calspec(tmp_path, unit, wave_unit, length, form):
    """Each unit of CALSPEC, pysynphot and astropy by its closed form; 1e-4, the digits of its constants."""
    wave = np.linspace(4000.0, 9000.0, 501)
    photons = 1e-3 * (2 + np.sin(wave / 500))
    table = Table({"WAVELENGTH": wave * length, "FLUX": OF_PHOTONS[unit](photons, wave)})
    file = tmp_path / f"s.{form}"
    if form == "fits":
        table.write(file)
        with fits.open(file, mode="update") as hdus:
            hdus[1].header["TUNIT1"], hdus[1].header["TUNIT2"] = wave_unit, unit
    else:
        table["WAVELENGTH"].unit, table["FLUX"].unit = wave_unit, unit
        table.write(file)
    seen = read_spectrum(str(file))
    at = (GRID > 4100) & (GRID < 8900)
    assert seen[at] == pytest.approx(1e4 * np.interp(GRID[at], wave, photons), rel=1e-3)


def catalog(folder, **columns):
    base = {"ra": [10.0, 10.1], "dec": [0.1, 0.2], "mag_r": [20.0, 21.0], "type": ["galaxy"] * 2, "size": [0.5, 0.4]}
    Table(base | columns).write(folder / "t.ecsv", overwrite=True)
    return TableCatalog({"file": str(folder / "t.ecsv")}, REGION)


def test_an_image_gives_its_galaxy_a_size(folder):
    table = catalog(folder, image_file=["g.fits", ""], image_scale=[0.05, np.nan]).table
    assert table["image_file"].tolist() == [str(folder / "g.fits"), ""]
    assert table["image_radius"] == pytest.approx([0.05 * 41 / np.sqrt(2), 0.0])
    assert table["size_disk"] == pytest.approx(
        [0.05 * 4 * np.sqrt(2 * np.log(2)), 0.4], rel=0.07
    )  # to a ring of pixels


def test_north_is_up_and_east_left_unless_the_header_says_otherwise(folder):
    picture = read_image(str(folder / "g.fits"))
    assert sky_of(picture, 0.1, 0.0) == pytest.approx(np.array([[-0.1, 0.0], [0.0, 0.1]]))
    up = sky_of(picture, 0.1, 90.0) @ [0.0, 1.0]  # turned from north through east: up is east
    assert up == pytest.approx([0.1, 0.0], abs=1e-9)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval = ["RA---TAN", "DEC--TAN"], [150.0, 2.0]
    wcs.wcs.cd = np.array([[0.04, 0.01], [0.01, -0.04]]) / 3600
    fits.writeto(folder / "w.fits", gaussian(), wcs.to_header())
    assert sky_of(read_image(str(folder / "w.fits")), 0.0, 0.0) == pytest.approx(
        np.array([[0.04, 0.01], [0.01, -0.04]])
    )


def test_parts_of_files(folder):
    assert read_image(f"{folder}/two.h5[deep/b]").pixels.shape == (21, 21)
    hdus = [fits.PrimaryHDU(), fits.ImageHDU(gaussian(5), name="A"), fits.ImageHDU(gaussian(7), name="B")]
    fits.HDUList(hdus).writeto(folder / "many.fits")
    assert read_image(f"{folder}/many.fits").pixels.shape == (5, 5)
    assert read_image(f"{folder}/many.fits[B]").pixels.shape == (7, 7)
    assert read_image(f"{folder}/many.fits[2]").pixels.shape == (7, 7)


def test_little_negative_light_is_drawn_dark(folder):
    pixels = gaussian()
    pixels[0, 0] = -0.9 * NEGATIVE * pixels.sum()
    fits.writeto(folder / "n.fits", pixels)
    picture = read_image(str(folder / "n.fits"))
    assert picture.pixels.min() == 0 and picture.pixels.sum() == pytest.approx(1.0)
    assert 0.8 * NEGATIVE < picture.negative < NEGATIVE


def wrong(folder, name):
    """Write an image that cannot be drawn; return its name."""
    pixels = gaussian(9, 2.0)
    if name == "nan.fits":
        pixels[3, 5] = np.nan
    elif name == "below.fits":
        pixels[0, 0] = -10.0
    elif name == "dark.fits":
        pixels[:] = 0.0
    elif name == "cube.fits":
        pixels = np.ones((2, 3, 3))
    elif name == "text.fits":
        (folder / name).write_text("no image")
        return name
    fits.writeto(folder / name, pixels)
    return name


@pytest.mark.parametrize("name, message", [
    ("nan.fits", r"row 2: .*nan.fits: image_file: 1 pixels are not numbers \(got 'row 3, column 5"),
    ("below.fits", r"row 2: .*below.fits: image_file: too much flux in negative pixels \(got '\d+.\d% of the flux'"),
    ("dark.fits", r"row 2: .*dark.fits: image_file: has no flux"),
    ("cube.fits", r"row 2: .*cube.fits: image_file: not an image \(got '.* \(2, 3, 3\)'"),
    ("text.fits", r"row 2: .*text.fits.*: not an image that can be read"),
])  # fmt: skip
def test_a_wrong_image_is_refused_by_row(folder, name, message):
    with pytest.raises(InputError, match=message):
        catalog(folder, image_file=["", wrong(folder, name)], image_scale=[0.05, 0.05])


@pytest.mark.parametrize("columns, message", [
    ({"image_file": ["", "none.fits"]}, "row 2: .*none.fits: image_file: no such file"),
    ({"image_file": ["", "g.jpg"]}, "row 2: image_file: not an image file"),
    ({"image_file": ["", "g.fits"]}, "image_scale: row 2: the image has no WCS, so its scale is needed"),
    ({"image_file": ["", "g.fits"], "image_scale": [0, -0.1]}, "image_scale: row 2"),
    ({"image_file": ["", "two.h5"], "image_scale": [0, 0.1]}, r"row 2: .*name the dataset: name.h5\[DATASET\]"),
    ({"image_file": ["", "two.h5[x]"], "image_scale": [0, 0.1]}, "row 2: .*name the dataset"),
    ({"image_file": ["", "g.fits[4]"], "image_scale": [0, 0.1]}, "row 2: .*not an image that can be read"),
    ({"image_file": ["g.fits", ""], "image_scale": [1, 1], "type": ["star"] * 2}, "row 1: only a galaxy has an image"),
    ({"image_file": [3.0, 4.0]}, "image_file: must be names of files"),
    ({"image_file": ["g.fits", ""], "image_scale": [1, 1], "bulge_frac": [0.2, 0]}, "row 1 cannot be rendered: a"),
    ({"knots": [5, 5], "knots_frac": [0.5, 1.5]}, "row 2 cannot be rendered: a galaxy whose knots_frac and bulge_frac"),
    ({"knots": [5, 0], "knots_frac": [0.5, 0.5]}, "row 2 cannot be rendered: a galaxy with knots_frac but no knots"),
    ({"knots": [20_000, 0]}, "row 1 cannot be rendered: a galaxy of more than 10000 knots"),
    ({"knots": [5, -3]}, "row 2 cannot be rendered: a negative number of knots"),
    ({"knots": [5, 0], "type": ["star", "galaxy"]}, "row 1 cannot be rendered: a star or quasar with knots"),
    ({"knots": [0, 0], "knots_frac": [0, 0.1], "type": ["galaxy", "quasar"]}, "row 2 cannot be rendered: a star or q"),
    ({"spectrum_file": ["", "blue.csv"]}, r"row 2: the spectrum has no flux in the band .*blue.csv, r'"),
    ({"spectrum_file": ["", "line.csv"], "mag_i": [20.0, 20.0]}, "spectrum_file: row 2: a spectrum from a file"),
    ({"spectrum_file": ["", "no.csv"]}, "row 2: .*no.csv: spectrum_file: no such file"),
    ({"spectrum_file": ["", "g.txt"]}, "row 2: .*unknown kind of spectrum"),
])  # fmt: skip
def test_a_wrong_row_is_refused(folder, columns, message):
    with pytest.raises(InputError, match=message):
        catalog(folder, **columns)


def test_knots_alone_are_all_of_the_disk(folder):
    table = catalog(folder, knots=[5, 0], bulge_frac=[0.25, 0.25]).table
    assert table["knots_frac"] == pytest.approx([0.75, 0.0]) and table["knots"].dtype == np.int32


def test_a_blank_share_of_knots_is_all_of_the_disk(folder):
    """As in a table without the column; a share of 0 stays one."""
    table = catalog(folder, knots=[5, 6], knots_frac=[np.nan, 0.0], bulge_frac=[0.25, np.nan]).table
    assert table["knots_frac"] == pytest.approx([0.75, 0.0])
    table = catalog(folder, knots=[5, 0], knots_frac=[np.nan, np.nan], bulge_frac=[np.nan, 0.1]).table
    assert table["knots_frac"] == pytest.approx([1.0, 0.0])


@pytest.mark.parametrize("name", ["image_file", "spectrum_file"])
def test_a_table_without_rows_may_have_columns_of_files(folder, name):
    (folder / "none.csv").write_text(f"ra,dec,mag_r,type,{name}\n")
    assert len(TableCatalog({"file": str(folder / "none.csv")}, REGION).table) == 0
    assert TableCatalog.files({"file": str(folder / "none.csv")}) == (str(folder / "none.csv"),)


@pytest.mark.parametrize(("wave", "missed"), [
    ((5800.0, 6400.0), "5800 to 6400 angstrom, not all of NUV, u, g, r, i, z, y"),
    ((2000.0, 11000.0), None),
    ((3000.0, 7300.0), "not all of NUV, i, z, y"),
])  # fmt: skip
def test_a_spectrum_that_ends_inside_a_band_is_said(folder, caplog, wave, missed):
    """Also of bands without a magnitude in the table: there the object has no flux, or too little."""
    Table({"WAVELENGTH": np.linspace(*wave, 100), "FLUX": np.ones(100)}).write(folder / "part.csv")
    mine = catalog(folder, spectrum_file=["part.csv", "part.csv"])
    assert len(mine.table) == 2
    said = [record.getMessage() for record in caplog.records if "spectrum file" in record.getMessage()]
    assert len(said) == (missed is not None)
    if missed:
        assert "1 spectrum file does not cover all bands" in said[0]
        assert "part.csv: " in said[0] and missed in said[0]


@pytest.mark.parametrize("flux", [[1.0, -1.0], [1.0, np.nan], [0.0, 0.0]])
def test_a_wrong_spectrum_is_refused(folder, flux):
    Table({"WAVELENGTH": [3000.0, 9000.0], "FLUX": flux}).write(folder / "bad.csv")
    with pytest.raises(InputError, match=r"row 1: .*bad.csv: FLUX: "):
        catalog(folder, spectrum_file=["bad.csv", ""])


@pytest.mark.parametrize(("names", "said"), [
    (("wavelength", "FLUX"), "has no column WAVELENGTH; its columns: wavelength, FLUX; allowed: WAVELENGTH and FLUX"),
    (("WAVELENGTH", "flux"), "has no column FLUX; its columns: WAVELENGTH, flux"),
])  # fmt: skip
def test_other_columns_of_a_spectrum_are_named(folder, names, said):
    for form in ("csv", "fits"):
        Table([[3000.0, 9000.0], [1.0, 1.0]], names=names).write(folder / f"named.{form}")
        with pytest.raises(InputError, match=rf"row 1: .*named\.{form}: {said}"):
            catalog(folder, spectrum_file=[f"named.{form}", ""])


def test_a_spectrum_from_a_file_has_its_row_s_magnitude_and_its_lines(folder, camera):
    """By trapezoids over the file's own samples; rates, means of bins and samples, which are means, are one light."""
    mine = catalog(folder, spectrum_file=["line.csv", ""])
    rows, band = np.array([1, 0, 0]), camera.filters["r"]
    seds = mine.load_seds(rows)
    assert [ab_mag(sed, GRID, band.at(GRID)) for sed in seds] == pytest.approx([21.0, 20.0, 20.0], abs=MAG)
    peak = np.searchsorted(GRID, 5000.0)
    assert seds[1][peak] / seds[1][peak - 200] == pytest.approx(8.9) and not seds[1][GRID > 9000.5].any()
    weights = subband_weights(band, camera.telescope)
    assert mine.load_fluxes(rows, band, camera.telescope) == pytest.approx(seds @ weights.T, rel=1e-4)
    edges = GRID[3000:9000:40]
    assert mine.load_binned(rows, edges)[1:] == pytest.approx(
        np.array(
            [[sed[a : a + 41].sum() - 0.5 * (sed[a] + sed[a + 40]) for a in range(3000, 8960, 40)] for sed in seds[1:]]
        )
        / 40,
        rel=1e-9,
    )
    assert mine.load_sed(mine.objs[0])["FLUX"] == pytest.approx(seds[1])


class Pictured(CatalogBase):
    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        place = {"type": "galaxy", "ra": 10.0, "dec": 0.1}
        self.objs = [
            MockObject(id=1, **place, image_file=self.options["file"], image_scale=0.05),
            MockObject(id=2, **place, size_disk=0.3, knots=4, knots_frac=0.5, part_of=1),
        ]

    def load_sed(self, obj):
        raise NotImplementedError


def test_a_class_may_name_images_too(folder):
    table = Pictured({"file": str(folder / "g.fits")}, REGION).table
    assert table["image_radius"] == pytest.approx([0.05 * 41 / np.sqrt(2), 0.0])
    assert table["size_disk"][1] == np.float32(0.3) and table["part_of"].tolist() == [-1, 1]
    assert table["knots"].tolist() == [0, 4]
    with pytest.raises(InputError, match=r"Pictured: row 1: .*no.fits: image_file: no such file"):
        _ = Pictured({"file": str(folder / "no.fits")}, REGION).table


def test_what_a_table_names_belongs_to_its_campaign(folder):
    """Its files are among those whose content decides, and a changed image is another sky, wherever it lies."""
    columns = {"image_file": ["g.fits", "two.h5[a]"], "image_scale": [0.1, 0.1], "spectrum_file": ["line.csv", ""]}
    mine = catalog(folder, **columns)
    named = {str(folder / name) for name in ("t.ecsv", "g.fits", "two.h5", "line.csv")}
    assert set(TableCatalog.files({"file": str(folder / "t.ecsv")})) == named
    (folder / "there").mkdir()
    for name in ("g.fits", "two.h5", "line.csv"):
        (folder / "there" / name).write_bytes((folder / name).read_bytes())
    assert catalog(folder / "there", **columns).truth_hash == mine.truth_hash
    (folder / "other").mkdir()
    for name in ("two.h5", "line.csv"):
        (folder / "other" / name).write_bytes((folder / name).read_bytes())
    fits.writeto(folder / "other" / "g.fits", gaussian(41, 4.5))
    assert catalog(folder / "other", **columns).truth_hash != mine.truth_hash
    assert TableCatalog.files({"file": str(folder / "g.fits")}) == (str(folder / "g.fits"),)


@pytest.mark.parametrize("name", ["infrared.fits", "nan.fits", "info_none.fits", "1e5"])
def test_a_name_that_begins_like_a_number_is_a_name(tmp_path, name):
    """Every cell of a column begins so; blanks stay blank."""
    path = tmp_path / "t.csv"
    path.write_text(f"id,ra,dec,mag_r,type,image_file,spectrum_file\n1,150,2,20,galaxy,{name},\n")
    columns = read_table(path)
    assert columns["image_file"].tolist() == [name] and columns["spectrum_file"].tolist() == [""]


def test_a_picture_that_is_no_square_and_not_in_its_middle(folder):
    """Corners from the middle of 3 by 7 pixels; half of the light within the distance of the brighter one of two."""
    pixels = np.zeros((3, 7))
    pixels[0, 0], pixels[1, 5] = 2.0, 3.0
    fits.writeto(folder / "oblong.fits", pixels)
    picture = read_image(f"{folder}/oblong.fits")
    assert picture.pixels.sum() == pytest.approx(1.0) and picture.pixels[1, 5] == pytest.approx(0.6)
    assert picture.radius == pytest.approx(0.5 * np.sqrt(58)) and picture.half_light == pytest.approx(2.0)
    pixels[0, 0] = 4.0
    fits.writeto(folder / "corner.fits", pixels)
    assert read_image(f"{folder}/corner.fits").half_light == pytest.approx(np.hypot(1, 3))
    fits.writeto(folder / "dot.fits", np.pad([[1.0]], 1))
    assert read_image(f"{folder}/dot.fits").half_light == 0.5


def test_an_image_with_a_wcs_is_turned_and_measured_by_it(folder):
    """Pixels twice as long in one direction; an angle turns it from north to east; a scale takes the WCS's place."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval = ["RA---TAN", "DEC--TAN"], [150.0, 2.0]
    wcs.wcs.cd = np.array([[-0.04, 0.0], [0.0, 0.08]]) / 3600
    wcs.wcs.crpix = 21.0, 21.0
    fits.writeto(folder / "long.fits", gaussian(), wcs.to_header())
    picture = read_image(f"{folder}/long.fits")
    np.testing.assert_allclose(sky_of(picture, 0.0, 0.0), [[-0.04, 0.0], [0.0, 0.08]], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(sky_of(picture, 0.0, 90.0), [[0.0, 0.08], [0.04, 0.0]], rtol=1e-6, atol=1e-9)
    half = np.radians(30.0)
    turned = np.array([[np.cos(half), np.sin(half)], [-np.sin(half), np.cos(half)]])
    np.testing.assert_allclose(sky_of(picture, np.nan, 30.0), turned @ [[-0.04, 0.0], [0.0, 0.08]], atol=1e-7)
    np.testing.assert_allclose(sky_of(picture, 0.5, 30.0), 0.5 * turned @ [[-1.0, 0.0], [0.0, 1.0]], atol=1e-7)
    table = catalog(folder, image_file=["long.fits"] * 2, image_scale=[0.0, 0.05], image_pa=[30.0, np.nan]).table
    pixel = picture.half_light
    assert table["image_radius"] == pytest.approx([0.08 * 41 / np.sqrt(2), 0.05 * 41 / np.sqrt(2)], rel=1e-5)
    assert table["size_disk"] == pytest.approx([pixel * np.sqrt(0.04 * 0.08), pixel * 0.05], rel=1e-5)
    np.testing.assert_array_equal(table["size_bulge"], table["size_disk"])
    assert table["image_pa"].tolist() == [30.0, 0.0] and table["image_scale"][0] == 0.0


def test_a_wcs_counts_in_the_middle_of_an_oblong_image(folder):
    """15 deg from the point where its plane touches the sky, where a step is shorter on the sky, by astropy's WCS."""
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval, wcs.wcs.crpix = ["RA---TAN", "DEC--TAN"], [150.0, 2.0], [1.0, 1.0]
    wcs.wcs.cd = np.array([[-0.1, 0.0], [0.0, 0.1]])
    pixels = np.zeros((11, 301), np.float32)
    pixels[5, 150] = 1.0
    fits.writeto(folder / "oblong.fits", pixels, wcs.to_header())
    at = wcs.pixel_to_world([149.5, 150.5, 150, 150], [5, 5, 4.5, 5.5])
    steps = [[axis.to_value("arcsec") for axis in at[k].spherical_offsets_to(at[k + 1])] for k in (0, 2)]
    np.testing.assert_allclose(read_image(f"{folder}/oblong.fits").sky, np.transpose(steps), rtol=1e-3, atol=0.5)
    assert abs(steps[0][0]) < 0.95 * 360


def test_rows_have_the_spectra_of_their_own_files_and_bands(folder, camera):
    """Two files and two bands, each with each; in any order of rows, by magnitudes measured in the row's own band."""
    Table({"WAVELENGTH": [3000.0, 10000.0], "FLUX": [1.0, 9.0]}).write(folder / "red.csv")
    nan, n = np.nan, 5
    columns = {
        "ra": [10.0] * n, "dec": [0.1] * n, "type": ["star"] * n, "size": [0.0] * n,
        "spectrum_file": ["red.csv", "line.csv", "", "line.csv", "red.csv"],
        "mag_r": [20.0, nan, 21.0, 19.0, nan], "mag_i": [nan, 18.0, nan, nan, 22.0],
    }  # fmt: skip
    mine = catalog(folder, **columns)
    seds = mine.load_seds(np.array([4, 3, 1, 0]))
    wanted = [("i", 22.0), ("r", 19.0), ("i", 18.0), ("r", 20.0)]
    for sed, (band, mag) in zip(seds, wanted, strict=True):
        assert ab_mag(sed, GRID, camera.filters[band].at(GRID)) == pytest.approx(mag, abs=MAG)
    blue, red = (np.flatnonzero(wave == GRID)[0] for wave in (4500.0, 8500.0))
    ratio = seds[:, red] / seds[:, blue]
    assert ratio == pytest.approx([ratio[0], ratio[1], ratio[1], ratio[0]]) and ratio[0] > 2 > ratio[1]
    weights = subband_weights(camera.filters["z"], camera.telescope)
    found = mine.load_fluxes([4, 3, 1, 0], camera.filters["z"], camera.telescope)
    assert found == pytest.approx(seds @ weights.T, rel=1e-6)
    edges = GRID[6000:9001:100]
    samples = np.stack([sed[6000:9001] for sed in seds])
    means = (samples[:, :-1] + samples[:, 1:]).reshape(4, -1, 100).mean(axis=2) / 2
    assert mine.load_binned([4, 3, 1, 0], edges) == pytest.approx(means, rel=1e-9)
    assert mine.load_sed(mine.objs[1])["FLUX"] == pytest.approx(seds[2])


def test_a_spectrum_too_large_for_sums_is_refused(folder):
    Table({"WAVELENGTH": [3000.0, 9000.0], "FLUX": [1.0, 1e101]}).write(folder / "huge.csv")
    with pytest.raises(InputError, match=r"huge\.csv: FLUX: is too large"):
        read_spectrum(str(folder / "huge.csv"))
    Table({"WAVELENGTH": [12000.0, 13000.0], "FLUX": [1.0, 1.0]}).write(folder / "far.csv")
    with pytest.raises(InputError, match=r"far\.csv: FLUX: has no flux"):
        read_spectrum(str(folder / "far.csv"))
