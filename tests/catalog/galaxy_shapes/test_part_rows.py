"""Rows that are parts of another row's object: places under a lens, shares of light, and what is refused by row."""

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.table import Table
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.base import Region
from csstsim.catalog.own_table import TableCatalog
from csstsim.instrument.filter import GRID

REGION = Region((10.0, 11.0, 11.0, 10.0), (0.0, 0.0, 1.0, 1.0), (0,), BANDS)
BLANK = np.nan
MAS = 1e-3  # arcsec


def load(**columns):
    """Return the table of a galaxy, id 3, and a part of it, id 4; columns: of both."""
    base = {
        "id": [3, 4], "ra": [10.0, BLANK], "dec": [60.0, BLANK], "mag_r": [20.0, BLANK], "mag_i": [19.5, BLANK],
        "type": ["galaxy", "galaxy"], "size": [0.5, 0.1], "part_of": [BLANK, 3], "offset_ra": [BLANK, 0.4],
        "offset_dec": [BLANK, -0.3], "part_share": [BLANK, 0.25], "z": [0.7, BLANK],
    }  # fmt: skip
    return TableCatalog({"columns": base | columns}, REGION).table


def test_a_part_has_its_share_of_the_light_and_the_object_the_rest():
    table = load()
    for band in ("r", "i"):
        light = 10 ** (-0.4 * table[f"mag_{band}"].astype(float))
        whole = 10 ** (-0.4 * {"r": 20.0, "i": 19.5}[band])
        assert light / whole == pytest.approx([0.75, 0.25], rel=1e-5)
    assert np.isnan(table["mag_g"]).all()
    assert table["part_of"].tolist() == [-1, 3] and table["z"] == pytest.approx([0.7, 0.7])
    assert not {"offset_ra", "user_offset_ra", "part_share", "user_part_share"} & set(table)


def test_a_share_is_one_in_every_band_of_a_spectrum_from_a_file(tmp_path, camera):
    """The part and the rest of a red object make the whole, in light of each filter and behind a grating."""
    Table({"WAVELENGTH": [3000.0, 10000.0], "FLUX": [0.1, 10.0]}).write(tmp_path / "red.csv")
    red = str(tmp_path / "red.csv")
    base = {"ra": [10.0], "dec": [60.0], "mag_r": [20.0], "type": ["galaxy"], "size": [0.5], "spectrum_file": [red]}
    whole = TableCatalog({"columns": base}, REGION)
    second = {"ra": BLANK, "dec": BLANK, "mag_r": BLANK, "type": "galaxy", "size": 0.1, "spectrum_file": ""}
    split = {name: [*values, second[name]] for name, values in base.items()}
    split |= {"id": [3, 4], "part_of": [BLANK, 3], "part_share": [BLANK, 0.4]}
    both = TableCatalog({"columns": split}, REGION)
    for band in ("g", "r", "y", "GV"):
        rates = [c.load_fluxes(np.arange(len(c.table)), camera.filters[band], camera.telescope) for c in (whole, both)]
        assert rates[1] == pytest.approx(np.array([0.6, 0.4])[:, None] * rates[0], rel=1e-6)
    edges = GRID[3000:9000:40]
    assert both.load_binned([0, 1], edges).sum(axis=0) == pytest.approx(whole.load_binned([0], edges)[0], rel=1e-6)


@pytest.mark.parametrize("dec", [-89.9, -30.0, 0.0, 60.0, 89.99])
@pytest.mark.parametrize("ra", [0.0, 123.0, 359.99995])
def test_a_part_stands_at_its_offset(ra, dec):
    """Against astropy's offsets on the sphere, across RA 0 and by the poles."""
    table = load(ra=[ra, BLANK], dec=[dec, BLANK])
    centre, part = (SkyCoord(table["ra"][k], table["dec"][k], unit="deg") for k in (0, 1))
    wanted = centre.directional_offset_by(np.arctan2(0.4, -0.3) * u.rad, 0.5 * u.arcsec)
    assert part.separation(wanted).arcsec < MAS


