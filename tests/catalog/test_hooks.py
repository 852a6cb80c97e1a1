"""What a catalogue's dimming and component_shares may return; anything else is one line with class and method."""

import numpy as np
import pytest
from astropy import units as u
from astropy.table import Table
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.changing.motion import Interval
from csstsim.catalog.contract import check
from csstsim.catalog.hooks import dimming_of, fractions_of
from csstsim.catalog.mock_object import MockObject
from csstsim.instrument.filter import GRID

REGION = Region((), (), (), BANDS)
ROWS = np.array([1, 0])
INTERVAL = Interval(61000.0, 150.0)


def catalogue(dimming=None, shares=None):
    """A class of three galaxies whose methods return these values, or raise them."""

    def given(value):
        if isinstance(value, Exception):
            raise value
        return value

    class Own(CatalogBase):
        def __init__(self, options, region):
            super().__init__(options, region)
            self._load()

        def _load(self):
            self.objs += [MockObject(id=k, type="galaxy", ra=10.0, dec=2.0, size_disk=0.5) for k in (1, 2, 3)]

        def load_sed(self, obj):
            return Table({"WAVELENGTH": GRID, "FLUX": np.ones(len(GRID))})

        def dimming(self, rows, interval, filter):
            return given(dimming)

        def component_shares(self, rows, filter):
            return given(shares)

    return Own


def test_numbers_for_each_row_pass(camera):
    for good in ([0.5, 1], np.array([0.5, 1.0]), np.ma.array([0.5, 1.0])):
        own = catalogue(good, {"bulge_frac": good})({}, REGION)
        assert dimming_of(own, ROWS, INTERVAL, camera.filters["r"]).tolist() == [0.5, 1.0]
        fractions = fractions_of(own, ROWS, camera.filters["r"])
        assert {name: values.tolist() for name, values in fractions.items()} == {"bulge_frac": [0.5, 1]}
        assert not check(type(own), {}, REGION, camera).faults
    masked = dimming_of(catalogue(np.ma.array([1, 2], mask=[0, 1]))({}, REGION), ROWS, INTERVAL, camera.filters["r"])
    assert masked[0] == 1.0 and np.isnan(masked[1])
    single = catalogue(shares={"knots_frac": np.zeros(2, np.float32)})({}, REGION)
    assert fractions_of(single, ROWS, camera.filters["r"])["knots_frac"].dtype == np.float32
    none = catalogue()({}, REGION)
    assert dimming_of(none, ROWS, INTERVAL, camera.filters["r"]) is None
    assert fractions_of(none, ROWS, camera.filters["r"]) == {}


BAD = [
    (0.3, r"its shape is \(\), not \(2,\) \(got 0.3\)"), ([0.1, 0.2, 0.3], r"shape is \(3,\), not \(2,\)"),
    (np.zeros((2, 2)), r"shape is \(2, 2\)"), ("bright", "one number for each row.*got 'bright'"),
    (["1", "2"], "one number"), ([[1.0], [1.0, 2.0]], "one number"),
    ([0.5, 1.0] * u.mag, "without a unit"),
    (KeyError("curve 7"), "KeyError: 'curve 7'"),
]  # fmt: skip


@pytest.mark.parametrize(("value", "said"), BAD)
def test_other_forms_are_refused_by_name(camera, value, said):
    own = catalogue(value, value if isinstance(value, Exception) else {"knots_frac": value})({}, REGION)
    with pytest.raises(InputError, match=rf"^Own\.dimming: .*{said}"):
        dimming_of(own, ROWS, INTERVAL, camera.filters["r"])
    with pytest.raises(InputError, match=rf"^Own\.component_shares(, knots_frac)?: .*{said}"):
        fractions_of(own, ROWS, camera.filters["r"])
    with pytest.raises(InputError, match=r"^Own\.dimming: "):
        check(type(own), {}, REGION, camera)


def test_an_exception_is_told_with_its_line(camera):
    with pytest.raises(InputError, match=r"\(test_hooks\.py, line \d+\)"):
        dimming_of(catalogue(KeyError(7))({}, REGION), ROWS, INTERVAL, camera.filters["r"])


@pytest.mark.parametrize(("shares", "said"), [
    (0.5, "None or a dict of arrays.*got 0.5"), (["bulge_frac"], "None or a dict"),
    ({"foo": [1.0, 1.0]}, "an unknown key .got 'foo'.; allowed: bulge_frac, knots_frac"),
    ({3: [1.0, 1.0]}, "unknown key"),
])  # fmt: skip
def test_shares_are_those_of_known_components(camera, shares, said):
    own = catalogue(shares=shares)({}, REGION)
    with pytest.raises(InputError, match=rf"^Own\.component_shares: .*{said}"):
        fractions_of(own, ROWS, camera.filters["r"])
    with pytest.raises(InputError, match=r"^Own\.component_shares: "):
        check(type(own), {}, REGION, camera)


def test_values_of_the_complete_table_are_too_many(camera):
    with pytest.raises(InputError, match=r"shape is \(3,\), not \(2,\)"):
        check(catalogue(np.zeros(3)), {}, REGION, camera)
