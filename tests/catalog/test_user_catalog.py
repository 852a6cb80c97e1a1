"""A user's own catalogue: the paper's four methods, found by dotted path, and mistakes in it."""

import re
import sys

import numpy as np
import pytest
from astropy import units as u
from astropy.table import Table
from csst import BANDS
from synphot import Empirical1D, Observation, SourceSpectrum, SpectralElement
from synphot.units import PHOTLAM

from csstsim.base.errors import InputError
from csstsim.base.units import ab_photon_density
from csstsim.campaign.sections import CatalogConfig
from csstsim.catalog import base
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.contract import check, sky_region
from csstsim.catalog.light.photometry import ab_mag, rate_to_mag
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.open import open_catalog
from csstsim.instrument.filter import GRID

REGION = Region((), (), (), BANDS)
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
    (tmp_path / "leaving_lab.py").write_text(MODULE.replace('slope = self.options["slope"]', "raise SystemExit(3)"))
    (tmp_path / "worse_lab.py").write_text("class Pair(:\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield
    for name in ("their_lab", "broken_lab", "leaving_lab", "worse_lab"):
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


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("broken_lab:Pair", {}, r"importing broken_lab: ModuleNotFoundError: .*nosuchpackage_xyz.*lab.py, line 1"),
        ("worse_lab:Pair", {}, r"importing worse_lab: SyntaxError: .*worse_lab.py, line 1"),
        ("leaving_lab:Pair", {"slope": 1.0}, r"Pair.__init__: SystemExit: 3 \(leaving_lab.py, line 14\)"),
        ("their_lab:Pair", {}, r"Pair.__init__: KeyError: 'slope' \(their_lab.py, line 14\)"),
        ("their_lab:Pair", {"slope": "x"}, r"Pair.load_sed, object 1: .*Error.*their_lab.py, line 20"),
    ],
)  # fmt: skip
def test_a_fault_inside_the_users_module_is_one_line_with_its_place(lab, kind, options, message):
    with pytest.raises(InputError, match=message) as caught:
        opened(kind, **options).load_seds([0])
    assert caught.value.__cause__ is not None  # for -v


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


def test_a_class_without_load_sed_cannot_be_made():
    class Half(CatalogBase):
        def _load(self):
            pass

    with pytest.raises(TypeError, match="load_sed"):
        Half({}, REGION)


class Absolute(CatalogBase):
    """A class without load_norm_filt: its star has AB 20 in every band."""

    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        self.objs = [MockObject(id=9, type="star", ra=10.0, dec=2.0, **self.options)]

    def load_sed(self, obj):
        return GOOD_20


def test_load_norm_filt_may_be_left_out(camera):
    """Spectra are then absolute, to 1 mmag; a mag_norm that is given all the same has no effect, which is said."""
    catalog = Absolute({}, REGION)
    assert catalog.load_norm_filt(catalog.objs[0]) is None
    rate = catalog.load_fluxes(np.array([0]), camera.filters["r"], camera.telescope).sum()
    assert rate_to_mag(rate, camera.filters["r"], camera.telescope) == pytest.approx(20.0, abs=1e-3)
    region = sky_region(ra=10.0, dec=2.0, radius=0.1)
    for options, warned in (({}, False), ({"mag_norm": 18.0}, True)):
        report = check(Absolute, options, region, camera)
        assert not report.faults, report
        assert any("mag_norm has no effect" in line for line in report.warnings) == warned, report


def one(flux=None, norm=None, **values):
    """A catalogue class of one object at RA 10, Dec 2; `flux` its spectrum (Table), AB 20 if None."""

    class One(Wrong):
        def __init__(self, options, region):
            super().__init__(GOOD_20 if flux is None else flux, norm)

        def _load(self):
            self.objs = [MockObject(**({"id": 9, "type": "star", "ra": 10.0, "dec": 2.0} | v)) for v in rows]

    rows = values.pop("rows", [values])
    return One


GOOD_20 = Table({"WAVELENGTH": GRID, "FLUX": ab_photon_density(GRID, 20.0)})
GALAXY = {"type": "galaxy", "size_disk": 0.5}


def beside(**values):
    """A catalogue class of a good star and object 9 of these values."""
    return one(rows=[{"id": 1}, values])


