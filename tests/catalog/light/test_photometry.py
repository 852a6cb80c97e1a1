"""Synthetic photometry against closed forms and two independent packages."""

from itertools import pairwise

import astropy.units as u
import numpy as np
import pytest
import speclite.filters
import synphot
from scipy.integrate import simpson
from support.embedded_sky import shipped

from csstsim.base.errors import InputError
from csstsim.base.units import C_A_S, H_J_S, ab_photon_density
from csstsim.catalog.light.photometry import CHUNK, ab_mag, bin_means, load_fluxes, rate_to_mag, subband_fluxes
from csstsim.instrument.filter import GRID

BANDS = ("NUV", "u", "g", "r", "i", "z", "y")


def spectra():
    """Flat f_nu of AB 20, a 5000 K black body, an old galaxy with lines at z = 0.7 [photon / s / m2 / A]."""
    universe, _ = shipped()
    mix = universe.galaxy_seds.coefficients(np.array([[0.2, 0.01, 0.1, 0.5, 0.2]]), [0.3], [1.0])
    galaxy = universe.galaxy_seds.spectra([0.7], mix, [1.0], [0.1])[0]
    galaxy *= 1e-2 / galaxy[6000]
    body = GRID**-4.0 / np.expm1(1.438776877e8 / (GRID * 5000.0))
    return np.stack([ab_photon_density(GRID, 20.0), body / body[6000] * 1e-2, galaxy])


@pytest.mark.parametrize("band", BANDS)
def test_flat_spectrum_gives_its_magnitude_and_the_textbook_rate(camera, band):
    filter_ = camera.filters[band]
    rate = subband_fluxes(ab_photon_density(GRID, 21.5)[None], filter_, camera.telescope)[0]
    assert rate_to_mag(rate.sum(), filter_, camera.telescope) == pytest.approx(21.5, abs=1e-6)
    # A f_nu / h int T dln(lambda), SI: 3631 Jy, a 2 m disc
    textbook = np.pi * 3631e-26 * 10 ** (-0.4 * 21.5) / 6.62607015e-34 * np.trapezoid(filter_.throughput / GRID, GRID)
    assert rate.sum() == pytest.approx(textbook, rel=1e-6)
    assert (rate > 0).all()


@pytest.mark.parametrize("band", BANDS)
def test_against_synphot(camera, band):
    filter_ = camera.filters[band]
    bandpass = synphot.SpectralElement(synphot.models.Empirical1D, points=GRID * u.AA, lookup_table=filter_.throughput)
    for sed in spectra():
        photlam = sed * 1e-4  # photon / s / cm2 / A
        source = synphot.SourceSpectrum(synphot.models.Empirical1D, points=GRID * u.AA, lookup_table=photlam)
        theirs = synphot.Observation(source, bandpass).effstim(u.ABmag).value
        ours = rate_to_mag(subband_fluxes(sed[None], filter_, camera.telescope).sum(), filter_, camera.telescope)
        assert ours == pytest.approx(theirs, abs=1e-3)  # mag
        assert ab_mag(sed, GRID, filter_.throughput) == pytest.approx(theirs, abs=1e-3)


@pytest.mark.parametrize("band", BANDS)
def test_against_speclite(camera, band):
    filter_ = camera.filters[band]
    inside = np.flatnonzero(filter_.throughput)
    used = slice(inside[0] - 1, inside[-1] + 2)  # speclite wants zeros at both ends
    wave, response = GRID[used], filter_.throughput[used].copy()
    response[[0, -1]] = 0.0
    theirs = speclite.filters.FilterResponse(wave, response, meta={"group_name": "csst", "band_name": f"{band}x"})
    for sed in spectra():
        flam = sed * 1e-4 * H_J_S * C_A_S / GRID * 1e7 * u.erg / (u.s * u.cm**2 * u.AA)
        ours = rate_to_mag(subband_fluxes(sed[None], filter_, camera.telescope).sum(), filter_, camera.telescope)
        assert ours == pytest.approx(theirs.get_ab_magnitude(flam, GRID * u.AA), abs=1e-3)  # mag


def test_chunks_join_and_nothing_is_fine(camera):
    filter_, sed = camera.filters["r"], spectra()[0]
    rows = np.arange(CHUNK + 3)
    fluxes = load_fluxes(lambda part: np.outer(1.0 + part, sed), rows, filter_, camera.telescope)
    np.testing.assert_allclose(fluxes, np.outer(1.0 + rows, fluxes[0]), rtol=1e-12)
    assert load_fluxes(None, rows[:0], filter_, camera.telescope).shape == (0, 4)


def test_no_light_is_infinitely_faint_and_nan_stays_nan(camera):
    filter_ = camera.filters["r"]
    mags = rate_to_mag([0.0, np.nan, -1.0], filter_, camera.telescope)
    assert mags[0] == np.inf and np.isnan(mags[1:]).all()


@pytest.mark.parametrize("at", [[0, 1, 2, 3], [0, 7, 8, 200], [3, 40, 100]])
def test_bin_means_are_those_of_lines_between_samples(at):
    """By quad's integral of numpy's interpolation, sample by sample."""
    spectra = np.random.default_rng(8).uniform(0.0, 5.0, (3, 201))
    found = bin_means(spectra, np.array(at))
    place = np.arange(201.0)
    for row, means in zip(spectra, found, strict=True):
        for (a, b), mean in zip(pairwise(at), means, strict=True):
            fine = np.linspace(a, b, 20 * (b - a) + 1)
            assert mean == pytest.approx(simpson(np.interp(fine, place, row), fine) / (b - a), rel=1e-9)
    assert found.shape == (3, len(at) - 1)


def test_light_of_one_wavelength_is_in_its_own_sub_band(camera):
    """From blue to red, rate = area x throughput x photons; grids of one's own count by their steps."""
    filter_, area = camera.filters["r"], np.pi * 1.0**2
    middles = 0.5 * (filter_.edges[1:] + filter_.edges[:-1])
    at = np.searchsorted(GRID, middles)
    lines = np.zeros((4, len(GRID)))
    lines[np.arange(4), at] = [1.0, 2.0, 3.0, 4.0]
    found = subband_fluxes(lines, filter_, camera.telescope)
    wanted = area * filter_.throughput[at] * [1.0, 2.0, 3.0, 4.0] * 0.5
    np.testing.assert_allclose(found, np.diag(wanted), rtol=1e-9, atol=1e-12)
    loaded = load_fluxes(lambda rows: lines[rows], np.array([2, 0]), filter_, camera.telescope)
    np.testing.assert_array_equal(loaded, found[[2, 0]])
    coarse = np.concatenate([GRID[:8000:2], GRID[8000::4]])
    flat = subband_fluxes(np.ones((1, len(coarse))), filter_, camera.telescope, coarse)
    fine = subband_fluxes(np.ones((1, len(GRID))), filter_, camera.telescope)
    assert flat.sum() == pytest.approx(fine.sum(), rel=1e-4) and flat[0] == pytest.approx(fine[0], rel=5e-3)


@pytest.mark.parametrize("shape", [(1, 18001), (3, 18000), (3,)])
def test_a_load_of_another_shape_is_refused(camera, shape):
    with pytest.raises(InputError, match=r"load_seds gave a wrong shape .*allowed: .*3, 18001"):
        load_fluxes(lambda rows: np.ones(shape), np.arange(3), camera.filters["r"], camera.telescope)
