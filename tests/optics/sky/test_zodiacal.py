"""Zodiacal light: the table, its symmetry, its colour, and other programs' numbers."""

import numpy as np
import pytest
from support.sky_geometry import numbers

from csstsim.base.errors import InputError
from csstsim.optics.sky.background_spectra import photons
from csstsim.optics.sky.zodiacal import elongation, intensity, mixture, spectrum

TABLE = numbers().zodiacal
LON, LAT = np.meshgrid(TABLE.longitude, TABLE.latitude, indexing="ij")
KNOWN = np.isfinite(TABLE.intensity)


def test_nodes():
    ok = KNOWN & (elongation(LON, LAT) >= 15)
    values = intensity(LON[ok], LAT[ok], numbers())
    assert np.allclose(values, TABLE.intensity[ok], rtol=1e-12)


@pytest.mark.parametrize("signs", [(1, -1), (-1, 1), (-1, -1)])
def test_symmetry_about_the_sun_and_the_ecliptic(signs):
    lon, lat = np.array([20.0, 77.0, 141.0, 180.0]), np.array([12.0, 0.0, 33.3, 90.0])
    assert np.array_equal(intensity(lon, lat, numbers()), intensity(signs[0] * lon, signs[1] * lat, numbers()))


def test_between_nodes_neither_more_nor_less_than_the_cell():
    """Monotone cubics do not overshoot: 2000 positions, within the corners of their cell."""
    rng = np.random.default_rng(5)
    lon, lat = rng.uniform(15, 180, 2000), rng.uniform(0, 90, 2000)
    value = intensity(lon, lat, numbers())
    i = np.searchsorted(TABLE.longitude, lon, side="right") - 1
    j = np.searchsorted(TABLE.latitude, lat, side="right") - 1
    corners = np.array([TABLE.intensity[np.minimum(i + a, 18), j + b] for a in (0, 1) for b in (0, 1)])
    assert (value <= corners.max(axis=0) * (1 + 1e-9)).all() and (value >= corners.min(axis=0) * (1 - 1e-9)).all()


def test_smooth_where_cells_are_missing():
    """Along a circle 16 deg from the Sun, through cells with filled corners, no step: below 4% a degree."""
    turn = np.radians(np.arange(0.0, 90.1, 0.5))
    lat = np.degrees(np.arcsin(np.sin(np.radians(16.0)) * np.sin(turn)))
    lon = np.degrees(np.arctan2(np.sin(np.radians(16.0)) * np.cos(turn), np.cos(np.radians(16.0))))
    value = intensity(lon, lat, numbers())
    assert np.isfinite(value).all() and (np.abs(np.diff(np.log(value))) < 0.02).all()
    assert (np.diff(value) < 1e-9).all()  # falling from the ecliptic to the pole's side


def test_pole_and_antisun():
    assert intensity(np.array([0.0, 15.0, 90.0, 180.0]), 90.0, numbers()) == pytest.approx([77.0] * 4)
    assert intensity(180.0, 0.0, numbers()) == pytest.approx(230.0)


@pytest.mark.parametrize("position", [(0.0, 0.0), (14.9, 0.0), (10.0, 10.0), (0.0, 14.99)])
def test_too_close_to_the_sun_is_refused(position):
    with pytest.raises(InputError, match="too close to the Sun"):
        intensity(*position, numbers())


def flam(wave, lon, lat):
    """erg / s / cm2 / A / arcsec2, mean of 500 A around `wave`."""
    grid = np.asarray(wave)[:, None] + np.linspace(-250, 250, 101)
    fractions = mixture(elongation(lon, lat), numbers())
    photon = np.einsum("k,kij->ij", fractions, spectrum(grid, numbers())) * intensity(lon, lat, numbers())
    return (photon / photons(1.0, grid)).mean(axis=1) * 0.1  # W m-2 um-1 = 0.1 erg s-1 cm-2 A-1


def test_published_level_at_the_pole():
    """1.81e-18 erg/s/cm2/A/arcsec2 at 5000 A (facts of Leinert's unit: 2.350e-12 per W m-2 sr-1 um-1), to 1%."""
    assert flam([5000.0], 90.0, 90.0)[0] == pytest.approx(1.81e-18, rel=0.01)


def test_spectrum_against_leinerts_table_19():
    """At (90, 0), W m-2 sr-1 um-1: solar lines and two sources of colour leave 12%."""
    wave, known = [4000.0, 5000.0, 7000.0, 9000.0, 10000.0], np.array([2.2e-6, 2.6e-6, 2.0e-6, 1.3e-6, 1.2e-6])
    assert flam(wave, 90.0, 0.0) == pytest.approx(known * 2.350e-12, rel=0.12)


def test_against_zodi():
    """AB mag / arcsec2 by the PyPI package zodi 1.0.0 (its Table 17 bilinear, its colour Table 19's): 0.12 mag."""
    wave = np.array([5000.0, 6200.0, 9000.0])
    published = {
        (90, 30): [22.868, 22.583, 22.344],
        (90, 60): [23.333, 23.048, 22.809],
        (180, 5): [22.353, 22.068, 21.830],
    }
    for (lon, lat), theirs in published.items():
        ours = -2.5 * np.log10(flam(wave, lon, lat) * wave**2 / 2.99792458e18) - 48.6
        assert np.abs(ours - theirs).max() < 0.12


def test_colour_reddens_towards_the_sun():
    fractions = mixture(np.array([15.0, 30.0, 60.0, 90.0, 180.0]), numbers())
    assert fractions[0] == pytest.approx([1, 1, 0.5, 0, 0]) and fractions.sum(axis=0) == pytest.approx(np.ones(5))
    near, far = spectrum(np.array([3500.0, 5000.0, 9000.0]), numbers())
    assert near[0] < far[0] and near[1] == far[1] and near[2] > far[2]
    assert near[0] / far[0] == pytest.approx((1 + 1.2 * np.log10(0.7)) / (1 + 0.9 * np.log10(0.7)))
