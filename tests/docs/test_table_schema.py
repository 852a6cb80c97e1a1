"""config/schema/tables.json: its columns are those of the files, and its version rises when they change."""

import copy
import json

import numpy as np
import pyarrow.parquet as pq
import pytest
import table_schema
from astropy import units as u

from csstsim.base.shipped import SHIPPED

WORDS = {"string": "string", "bool": "bool", "double": "float64", "float": "float32"}


def shipped():
    return json.loads((SHIPPED / "schema" / "tables.json").read_text())


def fields(table):
    return {field["name"]: field for field in shipped()["tables"][table]["schema"]["fields"]}


@pytest.mark.parametrize(
    "table, pattern",
    [
        ("truth", "level0/*/*_WIDE_*.truth.parquet"), ("orders", "level0/*/*.orders.parquet"),
        ("measured", "measure/*.parquet"), ("extracted", "spectra/*_29.parquet"), ("lines", "spectra/*_lines.parquet"),
        ("merged", "merge/dataset/*/*/Npix=*.parquet"),
    ],
)  # fmt: skip
def test_the_columns_of_a_finished_campaigns_files_have_these_names_and_types(sound, table, pattern):
    told = fields(table)
    paths = sorted(sound[1].glob(pattern))
    assert paths
    for path in paths:
        written = {field.name: field.type for field in pq.ParquetFile(path).schema_arrow}
        assert {name for name, field in told.items() if not field.get("optional")} <= set(written)
        for name, kind in written.items():
            if name.startswith("user_"):
                continue
            if told[name]["type"] == "array":
                kind = kind.value_type
            assert told[name]["dtype"] == WORDS.get(str(kind), str(kind)), (path.name, name)


def test_gates_of_a_verdict_have_these_names(sound):
    [gates] = [json.loads((sound[1] / "report" / "verdict.json").read_text())["gates"]]
    told = fields("validation")
    needed = {name for name, field in told.items() if not field.get("optional")}
    assert gates and all(needed <= set(gate) <= set(told) for gate in gates)


def test_units_are_those_of_the_quantities():
    names = {"solar masses": "solMass", "px": "pix", "microjansky": "uJy"}
    for table in shipped()["tables"]:
        for name, field in fields(table).items():
            if unit := field.get("unit"):
                for word in unit.split(" / "):
                    u.Unit(names.get(word, word))
                assert np.dtype(field["dtype"]).kind == "f", name
    assert fields("extracted")["flux"]["unit"] == "photon / s / m2 / angstrom"
    assert fields("lines")["flux"]["unit"] == "erg / s / cm2"
    assert fields("truth")["ra_epoch"]["unit"] == "deg" and "unit" not in fields("truth")["metallicity"]
    assert fields("measured")["flags"]["bits"]["4"].startswith("saturated")


def changed(place, what):
    """Return the shipped schema with a column of the measured tables changed."""
    new = copy.deepcopy(shipped())
    columns = new["tables"]["measured"]["schema"]["fields"]
    if what is None:
        del columns[place]
    elif place is None:
        columns.append(what)
    else:
        columns[place] |= what
    return new


@pytest.mark.parametrize(
    "place, what, least",
    [
        (3, None, "2.0.0"), (3, {"dtype": "int64"}, "2.0.0"), (6, {"unit": "rad"}, "2.0.0"),
        (None, {"name": "extra", "type": "number", "dtype": "float64"}, "1.1.0"),
        (6, {"description": "deg, other words"}, "1.0.1"),
    ],
)  # fmt: skip
def test_a_change_of_columns_needs_another_version(place, what, least):
    old, new = shipped() | {"version": "1.0.0"}, changed(place, what)
    with pytest.raises(ValueError, match=f"to {least} or more"):
        table_schema.check_raised(old, new | {"version": "1.0.0"})
    table_schema.check_raised(old, new | {"version": least})


def test_the_same_columns_keep_their_version():
    table_schema.check_raised(shipped(), shipped())
    assert shipped()["version"] == table_schema.VERSION
