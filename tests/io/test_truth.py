"""The truth table has the .cat columns under their names, whatever the catalogue's own are called."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.table import ObjectTable
from csstsim.io.truth import CAT_COLUMNS, electron_budget, read_truth, truth_table

CHIP = SimpleNamespace(id=9, filter="r")


def drawn(**columns):
    positions = {"id": [1, 2], "obj_type": [0, 1], "ra": [10.0, 11.0], "dec": [1.0, 2.0]}
    table = ObjectTable.complete(positions | columns, BANDS)
    added = {"x": np.array([3.0, 4.0]), "y": np.array([5.0, 6.0]), "mag": np.array([20.0, 21.0])}
    return table.with_columns(**added)


def test_round_trip(tmp_path):
    table = drawn(size_disk=[0.0, 0.5], kappa=[0.0, 0.1], parallax=[10.0, 0.0])
    truth_table(table, CHIP).write(tmp_path / "t.parquet", {"level0": "x"})
    stored = ObjectTable.read(tmp_path / "t.parquet")
    assert stored.names[:33] == tuple(CAT_COLUMNS) and stored.meta == {"level0": "x"}
    assert list(stored["xImage"]) == [4.0, 5.0] and list(stored["ID_chip"]) == [9, 9]
    assert stored["dm"][0] == 5.0 and np.isnan(stored["dm"][1])  # 100 pc
    assert np.allclose(stored["detA"], [1.0, 0.81]) and list(stored["size"]) == [0.0, 0.5]
    assert list(read_truth(tmp_path / "t.parquet")["x"]) == [3.0, 4.0]


def test_columns_of_the_catalogues_own_overwrite_nothing(tmp_path):
    """A catalogue with columns named as those of the .cat files, or as what is derived here: both are kept."""
    own = {name: np.array([7.0, 8.0]) for name in ("RV", "xImage", "pm_ra", "g1", "dm", "size", "detA", "galType")}
    for name, columns in (("plain", {}), ("own", own)):
        truth_table(drawn(rv=[5.0, 0.0], parallax=[10.0, 10.0], **columns), CHIP).write(
            tmp_path / f"{name}.parquet", {}
        )
    plain, both = (ObjectTable.read(tmp_path / f"{name}.parquet") for name in ("plain", "own"))
    assert all(list(map(str, both[name])) == list(map(str, plain[name])) for name in plain.names)
    assert set(both.names) - set(plain.names) == {f"user_{name}" for name in own}
    assert list(both["user_RV"]) == [7.0, 8.0] and both["RV"][0] == 5.0


def test_shear_is_reduced_and_light_magnified_by_the_same_lens():
    table = truth_table(drawn(kappa=[0.0, 0.2], gamma1=[0.05, 0.1], gamma2=[0.0, -0.04]), CHIP)
    assert np.allclose(table["g1"], [0.05, 0.125]) and np.allclose(table["g2"], [0.0, -0.05])
    assert np.allclose(table["detA"], (1 - np.array([0.0, 0.2])) ** 2 * (1 - table["g1"] ** 2 - table["g2"] ** 2))


def test_the_budget_of_electrons_has_all_that_layers_name():
    """Each of them once, the dark current for each pixel, what is trapped in columns and in registers."""
    header = {
        "objects_electrons": 1.0, "light_electrons": 2.0, "dark_electrons": 0.25, "cosmic_electrons": 4,
        "defects_electrons": 5.0, "cti_trapped": 6, "cti_serial_trapped": 7, "bloom_lost": 8.0,
    }  # fmt: skip
    assert electron_budget(header, 8) == {
        "objects": 1.0, "light": 2.0, "dark": 2.0, "rays": 4.0, "defects": 5.0, "trapped": 13.0, "bloomed": 8.0,
    }  # fmt: skip
    assert "bloomed" not in electron_budget({}, 8) and not any(electron_budget({}, 8).values())


def test_every_derived_column_by_hand(tmp_path):
    """Two rows that differ in every number: no factor, sign or column can stand for another."""
    columns = {
        "kappa": [0.2, -0.1], "gamma1": [0.1, 0.03], "gamma2": [-0.3, 0.2], "parallax": [2.5, -1.0],
        "bulge_frac": [0.25, 0.5], "size_bulge": [0.4, 1.0], "size_disk": [0.8, 3.0],
    }  # fmt: skip
    ends = {"trail_x0": [0.0, 5.0], "trail_y0": [10.0, 15.0], "trail_x1": [20.0, 25.0], "trail_y1": [30.0, 35.0]}
    table = drawn(**columns).with_columns(**{name: np.array(values) for name, values in ends.items()})
    truth_table(table, CHIP).write(tmp_path / "t.parquet", {})
    stored, back = ObjectTable.read(tmp_path / "t.parquet"), read_truth(tmp_path / "t.parquet")
    assert np.allclose(stored["detA"], [0.64 - 0.01 - 0.09, 1.21 - 0.0009 - 0.04], atol=1e-7)
    assert np.allclose(stored["g1"], [0.125, 0.03 / 1.1]) and np.allclose(stored["g2"], [-0.375, 0.2 / 1.1])
    assert np.allclose(stored["dm"], [8.0103, np.nan], atol=1e-4, equal_nan=True)  # 400 pc; no negative parallax
    assert np.allclose(stored["size"], [0.7, 2.0])
    assert list(stored["filter"]) == ["r", "r"] and list(stored["yImage"]) == [6.0, 7.0]
    for name, values in ends.items():
        assert list(stored[name]) == [value + 1.0 for value in values] and list(back[name]) == values
    assert list(back["x"]) == [3.0, 4.0] and list(back["y"]) == [5.0, 6.0] and not {"xImage", "yImage"} & set(back)


def test_names_of_the_cat_columns_are_those_of_the_catalogue(tmp_path):
    """Every quantity has its own number, so that none can be read as another's."""
    names = [name for name in CAT_COLUMNS.values() if name not in ("chip", "filter", "detA", "dm", "g1", "g2", "size")]
    values = {name: np.full(2, float(number)) for number, name in enumerate(names)}
    values |= {"id": np.array([1, 2]), "obj_type": np.array([0, 1], np.int8), "gal_type": np.array([1, 0], np.int8)}
    table = truth_table(drawn().with_columns(**values), CHIP)
    shifted = {"x", "y"}
    for name, our_name in CAT_COLUMNS.items():
        if our_name in values:
            assert np.array_equal(table[name], values[our_name] + (our_name in shifted)), name
    pairs = {"pm_ra": "pmra", "pm_dec": "pmdec", "RV": "rv", "galType": "gal_type", "xImage": "x", "obj_ID": "id"}
    assert pairs.items() <= CAT_COLUMNS.items() and len(CAT_COLUMNS) == 33


