"""A table as a catalogue: magnitudes kept in every band, blanks, units, and refused tables."""

import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.table import QTable, Table
from support.csst import BANDS
from support.own_bands import instrument_folder

from csstsim.base.errors import InputError
from csstsim.base.units import ab_photon_density
from csstsim.catalog.base import Region
from csstsim.catalog.contract import check, sky_region
from csstsim.catalog.light.colours import colour_spectra
from csstsim.catalog.light.photometry import ab_mag
from csstsim.catalog.object_table import object_table, plain_columns, read_table
from csstsim.catalog.own_table import TableCatalog
from csstsim.catalog.table import GALAXY, STAR
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID

MAG = 2e-4  # tolerance of a synthetic magnitude
REGION = Region((10.0, 11.0, 11.0, 10.0), (0.0, 0.0, 1.0, 1.0), (0,), BANDS)


def columns(**more):
    return {"ra": [10.0, 10.1], "dec": [0.1, 0.2], "mag_r": [20.0, 21.0]} | more


@pytest.fixture
def filters(camera):
    by_band = {name.lower(): value for name, value in camera.filters.items()}
    return [by_band[band] for band in BANDS]


def test_one_magnitude_is_a_flat_spectrum(filters):
    mags = np.full((1, 7), np.nan)
    mags[0, 3] = 21.5
    assert np.allclose(colour_spectra(mags, filters)[0], ab_photon_density(GRID, 21.5), rtol=1e-4)


def test_every_band_keeps_its_magnitude(filters):
    """Random colours, bands missing at random: photometry of the spectra, by the independent sum, gives them back."""
    rng = np.random.default_rng(5)
    mags = 20.0 + rng.normal(0.0, 0.2, (40, 7)).cumsum(axis=1)
    mags[rng.random((40, 7)) < 0.4] = np.nan
    mags = mags[np.isfinite(mags).any(axis=1)]
    for row, spectrum in zip(mags, colour_spectra(mags, filters), strict=True):
        for mag, filter_ in zip(row, filters, strict=True):
            if np.isfinite(mag):
                assert abs(ab_mag(spectrum, GRID, filter_.at(GRID)) - mag) < MAG
        assert (spectrum > 0).all()


def test_colours_that_jump_go_through_the_pivots(filters):
    mags = np.array([[20.0, 20.0, 20.0, 20.0, 20.0, 24.0, 15.0], [20.0] * 7])
    jump, flat = colour_spectra(mags, filters)
    assert np.allclose(flat, ab_photon_density(GRID, 20.0), rtol=1e-4)
    at = np.searchsorted(GRID, [f.pivot for f in filters])
    assert np.allclose(-2.5 * np.log10(jump[at] / ab_photon_density(GRID[at])), mags[0], atol=0.01)
    assert colour_spectra(np.empty((0, 7)), filters).shape == (0, len(GRID))


def test_columns_that_spare_typing():
    table = TableCatalog({"columns": columns(type=["Galaxy", "star"], size=[0.5, 0.5], e1=[0.1, 0.0])}, REGION).table
    assert list(table["id"]) == [1, 2] and list(table["obj_type"]) == [1, 0]
    assert np.allclose(table["size_disk"], [0.5, 0.0]) and np.allclose(table["size_bulge"], [0.5, 0.0])
    assert not check(TableCatalog, {"columns": columns()}, sky_region(10.0, 0.1, 0.3)).faults


@pytest.mark.parametrize("name", ["t.csv", "t.ecsv", "t.fits", "t.parquet"])
def test_files(tmp_path, name):
    wanted = Table(columns(mag_g=[20.5, np.nan], note=["a", "b"]))
    wanted.write(tmp_path / name)
    catalog = TableCatalog({"file": str(tmp_path / name)}, REGION)
    assert np.allclose(catalog.table["mag_g"], [20.5, np.nan], equal_nan=True)
    assert list(catalog.table["user_note"]) == ["a", "b"]
    one = catalog.load_sed(catalog.objs[0])["FLUX"]
    assert np.array_equal(one, catalog.load_seds([0])[0])
    again = TableCatalog({"file": str(tmp_path / name)}, REGION)
    assert catalog.truth_hash == again.truth_hash


