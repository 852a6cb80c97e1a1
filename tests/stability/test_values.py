"""Extreme values: NaN and infinity in every column, no light and far too much, lensing up to the caustic."""

import numpy as np
import pytest
from exposure import FIDELITIES, WINDOW, X, Y, inside, stamp_bounds
from support.csst import BANDS

from csstsim.catalog.flags import BAD_VALUE, STRONG_LENSING
from csstsim.catalog.table import GALAXY, QUASAR, STAR, columns_with

pytestmark = pytest.mark.thorough

FLOATS = [name for name, (dtype, _, _) in columns_with(BANDS).items() if np.dtype(dtype).kind == "f"]
SHAPE, LENSING = ("size_disk", "size_bulge", "bulge_frac", "e1", "e2"), ("kappa", "gamma1", "gamma2")
GOOD = {"size_disk": 0.3, "size_bulge": 0.2, "bulge_frac": 0.5, "e1": 0.1, "kappa": 0.05}
KINDS = np.array([GALAXY, STAR, QUASAR], np.int8)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_bad_numbers_in_any_column(expose, fidelity, value):
    """A galaxy, a star and a quasar for each column: flagged and dark if it is used, else drawn as if it were good."""
    n = 3 * len(FLOATS)
    kinds, names = np.tile(KINDS, len(FLOATS)), np.repeat(FLOATS, 3)
    used = np.isin(names, ("ra", "dec")) | (np.isin(names, SHAPE) & (kinds == GALAXY))
    used |= np.isin(names, LENSING) & (kinds != STAR)
    columns = {name: np.full(n, good) for name, good in GOOD.items()} | {"obj_type": kinds}
    got = expose(np.full(n, X), Y, fidelity, spoilt=[*zip(names, range(n), [value] * n, strict=True)], **columns)
    table = got.table
    assert len(table) == n and np.array_equal(table["flags"] & BAD_VALUE > 0, used)
    assert np.array_equal(table["method"] == "none", used) and np.array_equal(table["drawn"] == 0, used)
    for kind in KINDS:
        alike = ~used & (kinds == kind)
        wanted, noise = table["drawn"][alike].mean(), 0.0 if fidelity == "noise_free" else 6.0
        assert np.abs(table["drawn"][alike] - wanted).max() <= noise * np.sqrt(wanted) + 1e-6 * wanted


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_component_without_light_needs_no_size(expose, fidelity, share):
    """Neither NaN nor anything else in the size of the part that is not there changes a bit."""
    unused = "size_bulge" if share == 0 else "size_disk"
    columns = {"obj_type": KINDS[:1], "bulge_frac": [share]} | {name: [0.3] for name in ("size_disk", "size_bulge")}
    one, *others = (
        expose(X, Y, fidelity, **columns | {unused: [size]}) for size in (0.3, np.nan, np.inf, -1.0, 0.0, 1e30)
    )
    assert all(np.array_equal(one.light, other.light) for other in others)


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1.0])
def test_bad_light_is_flagged(expose, fidelity, value):
    table = expose([X, X], Y, fidelity, electrons=[value, 1e4]).table
    assert list(table["flags"]) == [BAD_VALUE, 0] and list(table["method"] == "none") == [True, False]


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("electrons", [0.0, 1e-30, 1e-3, 1e10])
@pytest.mark.parametrize("kind", [STAR, GALAXY])
def test_no_light_and_far_too_much(expose, psf_r, fidelity, electrons, kind):
    got = expose(X, Y, fidelity, electrons=electrons, obj_type=[kind], size_disk=[0.3])
    table = got.table
    if electrons == 0:
        assert table["method"][0] == "none" and not got.light.any()
    elif table["method"][0] == "photons":
        assert electrons < 1 and table["drawn"][0] <= 1
    elif table["method"][0] == "stamp":
        assert table["fraction"][0] == pytest.approx(psf_r.at(X, Y).sum() / 4, rel=1e-3)
    else:
        assert fidelity == "preview" and table["fraction"][0] == pytest.approx(psf_r.at(X, Y).sum() / 4, rel=1e-3)


LENSED = [(0, 0.99, 0), (0, 0, -0.99), (0.9, 0, 0.099), (0.99, 0, 0), (0.99999, 0, 0), (-5, 0.1, 0)]
REFUSED = [(1.0, 0.0, 0.0), (1.0, 0.1, 0.0), (0.0, 1.0, 0.0), (0.0, 0.8, 0.8), (0.5, 0.0, -0.6), (2.0, 0.0, 0.0)]


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("field", LENSED)
@pytest.mark.parametrize("size", [0.3, 3.0])
def test_thin_shear_is_drawn_to_its_limit(expose, psf_r, fidelity, field, size):
    """Light is the unlensed galaxy's times mu, on the window or the stamp: to 1%, or 5 sigma of the electrons."""
    lensing = {name: [value] for name, value in zip(LENSING, field, strict=True)}
    got = expose(X, Y, fidelity, electrons=100.0, obj_type=KINDS[:1], size_disk=[size], **lensing)
    kappa, gamma1, gamma2 = np.float32(field).astype(float)  # as the catalogue keeps them
    table = got.table
    assert table["electrons"][0] == pytest.approx(100 / ((1 - kappa) ** 2 - gamma1**2 - gamma2**2), rel=1e-6)
    bounds = stamp_bounds(X, Y, table["reach"][0] if table["method"][0] == "stamp" else 10**6, WINDOW)
    wanted = table["electrons"][0] * inside(got.scene, 0, bounds) * psf_r.at(X, Y).sum() / 4
    noise = 5 * np.sqrt(wanted) if got.counted is not None else 0.0
    if table["method"][0] != "unresolved":
        assert table["drawn"][0] == pytest.approx(wanted, rel=1e-2, abs=noise)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_strong_lensing_is_refused(expose, fidelity):
    columns = {name: np.repeat(values, 3) for name, values in zip(LENSING, np.transpose(REFUSED), strict=True)}
    kinds = np.tile(KINDS, len(REFUSED))
    table = expose(
        np.full(len(kinds), X), Y, fidelity, obj_type=kinds, size_disk=np.full(len(kinds), 0.3), **columns
    ).table
    assert np.array_equal(table["flags"] & STRONG_LENSING > 0, kinds != STAR)
    assert np.array_equal(table["method"] == "none", kinds != STAR)