def test_the_example_in_the_documentation_keeps_the_contract():
    code = re.search(r"    import numpy as np\n.*?(?=\n\n\S)", base.__doc__, re.S).group()
    lines = {}
    exec(re.sub(r"^    ", "", code, flags=re.M), lines)
    report = check(lines["Mine"], {}, sky_region(10.0, -2.0, 0.1))
    assert report.counts == {"star": 1, "galaxy": 1} and not report.faults and not report.warnings, report


@pytest.mark.parametrize(
    ("cls", "fault"),
    [
        (one(rows=[{}, {"ra": 11.0}]), "an id given more than once: object 9"),
        (one(Table({"WAVELENGTH": [200.0, 1100.0], "FLUX": [1.0, 1.0]})), "nanometre"),
        (one(Table({"WAVELENGTH": [0.2, 1.1], "FLUX": [1.0, 1.0]})), "micron"),
        (one(Table({"WAVELENGTH": [2000.0, 11000.0], "FLUX": [1.0, np.nan]})), "FLUX holds values that are not finite"),
        (one(Table({"WAVELENGTH": [2000.0, 11000.0], "FLUX": [1.0, -0.1]})), "FLUX holds negative"),
        (one(Table({"WAVELENGTH": [2000.0, 11000.0], "FLUX": [0.0, 0.0]})), "no light in any band"),
        (one(norm=Table({"WAVELENGTH": [1.0, 2.0], "SENSITIVITY": [1.0, 1.0]}), mag_norm=20.0), "no light in any band"),
        (one(norm=Table({"WAVELENGTH": [5000.0, 6000.0], "SENSITIVITY": [1.0, -1.0]}), mag_norm=20.0), "SENSITIVITY"),
        (one(type="galaxy"), "every object would be left out: object 9"),
    ],
)
def test_the_contract_finds_faults(camera, cls, fault):
    report = check(cls, {}, REGION, camera)
    assert fault in "\n".join(report.faults), report


@pytest.mark.parametrize(
    ("cls", "warning"),
    [
        (beside(type="galaxy"), "would not be drawn: a galaxy without size_disk: object 9"),
        (beside(**GALAXY, bulge_frac=0.5), "a galaxy without size_bulge"),
        (beside(**GALAXY, e1=0.8, e2=0.7), "|e1, e2|"),
        (beside(**GALAXY, bulge_frac=-0.1), "bulge_frac"),
        (beside(**GALAXY, kappa=1.2), "strongly lensed"),
        (beside(**GALAXY, gamma1=np.nan), "kappa, gamma1 or gamma2 is not finite"),
        (beside(dec=95.0), "not a position on the sky"),
        (beside(size_disk=0.5), "a star, drawn as a point, has a size or an ellipticity: object 9"),
        (one(pm_ra=3.0), "pm_ra is unknown to csstsim; is pmra meant: object 9"),
        (one(offset_ra=0.3), "offset_ra is a column of tables alone: give the part's own place and light: object 9"),
        (one(PARALAX="dwarf"), "is parallax meant"),
        (beside(**GALAXY | {"size_disk": 1e9}), "above 3600 arcsec: object 9"),
        (one(flags=32), "flags are csstsim's own"),
        (one(norm=Table({"WAVELENGTH": [1700.0, 6000.0], "SENSITIVITY": [1.0, 1.0]}), mag_norm=20.0), "is cut there"),
        (one(mag_g=20.1), "mag_g is not the spectrum's magnitude: object 9"),
        (one(Table({"WAVELENGTH": [3000.0, 11000.0], "FLUX": [1.0, 1.0]})), "does not cover 2000-11000"),
        (one(Table({"WAVELENGTH": GRID, "FLUX": np.full(len(GRID), 1e-17)})), "fainter than 40"),
    ],
)
def test_the_contract_warns(camera, cls, warning):
    report = check(cls, {}, REGION, camera)
    assert not report.faults and len(report.warnings) == 1 and warning in report.warnings[0], report


def test_a_good_catalogue_and_an_empty_one_pass(camera):
    report = check(one(**GALAXY, mag_g=20.0, mag_y=20.0), {}, REGION, camera)
    assert not report.faults and not report.warnings and "1 object: 1 of type galaxy" in str(report)
    assert str(check(one(rows=[]), {}, REGION, camera)) == "no objects in the region"