def test_nulls_of_a_parquet_table_are_blanks(tmp_path):
    table = pa.table({"ra": [10.0, 10.1], "dec": [0.1, 0.2], "mag_r": [20.0, None], "mag_g": [21.0, 21.5],
                      "type": ["star", "star"], "note": ["x", None]})  # fmt: skip
    pq.write_table(table, tmp_path / "t.parquet")
    found = TableCatalog({"file": str(tmp_path / "t.parquet")}, REGION).table
    assert np.isnan(found["mag_r"][1]) and list(found["obj_type"]) == [0, 0] and len(found) == 2
    (tmp_path / "t.parquet").write_bytes(b"no")
    with pytest.raises(InputError, match="not a table that can be read"):
        TableCatalog({"file": str(tmp_path / "t.parquet")}, REGION)


def test_a_text_of_millions_of_rows_is_wanted_as_fits_or_parquet(tmp_path, monkeypatch):
    monkeypatch.setattr("csstsim.catalog.object_table.LARGE", 10)
    (tmp_path / "t.csv").write_text("ra,dec,mag_r\n10,0.1,20\n")
    with pytest.raises(InputError, match=r"too large for a table of text.*as \.fits or \.parquet"):
        TableCatalog({"file": tmp_path / "t.csv"}, REGION)


def test_blank_cells_of_a_csv(tmp_path):
    (tmp_path / "t.csv").write_text("ra,dec,mag_r,mag_g,type,size\n10,0.1,20,,star,\n10.1,0.2,,21,galaxy,0.4\n")
    table = TableCatalog({"file": tmp_path / "t.csv"}, REGION).table
    assert np.isnan(table["mag_g"][0]) and np.isnan(table["mag_r"][1]) and table["size_disk"][1] == np.float32(0.4)
    assert table["ra"].dtype == float


def test_other_surveys_columns_travel_on():
    """Near-infrared magnitudes, errors, flags: no slips of the pen, though like names that csstsim has."""
    other = {key: [1.0, 2.0] for key in ("mag_k", "mag_j", "mag_r_err", "flag", "name", "e")}
    table = TableCatalog({"columns": columns(**other)}, REGION).table
    assert {f"user_{name}" for name in other} <= set(table.names)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("mag_R", "mag_R is unknown to csstsim; did you mean mag_r"),  # a band of both spellings: Johnson's R, perhaps
        ("g", "g is not used; did you mean mag_g"),
        ("mag_k", "mag_k is not used: the camera's magnitudes are mag_nuv, mag_u"),
        ("mag_V", "mag_V is not used"),
        ("MAG_AUTO_g", "MAG_AUTO_g is not used"),
        ("mag_r_err", ""),
        ("note", ""),
    ],
)
def test_a_magnitude_that_is_not_used_is_said(name, words):
    warnings = check(TableCatalog, {"columns": columns(**{name: [1.0, 2.0]})}, sky_region(10.0, 0.1, 0.3)).warnings
    found = [text for text in warnings if name in text]
    assert len(found) == bool(words) and (not words or words in found[0]), warnings


def test_a_table_out_of_excel(tmp_path):
    (tmp_path / "t.csv").write_bytes("\ufeffra,dec,mag_r\r\n10,0.1,20\r\n".encode())
    assert len(TableCatalog({"file": tmp_path / "t.csv"}, REGION).table) == 1
    (tmp_path / "t.csv").write_text("ra;dec;mag_r\n10;0.1;20\n")
    with pytest.raises(InputError, match="semicolons separate the columns"):
        TableCatalog({"file": tmp_path / "t.csv"}, REGION)


