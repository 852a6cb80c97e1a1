"""Walks of quasars: what they owe to the rest frame and to the mass of the black hole."""

import numpy as np
import pytest

from csstsim.base.shipped import SHIPPED
from csstsim.universe.changing.numbers import numbers_of
from csstsim.universe.changing.variable_quasars import quasar_changes, walk_parameters

NUMBERS = numbers_of(SHIPPED / "universe", "variable_quasars")


@pytest.mark.parametrize("z", [0.3, 1.0, 4.0])
def test_a_walk_is_that_of_the_light_as_it_was_emitted(z):
    """At a wavelength stretched by 1 + z, rms and damping time are those of the same quasar nearby."""
    near = walk_parameters(0.0, -25.0, 0.3, 2500.0, NUMBERS)
    assert walk_parameters(z, -25.0, 0.3, 2500.0 * (1 + z), NUMBERS) == pytest.approx(near, rel=1e-12)


def test_exponents_are_those_of_macleod_2010():
    """Table 1: wavelength -0.479 and 0.17; luminosity 0.131 and 0.03; mass 0.18 and 0.21, by differences of logs.

    The mean mass falls by 0.27 dex with a magnitude, and its width, 0.58 + 0.011 M_i, is one normal deviate.
    """
    base = np.log10(walk_parameters(0.0, -25.0, 0.0, 4000.0, NUMBERS))
    red = np.log10(walk_parameters(0.0, -25.0, 0.0, 40_000.0, NUMBERS))
    assert red - base == pytest.approx([-0.479, 0.17])
    width = 0.58 + 0.011 * (-25.0 - 1.486)
    heavy = np.log10(walk_parameters(0.0, -25.0, 1.0, 4000.0, NUMBERS))
    assert heavy - base == pytest.approx([0.18 * width, 0.21 * width])
    faint = np.log10(walk_parameters(0.0, -24.0, 0.0, 4000.0, NUMBERS))
    assert faint - base == pytest.approx([0.131 - 0.27 * 0.18, 0.03 - 0.27 * 0.21])


def test_a_later_night_does_not_change_the_nights_before():
    """The walk to the last of several times is that to each of them alone, in whatever order they are asked for."""
    table = {"id": np.array([7, 3]), "z": np.array([0.4, 2.2]), "coeff0": np.array([-23.5, -26.0])}
    times = NUMBERS["start"] + np.array([900.3, 3.7, 4000.0])
    together = quasar_changes(2, table, times, 6200.0, NUMBERS)
    for k, time in enumerate(times):
        alone = quasar_changes(2, table, [time], 6200.0, NUMBERS)
        np.testing.assert_allclose(alone[:, 0], together[:, k], atol=1e-12)
