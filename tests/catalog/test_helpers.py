"""Every number on docs/catalogue_helpers.md is that of another code: synphot, dust_extinction, healpy, astropy, ERFA.

`make tutorials` sees that csstsim gives the page's numbers; here they are computed without csstsim's formulae.
"""

import doctest
import re

import erfa
import healpy
import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.cosmology import FlatLambdaCDM
from astropy.time import Time
from synphot import Empirical1D, Observation, SourceSpectrum, SpectralElement
from synphot.units import PHOTLAM

from csstsim.base.shipped import ROOT
from csstsim.catalog.astrometry.ephemeris import observer
from csstsim.catalog.astrometry.reduction import moved
from csstsim.instrument.filter import GRID
from csstsim.universe.lensing.cosmology import Cosmology
from csstsim.universe.parameters import load_universe

PAGE = ROOT / "docs" / "catalogue_helpers.md"
RA, DEC = 150.1, 2.2


@pytest.fixture(scope="module")
def page():
    """{a word of the code: the numbers it prints} of the page's examples that print."""
    examples = doctest.DocTestParser().get_examples(PAGE.read_text())
    return {one.source: [float(n) for n in re.findall(r"-?\d+\.\d*", one.want)] for one in examples if one.want}


@pytest.fixture
def printed(page):
    """Return a function: the numbers of the only example with these words."""

    def of(*words):
        [numbers] = [numbers for source, numbers in page.items() if all(word in source for word in words)]
        return numbers

    return of


@pytest.fixture(scope="module")
def synthetic(camera):
    """Return a function: synphot's Observation of photons / s / m2 / A on GRID in a band."""

    def of(sed, band):
        source = SourceSpectrum(Empirical1D, points=GRID * u.AA, lookup_table=sed * 1e-4 * PHOTLAM)
        response = SpectralElement(Empirical1D, points=GRID * u.AA, lookup_table=camera.filters[band].at(GRID))
        return Observation(source, response, binset=GRID * u.AA)

    return of


SED = 2.0 * (GRID / 6000.0) ** -1.2


def magnitude(observation):
    return observation.effstim(u.ABmag).value


def test_magnitudes(printed, synthetic, camera):
    """To 1 mmag: half a unit of the last digit, and synphot's integral."""
    r, g = magnitude(synthetic(SED, "r")), magnitude(synthetic(SED, "g"))
    assert printed('print(f"{ab_mag(sed, GRID, r') == pytest.approx([r], abs=1e-3)
    assert printed("g.at(GRID)) - ab_mag(sed, GRID, r") == pytest.approx([g - r], abs=1e-3)
    *rates, mag = printed("rate_to_mag")
    area = np.pi * (camera.telescope.diameter_m / 2) ** 2
    counts = synthetic(SED, "r").countrate(area * 1e4 * u.cm**2).value
    assert sum(rates) == pytest.approx(counts, rel=2e-4) and len(rates) == 4 and mag == pytest.approx(r, abs=1e-3)
    assert printed("ab_photon_density(GRID, 21.5)") == [21.5] and printed("scaled, GRID") == [20.0]
    flat = 3631e-26 * 10 ** (-0.4 * 21.5) / (6.62607015e-34 * GRID)
    assert magnitude(synthetic(flat, "g")) == pytest.approx(21.5, abs=1e-3)


def test_dust(printed, synthetic):
    averages = pytest.importorskip("dust_extinction.parameter_averages")
    law = averages.O94(Rv=3.1)
    assert printed("odonnell(np.array") == pytest.approx(law(np.array([2800.0, 5500.0, 9000.0]) * u.AA), abs=6e-4)
    place = SkyCoord(RA * u.deg, DEC * u.deg).galactic
    path = load_universe().dust.path
    ebv = 0.86 * healpy.get_interp_val(healpy.read_map(path), RA, DEC, lonlat=True)  # Schlafly & Finkbeiner 2011
    assert printed("dust.ebv(") == pytest.approx([ebv], abs=6e-5)
    # of the column to infinity through an exponential layer of 125 pc; the page's star is at 800 pc
    before = ebv * (1 - np.exp(-800 * np.sin(np.radians(place.b.deg)) / 125))
    assert printed('print(f"{ebv:.4f}")') == pytest.approx([before], abs=6e-5)
    reddened = SED * 10 ** (-0.4 * 3.1 * before * law(GRID * u.AA))
    dimmer = magnitude(synthetic(reddened, "r")) - magnitude(synthetic(SED, "r"))
    assert printed("ab_mag(reddened") == pytest.approx([dimmer], abs=2e-4)