def test_units_are_turned_into_ours():
    table = QTable(
        {"ra": [1.0] * u.hourangle, "dec": [30.0] * u.arcmin, "mag_r": [20.0] * u.ABmag, "size": [1.0] * u.arcmin}
    )
    plain = plain_columns(table)
    assert plain["ra"][0] == pytest.approx(15.0) and plain["dec"][0] == 0.5 and plain["size"][0] == pytest.approx(60.0)
    assert plain["mag_r"][0] == 20.0
    with pytest.raises(InputError, match="dec: the unit does not fit the column"):
        plain_columns(QTable({"dec": [1.0] * u.m}))
    for wrong in (u.Jy, u.STmag):
        with pytest.raises(InputError, match="mag_r: the unit does not fit the column"):
            plain_columns(QTable({"mag_r": [1.0] * wrong}))
    with pytest.raises(InputError, match="e1: the unit does not fit the column"):
        plain_columns(QTable({"e1": [1.0] * u.deg}))
    with pytest.raises(InputError, match="one number or word per row"):
        plain_columns(Table({"ra": np.zeros((2, 2))}))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "give either file or columns"),
        ({"columns": columns(), "file": "x.csv"}, "give either file or columns"),
        ({"columns": columns(), "fiel": 1}, "unknown key"),
        ({"columns": {"ra": [1.0], "dec": [1.0]}}, "mag_r: a column is missing"),
        ({"columns": {"ra": [1.0], "mag_r": [20.0]}}, "dec: a column is missing"),
        ({"columns": columns(ra=[1.0])}, "differ in length"),
        ({"columns": columns(ra=["1h", "2h"])}, "ra, row 1: must be numbers"),
        ({"columns": columns(mag_r=[20.0, np.nan])}, "row 2 has no magnitude"),
        ({"columns": columns(mag_r=[20.0, 999.0])}, "row 2 has a magnitude outside"),
        ({"columns": columns(mag_g=[99.0, 20.0])}, "row 1 has a magnitude outside"),
        ({"columns": columns(mag_g=[20.0, -99.0])}, "row 2 has a magnitude outside"),
        ({"columns": columns(typ=["star", "star"])}, "typ: did you mean type"),
        ({"columns": columns(mag_G=[20.0, 20.0])}, "mag_G: did you mean mag_g"),
        ({"columns": columns(gmag=[20.0, 20.0])}, "gmag: did you mean mag_g"),
        ({"columns": columns(siez=[0.5, 0.5])}, "siez: did you mean size"),
        ({"columns": {"RA": [1.0], "DEC": [1.0], "mag_r": [20.0]}}, "RA: did you mean ra"),
        ({"columns": columns(size=[0.5, 0.5])}, "the column type is missing"),
        ({"columns": columns(type=["galaxy", "star"])}, "row 1 cannot be rendered: a galaxy without size_disk"),
        ({"columns": columns(id=[3, 3])}, "row 2 cannot be rendered: another row has the same id"),
        ({"columns": columns(ra=[10.0, 510.0])}, "row 2 cannot be rendered: ra is not within"),
        ({"columns": columns(dec=[95.0, 1.0])}, "row 1 cannot be rendered: ra, dec is not a position"),
        ({"columns": columns(z=[0.5, -5.0])}, "row 2 cannot be rendered: its z is not above -1"),
        ({"columns": columns(pmra=[1e4, -1e12])}, "row 2 cannot be rendered: its proper motion is above 1e"),
        ({"columns": columns(e1=["0.1", "junk"])}, "e1, row .: must be numbers .got 'junk'"),
        (
            {"columns": columns(type=["galaxy"] * 2, size=[0.6, 0.6], size_disk=[0.3, 0.3], size_bulge=[0.3, 0.3])},
            "size: means the same as size_disk and size_bulge",
        ),
        ({"columns": columns(type=["star", "comet"])}, "unknown type .got 'comet'"),
        ({"columns": columns(id=[1.5, 2.0])}, "id, row 1: not a number of an object"),
        ({"file": "objects.txt"}, "unknown kind of table"),
        ({"file": "missing.csv"}, "cannot read"),
        ({"file": "missing.fits"}, "missing.fits"),
    ],
)
def test_what_cannot_be_used_is_refused(options, message):
    with pytest.raises(InputError, match=message):
        TableCatalog(options, REGION)


def test_the_hash_knows_values_and_their_names():
    """Same values under another name, other values, another order of rows: each is another table."""
    first = TableCatalog({"columns": columns(note=[1.0, 2.0])}, REGION).truth_hash
    others = [{"remark": [1.0, 2.0]}, {"note": [1.0, 2.5]}, {"note": [2.0, 1.0]}, {}]
    hashes = {TableCatalog({"columns": columns(**extra)}, REGION).truth_hash for extra in others}
    assert len(hashes | {first}) == 5
    assert first == TableCatalog({"columns": columns(note=[1.0, 2.0])}, REGION).truth_hash


