"""The truth table has the .cat columns under their names, whatever the catalogue's own are called."""

from types import SimpleNamespace

import numpy as np
from csst import BANDS

from csstsim.catalog.table import ObjectTable
from csstsim.io.truth import CAT_COLUMNS, electron_budget, read_truth, truth_table

CHIP = SimpleNamespace(id=9, filter="r")


def drawn(**columns):
    places = {"id": [1, 2], "obj_type": [0, 1], "ra": [10.0, 11.0], "dec": [1.0, 2.0]}
    table = ObjectTable.complete(places | columns, BANDS)
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