def test_a_lens_moves_the_part_as_it_stretches_the_galaxy():
    """beta = A theta: the offset in the table is that of the source."""
    table = load(kappa=[0.1, BLANK], gamma1=[0.05, BLANK], gamma2=[-0.08, BLANK])
    east, north = (table["ra"][1] - 10.0) * 3600 * np.cos(np.radians(60)), (table["dec"][1] - 60.0) * 3600
    mapping = np.array([[1 - 0.1 - 0.05, 0.08], [0.08, 1 - 0.1 + 0.05]])
    assert mapping @ [east, north] == pytest.approx([0.4, -0.3], abs=MAS)
    assert table["kappa"] == pytest.approx([0.1, 0.1]) and table["gamma2"] == pytest.approx([-0.08, -0.08])


def test_a_part_may_have_a_place_and_light_of_its_own():
    table = load(ra=[10.0, 10.001], dec=[60.0, 60.001], mag_r=[20.0, 23.0], part_share=[BLANK, BLANK], z=[0.7, 0.71],
                 offset_ra=[BLANK, 0.0], offset_dec=[BLANK, BLANK])  # fmt: skip
    assert table["ra"][1] == 10.001 and table["mag_r"].tolist() == [20.0, 23.0]
    assert table["z"][1] == np.float32(0.71) and np.isnan(table["mag_i"][1])


def test_all_of_the_light_may_be_in_parts():
    table = load(part_share=[BLANK, 1.0])
    assert table["mag_r"][1] == 20.0 and table["mag_r"][0] > 80


@pytest.mark.parametrize("columns, message", [
    ({"part_of": [BLANK, 9]}, "row 2, a part of object 9: there is no row with that id"),
    ({"part_of": [4, 3]}, "row 1, a part of object 4: that row is a part itself"),
    ({"type": ["star", "galaxy"]}, "row 2, a part of object 3: a star has no parts"),
    ({"type": ["galaxy", "star"]}, "row 2, a part of object 3: a part is a galaxy, or as a point a quasar"),
    ({"part_share": [BLANK, 1.2]}, "part_share: row 2, a part of object 3: is not above 0 and up to 1"),
    ({"part_share": [BLANK, 0.0]}, "part_share: row 2"),
    ({"mag_r": [20.0, 22.0]}, "mag_r: row 2, a part of object 3: has both a magnitude and part_share"),
    ({"part_share": [BLANK, BLANK]}, "row 2 has no magnitude"),
    ({"offset_ra": [BLANK, 4000.0]}, "offset_ra: row 2, a part of object 3: is not within 3600 arcsec"),
    ({"n": [1.0, 9.0]}, "row 2 cannot be rendered: a galaxy whose n_disk"),
    ({"ra": [10.0, 10.0], "dec": [60.0, 60.0]}, "row 2, a part of object 3: has both a position and an offset"),
    ({"ra": [10.0, 10.0]}, "row 2, a part of object 3: has only one of ra and dec"),
    ({"part_of": [BLANK, -5]}, r"part_of: row 2: is not an id \(got -5"),
    ({"part_of": [BLANK, np.inf]}, r"part_of: row 2: is not an id \(got inf"),
    ({"part_of": [BLANK, 3.5]}, "part_of: row 2: is not an id"),
    ({"part_of": [0, 3]}, "row 1, a part of object 0: there is no row with that id"),
    ({"part_share": [BLANK, np.inf]}, "part_share: row 2, a part of object 3: is not above 0"),
    ({"offset_ra": [0.1, 0.4]}, "offset_ra: row 1: is for parts, but part_of is blank"),
    ({"offset_dec": [np.inf, 0.4]}, "offset_dec: row 1: is for parts"),
    ({"part_share": [0.5, 0.25]}, "part_share: row 1: is for parts"),
    ({"part_of": [BLANK, -1], "part_share": [BLANK] * 2}, "offset_ra: row 2: is for parts"),
])  # fmt: skip
def test_a_wrong_part_is_refused_by_row(columns, message):
    with pytest.raises(InputError, match=message):
        load(**columns)


