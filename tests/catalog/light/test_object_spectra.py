"""Spectra of selected objects: whose light, by which factor, in which order; by loads whose every value is known."""

import numpy as np
import pytest
from support.csst import BANDS
from support.embedded_sky import shipped

from csstsim.base.errors import InputError
from csstsim.catalog.galaxy_shapes.component_light import BULGE, DISK, KNOTS
from csstsim.catalog.light.binned_spectra import binned
from csstsim.catalog.light.object_spectra import ROW, Spectra, catalog_spectra, embedded_spectra
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable

EDGES = np.array([4000.0, 5000.0, 7000.0])
KAPPA, GAMMA1, GAMMA2 = [0.1, 0.1, 0.0, 0.2], [0.0, 0.05, 0.03, 0.0], [0.02, 0.0, 0.0, 0.1]
KINDS = [STAR, GALAXY, QUASAR, GALAXY]
MU = np.array([1.0, 1 / (0.9**2 - 0.05**2), 1 / (1 - 0.03**2), 1 / (0.8**2 - 0.1**2)])
LIGHT = np.array([[1.0, 2.0], [30.0, 70.0], [500.0, 900.0], [7000.0, 4000.0]])


def objects(**more):
    columns = {"id": [5, 6, 7, 8], "obj_type": KINDS, "kappa": KAPPA, "gamma1": GAMMA1, "gamma2": GAMMA2}
    return ObjectTable.complete(columns | more, BANDS)


def load(rows, edges):
    assert edges is EDGES
    return LIGHT[rows]


def test_galaxies_and_quasars_are_magnified_and_stars_are_not():
    spectra = Spectra(objects(), load)
    np.testing.assert_allclose(spectra(np.array([3, 0, 2, 1]), EDGES), (MU[:, None] * LIGHT)[[3, 0, 2, 1]], rtol=1e-6)


def test_what_varies_is_dimmed():
    dmag = np.array([0.0, 0.5, -1.0, 2.5], np.float32)
    spectra = Spectra(objects(dmag=dmag), load)
    factor = MU * [1.0, 10**-0.2, 10**0.4, 0.1]
    np.testing.assert_allclose(spectra(np.arange(4), EDGES), factor[:, None] * LIGHT, rtol=1e-6)


def test_factors_and_order_are_of_the_rows():
    """One after the other, and the spectra they are made of stay as they are."""
    whole, factor, order = Spectra(objects(), load), np.array([2.0, 3.0, 5.0, 7.0]), np.array([2, 3, 3, 0])
    made = whole.times(factor).take(order)
    wanted = (MU * factor)[:, None] * LIGHT
    np.testing.assert_allclose(made(np.array([1, 3, 0]), EDGES), wanted[[3, 0, 2]], rtol=1e-6)
    again = made.take(np.array([3, 0]))
    np.testing.assert_allclose(again(np.array([0, 1]), EDGES), wanted[[0, 2]], rtol=1e-6)
    np.testing.assert_allclose(whole(np.arange(4), EDGES), MU[:, None] * LIGHT, rtol=1e-6)


SHARES = {
    6: [[0.5, 0.3, 0.2], [0.6, 0.3, 0.1]], 8: [[0.1, 0.8, 0.1], [0.25, 0.7, 0.05]], 5: [[0.0, 1.0, 0.0]] * 2,
}  # fmt: skip


class Gradients:
    """Shares of bulge, disk and knots of each object in both bins, by its id."""

    def binned(self, table, edges):
        assert edges is EDGES
        return np.array([SHARES[number] for number in table["id"].tolist()]).reshape(-1, 2, 3)


def test_components_have_their_shares_of_their_owners_light():
    owner, kind = np.array([3, 1, 1, 0, 3, 3]), np.array([DISK, BULGE, KNOTS, -1, KNOTS, -1])
    spectra = Spectra(objects(), load, Gradients()).of_components(owner, kind)
    whole = (MU[:, None] * LIGHT)[owner]
    share = np.array([[0.8, 0.7], [0.5, 0.6], [0.2, 0.1], [1.0, 1.0], [0.1, 0.05], [1.0, 1.0]])
    np.testing.assert_allclose(spectra(np.arange(6), EDGES), whole * share, rtol=1e-6)
    some = np.array([4, 3, 0])
    np.testing.assert_allclose(spectra(some, EDGES), (whole * share)[some], rtol=1e-6)
    np.testing.assert_allclose(spectra(np.array([5, 3]), EDGES), whole[[5, 3]], rtol=1e-6)


class Catalogue:
    truth_hash = "of today"

    def load_binned(self, rows, edges):
        return LIGHT[np.asarray(rows) - 10]


def test_rows_of_the_catalogue_are_loaded_and_another_catalogue_is_refused():
    table = objects(**{ROW: np.array([13, 10, 12, 11])})
    table.meta["truth_hash"] = "of today"
    found = catalog_spectra(table, Catalogue())(np.array([0, 2, 3]), EDGES)
    np.testing.assert_allclose(found, (MU[[0, 2, 3]])[:, None] * LIGHT[[3, 2, 1]], rtol=1e-6)
    table.meta["truth_hash"] = "of yesterday"
    with pytest.raises(InputError, match="Catalogue: gives other objects each time it is opened"):
        catalog_spectra(table, Catalogue())


def test_a_fault_of_the_class_is_named():
    class Faulty(Catalogue):
        def load_binned(self, rows, edges):
            return 1 / 0

    table = objects(**{ROW: np.arange(4)})
    table.meta["truth_hash"] = "of today"
    with pytest.raises(InputError, match=r"Faulty\.load_binned: ZeroDivisionError"):
        catalog_spectra(table, Faulty())(np.arange(2), EDGES)


@pytest.mark.parametrize("full", [False, True])
def test_embedded_objects_need_their_columns_alone(full):
    universe = shipped()[0]
    tail = {f"coeff{k}": np.zeros(4, np.float32) for k in range(20)} | {"sed_scale": np.full(4, 1e-20, np.float32)}
    table = objects(teff=[4000.0, 5000.0, 6000.0, 9000.0], logg=[4.0] * 4, **tail)
    table = table.with_columns(obj_type=np.full(4, STAR, np.int8))
    spectra = embedded_spectra(table, universe, full)
    np.testing.assert_allclose(spectra(np.array([3, 1]), EDGES), binned(universe, table, EDGES)[[3, 1]], rtol=1e-9)
    assert (spectra.gradients is not None) == full
