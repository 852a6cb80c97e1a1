"""Columns of lensing, magnification, and allowed values of the campaign's `lensing`."""

import numpy as np
import pytest
from support.embedded_sky import brick, key

from csstsim.base.errors import InputError
from csstsim.base.model import validate
from csstsim.campaign.sections import CatalogConfig, Lensing
from csstsim.catalog.truth_bricks import make_brick
from csstsim.universe.lensing.lensing import lens, magnification, stretch
from csstsim.universe.lensing.potential_field import Lensed

PIX = 100000


def test_magnification_in_closed_form():
    mu, thin = magnification([0.0, 0.1, 0.05], [0.0, 0.0, 0.03], [0.0, 0.0, 0.04])
    np.testing.assert_allclose(mu, [1.0, 1 / 0.81, 1 / (0.95**2 - 0.05**2)])
    assert thin.all()


def test_stretch_in_closed_form():
    got = stretch(
        np.array([0.0, 0.1, 0.5, 0.5, 1.2]), np.array([0.0, 0.3, 0.3, 0.4, 0.0]), np.array([0, 0.4, 0, 0.3, 0])
    )
    np.testing.assert_allclose(got, [1.0, 2.5, 5.0, np.inf, np.inf])


@pytest.mark.parametrize(
    "field", [(1.0, 0, 0), (1.5, 0.1, 0), (0.5, 0.5, 0), (0.5, 0.4, 0.4), (np.nan, 0, 0), (0, np.inf, 0)]
)
def test_strong_or_undefined_lensing_is_rejected_without_nan(field):
    mu, thin = magnification(*field)
    assert mu == 1.0 and not thin


def test_constant_field_and_none():
    position = (PIX, np.zeros(3), np.zeros(3), np.array([0.0, 1.0, np.nan]))
    columns = lens(*position, Lensing(field="constant", kappa=0.1, gamma1=0.02, gamma2=-0.01))
    np.testing.assert_array_equal(columns["gamma2"], np.full(3, -0.01, np.float32))
    assert not any(column.any() for column in lens(*position, Lensing(field="none")).values())


def test_bricks_carry_the_cosmic_field_by_default():
    table = brick(PIX)
    star, deep = table["obj_type"] == 0, table["z"] > 0.5
    assert not table["kappa"][star].any()
    assert table["kappa"][~star & deep].all() and table["kappa"].dtype == np.float32
    mu, thin = magnification(table["kappa"], table["gamma1"], table["gamma2"])
    assert thin.all() and mu.min() > 0.5 and mu.max() < 2
    # Nothing else of the sky depends on the field.
    plain = make_brick(pix=PIX, **key(Lensing(field="none")))
    for name in ("ra", "z", "mag_i", "e1"):
        np.testing.assert_array_equal(plain[name], table[name])


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"kappa": 0.1}, "need field: constant"),
        ({"field": "none", "gamma2": 0.01}, "need field: constant"),
        ({"field": "constant", "kappa": 1.0}, "less than 1"),
        ({"field": "constant", "kappa": 0.5, "gamma1": 0.3, "gamma2": 0.4}, "strong lensing"),
        ({"field": "constant", "gamma1": float("nan")}, "finite"),
        ({"field": "constant", "kappa": float("-inf")}, "finite"),
        ({"field": "Cosmic"}, "'none', 'constant' or 'cosmic'"),
    ],
)
def test_faults_of_the_campaign_are_named(fault, words):
    with pytest.raises(InputError, match=words) as caught:
        validate(CatalogConfig, {"lensing": fault}, "campaign.yaml")
    assert "campaign.yaml" in str(caught.value) and "lensing" in str(caught.value)


def test_twin_campaign_is_known():
    assert validate(CatalogConfig, {"shapes": "rotated90"}, "campaign.yaml").shapes == "rotated90"
    with pytest.raises(InputError, match="shapes"):
        validate(CatalogConfig, {"shapes": "rotated45"}, "campaign.yaml")


def test_images_are_magnified_and_stretched_by_the_eigenvalues():
    """Of the Jacobian, by numpy, for asymmetric shears and both signs of convergence."""
    rng = np.random.default_rng(5)
    kappa, gamma1, gamma2 = rng.uniform(-0.3, 0.4, 50), rng.uniform(-0.2, 0.2, 50), rng.uniform(-0.2, 0.2, 50)
    jacobian = np.moveaxis(np.array([[1 - kappa - gamma1, -gamma2], [-gamma2, 1 - kappa + gamma1]]), -1, 0)
    mu, thin = magnification(kappa, gamma1, gamma2)
    assert thin.all()
    np.testing.assert_allclose(mu, 1 / np.linalg.det(jacobian))
    np.testing.assert_allclose(stretch(kappa, gamma1, gamma2), 1 / np.linalg.eigvalsh(jacobian)[:, 0])


def test_each_component_of_a_constant_field_is_its_own():
    position = (PIX, np.zeros(2), np.zeros(2), np.array([0.0, 1.0]))
    columns = lens(*position, Lensing(field="constant", kappa=0.1, gamma1=0.02, gamma2=-0.01))
    assert list(columns) == ["kappa", "gamma1", "gamma2"]
    np.testing.assert_array_equal(list(columns.values()), np.float32([[0.1] * 2, [0.02] * 2, [-0.01] * 2]))


def test_a_cosmic_field_is_asked_at_the_objects():
    class Field:
        def lens(self, pix, ra, dec, z):
            return Lensed(pix + ra, pix + dec, pix + z)

    columns = lens(3, np.array([1.0]), np.array([20.0]), np.array([300.0]), Lensing(field="cosmic"), Field())
    assert {name: values[0] for name, values in columns.items()} == {"kappa": 4.0, "gamma1": 23.0, "gamma2": 303.0}
