"""What the embedded universe holds, against the anchors it is meant to follow."""

import os
from pathlib import Path

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from embedded_sky import shipped

from csstsim.catalog.photometry import rate_to_mag, subband_fluxes
from csstsim.config import SHIPPED
from csstsim.instrument.filter import GRID
from csstsim.rng import stream
from csstsim.units import ab_photon_density
from csstsim.universe.igm import Intergalactic
from csstsim.universe.stars import cumulative_counts as star_counts
from csstsim.universe.stars import draw_stars, sin_latitude

DATA = Path(os.environ.get("CSSTSIM_DATA", SHIPPED.parents[1] / "shared" / "data"))


def _draw(draw, *args):
    return draw(lambda name: stream(3, "test", draw.__name__, name), *args)


@pytest.mark.parametrize(("b", "factor"), [(90, 1), (-90, 1), (30, 3), (-15, 10), (2, 10)])
def test_star_counts_follow_the_anchors(b, factor):
    numbers, sin_b = shipped()[0].stars, np.sin(np.radians(b))
    mag, total = star_counts(numbers, sin_b)
    for v, anchor in ((18, 900), (20, 2000), (22, 4000), (24, 8000), (26, 15000)):
        assert np.interp(v, mag, total) == pytest.approx(factor * (anchor - 25), rel=1e-4)  # 25: brighter than V = 12
    drawn = _draw(draw_stars, 1.0, sin_b, numbers)
    expected = factor * (15000 - 25)
    assert abs((drawn["v"] < 26).sum() - expected) < 5 * np.sqrt(expected)


def test_galactic_latitude_against_astropy():
    rng = np.random.default_rng(1)
    ra, dec = rng.uniform(0, 360, 100), np.degrees(np.arcsin(rng.uniform(-1, 1, 100)))
    b = SkyCoord(ra, dec, unit="deg").galactic.b.deg
    np.testing.assert_allclose(np.degrees(np.arcsin(sin_latitude(ra, dec))), b, atol=1e-4)


def test_drawn_star_magnitude_is_that_of_its_spectrum():
    seds = shipped()[0].star_seds
    teff, feh = np.array([2700.0, 3400.0, 4803.0, 5810.0, 9000.0]), np.array([0.0, -0.4, 0.2, -1.5, -2.5])
    box = (GRID >= 5000) & (GRID <= 5900)
    direct = -2.5 * np.log10(seds.shape(teff, feh)[:, box].sum(axis=1) / ab_photon_density(GRID[box]).sum())
    np.testing.assert_allclose(seds.unit_v_mag(teff, feh), direct, atol=1e-3)


def test_star_colours_against_model_atmospheres():
    path = DATA / "ck04/ck04_packed_1500_12000A.fits"
    if not path.exists():
        pytest.skip("Castelli & Kurucz spectra are not on this machine (CSSTSIM_DATA)")
    from astropy.io import fits

    universe, camera = shipped()
    with fits.open(path) as file:
        wave, rows = np.float64(file[1].data), file[2].data
    for teff, feh, limit in ((5000, 0.0, 0.06), (5750, 0.0, 0.06), (6500, -1.0, 0.10), (9500, 0.0, 0.06)):
        row = rows[(rows["teff"] == teff) & (rows["logg"] == 4.5) & (rows["feh"] == feh)][0]
        model = np.interp(GRID, wave, np.float64(row["flux"])) * GRID
        ours = universe.star_seds.shape([teff], [feh])[0]
        for blue, red in (("u", "g"), ("g", "r"), ("r", "i"), ("i", "z")):
            colour = [_mag(sed, camera, blue) - _mag(sed, camera, red) for sed in (ours, model)]
            assert abs(colour[0] - colour[1]) < limit, (teff, feh, blue, red)


def _mag(sed, camera, band):
    rate = subband_fluxes(sed[None], camera.filters[band], camera.telescope).sum()
    return rate_to_mag(rate, camera.filters[band], camera.telescope)


def test_lyman_forest_at_redshift_3():
    numbers = shipped()[0].galaxies["igm"]
    wave = np.array([2400.0, 4.0 * 1100.0, 4.0 * 1210.0, 4.0 * 1220.0])
    through = Intergalactic(wave, numbers).absorb(np.ones(4), 3.0)
    assert through[3] == 1.0  # redward of Lyman alpha: clear
    x = 2400 / 912.0  # below the Lyman limit: forest of three lines and continuum (Moller & Jakobsen 1990)
    forest = sum(0.0036 * a * (2400 / line) ** 3.46 for line, a in ((1215.67, 1), (1025.72, 0.47), (972.54, 0.34)))
    assert through[0] == pytest.approx(np.exp(-forest - 0.25 * x**3 * (4**0.46 - x**0.46)))
    assert through[2] == pytest.approx(np.exp(-0.0036 * (4 * 1210 / 1215.67) ** 3.46))
