"""Tables of products with units, and spectra for specutils."""

import json

import numpy as np
import pytest
from astropy import units as u

import csstsim
from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.table import ObjectTable
from csstsim.io.astropy_tables import _unit

TABLES = json.loads((SHIPPED / "schema" / "tables.json").read_text())["tables"]
PARQUET = [name for name, table in TABLES.items() if table["path"].endswith(".parquet")]


def written(path, fields, **values):
    """Write a table of three rows with these columns of a schema, and return its path."""
    kinds = {"string": str}
    columns = {
        field["name"]: np.zeros(3, kinds.get(field["dtype"], field["dtype"]))
        for field in fields
        if "[" not in field["dtype"]
    }
    ObjectTable(columns | values).write(path, {"made": "here"})
    return path


@pytest.mark.parametrize("table", PARQUET)
def test_every_table_has_its_units_and_descriptions(table, tmp_path):
    fields = [f for f in TABLES[table]["schema"]["fields"] if f["type"] != "array"]
    own = np.arange(3.0)
    read = csstsim.read_table(written(tmp_path / "t.parquet", fields, user_colour=own))
    assert read.meta["made"] == "here" and len(read) == 3
    for field in fields:
        column = read[field["name"]]
        assert column.description == field["description"]
        assert column.unit == (_unit(field["unit"]) if "unit" in field else None)
    assert read["user_colour"].unit is None and np.array_equal(read["user_colour"], own)


def test_units_are_those_that_the_texts_say():
    assert _unit("photon / s / m2 / angstrom") == u.photon / u.s / u.m**2 / u.AA
    assert _unit("erg / s / cm2") == u.erg / u.s / u.cm**2
    assert _unit("solar masses / yr") == u.Msun / u.yr
    assert _unit("electron / px") == u.electron / u.pix
    assert _unit("microjansky") == u.uJy
    assert all(_unit(field["unit"]) for t in TABLES.values() for field in t["schema"]["fields"] if "unit" in field)


def test_some_columns_have_the_units_of_their_own_table(tmp_path):
    for table, unit in (("extracted", u.photon / u.s / u.m**2 / u.AA), ("lines", u.erg / u.s / u.cm**2)):
        path = written(tmp_path / "t.parquet", TABLES[table]["schema"]["fields"])
        read = csstsim.read_table(path, ["flux"])
        assert read.colnames == ["flux"] and read["flux"].unit == unit


def test_what_is_no_table_is_refused(tmp_path):
    (tmp_path / "t.parquet").write_text("no table")
    for path in (tmp_path / "t.parquet", tmp_path / "none.parquet"):
        with pytest.raises(InputError, match=path.name):
            csstsim.read_table(path)


def spectra_file(path):
    """Write three spectra: objects 7 and 8, of which 8 has two orders."""
    sizes = {(7, 1): 4, (8, 1): 3, (8, 2): 2}
    count = sum(sizes.values())
    keys = np.repeat(list(sizes), list(sizes.values()), axis=0)
    columns = {
        "id": keys[:, 0], "order": keys[:, 1].astype(np.int8), "row": (keys[:, 0] - 7).astype(np.int32),
        "wavelength": 5000.0 + np.arange(count), "flux": np.r_[np.nan, np.arange(1, count)].astype(np.float32),
        "flux_err": np.full(count, 0.5, np.float32), "flags": np.r_[512, np.zeros(count - 1)].astype(np.int16),
    }  # fmt: skip
    ObjectTable(columns).write(path)
    return path


def test_spectra_are_those_of_specutils(tmp_path):
    specutils = pytest.importorskip("specutils", reason="specutils is not installed")
    spectra = csstsim.read_spectra(spectra_file(tmp_path / "s.parquet"))
    assert [(s.meta["id"], s.meta["order"], s.meta["row"], len(s.flux)) for s in spectra] == [
        (7, 1, 0, 4), (8, 1, 1, 3), (8, 2, 1, 2),
    ]  # fmt: skip
    first = spectra[0]
    assert isinstance(first, specutils.Spectrum)
    assert np.allclose(first.spectral_axis.to_value("nm"), 500 + np.arange(4) / 10)
    assert first.flux.unit == u.photon / u.s / u.m**2 / u.AA and first.flux.value.tolist()[1:] == [1, 2, 3]
    assert first.uncertainty.array.tolist() == [0.5] * 4 and first.mask.tolist() == [True, False, False, False]
    assert first.meta["flags"].tolist() == [512, 0, 0, 0]
    energy = first.flux[1].to(u.erg / u.s / u.cm**2 / u.AA, u.spectral_density(first.spectral_axis[1]))
    assert energy.value == pytest.approx(1.986446e-8 / 5001 * 1e-4)  # h c / lambda


def test_no_spectra_and_no_table_of_spectra(tmp_path):
    pytest.importorskip("specutils", reason="specutils is not installed")
    table = ObjectTable.read(spectra_file(tmp_path / "s.parquet"))
    table.take(slice(0, 0)).write(tmp_path / "empty.parquet")
    assert csstsim.read_spectra(tmp_path / "empty.parquet") == []
    ObjectTable({"id": np.arange(3)}).write(tmp_path / "t.parquet")
    with pytest.raises(InputError, match=r"t\.parquet: not a table of spectra"):
        csstsim.read_spectra(tmp_path / "t.parquet")