def test_a_fast_hook_that_is_not_the_spectrum_is_a_fault(camera):
    class Fast(one()):
        def load_fluxes(self, rows, filter, telescope):
            return 1.02 * super().load_fluxes(rows, filter, telescope)

    assert "load_fluxes is not the integral of load_seds in r: object 9" in check(Fast, {}, REGION, camera).faults


def test_reasons_are_those_of_the_selection(camera, make_pointing, observe):
    """Random nonsense: an object is flagged as not drawable if and only if there is a reason in words."""
    from csstsim.catalog.flags import BAD_VALUE, STRONG_LENSING
    from csstsim.catalog.selection.drawable import NO_LIGHT, STRONGLY_LENSED, reasons, why_not_drawn
    from csstsim.catalog.selection.select import Noise, select_objects
    from csstsim.instrument.chip import Window
    from csstsim.optics.geometry.wcs import ChipWCS

    rng = np.random.default_rng(4)
    values = {
        "size_disk": [0, 1, np.nan], "size_bulge": [0, 1], "bulge_frac": [0, 0.5, 1, 2], "e1": [0, 0.9, np.nan],
        "e2": [0, 0.9], "kappa": [0, 1.5, np.inf], "gamma1": [0, 0.1], "obj_type": [0, 1, 1, 1, 2, 3],
    }  # fmt: skip
    pointing = make_pointing()
    wcs, craft = ChipWCS(camera.chips[9], pointing), observe(pointing)
    ra, dec = (float(v) for v in wcs.pixel_to_world(4000.0, 3000.0))
    rows = [{n: rng.choice(v) for n, v in values.items()} | {"id": i, "ra": ra, "dec": dec} for i in range(300)]
    for row in rows:
        row["obj_type"] = int(row["obj_type"])
        row["type"] = None
    catalog = one(rows=rows)({}, REGION)
    table = select_objects(
        catalog, wcs, craft, Window(3000, 5000, 2000, 4000), camera.filters["r"], camera.telescope, 150.0,
        Noise(0.2, 0.02, 5.0),
    )  # fmt: skip
    dark = (table["flags"] & (BAD_VALUE | STRONG_LENSING)) > 0
    assert 50 < dark.sum() < 290 and len(table) == 300
    assert np.array_equal(np.any(list(reasons(table).values()), axis=0), dark)
    why = why_not_drawn(table, dark)
    assert sum(why.values()) == dark.sum() and NO_LIGHT not in why
    flagged = table.with_columns(flags=np.full_like(table["flags"], STRONG_LENSING))  # as bricks flag arcs
    assert why_not_drawn(flagged, ~dark) == {STRONGLY_LENSED: (~dark).sum()}


@pytest.mark.parametrize("value", [np.nan, 1.5, 2**63, 2**64, None, "one"])
def test_ids_are_whole_numbers(value):
    with pytest.raises(InputError, match="id: does not fit the column; allowed: int64"):
        one(id=value)({}, REGION).table  # noqa: B018


def test_extras_keep_to_themselves():
    """A user's `mag`, `RV` and `flux0` are columns of theirs, whatever csstsim calls its own."""
    catalog = one(rows=[{"mag": 1.0, "RV": 7.0, "file": "a.fits", "curve": np.ones(3), "rv": 5.0}])({}, REGION)
    table = catalog.table
    assert {"user_mag", "user_RV", "user_file"} == {name for name in table if name.startswith("user_")}
    assert "mag" not in table and table["rv"][0] == 5.0 and table["user_RV"][0] == 7.0


def test_known_columns_come_through_whatever_their_form():
    table = one(ra=np.array(10.5), dec=np.float32(2.0))({}, REGION).table
    assert table["ra"][0] == 10.5 and table["dec"][0] == 2.0


def test_objects_must_be_mock_objects_and_objs_must_be_there():
    class Tuples(one()):
        def _load(self):
            self.objs = [(1, 2)]

    class Forgetful(one()):
        def __init__(self, options, region):
            pass

    with pytest.raises(InputError, match="Tuples: objs holds an item that is not a MockObject"):
        check(Tuples, {}, REGION)
    with pytest.raises(InputError, match="Forgetful: has no objs"):
        check(Forgetful, {}, REGION)


