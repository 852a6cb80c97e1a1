"""A galaxy's components from the columns of a table: Sersic indices of its own, defaults, and what is refused."""

import numpy as np
import pytest
from scipy.special import gammaincc, gammaincinv
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.galaxy_shapes.components import components
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.own_table import TableCatalog
from csstsim.catalog.profiles.sersic import light_beyond
from csstsim.catalog.selection.reach import galaxy_radius
from csstsim.catalog.selection.renderable import reasons
from csstsim.catalog.table import ObjectTable

REGION = Region((10.0, 11.0, 11.0, 10.0), (0.0, 0.0, 1.0, 1.0), (0,), BANDS)
VARIANCE, SCALE = 60.0, 0.074
BEYOND = 0.02  # of the light beyond a radius: what the table of all indices may be wrong by


def load(**columns):
    base = {"ra": [10.0, 10.1], "dec": [0.1, 0.2], "mag_r": [20.0, 21.0], "type": ["galaxy"] * 2, "size": [0.5, 0.4]}
    return TableCatalog({"columns": base | columns}, REGION).table


def test_n_of_a_table_is_of_all_the_light():
    disk, bulge = components(load(n=[2.5, np.nan]))
    assert disk[0].tolist() == [1, 1] and disk[1].tolist() == [2.5, 1.0]
    assert bulge[0].tolist() == [0, 0]


def test_each_component_has_its_index():
    disk, bulge = components(load(n_disk=[0.7, 0.7], n_bulge=[6.2, 2.0], bulge_frac=[0.0, 0.3]))
    assert disk[1] == pytest.approx([0.7, 0.7])
    assert bulge[1] == pytest.approx([4.0, 2.0])  # without light any index would do
    assert components(load())[0][1] == 1.0 and components(load())[1][1] == 4.0


@pytest.mark.parametrize("columns, message", [
    ({"n": [1.0, 7.0]}, "row 2 cannot be rendered: a galaxy whose n_disk is not within 0.3..6.2"),
    ({"n": [0.0, 1.0]}, "row 1 cannot be rendered: a galaxy whose n_disk"),
    ({"n_bulge": [4.0, 0.2], "bulge_frac": [0.1, 0.1]}, "row 2 cannot be rendered: a galaxy whose n_bulge"),
    ({"n": [1.0, 2.0], "bulge_frac": [0.1, 0.1]}, "n: is of the total flux, so not together with bulge_frac"),
    ({"n": ["one", "two"]}, "n, row 1: must be numbers"),
    ({"n_disc": [1.0, 2.0]}, "n_disc: did you mean n_disk"),
])  # fmt: skip
def test_a_wrong_index_is_refused_by_row(columns, message):
    with pytest.raises(InputError, match=message.replace(".", r"\.")):
        load(**columns)


def test_the_limits_themselves_are_drawn():
    assert not any(mask.any() for mask in reasons(load(n=[0.3, 6.2])).values())


class Mine(CatalogBase):
    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        self.objs = [
            MockObject(id=1, type="galaxy", ra=10.0, dec=0.1, size_disk=0.3, n_disk=2.0),
            MockObject(id=2, type="galaxy", ra=10.0, dec=0.2, size_disk=0.3),
        ]

    def load_sed(self, obj):
        raise NotImplementedError


def test_a_class_gives_an_index_or_none():
    table = Mine({}, REGION).table
    assert table["n_disk"].dtype == np.float32 and table["n_disk"].tolist() == [2.0, 1.0]
    assert "n_bulge" not in table and "user_n_disk" not in table


def test_a_table_without_an_index_has_no_column_of_it():
    """So that files of catalogues made before stay as they are."""
    assert not {"n_disk", "n_bulge"} & set(ObjectTable.complete({"id": [1]}, BANDS))


@pytest.mark.parametrize("n", [0.3, 0.52, 1.0, 2.5, 4.0, 6.2])
def test_light_beyond_of_many_indices_is_the_closed_form(n):
    radius = np.geomspace(1e-2, 300, 200)
    got = light_beyond(radius, 1.0, np.full(200, n))
    exact = gammaincc(2 * n, gammaincinv(2 * n, 0.5) * radius ** (1 / n))
    seen = exact > 1e-5
    assert got[seen] == pytest.approx(exact[seen], rel=BEYOND)
    assert (got[~seen] < 1.2e-5).all()
    if n in (1, 4):
        assert np.array_equal(got, light_beyond(radius, 1.0, n))


@pytest.mark.parametrize("n", [0.3, 2.0, 6.2])
def test_a_stamp_loses_what_the_noise_allows(n):
    """Faint and bright, for a profile with long wings and one without: the closed form at the radius found."""
    table = load(n=[n, n])
    radius, lost = galaxy_radius(table, np.array([1e3, 1e8]), VARIANCE, SCALE)
    sizes = np.array([0.5, 0.4]) / SCALE
    exact = gammaincc(2 * n, gammaincinv(2 * n, 0.5) * (radius / sizes) ** (1 / n))
    assert exact == pytest.approx(lost, rel=BEYOND)


def test_a_galaxy_is_treated_alike_whatever_the_others_are():
    """A disk among profiles of any index has the stamp that it has in a table without them, to the bit."""
    alone, among = load(), load(n=[1.0, 3.3])
    electrons = np.array([1e5, 1e5])
    assert (
        galaxy_radius(alone, electrons, VARIANCE, SCALE)[0][0] == galaxy_radius(among, electrons, VARIANCE, SCALE)[0][0]
    )