def test_spectra_are_straight_in_magnitude_over_the_logarithm_of_wavelength(camera):
    """Between the pivots of two bands given, and level beyond them."""
    filters = [camera.filters[band] for band in ("g", "z")]
    spectrum = colour_spectra(np.array([[20.0, 22.0]]), filters)[0]
    mag, log = -2.5 * np.log10(spectrum / ab_photon_density(GRID)), np.log(GRID)
    first, last = np.searchsorted(GRID, [f.pivot for f in filters])
    slope = np.diff(mag[first + 1 : last]) / np.diff(log[first + 1 : last])
    assert np.ptp(slope) < 1e-3 * abs(slope.mean()) and slope.mean() > 1
    assert np.ptp(mag[:first]) < 1e-9 and np.ptp(mag[last + 1 :]) < 1e-9


@pytest.mark.parametrize("heading", ["ra,dec,mag_r,mag_r", "ra,dec,mag_r, mag_r ", '"mag_r",ra,dec,mag_r'])
def test_a_column_given_twice_is_refused(tmp_path, heading):
    """astropy would draw the first and keep the other under a name of its own."""
    (tmp_path / "two.csv").write_text(f"\n{heading}\n10,20,18,19\n")
    with pytest.raises(InputError, match=r"two\.csv: mag_r: column given twice"):
        read_table(tmp_path / "two.csv")


@pytest.mark.parametrize("row", ['"150.1,2.2,20', '150.1,2.2,"20', '"150.1"x,2.2,20', '"150.1\n",2.2,20'])
def test_a_quote_left_open_does_not_take_the_rows_after_it(tmp_path, row):
    (tmp_path / "open.csv").write_text(f"ra,dec,mag_r\n150.1,2.2,20\n{row}\n150.2,2.2,21\n")
    with pytest.raises(InputError, match=r"open\.csv: a quote"):
        read_table(tmp_path / "open.csv")


def test_flags_of_another_program_do_not_hide_objects(camera):
    columns = {"ra": [1.0, 2.0], "dec": [0.0, 0.0], "mag_r": [20.0, 21.0], "flags": [2, 32]}
    table = object_table(columns, camera.bands, "a table")
    assert table["user_flags"].tolist() == [2, 32] and not table["flags"].any()


@pytest.mark.parametrize("options, message", [
    ({"file": 5}, r"catalog.options.file: not the name of a file \(got 5"),
    ({"file": ["a.csv"]}, "catalog.options.file: not the name of a file"),
    ({"file": None}, "catalog.options.file: not the name of a file"),
    ({"columns": 3}, r"catalog.options.columns: not columns \(got 'int'\); allowed: {name: list of values}"),
    ({"columns": [1]}, "catalog.options.columns: not columns"),
    ({"columns": {1: [3]}}, "catalog.options.columns: not columns"),
    ({"columns": {"ra": [[1, 2], [3]], "dec": [1, 2], "mag_r": [3, 4]}}, "catalog.options.columns.ra: must have one"),
    ({"columns": columns(), "light_curves": True}, "catalog.options.light_curves: not the name of a file"),
    ({"columns": columns(), "colums": 1}, "catalog.options: unknown key"),
])  # fmt: skip
def test_options_of_another_kind_are_refused_in_words(options, message):
    """By the class, and when its files are asked for, before anything is made."""
    for use in (lambda: TableCatalog(options, REGION), lambda: TableCatalog.files(options)):
        with pytest.raises(InputError, match=message):
            use()


@pytest.mark.parametrize(
    ("column", "value", "word"),
    [
        ("z", np.inf, "its z"), ("z", 1e300, "its z"), ("rv", -1e9, "its rv"), ("rv", np.inf, "its rv"),
        ("parallax", np.inf, "its parallax"), ("parallax", -1e5, "its parallax"),
    ],
)  # fmt: skip
def test_values_that_no_object_has_are_refused(column, value, word):
    with pytest.raises(InputError, match=rf"row 2 cannot be rendered: {word}"):
        object_table({"ra": [1.0, 2.0], "dec": [0.0, 0.0], "mag_r": [20.0, 20.0], column: [0.0, value]}, BANDS, "t.csv")