def test_distances(printed):
    peer = FlatLambdaCDM(H0=67.66, Om0=0.3111, Tcmb0=0)
    distances = [peer.comoving_distance(1.0).value, peer.luminosity_distance(1.0).value]
    assert printed("luminosity_distance") == pytest.approx(distances, abs=0.06)
    angular, modulus = printed("distance_modulus")
    assert angular == pytest.approx(peer.angular_diameter_distance(1.0).value, abs=0.06)
    assert modulus == pytest.approx(peer.distmod(1.0).value, abs=6e-4)
    assert printed("4e-3 /") == pytest.approx([(4 * u.kpc * peer.arcsec_per_kpc_proper(1.0)).value], abs=6e-4)
    star = SkyCoord(RA * u.deg, DEC * u.deg, distance=u.Quantity(2.5, u.mas).to(u.pc, u.parallax()))
    assert printed("print(distance") == pytest.approx([star.distance.pc, star.distance.distmod.value], abs=6e-4)


@pytest.mark.parametrize("z", [0.0, 1e-6, 0.5, 1100.0])
def test_angular_diameter_distance(z):
    numbers, peer = {"omega_m": 0.3111, "omega_lambda": 0.6889, "h0": 67.66}, FlatLambdaCDM(67.66, 0.3111, Tcmb0=0)
    ours = Cosmology(numbers).angular_diameter_distance(z)
    assert ours == pytest.approx(peer.angular_diameter_distance(z).value, rel=1e-8, abs=1e-12)
    assert np.isnan(Cosmology(numbers).angular_diameter_distance(np.array([-0.5, np.nan]))).all()


def test_places(printed):
    """By ERFA's own pmpx and atciqz, to half a unit of the last digit: 0.2 mas and 2 mas."""
    craft = observer(61635.0, (6778.0, 0.0, 0.0), (0.0, 5.7, 5.1)).astrom
    mas = np.radians(1 / 3.6e6)
    rates = 250.0 * mas / np.cos(np.radians(DEC)), -150.0 * mas
    star = erfa.pmpx(np.radians(RA), np.radians(DEC), *rates, 12e-3, 40.0, craft["pmt"], craft["eb"])
    ra, dec = np.degrees(erfa.c2s(star))
    assert printed("{ra:.7f}") == pytest.approx([ra, dec], abs=6e-8)
    seen = np.degrees(erfa.atciqz(np.radians(ra), np.radians(dec), craft))
    assert printed("apparent(ra") == pytest.approx(seen, abs=6e-7)


def test_places_of_another_epoch(printed):
    """By astropy; also at the pole, across RA 0, without motion, and for stars whose motion is not known."""
    assert printed("moved(") == pytest.approx(by_astropy(RA, DEC, 250.0, -150.0, -16.0), abs=6e-8)
    for ra, dec, pmra, pmdec in (
        (0.0001, -30.0, -900.0, 5.0),
        (359.9999, 30.0, 900.0, 0.0),
        (10.0, 89.9999, 500.0, 800.0),
    ):
        place = SkyCoord(*moved(ra, dec, pmra, pmdec, 16.0), unit="deg")
        there = SkyCoord(*by_astropy(ra, dec, pmra, pmdec, 16.0), unit="deg")
        assert place.separation(there).to_value("mas") < 0.01
    ra, dec = moved(np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([np.nan, 0.0]), np.array([np.nan, 0.0]), 16.0)
    np.testing.assert_allclose([ra, dec], [[1.0, 2.0], [3.0, 4.0]], rtol=1e-14)
    assert [np.shape(v) for v in moved(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0), 16.0)] == [(0,), (0,)]


def by_astropy(ra, dec, pmra, pmdec, years):
    start = Time(2010.0, format="jyear", scale="tdb")
    star = SkyCoord(
        ra * u.deg, dec * u.deg, pm_ra_cosdec=pmra * u.mas / u.yr, pm_dec=pmdec * u.mas / u.yr, distance=100 * u.pc,
        obstime=start,
    )  # fmt: skip
    there = star.apply_space_motion(Time(2010.0 + years, format="jyear", scale="tdb"))
    return [there.ra.deg, there.dec.deg]


def test_lensing(printed):
    [mu] = printed("mu:.4f")
    jacobian = np.array([[1 - 0.02 - 0.01, 0.03], [0.03, 1 - 0.02 + 0.01]])
    assert mu == pytest.approx(1 / np.linalg.det(jacobian), abs=6e-5)
