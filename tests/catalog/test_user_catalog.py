"""A user's own catalogue: the paper's four methods, found by dotted path, and mistakes in it."""

import re
import sys
from pathlib import Path

import healpy
import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable, Table
from support.csst import BANDS
from synphot import Empirical1D, Observation, SourceSpectrum, SpectralElement
from synphot.units import PHOTLAM

from csstsim.base.errors import InputError
from csstsim.base.units import ab_photon_density
from csstsim.campaign.sections import CatalogConfig
from csstsim.catalog import base
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.changing.motion import Interval
from csstsim.catalog.contract import check, sky_region
from csstsim.catalog.light.photometry import ab_mag, rate_to_mag
from csstsim.catalog.light.spectrum_tables import read_columns
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.open import catalog_class, catalogue_digests, importable, open_catalog, resolved_options
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
        (one(Table({"WAVELENGTH": [2000.0, 11000.0], "FLUX": [0.0, 0.0]})), "no flux in any band"),
        (one(norm=Table({"WAVELENGTH": [1.0, 2.0], "SENSITIVITY": [1.0, 1.0]}), mag_norm=20.0), "no flux in any band"),
        (one(norm=Table({"WAVELENGTH": [5000.0, 6000.0], "SENSITIVITY": [1.0, -1.0]}), mag_norm=20.0), "SENSITIVITY"),
        (one(type="galaxy"), "every object would be omitted: object 9"),
    ],
)
def test_the_contract_finds_faults(camera, cls, fault):
    report = check(cls, {}, REGION, camera)
    assert fault in "\n".join(report.faults), report