def test_of_several_tables_of_a_file_the_first_is_read_with_a_word(tmp_path, caplog):
    rows = {name: Table({"ra": [ra], "dec": [0.0], "mag_r": [20.0]}) for ra, name in ((1.0, "A"), (2.0, "B"))}
    tables = [fits.BinTableHDU(table, name=name) for name, table in rows.items()]
    fits.HDUList([fits.PrimaryHDU(), *tables]).writeto(tmp_path / "two.fits")
    assert read_table(tmp_path / "two.fits")["ra"].tolist() == [1.0] and "A, B the first is read" in caplog.text


def test_blank_cells_of_whole_numbers_are_the_default(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("id,ra,dec,mag_r,type,size,host,gal_type\n1,150.1,2.2,20,galaxy,0.3,,\n2,150.1,2.2,20,,,1,0\n")
    table = object_table(read_table(path), BANDS, path)
    assert table["host"].tolist() == [-1, 1] and table["obj_type"].tolist() == [1, 0]


@pytest.mark.parametrize("form", ["csv", "fits", "parquet"])
@pytest.mark.parametrize("name", ["source_id", "host"])
def test_numbers_of_too_many_digits_beside_blanks_are_words_or_refused(tmp_path, form, name):
    """A float would lose their last digits; without a blank they are whole."""
    ids = np.ma.array([4295806720384589185, 0, 6144039378640938123], mask=[False, True, False])
    table = Table({"ra": [1.0, 2, 3], "dec": [0.0, 0, 0], "mag_r": [20.0, 20, 20], name: ids}, masked=True)
    if form == "parquet":  # astropy writes what is below the mask
        columns = {name: table[name].tolist() for name in table.colnames}
        pq.write_table(pa.table(columns), tmp_path / "t.parquet")
    else:
        table.write(tmp_path / f"t.{form}")
    if name == "host":
        with pytest.raises(InputError, match="host: has blank cells, and numbers of too many digits"):
            read_table(tmp_path / f"t.{form}")
    else:
        words = ["4295806720384589185", "", "6144039378640938123"]
        read = object_table(read_table(tmp_path / f"t.{form}"), BANDS, "t")
        assert read["user_source_id"].tolist() == words
    table[name] = ids.data
    table.write(tmp_path / f"t.{form}", overwrite=True)
    assert read_table(tmp_path / f"t.{form}")[name].tolist() == ids.data.tolist()


def test_a_blank_number_of_a_type_is_a_star(tmp_path):
    columns = {"ra": [1.0, 2, 3], "dec": [0.0] * 3, "mag_r": [20.0] * 3, "size": [0.3] * 3}
    pq.write_table(pa.table(columns | {"obj_type": pa.array([1, None, 0], pa.int8())}), tmp_path / "t.parquet")
    assert object_table(read_table(tmp_path / "t.parquet"), BANDS, "t")["obj_type"].tolist() == [GALAXY, STAR, STAR]


def test_a_display_format_of_another_type_is_ignored(tmp_path):
    """TDISP I10 of doubles: astropy refuses the whole table."""
    values = {"ra": [10.25, 20], "dec": [1.0, 2], "mag_r": [20.5, 21]}
    columns = [fits.Column(name, "D", array=column, disp="I10") for name, column in values.items()]
    image = fits.ImageHDU(np.zeros((2, 2)))
    hdus = [fits.PrimaryHDU(), image, fits.BinTableHDU.from_columns(columns)]
    fits.HDUList(hdus).writeto(tmp_path / "t.fits")
    assert {name: column.tolist() for name, column in read_table(tmp_path / "t.fits").items()} == values
    fits.HDUList(hdus[:2]).writeto(tmp_path / "none.fits")
    with pytest.raises(InputError, match=r"none\.fits: the file has no table"):
        read_table(tmp_path / "none.fits")


@pytest.mark.parametrize(("dtype", "said"), [("f4", "ra is float32, which rounds positions to 1.1e\\+02 mas"),
                                             ("f2", "ra is float16"), ("f8", None), ("i4", None)])  # fmt: skip
def test_rounded_positions_are_said(caplog, dtype, said):
    """A float32 near 350 deg has steps of 2^-15 deg, 110 mas."""
    columns = {"ra": np.array([350, 351], dtype), "dec": np.zeros(2), "mag_r": np.full(2, 20.0)}
    object_table(columns, BANDS, f"table of {dtype}")
    found = re.findall(r"table of .*float64", caplog.text)
    assert len(found) == (said is not None) and (said is None or re.search(said, found[0]))


@pytest.mark.parametrize("name, given, value", [
    ("ra", 0.5 * u.rad, np.degrees(0.5)), ("dec", 1800 * u.arcsec, 0.5), ("size", 2 * u.arcmin, 120.0),
    ("size_disk", 0.001 * u.deg, 3.6), ("size_bulge", 500 * u.mas, 0.5), ("pmra", 0.2 * u.arcsec / u.yr, 200.0),
    ("pmdec", 1.0 * u.arcsec / u.yr, 1000.0), ("parallax", 0.1 * u.arcsec, 100.0), ("rv", 7e3 * u.m / u.s, 7.0),
    ("teff", 5.8 * u.kK, 5800.0), ("av", 0.3 * u.mag, 0.3), ("rate_dec", 1 * u.arcsec / u.min, 60.0),
    ("rate_mjd", 24 * u.h, 1.0), ("trail_width", 0.1 * u.arcmin, 6.0), ("var_period", 12 * u.h, 0.5),
    ("var_amplitude", 0.2 * u.mag, 0.2), ("kappa", 5 * u.percent, 0.05), ("mag_y", 21.0 * u.mag, 21.0),
])  # fmt: skip
def test_each_quantity_has_its_unit(name, given, value):
    assert plain_columns(QTable({name: u.Quantity([given])}))[name].tolist() == pytest.approx([value])


@pytest.mark.parametrize("dtype", [float, int])
def test_a_blank_cell_of_a_column_with_a_unit_stays_blank(tmp_path, dtype):
    """Whatever lies below the mask: as a table, out of a file, and as a row without that value."""
    values = np.ma.array(np.array([2, 7], dtype), mask=[False, True])
    table = Table({"ra": [10.0, 10.1], "dec": [0.1, 0.2], "mag_r": [20.0, 21.0]})
    table["parallax"] = values
    table["parallax"].unit = "arcsec"
    np.testing.assert_allclose(plain_columns(table)["parallax"], [2000.0, np.nan], rtol=1e-12)
    for form in ("ecsv", "fits"):
        table.write(tmp_path / f"t.{form}")
        np.testing.assert_allclose(read_table(tmp_path / f"t.{form}")["parallax"], [2000.0, np.nan], rtol=1e-12)


@pytest.mark.parametrize("column, at, beyond", [
    ("ra", -180.0, -180.1), ("ra", 360.0, 360.1), ("z", 1000.0, 1001.0), ("z", -0.99, -1.0),
    ("rv", 299792.0, 299793.0), ("parallax", -1e4, -10001.0), ("parallax", 1e4, 10001.0),
    ("pmra", 1e6, 1.001e6), ("pmdec", -1e6, -1.001e6), ("mag_r", -3.0, -3.1), ("mag_r", 90.0, 90.1),
])  # fmt: skip
def test_values_up_to_the_limits_are_taken(column, at, beyond):
    good = {"ra": [1.0, 2.0], "dec": [0.0, 0.0], "mag_r": [20.0, 20.0]}
    if column not in good:
        good[column] = [0.0, 0.0]
    last = [good[column][0], at]
    assert object_table(good | {column: last}, BANDS, "t.csv")[column][1] == np.float32(at)
    with pytest.raises(InputError, match="row 2"):
        object_table(good | {column: [good[column][0], beyond]}, BANDS, "t.csv")


def test_both_parts_of_a_proper_motion_count():
    with pytest.raises(InputError, match="row 1 cannot be rendered: its proper motion"):
        object_table(columns(pmra=[8e5, 0.0], pmdec=[8e5, 0.0]), BANDS, "t.csv")


@pytest.mark.parametrize("ids, good", [
    (np.array([1, 2**63 - 1]), True), (np.array([1, 2**63], np.uint64), False), ([1.0, -2.0], True),
    ([1.0, np.nan], False), ([1.0, 2.0**63], False), (["7", "8"], False), ([True, False], False),
])  # fmt: skip
def test_ids_are_whole_and_of_64_bits(ids, good):
    if good:
        assert object_table(columns(id=ids), BANDS, "t.csv")["id"].tolist() == [int(k) for k in ids]
        return
    with pytest.raises(InputError, match=r"id, row \d: not a number of an object|id"):
        object_table(columns(id=ids), BANDS, "t.csv")


def test_the_second_row_of_an_id_is_named_wherever_it_is():
    rows = {"ra": [1.0, 2, 3, 4], "dec": [0.0] * 4, "mag_r": [20.0] * 4, "id": [9, 5, 7, 5]}
    with pytest.raises(InputError, match="row 4 cannot be rendered: another row has the same id"):
        object_table(rows, BANDS, "t.csv")


def test_blanks_have_the_default_of_their_column():
    """In the columns that are filled; one part's own size stays."""
    nan = np.nan
    blank = {name: [nan, 0.5] for name in ("e1", "e2", "bulge_frac", "z", "gamma1", "n_bulge")}
    blank |= {"gamma2": [nan, 0.125], "kappa": [nan, -1.0]}
    sizes = {"size": [0.5, 0.4], "size_bulge": [0.2, 0.1], "satellite": [nan, 1.0]}
    table = object_table(columns(type=["galaxy"] * 2, **sizes) | blank, BANDS, "t")
    for name in blank:
        assert table[name].tolist() == [4.0 if name == "n_bulge" else 0.0, blank[name][1]], name
    assert table["satellite"].tolist() == [-1, 1]
    assert table["size_disk"] == pytest.approx([0.5, 0.4]) and table["size_bulge"] == pytest.approx([0.2, 0.1])
    assert np.isnan(table["stellarmass"]).all()
    sizes = {name: [1.0, nan] for name in ("size_disk", "size_bulge", "gal_type")}
    star = object_table(columns(type=["galaxy", "star"]) | sizes, BANDS, "t")
    assert [star[name].tolist() for name in sizes] == [[1.0, 0.0], [1.0, 0.0], [1, -1]]


def test_types_in_any_spelling_and_by_number():
    table = object_table(columns(type=[" QUASAR", ""]), BANDS, "t")
    assert table["obj_type"].tolist() == [2, 0]
    assert object_table(columns(obj_type=[2, 0]), BANDS, "t")["obj_type"].tolist() == [2, 0]
    assert object_table(columns(type=["asteroid", "satellite"]), BANDS, "t")["obj_type"].tolist() == [3, 4]


def test_a_parquet_table_of_many_types(tmp_path):
    """Coded words, decimals, truths, whole numbers with blanks, columns of blanks, views; lists are left out."""
    from decimal import Decimal

    table = pa.table({
        "ra": pa.array([Decimal("10.25"), Decimal("11.5")]), "dec": pa.array([0.5, None], pa.float32()).fill_null(1.0),
        "mag_r": pa.array([20, 21], pa.int16()), "type": pa.array(["star", None]).dictionary_encode(),
        "n_obs": pa.array([3, None]), "good": pa.array([True, None]), "sure": pa.array([True, False]),
        "nothing": pa.nulls(2), "word": pa.array(["é", "b"], pa.large_string()), "many": pa.array([[1.0], [2.0, 3.0]]),
        "text": pa.array(["x", None], pa.string_view()),
    })  # fmt: skip
    pq.write_table(table, tmp_path / "t.parquet")
    found = read_table(tmp_path / "t.parquet")
    assert found["ra"].tolist() == [10.25, 11.5] and found["dec"].tolist() == [0.5, 1.0]
    assert found["type"].tolist() == ["star", ""] and found["word"].tolist() == ["é", "b"]
    np.testing.assert_array_equal(found["n_obs"], [3.0, np.nan])
    np.testing.assert_array_equal(found["good"], [1.0, np.nan])
    assert found["sure"].tolist() == [True, False] and np.isnan(found["nothing"]).all()
    assert found["text"].tolist() == ["x", ""] and "many" not in found
    lists = pa.table({"ra": pa.array([[1.0]]), "dec": [0.0], "mag_r": [20.0]})
    pq.write_table(lists, tmp_path / "l.parquet")
    with pytest.raises(InputError, match="ra: must have one number or word per row"):
        read_table(tmp_path / "l.parquet")


def test_remarks_above_the_heading_are_left_out_and_others_are_rows(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("# made by hand\n\n# twice\nra,dec,mag_r,note\n10,0,20,#1\n11,1,21,b\n")
    found = read_table(path)
    assert found["ra"].tolist() == [10, 11] and found["note"].tolist() == ["#1", "b"]
    path.write_text("# only a remark\n")
    with pytest.raises(InputError, match=r"t\.csv: the table is empty: no heading"):
        read_table(path)


def test_bytes_and_long_numbers_of_a_fits_table(tmp_path):
    """Words of FITS come as bytes or text; masked whole numbers are floats with blanks."""
    table = Table({"word": np.array([b"ab", b"c"]), "long": np.array([1.5, 2.5], np.longdouble)})
    found = plain_columns(table)
    assert found["word"].tolist() == ["ab", "c"] and found["long"].dtype == float
    masked = Table({"k": np.ma.array([1, 2], mask=[True, False]), "w": np.ma.array(["a", "b"], mask=[False, True])})
    found = plain_columns(masked)
    np.testing.assert_array_equal(found["k"], [np.nan, 2.0])
    assert found["w"].tolist() == ["a", ""]


def test_files_are_those_that_are_given(tmp_path):
    """Of a table without names of files its rows are not read; curves are among them; columns may name some."""
    path = tmp_path / "t.csv"
    path.write_text("ra,dec,mag_r\n10,0,20\n")
    assert TableCatalog.files({"file": str(path)}) == (str(path),)
    assert TableCatalog.files({"file": str(path), "light_curves": "c.csv"}) == (str(path), "c.csv")
    named = columns(spectrum_file=["b.csv", "a.csv"], image_file=["a.fits[1]", ""])
    assert TableCatalog.files({"columns": named}) == ("a.csv", "a.fits", "b.csv")
    assert TableCatalog.files({"columns": columns(), "light_curves": None}) == ()


def test_magnitudes_are_those_of_the_camera_that_is_meant(tmp_path):
    """Spectra of rows asked in any order; a magnitude in another band moves the light by its colour alone."""
    mine = TableCatalog({"columns": columns(mag_g=[21.0, np.nan])}, REGION)
    seds = mine.load_seds([1, 0])
    flat = ab_photon_density(GRID, 21.0)
    np.testing.assert_allclose(seds[0], flat, rtol=1e-4)
    red = seds[1] / ab_photon_density(GRID)
    assert red[GRID == 6200.0] > 1.5 * red[GRID == 4700.0]
    np.testing.assert_allclose(mine.load_sed(mine.objs[0])["FLUX"], seds[1], rtol=1e-12)
    assert mine.load_norm_filt(mine.objs[0]) is None


def test_spectra_have_their_magnitudes_through_the_camera_that_is_named(tmp_path):
    """A camera whose r band is that of i: the spectrum is another one, and has the magnitude there."""
    own = instrument_folder(tmp_path, "r", "i")
    table = {"ra": [10.0], "dec": [0.1], "mag_g": [21.0], "mag_r": [20.0]}
    found = []
    for more, camera in (({}, load_camera()), ({"instrument": own}, load_camera(own))):
        catalog = TableCatalog({"columns": table} | more, REGION)
        [sed] = catalog.load_seds([0])
        for band, mag in (("g", 21.0), ("r", 20.0)):
            assert ab_mag(sed, GRID, camera.filters[band].at(GRID)) == pytest.approx(mag, abs=MAG)
        found.append(sed)
    assert np.abs(found[1] / found[0] - 1).max() > 0.1