@pytest.mark.parametrize("name", ["offset_ra", "offset_dec", "part_share"])
def test_a_table_without_part_of_has_no_offsets_and_shares(name):
    columns = {"ra": [10.0, 10.1], "dec": [60.0, 60.0], "mag_r": [20.0, 21.0]}
    table = TableCatalog({"columns": columns | {name: [BLANK, BLANK]}}, REGION).table
    assert name not in table and f"user_{name}" not in table
    with pytest.raises(InputError, match=f"{name}: row 2: is for parts, but part_of is blank"):
        TableCatalog({"columns": columns | {name: [BLANK, 0.3]}}, REGION)


def test_shares_above_the_whole_are_refused():
    columns = {name: [*values, values[1]] for name, values in {
        "id": [3, 4], "ra": [10.0, BLANK], "dec": [60.0, BLANK], "mag_r": [20.0, BLANK], "mag_i": [19.5, BLANK],
        "type": ["galaxy", "galaxy"], "size": [0.5, 0.1], "part_of": [BLANK, 3], "offset_ra": [BLANK, 0.4],
        "offset_dec": [BLANK, -0.3], "part_share": [BLANK, 0.6], "z": [0.7, BLANK],
    }.items()}  # fmt: skip
    columns["id"] = [3, 4, 5]
    with pytest.raises(InputError, match="row 2, a part of object 3: the fractions of its object's parts exceed 1"):
        TableCatalog({"columns": columns}, REGION)


def test_a_part_moves_with_its_object_and_varies_with_a_share_of_its_light():
    changes = {
        "rate_ra": [30.0, BLANK], "rate_dec": [-5.0, BLANK], "rate_mjd": [61000.0, BLANK], "var_period": [2.0, BLANK],
        "var_amplitude": [0.3, BLANK], "light_curve": ["", ""],
    }  # fmt: skip
    table = load(**{name: values for name, values in changes.items() if name != "light_curve"})
    for name in ("rate_ra", "rate_dec", "rate_mjd", "var_period", "var_amplitude"):
        assert table[name][1] == table[name][0] == changes[name][0]
    table = load(**{name: changes[name] for name in ("var_period", "var_amplitude")}, mag_r=[20.0, 23.0],
                 mag_i=[19.5, 23.0], part_share=[BLANK, BLANK])  # fmt: skip
    assert table["var_amplitude"].tolist() == [pytest.approx(0.3), 0.0]  # light of its own does not vary


def test_ids_are_compared_exactly():
    big = 4611686018427387904
    table = load(id=[big, big + 1], part_of=np.array([-1, big]))
    assert table["part_of"].tolist() == [-1, big]
    for of, words in ((np.array([-1, big + 2]), "no row with that id"), ([BLANK, float(big)], "inexact")):
        with pytest.raises(InputError, match=words):
            load(id=[big, big + 1], part_of=of)


