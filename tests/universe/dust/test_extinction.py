"""The extinction law against published values and another code; limits of the dust in front of a star."""

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.instrument.filter import GRID
from csstsim.universe.dust.extinction import LAWS, fitzpatrick, odonnell, star_ebv


@pytest.mark.parametrize(("law", "name"), [(odonnell, "O94"), (fitzpatrick, "F99")])
def test_laws_agree_with_another_code(law, name):
    peer = pytest.importorskip("dust_extinction.parameter_averages")
    units = pytest.importorskip("astropy.units")
    wave = np.concatenate([GRID, np.geomspace(1001, 33_000, 997)])
    for r_v in (2.5, 3.1, 5.5):
        np.testing.assert_allclose(law(wave, r_v), getattr(peer, name)(r_v)(wave * units.AA), rtol=1e-12)


# R, I, J, H, K of Cardelli et al. (1989), table 3, R_V = 3.1; O'Donnell's R differs from theirs by 0.004.
@pytest.mark.parametrize(("x", "printed"), [(1.43, 0.751), (1.11, 0.479), (0.80, 0.282), (0.63, 0.190), (0.46, 0.114)])
def test_law_gives_the_published_values(x, printed):
    assert odonnell(1e4 / x) == pytest.approx(printed, abs=0.005)


def test_law_gives_the_values_of_other_codes():
    """Kept for where no peer is installed: dust_extinction 1.7 and extinction 0.4.9 at R_V = 3.1."""
    found = odonnell([2000.0, 2560.0, 3000.0, 5500.0, 9900.0])
    np.testing.assert_allclose(found, [2.8425, 2.2116, 1.8182, 0.9987, 0.4106], atol=6e-5)


# Fitzpatrick (1999), table 3: A / E(B-V) at R_V = 3.1
@pytest.mark.parametrize(
    ("wavelength", "printed"),
    [(26500, 0.265), (12200, 0.829), (6000, 2.688), (5470, 3.055), (4670, 3.806), (4110, 4.315)],
)
def test_fitzpatrick_goes_through_the_published_points(wavelength, printed):
    assert 3.1 * fitzpatrick(float(wavelength)) == pytest.approx(printed, abs=2e-3)


def test_fitzpatrick_gives_the_values_of_another_code():
    """Kept for where no peer is installed: dust_extinction 1.7 at R_V = 3.1."""
    found = fitzpatrick([1200.0, 2000.0, 2560.0, 3000.0, 5500.0, 9900.0])
    np.testing.assert_allclose(found, [3.4134, 2.7623, 2.1794, 1.7967, 0.9779, 0.3834], atol=6e-5)


def test_definition_of_v_and_of_the_colour_excess():
    assert odonnell(1e4 / 1.82) == pytest.approx(1.0, abs=1e-12)  # A(V) is at 5494.5 A
    slope = [(odonnell(1e4 / 2.27, r_v) - 1) * r_v for r_v in (2.5, 3.1, 5.5)]  # (A_B - A_V) / E(B-V)
    np.testing.assert_allclose(slope, 1.0, atol=0.02)


def test_larger_grains_redden_less_in_the_ultraviolet():
    assert (np.diff([odonnell(2500.0, r_v) for r_v in (2.0, 3.1, 4.0, 6.0)]) < 0).all()


@pytest.mark.parametrize("wave", [0.0, -5000.0, 999.0, 34_000.0, np.nan, np.inf])
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_wavelengths_outside_the_law_are_refused(law, wave):
    with pytest.raises(InputError, match=r"1000\.\.33333"):
        law(np.array([5000.0, wave]))


def test_dust_before_a_star():
    # Half of the column lies below the height h ln 2.
    height = 125 * np.log(2)
    half = star_ebv(0.4, height / np.sin(np.radians(30)), np.array([30.0, -30.0]), 125, 4000)
    np.testing.assert_allclose(half, 0.2, rtol=1e-12)
    assert star_ebv(0.4, 0.0, 30.0, 125, 4000) == 0
    assert star_ebv(0.4, np.inf, 30.0, 125, 4000) == 0.4
    assert star_ebv(0.4, -7.0, 30.0, 125, 4000) == 0
    assert np.isnan(star_ebv(0.4, np.nan, 30.0, 125, 4000))
    assert star_ebv(0.0, 500.0, 30.0, 125, 4000) == 0


def test_dust_before_a_star_in_the_plane():
    """At b = 0 the bare formula has no dust at any distance; here it grows with distance to the whole column."""
    distance = np.array([0.0, 1.0, 4000.0, 1e5, np.inf])
    in_plane = star_ebv(2.0, distance, 0.0, 125, 4000)
    np.testing.assert_allclose(in_plane, [0, 2 / 4000, 2 * (1 - np.exp(-1)), 2, 2], rtol=2e-4)
    np.testing.assert_allclose(star_ebv(2.0, distance, 1e-9, 125, 4000), in_plane, rtol=1e-12)
    edge = np.degrees(np.arcsin(125 / 4000))  # the two regimes meet
    np.testing.assert_allclose(
        star_ebv(2.0, 800.0, edge * (1 + 1e-9), 125, 4000),
        star_ebv(2.0, 800.0, edge * (1 - 1e-9), 125, 4000),
        rtol=1e-8,
    )
