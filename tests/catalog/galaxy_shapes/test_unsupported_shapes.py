"""Columns of galaxy properties that are not drawn are refused; following the advice gives the intended galaxy."""

import re

import numpy as np
import pytest
from support.csst import BANDS

from csstsim.base.errors import InputError
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.galaxy_shapes.unsupported_shapes import advice_for
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.own_table import TableCatalog

REGION = Region((10.0, 11.0, 11.0, 10.0), (0.0, 0.0, 1.0, 1.0), (0,), BANDS)
AXES = ["q", "axis_ratio", "ba", "b_over_a", "b/a", "q_r", "GALELLIP_r", "A_IMAGE", "ellipticity", "e", "ELONGATION"]
ANGLES = ["pa", "PA", "PA [deg]", "pa_deg", "theta", "THETA_J2000", "position_angle", "PosAng", "phi", "orientation"]
INDICES = ["sersic_n", "n_sersic", "sersic", "SersicIndex", "nser", "sersic_n_i", "n_r"]
BULGES = ["B/T", "bulge_to_total"]
SIZES = ["re", "r_e", "r_eff", "Re_arcsec", "reff", "R50", "half_light_radius", "hlr", "FLUX_RADIUS", "r_half"]
LENSING = ["g1", "g2", "shear1", "gamma_1"]


def table(**more):
    return {"ra": [10.0, 10.1], "dec": [0.1, 0.2], "mag_r": [20.0, 21.0]} | more


def load(columns):
    return TableCatalog({"columns": columns}, REGION).table


@pytest.mark.parametrize(
    ("names", "own", "advice"),
    [
        (AXES + ANGLES, {"e1": [0.1, 0.0], "e2": [0.0, 0.1]}, r"allowed: e1 = -e cos\(2 PA\), e2 = e sin\(2 PA\)"),
        (INDICES, {"n_disk": [0.5, 6.0]}, "allowed: n_disk, n_bulge: Sersic indices, 0.3 to 6.2"),
        (BULGES, {"bulge_frac": [0.5, 0.0]}, "allowed: bulge_frac: the bulge's fraction of the flux"),
        (SIZES, {"size": [0.5, 0.4]}, r"allowed: size .* along the circle of equal area, sqrt\(q\) r_e"),
        (LENSING, {"gamma1": [0.1, 0.0]}, "allowed: gamma1, gamma2 and kappa"),
    ],
)
def test_a_shape_in_other_words_is_refused_unless_it_is_given_in_ours(names, own, advice):
    galaxies = table(type=["galaxy", "galaxy"])
    sized = {} if "size" in own else {"size": [0.5, 0.4]}
    for name in names:
        with pytest.raises(
            InputError, match=f"{re.escape(name)}: galaxies are not rendered from this column; {advice}"
        ):
            load(galaxies | sized | {name: [1.0, 2.0]})
    every = {name: [1.0, 2.0] for name in names}
    given, stars = load(galaxies | sized | own | every), load(table(**every))
    blank = load(table(type=["galaxy", "star"], size=[0.5, np.nan]) | {name: [np.nan, 2.0] for name in names})
    for name in names:
        assert list(given[f"user_{name}"]) == [1.0, 2.0]
        assert f"user_{name}" in stars.names
        assert f"user_{name}" in blank.names  # of the galaxy it says nothing


def test_other_columns_of_galaxies_travel_on():
    for name in (
        "name",
        "index",
        "id_r",
        "mag_k",
        "mag_err",
        "ab",
        "b",
        "rs",
        "n_obs",
        "nobs",
        "photo_z",
        "sn",
        "field",
        "my_n",
        "ra_err",
    ):
        assert advice_for(name, ()) is None, name
        assert f"user_{name}" in load(table(type=["galaxy"] * 2, size=[0.5, 0.4]) | {name: [1.0, 2.0]}).names


class Mine(CatalogBase):
    """A catalogue of the user's whose galaxies have one more value."""

    def __init__(self, options, region):
        super().__init__(options, region)
        self._load()

    def _load(self):
        self.objs = [
            MockObject(id=1, type="star", ra=10.0, dec=0.1, n=3.0),
            MockObject(id=2, type=self.options["type"], ra=10.0, dec=0.2, size_disk=0.4, q=0.5),
        ]

    def load_sed(self, obj):
        raise NotImplementedError

    def load_norm_filt(self, obj):
        return None


def test_a_class_is_told_as_well():
    assert {"user_n", "user_q"} <= set(Mine({"type": "quasar"}, REGION).table.names)
    with pytest.raises(InputError, match="Mine: q: galaxies are not rendered from this column; allowed: e1 = "):
        _ = Mine({"type": "galaxy"}, REGION).table


def test_the_formula_is_that_of_the_sky():
    """An ellipse with axis ratio q at PA from north through east: its second moments, east and north, have these e."""
    rng = np.random.default_rng(2)
    for q, pa in zip(rng.uniform(0.05, 1.0, 50), rng.uniform(-180.0, 360.0, 50), strict=True):
        a, b, turn = 1 / np.sqrt(q), np.sqrt(q), np.radians(pa)
        along, across = np.array([np.sin(turn), np.cos(turn)]), np.array([np.cos(turn), -np.sin(turn)])  # east, north
        moments = a**2 * np.outer(along, along) + b**2 * np.outer(across, across)
        e = (1 - q) / (1 + q)
        e1, e2 = -e * np.cos(2 * turn), e * np.sin(2 * turn)
        shear = np.array([[1 + e1, e2], [e2, 1 - e1]]) / np.sqrt(1 - e**2)  # as render.scene.shape_matrix
        np.testing.assert_allclose(shear @ shear.T, moments, atol=1e-12)