@pytest.mark.parametrize(
    ("cls", "warning"),
    [
        (beside(type="galaxy"), "would not be rendered: a galaxy without size_disk (or size): object 9"),
        (beside(**GALAXY, bulge_frac=0.5), "a galaxy without size_bulge"),
        (beside(**GALAXY, e1=0.8, e2=0.7), "|e1, e2|"),
        (beside(**GALAXY, bulge_frac=-0.1), "bulge_frac"),
        (beside(**GALAXY, kappa=1.2), "strongly lensed"),
        (beside(**GALAXY, gamma1=np.nan), "kappa, gamma1 or gamma2 is not finite"),
        (beside(dec=95.0), "not a position on the sky"),
        *(
            (beside(**shape), "a star, rendered as a point, has a size or an ellipticity: object 9")
            for shape in ({"size_disk": 0.5}, {"size_bulge": 0.5}, {"e1": -0.1}, {"e2": 0.1})
        ),
        (one(pm_ra=3.0), "pm_ra is unknown to csstsim; did you mean pmra?: object 9"),
        (one(offset_ra=0.3), "offset_ra is a column of tables only: give the position and flux of the part: object 9"),
        (one(PARALAX="dwarf"), "did you mean parallax"),
        (beside(**GALAXY | {"size_disk": 1e9}), "above 3600 arcsec: object 9"),
        (one(flags=32), "flags are set by csstsim"),
        (one(norm=Table({"WAVELENGTH": [1700.0, 6000.0], "SENSITIVITY": [1.0, 1.0]}), mag_norm=20.0), "is cut there"),
        (one(mag_g=20.1), "mag_g is not the spectrum's magnitude: object 9"),
        (one(norm=Table({"WAVELENGTH": [5000.0, 12000.0], "SENSITIVITY": [1.0, 1.0]}), mag_norm=20.0), "is cut there"),
        (one(Table({"WAVELENGTH": [3000.0, 11000.0], "FLUX": [1.0, 1.0]})), "does not cover 2000-11000"),
        (one(Table({"WAVELENGTH": [2000.0, 10000.0], "FLUX": [1.0, 1.0]})), "does not cover 2000-11000"),
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
    from csstsim.catalog.selection.renderable import NO_LIGHT, STRONGLY_LENSED, reasons, why_not_rendered
    from csstsim.catalog.selection.select import ChipView, Noise, select_objects
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
    window = Window(3000, 5000, 2000, 4000)
    noise = Noise(0.2, 0.02, 5.0)
    view = ChipView(wcs, craft, window, camera.filters["r"], camera.telescope, 150.0, noise)
    table = select_objects(catalog, view)
    dark = (table["flags"] & (BAD_VALUE | STRONG_LENSING)) > 0
    assert 50 < dark.sum() < 290 and len(table) == 300
    assert np.array_equal(np.any(list(reasons(table).values()), axis=0), dark)
    why = why_not_rendered(table, dark)
    assert sum(why.values()) == dark.sum() and NO_LIGHT not in why
    flagged = table.with_columns(flags=np.full_like(table["flags"], STRONG_LENSING))  # as bricks flag arcs
    assert why_not_rendered(flagged, ~dark) == {STRONGLY_LENSED: (~dark).sum()}


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

    class Emptied(one()):
        def _load(self):
            self.objs = None

    with pytest.raises(InputError, match=r"Emptied: objs is not a list of MockObjects .got 'None'"):
        _ = Emptied({}, REGION).table
    with pytest.raises(InputError, match="Tuples: objs contains an item that is not a MockObject"):
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
    assert any("did you mean pmra" in warning for warning in check(Some, {}, REGION, camera).warnings)


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


@pytest.mark.parametrize(("ra", "dec", "radius"), [(10.0, -2.0, 0.1), (359.95, 60.0, 0.2), (0.01, -75.0, 0.5)])
def test_a_region_of_the_sky_is_the_square_about_its_circle(ra, dec, radius):
    """It holds the circle and not much more; bricks are healpy's; a band's name is kept."""
    region = sky_region(ra, dec, radius, ("r",))
    assert region.bands == ("r",) and np.ptp(region.dec) == pytest.approx(2 * radius)
    assert np.mean(region.dec) == pytest.approx(dec)
    wide = np.ptp((np.array(region.ra) - ra + 180) % 360) / 2
    assert wide == pytest.approx(radius / np.cos(np.radians(abs(dec) + radius))) and min(region.ra) >= 0
    angle = np.linspace(0, 2 * np.pi, 50)
    for size, inside in ((0.97, True), (1.6, False)):
        there = dec + size * radius * np.cos(angle)
        beside = ra + size * radius * np.sin(angle) / np.cos(np.radians(there))
        assert region.contains(beside % 360, there).all() if inside else not region.contains(beside % 360, there).all()
    wanted = healpy.query_disc(256, healpy.ang2vec(ra, dec, lonlat=True), np.radians(radius), inclusive=True, nest=True)
    touched = healpy.query_disc(256, healpy.ang2vec(ra, dec, lonlat=True), np.radians(radius), nest=True)
    assert set(touched) <= set(region.bricks) and len(set(region.bricks) - set(wanted)) <= 0.5 * len(wanted) + 2


def test_a_report_counts_kinds_and_names_some_of_many(camera):
    """Seven objects without light: five ids and the number of the others; singular and plural."""
    rows = [{"id": k, "type": "galaxy" if k % 2 else "quasar", "size_disk": 0.5} for k in range(1, 8)]
    report = check(one(Table({"WAVELENGTH": [2000.0, 11000.0], "FLUX": [0.0, 0.0]}), rows=rows), {}, REGION, camera)
    assert report.counts == {"galaxy": 4, "quasar": 3}
    assert report.faults == (
        "has no flux in any band (or none in its mag_norm's filter): object 1, 2, 3, 4, 5 and 2 more",
    )
    assert str(report).splitlines() == ["7 objects: 4 of type galaxy, 3 of type quasar", f"fault: {report.faults[0]}"]


def test_some_of_each_type_are_checked(camera):
    """At most so many, from the first to the last of the table; those between are not asked."""
    asked = []
    rows = [{"id": k, "type": "star" if k < 9 else "quasar"} for k in range(12)]

    class Asked(one(rows=rows)):
        def load_sed(self, obj):
            asked.append(obj.id)
            return GOOD_20

    check(Asked, {}, REGION, camera, most=3)
    assert sorted(set(asked)) == [0, 4, 8, 9, 10, 11]


@pytest.mark.parametrize(("factor", "found"), [(1.008, False), (1.012, True), (0.988, True)])
def test_fast_light_may_differ_by_a_hundredth(camera, factor, found):
    class Fast(one()):
        def load_fluxes(self, rows, filter, telescope):
            return super().load_fluxes(rows, filter, telescope) * [1.0, 1.0, 1.0, factor]

    assert bool(check(Fast, {}, REGION, camera).faults) == found


@pytest.mark.parametrize(("mag", "found"), [(20.04, False), (20.06, True), (19.94, True)])
def test_magnitudes_may_differ_by_a_twentieth(camera, mag, found):
    warnings = check(one(mag_i=mag), {}, REGION, camera).warnings
    assert warnings == (("mag_i is not the spectrum's magnitude: object 9",) if found else ())


@pytest.mark.parametrize(("mag", "found"), [(39.9, False), (40.2, True), (-0.2, True), (0.1, False)])
def test_light_beyond_all_reason_is_said(camera, mag, found):
    flux = Table({"WAVELENGTH": GRID, "FLUX": ab_photon_density(GRID, mag)})
    warnings = check(one(flux), {}, REGION, camera).warnings
    assert any("brighter than 0 or fainter than 40" in line for line in warnings) == found


def test_an_objects_length_is_that_of_its_table(camera):
    class Lost(one(rows=[{"id": 1}, {"id": 2}])):
        @property
        def table(self):
            return super().table.take([0])

    assert check(Lost, {}, REGION, camera).faults == ("objs has 2 objects, table 1 rows",)


@pytest.mark.parametrize(("table", "message"), [
    (Table({"WAVELENGTH": [0.0, 3000.0], "FLUX": [1.0, 1.0]}), "WAVELENGTH must be above 0"),
    (Table({"WAVELENGTH": [3000.0], "FLUX": [1.0]}), "WAVELENGTH must rise"),
    (Table({"WAVELENGTH": [3000.0, 3000.0], "FLUX": [1.0, 1.0]}), "WAVELENGTH must rise"),
    ({"WAVELENGTH": [3000.0, 4000.0], "FLUX": [1.0, 1.0, 2.0]}, "match its column in length"),
    ({"WAVELENGTH": ["a", "b"], "FLUX": [1.0, 1.0]}, "cannot be used"),
])  # fmt: skip
def test_columns_of_a_spectrum(table, message):
    with pytest.raises(InputError, match=message):
        read_columns(table, "FLUX", "here")


def test_masked_samples_are_no_numbers_and_nanometres_are_exact():
    flux = np.ma.array([1.0, 2.0, 3.0], mask=[False, True, False])
    table = Table({"WAVELENGTH": [200.0, 700.0, 1100.0], "FLUX": flux})
    table["WAVELENGTH"].unit = "nm"
    wave, values = read_columns(table, "FLUX", "here")
    assert wave.tolist() == [2000.0, 7000.0, 11000.0] and values.dtype == float
    np.testing.assert_array_equal(values, [1.0, np.nan, 3.0])


def test_columns_of_a_spectrum_may_be_quantities():
    table = QTable({"WAVELENGTH": [300.0, 400.0] * u.nm, "FLUX": [1.0, 2.0] * u.Unit("photon / (s m2 nm)")})
    wave, values = read_columns(table, "FLUX", "here")
    assert wave.tolist() == [3000.0, 4000.0] and values == pytest.approx([0.1, 0.2], rel=1e-12)


def test_a_class_is_dimmed_by_its_columns_and_bounds_nothing(camera):
    """A sine at its faintest for one object and none for the other, from the base class."""
    phase = 0.25 - 61000.0 % 1.0
    rows = [{"id": 1, "var_period": 1e4, "var_amplitude": 0.4, "var_phase": phase - 6.1}, {"id": 2}]
    catalog = one(rows=rows)({}, REGION)
    assert set(catalog.table) >= {"var_period", "var_amplitude", "var_phase"} and "user_var_period" not in catalog.table
    assert np.isnan(catalog.table["var_period"][1]) and catalog.table["var_phase"][1] == 0  # as in a table's blanks
    dmag = catalog.dimming(np.array([1, 0]), Interval(61000.0, 150.0), camera.filters["r"])
    assert dmag == pytest.approx([0.0, 0.4], abs=1e-6)
    assert catalog.rate_bound([0], camera.filters["r"], camera.telescope) is None
    assert catalog.component_shares([0], camera.filters["r"]) is None
    assert one()({}, REGION).dimming([0], Interval(61000.0, 150.0), camera.filters["r"]) is None


def test_rows_of_spectra_are_in_the_order_asked_and_normalised_one_by_one(camera):
    norm = Table({"WAVELENGTH": [5999.0, 6000.0, 7000.0, 7001.0], "SENSITIVITY": [0.0, 1.0, 1.0, 0.0]})
    rows = [{"id": k, "mag_norm": 18.0 + k} for k in range(4)]
    catalog = one(norm=norm, rows=rows)({}, REGION)
    seds = catalog.load_seds([3, 0, 2])
    expected = ab_photon_density(GRID)[None] * 10 ** (-0.4 * np.array([[21.0], [18.0], [20.0]]))
    np.testing.assert_allclose(seds, expected, rtol=1e-6)
    edges = GRID[100:2001:100]
    assert catalog.load_binned([3, 0], edges) == pytest.approx(expected[:2, 150:2000:100], rel=2e-3)


@pytest.mark.parametrize("name", ["ra", "kappa", "image_file"])
def test_a_value_that_is_several_is_refused_by_name(name):
    with pytest.raises(InputError, match=f"One, {name}: is not one value"):
        _ = one(**{name: np.ones(2)})({}, REGION).table


def test_extras_of_several_kinds():
    """True and false, numbers and words; what only some have is a number or a word, never both."""
    rows = [{"id": 1, "good": True, "rank": 3, "word": "a"}, {"id": 2, "good": False, "rank": 2.5, "word": "b"}]
    table = one(rows=rows)({}, REGION).table
    assert table["user_good"].tolist() == [True, False] and table["user_rank"].tolist() == [3.0, 2.5]
    assert table["user_word"].tolist() == ["a", "b"]


def test_the_hash_knows_the_options():
    class Optional(one()):
        def __init__(self, options, region):
            super().__init__(options, region)
            self.options = options

    first, again, other = (Optional({"slope": s}, REGION).truth_hash for s in (1, 1, 2))
    assert first == again != other and len(first) == 16


def test_paths_of_options_begin_beside_the_campaign(lab, tmp_path):
    """Those that the class names as paths, one or a list; others and absolute ones stay."""
    import their_lab

    their_lab.Pair.PATHS = ("file", "more", "absent")
    campaign = tmp_path / "deep" / "campaign.yaml"
    options = {"file": "a.csv", "more": ["b.csv", "/abs/c.csv"], "slope": "d.csv"}
    found = resolved_options("their_lab:Pair", options, campaign)
    there = tmp_path / "deep"
    assert {n: v if isinstance(v, str) else list(map(Path, v)) for n, v in found.items() if n != "file"} == {
        "more": [there / "b.csv", Path("/abs/c.csv")], "slope": "d.csv",
    }  # fmt: skip
    assert Path(found["file"]) == there / "a.csv" and options["file"] == "a.csv"
    other = tmp_path / "other"
    other.mkdir()
    (other / "their_lab.py").write_text("")
    with pytest.raises(InputError, match=r"was loaded under this name, not .*other/their_lab\.py"):
        resolved_options("their_lab:Pair", {}, other / "campaign.yaml")


def test_a_folder_becomes_importable_once(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = list(sys.path)
    for _ in range(2):
        importable(tmp_path)
    assert sys.path == [*before, str(tmp_path.resolve())]  # modules of the environment come first


def test_digests_are_of_the_module_and_the_files_that_it_names(lab, tmp_path):
    import their_lab

    (tmp_path / "stars.csv").write_text("1")
    their_lab.Pair.files = classmethod(lambda cls, options: (options["file"],))
    config = CatalogConfig(kind="their_lab:Pair", options={"file": str(tmp_path / "stars.csv")})
    assert catalog_class("their_lab:Pair") is their_lab.Pair
    first = catalogue_digests(config)
    (tmp_path / "stars.csv").write_text("2")
    second = catalogue_digests(config)
    assert len(first) == 2 and first[0] == second[0] and first[1] != second[1]
    (tmp_path / "their_lab.py").write_text(MODULE + "# more\n")
    assert catalogue_digests(config)[0] != first[0]
    (tmp_path / "stars.csv").unlink()
    with pytest.raises(InputError, match=r"stars\.csv: catalog\.options: cannot read the file: No such file"):
        catalogue_digests(config)