def test_files_are_named_without_their_folders():
    files = {"image_file": np.array(["/data/a.fits", ""]), "spectrum_file": np.array(["s/b.fits", "c.fits"])}
    table = truth_table(drawn().with_columns(**files), CHIP)
    assert list(table["image_file"]) == ["a.fits", ""] and list(table["spectrum_file"]) == ["b.fits", "c.fits"]


def test_an_exposure_without_objects_has_the_columns(tmp_path):
    table = ObjectTable.complete({name: [] for name in ("id", "obj_type", "ra", "dec")}, BANDS)
    truth_table(table, CHIP).write(tmp_path / "t.parquet", {})
    back = read_truth(tmp_path / "t.parquet")
    assert len(back) == 0 and set(CAT_COLUMNS.values()) <= set(back)


@pytest.mark.parametrize("name", ["xImage", "yImage"])
def test_a_table_without_places_is_no_truth(tmp_path, name):
    table = truth_table(drawn(), CHIP)
    ObjectTable({other: table[other] for other in table if other != name}).write(tmp_path / "t.parquet", {})
    with pytest.raises(InputError, match=f"t.parquet: {name}: not a truth table"):
        read_truth(tmp_path / "t.parquet")


def test_numbers_that_are_words_are_refused(tmp_path):
    truth_table(drawn(), CHIP).with_columns(mag=np.array(["a", "b"])).write(tmp_path / "t.parquet", {})
    with pytest.raises(InputError, match="mag"):
        read_truth(tmp_path / "t.parquet")


def test_the_bias_structure_is_in_the_budget_if_a_layer_states_it():
    assert electron_budget({"bias_structure": 3.5}, 8)["bias_structure"] == 3.5
    assert "bias_structure" not in electron_budget({}, 8)