def test_parts_of_several_objects_in_any_order_of_rows():
    """Each gets its own object's place, lens, light and redshift; two parts of one share its light."""
    lens = {"kappa": [BLANK, 0.1, BLANK, BLANK, 0.0, BLANK], "gamma1": [BLANK, 0.0, BLANK, 0.05, 0.0, BLANK]}
    table = TableCatalog({"columns": {
        "id": [40, 9, 31, 22, 7, 55], "part_of": [9, BLANK, 7, 9, BLANK, BLANK],
        "ra": [BLANK, 10.0, BLANK, BLANK, 200.0, 30.0], "dec": [BLANK, 0.0, BLANK, BLANK, 60.0, 5.0],
        "mag_r": [BLANK, 20.0, BLANK, BLANK, 22.0, 18.0], "mag_y": [BLANK, 19.0, BLANK, BLANK, BLANK, BLANK],
        "z": [BLANK, 0.9, 0.2, BLANK, 0.3, 0.4], "offset_ra": [0.9, BLANK, 1.0, 0.0, BLANK, BLANK],
        "offset_dec": [0.0, BLANK, 0.5, 0.9, BLANK, BLANK], "part_share": [0.5, BLANK, 0.1, 0.2, BLANK, BLANK],
        "type": ["galaxy", "galaxy", "quasar", "galaxy", "quasar", "star"], "size": [0.1, 0.5, 0, 0.1, 0, 0],
    } | lens}, REGION).table  # fmt: skip
    assert table["id"].tolist() == [40, 9, 31, 22, 7, 55] and table["part_of"].tolist() == [9, -1, 7, 9, -1, -1]
    light = 10 ** (-0.4 * (table["mag_r"].astype(float) - [20.0, 20.0, 22.0, 20.0, 22.0, 18.0]))
    assert light == pytest.approx([0.5, 0.3, 0.1, 0.2, 0.9, 1.0], rel=1e-5)
    assert 10 ** (-0.4 * (table["mag_y"][[0, 1, 3]].astype(float) - 19.0)) == pytest.approx([0.5, 0.3, 0.2], rel=1e-5)
    assert np.isnan(table["mag_y"][[2, 4, 5]]).all()
    assert table["z"] == pytest.approx([0.9, 0.9, 0.2, 0.9, 0.3, 0.4])
    east = (table["ra"] - [10.0, 10.0, 200.0, 10.0, 200.0, 30.0]) * np.cos(np.radians(table["dec"])) * 3600
    north = (table["dec"] - [0.0, 0.0, 60.0, 0.0, 60.0, 5.0]) * 3600
    assert east == pytest.approx([0.9 / 0.9, 0.0, 1.0, 0.0, 0.0, 0.0], abs=MAS)
    # behind kappa 0.1 of its object and gamma1 0.05 of its own
    assert table["gamma1"] == pytest.approx([0.0, 0.0, 0.0, 0.05, 0.0, 0.0])
    assert table["kappa"] == pytest.approx([0.1, 0.1, 0.0, 0.1, 0.0, 0.0])
    assert north == pytest.approx([0.0, 0.0, 0.5, 1.0, 0.0, 0.0], abs=MAS)


def test_a_part_of_no_object_and_none_at_all():
    """-1 and a blank are the same; a table whose column is blank has objects alone."""
    columns = {"ra": [10.0, 11.0], "dec": [0.0, 0.0], "mag_r": [20.0, 21.0], "part_of": [-1, BLANK]}
    assert TableCatalog({"columns": columns}, REGION).table["part_of"].tolist() == [-1, -1]


def test_a_part_with_a_share_follows_its_object_s_curve_and_one_with_light_of_its_own_does_not(tmp_path):
    (tmp_path / "c.csv").write_text("curve,mjd,dmag\na,1,0\nb,1,1\n")
    base = {
        "id": [3, 4, 5], "ra": [10.0, BLANK, BLANK], "dec": [60.0, BLANK, BLANK], "mag_r": [20.0, BLANK, 22.0],
        "type": ["galaxy"] * 3, "size": [0.5, 0.1, 0.1], "part_of": [BLANK, 3, 3], "part_share": [BLANK, 0.25, BLANK],
        "light_curve": ["a", "", "b"], "var_period": [2.0, 9.0, 3.0], "var_amplitude": [0.1, 0.4, 0.2],
        "rate_ra": [7.0, BLANK, 3.0], "rate_mjd": [61000.0, BLANK, 3.0],
    }  # fmt: skip
    table = TableCatalog({"columns": base, "light_curves": str(tmp_path / "c.csv")}, REGION).table
    assert table["light_curve"].tolist() == ["a", "a", "b"]
    assert table["var_period"].tolist() == [2.0, 2.0, 3.0]
    assert table["var_amplitude"] == pytest.approx([0.1, 0.1, 0.2])
    assert table["rate_ra"].tolist() == [7.0] * 3 and table["rate_mjd"].tolist() == [61000.0] * 3


@pytest.mark.parametrize("value", [-3600.0, 3600.0])
def test_offsets_up_to_a_degree_and_a_whole_share(value):
    table = load(offset_ra=[BLANK, 0.0], offset_dec=[BLANK, value], ra=[10.0, BLANK], dec=[10.0, BLANK])
    assert table["dec"][1] == pytest.approx(10.0 + value / 3600, abs=1e-3)
