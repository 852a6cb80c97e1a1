"""Panels of all bands in a brick's figure: every point and error bar against numbers by hand."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import beta

from csstsim.catalog.table import ObjectTable
from csstsim.report import exposure_panels


def axes_of():
    return Figure().add_subplot()


def bars(axes):
    """[(x, y, error downward, error upward, colour, label)] of the error bars in axes."""
    found = []
    for bar in axes.containers:
        data, _, (lines,) = bar.lines
        x, y = (np.array(values, float) for values in data.get_data())
        ends = np.array(lines.get_segments())[:, :, 1]
        found.append((x, y, y - ends[:, 0], ends[:, 1] - y, data.get_color(), bar.get_label()))
    return found


def joined(*tables):
    return ObjectTable({name: np.concatenate([table[name] for table in tables]) for name in tables[0]})


def test_completeness_and_purity_by_density_have_their_beta_errors():
    part = {"edges": [0, 10, 40], "objects": [20, 2, 9], "found": [15, 2, 9], "sources": [3, 2, 0], "real": [2, 1, 0]}
    axes = axes_of()
    assert exposure_panels.density(axes, {"density": part}, {})
    (x, y, down, up, _, complete), (x2, y2, _, up2, _, pure) = bars(axes)
    np.testing.assert_allclose(x, [5.0, 50.0])
    np.testing.assert_allclose(y, [0.75, 1.0])
    np.testing.assert_allclose([down, up], [[beta.std(16, 6), beta.std(10, 1)]] * 2)
    np.testing.assert_allclose((*x2, *y2, *up2), (5.0, 2 / 3, beta.std(3, 2)))
    assert complete.startswith("completeness") and pure.startswith("purity")
    none = {name: [0, 0, 0] for name in ("objects", "found", "sources", "real")}
    assert not exposure_panels.density(axes_of(), {"density": {"edges": [0, 10, 40]} | none}, {})


@pytest.mark.parametrize("n", [2, 3])
def test_the_locus_has_true_and_measured_colours_over_that_of_sdss(n):
    """Covey et al.: g - r 0.44 with r - i 0.16, and M dwarfs whose g - r hardly grows."""
    true, seen = np.arange(2.0 * n).reshape(2, n), np.arange(2.0 * n).reshape(2, n) - 0.3
    axes = axes_of()
    drawn = exposure_panels.locus(axes, None, {"locus": {"bands": ("g", "r", "i"), "input": true, "output": seen}})
    assert drawn is (n >= 3)
    lines = {line.get_label(): np.array(line.get_data()) for line in axes.lines}
    np.testing.assert_allclose(lines["true"], true)
    np.testing.assert_allclose(lines["measured"], seen)
    g_r, r_i = lines["SDSS locus (Covey et al. 2007)"]
    assert (0.44, 0.16) in zip(g_r, r_i, strict=True) and (1.41, 0.79) in zip(g_r, r_i, strict=True)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("g - r [AB mag]", "r - i [AB mag]")
    none = {"bands": (), "input": np.zeros((2, 0)), "output": np.zeros((2, 0))}
    assert exposure_panels.locus(axes_of(), None, {"locus": none}) is False


def test_residuals_by_rows_are_medians_of_sound_stars_in_eighths():
    """The largest number of rows ends the last bin; stars of other S/N, galaxies and saturated ones are no part."""
    n = 40
    good = {
        "sound": np.ones(n), "galaxy": np.zeros(n), "snr": np.full(n, 100.0), "transfers": np.full(n, 100.0),
        "deferred_mas": np.where(np.arange(n) < 25, 1.0, 4.0), "light": np.where(np.arange(n) < 25, 0.98, 0.90),
    }  # fmt: skip
    far = {name: values[:5] for name, values in good.items()} | {
        "transfers": np.full(5, 800.0), "deferred_mas": np.array([3.0, -2.0, 3.0, 3.0, 9.0]), "light": np.full(5, 1.01),
    }  # fmt: skip
    lone = {name: values[:2] for name, values in good.items()} | {"transfers": np.full(2, 450.0)}
    others = []
    for changed in ({"sound": 0.0}, {"galaxy": 1.0}, {"snr": 19.0}, {"snr": 501.0}):
        (name, value), *_ = changed.items()
        others.append(
            good
            | {name: np.full(n, value), "deferred_mas": np.full(n, -50.0), "transfers": np.full(n, 130.0)}
            | {"light": np.full(n, 0.5)}
        )
    axes = axes_of()
    assert exposure_panels.rows(axes, None, {"trials": {"g": joined(good, lone, *others), "r": ObjectTable(far)}})
    (x, y, down, up, _, place), (x2, y2, down2, *_, flux) = bars(axes)
    np.testing.assert_allclose(x, [150.0, 750.0])  # eighths of 800 rows: 100 begins the second
    np.testing.assert_allclose(y, [1.0, 3.0])
    spread = 3 * np.sqrt(25 * 15) / 40  # of two values 3 apart
    error = np.array([spread / np.sqrt(40), np.std([3.0, -2.0, 3.0, 3.0, 9.0]) / np.sqrt(5)]) * np.sqrt(np.pi / 2)
    np.testing.assert_allclose([down, up], [error, error], rtol=1e-3)
    np.testing.assert_allclose(y2, [-2.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(down2, [8 / 3 * error[0], 0.0], rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(x2, x)
    assert "[mas]" in place and "[%]" in flux
    assert not exposure_panels.rows(axes_of(), None, {"trials": {}})
