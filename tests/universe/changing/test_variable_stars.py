"""Variable stars of several classes at once: each with the form, the period and the colour of its own."""

import numpy as np
import pytest

from csstsim.catalog.table import ObjectTable
from csstsim.universe.changing.variable_stars import REFERENCE, star_changes

CLASSES = {
    "names": ["cool", "warm", "hot"], "teff": [[0, 4000], [4000, 6000], [6000, 9000]], "logg": [[-9, 9]] * 3,
    "share": [1.0, 1.0, 1.0], "period": [[2.0, 2.0], [3.0, 3.0], [5.0, 5.0]],
    "amplitude": [[0.1, 0.0], [0.2, 0.0], [0.4, 0.0]], "slope": [-1.5, -0.5, 0.7], "form": ["sine", "saw", "eclipse"],
}  # fmt: skip
TABLE = ObjectTable({"id": np.arange(6) + 5, "teff": [7e3, 3e3, 5e3, 3e3, 5e3, 7e3], "logg": np.full(6, 4.0)})
KIND = np.array([2, 0, 1, 0, 1, 2])


@pytest.mark.parametrize("wavelength", [2900.0, REFERENCE, 9500.0])
def test_each_class_has_an_amplitude_by_wavelength_of_its_own(wavelength):
    """(wavelength / 5500 A)^slope, rows of three classes mixed; a sine's and a saw's range is twice the amplitude."""
    times = np.linspace(0.0, 5.0, 4001)
    mags = star_changes(1, TABLE, times, wavelength, {"classes": CLASSES})
    factor = (wavelength / 5500.0) ** np.array([-1.5, -0.5, 0.7])
    assert np.ptp(mags, axis=1) == pytest.approx((2 * np.array([0.1, 0.2, 0.4]) * factor)[KIND], rel=2e-3)


def test_each_class_has_the_period_and_the_form_of_its_own():
    """Repeated after its period and not before; an eclipse never brightens, and lasts a tenth of the period."""
    times = np.linspace(0.0, 30.0, 6001)[:-1]
    mags = star_changes(1, TABLE, times, REFERENCE, {"classes": CLASSES})
    for row, period in zip(mags, np.array([2, 3, 5])[KIND], strict=True):
        for days in (2, 3, 5):
            same = np.abs(np.roll(row, 200 * days) - row).max() < 1e-6
            assert same == (days == period)
    eclipsed = mags[KIND == 2]
    assert eclipsed.min() == 0.0 and (eclipsed > 0).mean() == pytest.approx(0.1, abs=0.005)
    assert mags[KIND != 2].mean(axis=1) == pytest.approx(0.0, abs=2e-3)
