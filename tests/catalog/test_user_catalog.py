"""A catalogue of the user's own: the paper's four methods, reached by dotted path, and its mistakes."""

import sys

import numpy as np
import pytest
from astropy.table import Table

from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.open import open_catalog
from csstsim.catalog.photometry import rate_to_mag
from csstsim.config import CatalogConfig
from csstsim.errors import InputError

REGION = Region((), (), ())
MODULE = """
import numpy as np
from astropy.table import Table
from csstsim.catalog.base import CatalogBase
from csstsim.catalog.mock_object import MockObject


class Pair(CatalogBase):
    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        slope = self.options["slope"]
        self.objs.append(MockObject(id=1, type="star", ra=10.0, dec=2.0, mag_norm=18.0, slope=slope))
        self.objs.append(MockObject(id=2, type="galaxy", ra=10.1, dec=2.0, mag_norm=20.0, slope=0.0, size_disk=0.5))

    def load_sed(self, obj):
        wave = np.linspace(1500.0, 12000.0, 400)
        return Table({"WAVELENGTH": wave, "FLUX": wave ** (obj.slope - 1.0)})

    def load_norm_filt(self, obj):
        wave = np.array([5000.0, 5001.0, 6000.0, 6001.0])
        return Table({"WAVELENGTH": wave, "SENSITIVITY": [0.0, 1.0, 1.0, 0.0]})


NOT_A_CLASS = 3
"""


@pytest.fixture
def lab(tmp_path, monkeypatch):
    (tmp_path / "their_lab.py").write_text(MODULE)
    (tmp_path / "broken_lab.py").write_text("import nosuchpackage_xyz\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield
    for name in ("their_lab", "broken_lab"):
        sys.modules.pop(name, None)


def opened(kind, **options):
    return open_catalog(CatalogConfig(kind=kind, options=options), REGION, None, {})


def test_four_methods_make_a_working_catalogue(lab, camera):
    catalog = opened("their_lab:Pair", slope=1.0)
    assert list(catalog.table["id"]) == [1, 2] and list(catalog.table["obj_type"]) == [0, 1]
    assert catalog.table["size_disk"][1] == np.float32(0.5)
    seds = catalog.load_seds([1, 0])
    assert seds.shape == (2, 18001) and (seds > 0).all()
    rate = catalog.load_fluxes(np.array([1]), camera.filters["r"], camera.telescope).sum()
    assert rate_to_mag(rate, camera.filters["r"], camera.telescope) == pytest.approx(20.0, abs=1e-3)  # flat f_nu
    assert catalog.load_seds([]).shape == (0, 18001)
    assert catalog.truth_hash == opened("their_lab:Pair", slope=1.0).truth_hash
    assert catalog.truth_hash != opened("their_lab:Pair", slope=2.0).truth_hash


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("embeded", "unknown catalogue .*allowed: embedded, module.path:ClassName"),
        ("their_lab:", "unknown catalogue"),
        ("no_such_lab:Pair", "no module 'no_such_lab' on the Python path"),
        ("their_lab.inner:Pair", "no module 'their_lab"),
        ("their_lab:Pairs", "not a CatalogBase class of that module .*allowed: Pair"),
        ("their_lab:NOT_A_CLASS", "not a CatalogBase class"),
    ],
)
def test_wrong_names_are_explained(lab, kind, message):
    with pytest.raises(InputError, match=message):
        opened(kind, slope=1.0)


def test_a_fault_inside_the_users_module_is_not_hidden(lab):
    with pytest.raises(ModuleNotFoundError, match="nosuchpackage_xyz"):
        opened("broken_lab:Pair")


class Wrong(CatalogBase):
    """One object whose methods give what the test says."""

    def __init__(self, sed, norm=None, **values):
        super().__init__({}, REGION)
        self.sed, self.norm, self.values = sed, norm, values
        self._load()

    def _load(self):
        self.objs.append(MockObject(id=9, ra=0.0, dec=0.0, **self.values))

    def load_sed(self, obj):
        return self.sed

    def load_norm_filt(self, obj):
        return self.norm


GOOD = Table({"WAVELENGTH": [2000.0, 11000.0], "FLUX": [1.0, 1.0]})


@pytest.mark.parametrize(
    ("catalog", "message"),
    [
        (Wrong(None), "Wrong.load_sed, object 9: must return a table with the columns WAVELENGTH and FLUX"),
        (Wrong(Table({"WAVELENGTH": [2000.0]})), "columns WAVELENGTH and FLUX"),
        (Wrong(Table({"WAVELENGTH": [3000.0, 2000.0], "FLUX": [1.0, 1.0]})), "WAVELENGTH must rise"),
        (Wrong(GOOD, Table({"WAVELENGTH": [1.0, 2.0]}), mag_norm=1.0), "load_norm_filt, object 9: .*SENSITIVITY"),
        (Wrong(GOOD, Table({"WAVELENGTH": [1.0, 2.0], "SENSITIVITY": [1, 1]})), "no mag_norm"),
    ],
)
def test_wrong_spectra_are_explained(catalog, message):
    with pytest.raises(InputError, match=message):
        catalog.load_seds([0])


def test_a_class_without_the_four_methods_cannot_be_made():
    class Half(CatalogBase):
        def _load(self):
            pass

    with pytest.raises(TypeError, match="load_norm_filt"):
        Half({}, REGION)