def test_units_of_columns_are_honoured():
    """A spectrum in nm and erg / s / cm2 / A, or f_nu in Jy, is the same light; a unit without a way is refused."""
    wave = GRID / 10 * u.nm
    flux = ab_photon_density(GRID, 20.0) * u.ph / (u.s * u.m**2 * u.AA)
    expected = one()({}, REGION).load_seds([0])
    for unit in ("erg / (s cm2 AA)", "Jy"):
        table = Table({"WAVELENGTH": wave, "FLUX": flux.to(unit, u.spectral_density(wave))})
        np.testing.assert_allclose(one(table)({}, REGION).load_seds([0]), expected, rtol=1e-9)
    with pytest.raises(InputError, match=r"cannot be used: .*kg"):
        one(Table({"WAVELENGTH": wave, "FLUX": np.ones(len(wave)) * u.kg}))({}, REGION).load_seds([0])


@pytest.mark.parametrize("system", ["sdss2010-r", "lsst2023-g", "decam2014-z"])
def test_magnitudes_of_other_systems(system):
    """load_norm_filt through other surveys' curves: synphot and speclite measure the mag_norm asked for, to 2 mmag."""
    import speclite.filters

    curve = speclite.filters.load_filter(system)
    norm = Table({"WAVELENGTH": curve.wavelength, "SENSITIVITY": curve.response})
    slope = Table({"WAVELENGTH": GRID, "FLUX": (GRID / 5000.0) ** 1.7 * (1 + 0.3 * np.sin(GRID / 300.0))})
    [sed] = one(slope, norm, mag_norm=21.3)({}, REGION).load_seds([0])
    source = SourceSpectrum(Empirical1D, points=GRID, lookup_table=sed * 1e-4 * PHOTLAM)
    band = SpectralElement(Empirical1D, points=curve.wavelength, lookup_table=curve.response)
    assert Observation(source, band, binset=GRID).effstim(u.ABmag).value == pytest.approx(21.3, abs=2e-3)
    energy = (sed * u.ph / (u.s * u.m**2 * u.AA)).to("erg / (s cm2 AA)", u.spectral_density(GRID * u.AA))
    assert curve.get_ab_magnitude(energy, GRID * u.AA) == pytest.approx(21.3, abs=2e-3)
    assert ab_mag(sed, GRID, np.interp(GRID, curve.wavelength, curve.response)) == pytest.approx(21.3, abs=1e-9)


def test_keywords_that_only_some_objects_have_reach_the_table_with_blanks(camera):
    class Some(one()):
        def _load(self):
            rows = [{"id": 1, "filter": "r.csv", "rank": 3}, {"id": 2}, {"id": 3, "pm_ra": 5.0}]
            self.objs = [MockObject(type="star", ra=10.0, dec=2.0, **row) for row in rows]

    table = Some({}, REGION).table
    assert list(table["user_filter"]) == ["r.csv", "", ""]
    np.testing.assert_array_equal(table["user_rank"], [3.0, np.nan, np.nan])
    assert any("is pmra meant" in warning for warning in check(Some, {}, REGION, camera).warnings)


def test_units_in_an_object_are_refused_by_name():
    with pytest.raises(InputError, match=r"One._load, ra: must be a plain number"):
        _ = one(ra=10.0 * u.deg)({}, REGION).table


@pytest.mark.parametrize("shape", [(1, 18001), (2, 100)])
def test_spectra_of_the_wrong_shape_are_refused(camera, shape):
    class Rows(one(rows=[{}, {"id": 2}])):
        def load_seds(self, rows):
            return np.ones(shape)

    with pytest.raises(InputError, match="load_seds gave a wrong shape"):
        check(Rows, {}, REGION, camera)


def test_fluxes_of_the_wrong_shape_are_refused(camera):
    class Rates(one()):
        def load_fluxes(self, rows, filter, telescope):
            return np.ones(len(rows))

    with pytest.raises(InputError, match=r"load_fluxes: .*shape"):
        check(Rates, {}, REGION, camera)


def test_the_hash_knows_values_and_their_names(lab):
    """Of a catalogue's own columns, too: same value under another name is another truth."""
    import their_lab

    found = []
    for own in ({"tint": 1.0}, {"tone": 1.0}, {"tint": 2.0}):
        catalog = their_lab.Pair({"slope": 1.0}, REGION)
        catalog.objs.append(MockObject(id=3, type="star", ra=10.2, dec=2.0, **own))
        found.append(catalog.truth_hash)
    assert len(set(found)) == 3
