"""Spectra of quasars against closed forms, published equivalent widths, real composites and colours."""

import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from csstsim.base.shipped import SHIPPED
from csstsim.base.units import ab_photon_density
from csstsim.catalog.light.photometry import ab_mag, subband_weights
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID
from csstsim.instrument.load import read_data
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.dust.extinction import odonnell
from csstsim.universe.galaxies.igm import Intergalactic
from csstsim.universe.quasars.quasar_sed import QuasarSeds

DATA = Path(os.environ.get("CSSTSIM_DATA", SHIPPED.parents[1] / "shared" / "data"))
NUMBERS = read_data(SHIPPED / "universe" / "quasars.yaml")
IGM = read_data(SHIPPED / "universe" / "galaxies.yaml")["igm"]
REST = np.arange(950.0, 9600.0, 1.0)


@cache
def seds(lines=True):
    empty = {} if lines else {"lines": {"table": []}, "small_blue_bump": {"table": []}}
    return QuasarSeds(NUMBERS | empty, IGM, odonnell(GRID))


def parameters_of(m1450=-26.0, **changed):
    """Coefficients of a mean quasar."""
    out = np.zeros(COEFFICIENTS)
    out[0] = m1450
    for k, value in changed.items():
        out[int(k[1:])] = value
    return out


def spectrum(z, coefficients=None, av=0.0, lines=True, wavelength=GRID):
    coefficients = parameters_of() if coefficients is None else coefficients
    return seds(lines).spectra([z], [coefficients], [1.0], [av], wavelength)[0]


def f_lambda(wavelength, lines=True):
    """A mean quasar's rest-frame energy density without the intergalactic medium, 1 at 1450 A."""
    wavelength = np.asarray(wavelength, dtype=float)
    redshifted = spectrum(0.0, lines=lines, wavelength=wavelength)
    transmission = Intergalactic(wavelength, IGM).absorb(np.ones_like(wavelength), 0.0)
    flux = redshifted / transmission / wavelength
    return flux / np.interp(1450.0, wavelength, flux)


@pytest.mark.parametrize("z", [0.5, 1.0, 3.0, 6.0])
def test_unit_scale_is_ab_zero_at_1450_rest(z):
    wave = np.array([1449.0, 1450.0, 1451.0]) * (1 + z)
    assert spectrum(z, lines=False, wavelength=wave)[1] == pytest.approx(ab_photon_density(wave[1]), rel=1e-12)


def test_continuum_is_the_broken_power_law_and_joins():
    pieces = np.add(NUMBERS["continuum"]["slopes"], [0.1, -0.2, 0.3, -0.4])
    breaks = NUMBERS["continuum"]["breaks"]
    quasars = parameters_of(c1=0.1, c2=-0.2, c3=0.3, c4=-0.4)
    inside = ([1000, 1090], [1110, 5600], [5800, 9600], [9800, 10900])
    for (low, high), slope in zip(inside, pieces, strict=True):
        wave = np.array([low, high], dtype=float)
        f_nu = spectrum(0.0, quasars, lines=False, wavelength=wave) * wave
        f_nu /= Intergalactic(wave, IGM).absorb(np.ones(2), 0.0)
        assert np.log(f_nu[1] / f_nu[0]) / np.log(low / high) == pytest.approx(slope, rel=1e-9)
    for edge in breaks[1:]:
        below, above = spectrum(0.0, quasars, lines=False, wavelength=np.array([edge - 1e-6, edge + 1e-6]))
        assert below == pytest.approx(above, rel=1e-8)


def test_lines_have_their_equivalent_widths_and_fall_with_luminosity():
    wave = np.arange(2000.0, 11000.0, 0.5)
    ratio = spectrum(1.0, wavelength=wave) / spectrum(1.0, lines=False, wavelength=wave) - 1
    found = np.trapezoid(ratio, wave) / 2  # rest
    rows = [*NUMBERS["lines"]["table"], *NUMBERS["small_blue_bump"]["table"]]
    widths = seds().widths(parameters_of())
    inside = np.array([1000 < w < 5400 for w, *_ in rows])
    assert found == pytest.approx(widths[inside].sum(), rel=2e-3)
    civ = [row[3] == "civ" for row in rows]
    bright, faint = (seds().widths(parameters_of(m))[civ].sum() for m in (-28.0, -23.0))
    assert np.log10(bright / faint) == pytest.approx(NUMBERS["families"]["civ"]["baldwin"] * 2.0, abs=1e-9)


# Rest equivalent widths [A] of Vanden Berk et al. (2001), table 2; blends as theirs.
@pytest.mark.parametrize(
    ("low", "high", "published"),
    [(1200, 1250, 92.9), (1540, 1560, 23.8), (1850, 1920, 21.2), (2790, 2800, 32.3), (4860, 4870, 46.2),
     (5005, 5010, 13.2), (6560, 6570, 194.5), (1390, 1410, 8.1)],
)  # fmt: skip
def test_equivalent_widths_beside_vanden_berk(low, high, published):
    """Within a factor 1.7: the composite's quasars are brighter and its continuum is drawn closer to the lines."""
    rows = [*NUMBERS["lines"]["table"], *NUMBERS["small_blue_bump"]["table"]]
    chosen = [low < row[0] < high and row[3] != "iron" for row in rows]
    assert 1 / 1.7 < seds().widths(parameters_of(-26.0))[chosen].sum() / published < 1.7


def test_spectrum_follows_real_composites():
    """LBQS (Francis et al. 1991), SDSS (Vanden Berk et al. 2001), Polletta et al. 2007: their mean to 7% rms."""
    paths = [DATA / "qso" / "synphot_qso_template_001.dat", *(DATA / "lephare" / "QSO" / name for name in
             ("QSO_SDSS.sed", "qso_template_norm.sed"))]  # fmt: skip
    if not all(path.exists() for path in paths):
        pytest.skip("real quasar composites are absent")
    wave = REST[(REST > 1250) & (REST < 5500)]
    real = []
    for path in paths:
        flux = np.interp(wave, *np.loadtxt(path, usecols=(0, 1)).T)
        real.append(flux / np.median(flux[(wave > 1430) & (wave < 1480)]))
    scatter = np.std(real, axis=0) / np.mean(real, axis=0)
    ratio = f_lambda(wave) / np.mean(real, axis=0)
    ratio /= np.median(ratio)
    assert np.std(ratio) < 0.07 and np.median(scatter) > 0.03  # no closer than the composites are to each other
    for low in range(1250, 5500, 500):
        part = (wave >= low) & (wave < low + 500)
        assert np.median(ratio[part]) == pytest.approx(1, abs=0.1), low


@pytest.mark.parametrize(("kind", "low", "high", "rms"), [("HIZ", 1230, 4400, 0.055), ("LOZ", 1700, 7000, 0.085)])
def test_spectrum_lies_among_real_ones(kind, low, high, rms):
    """Four eigenspectra of SDSS quasars (redrock-templates 1.1) describe it: relative residual."""
    path = DATA / "qso" / f"redrock_rrtemplate-QSO-{kind}-v1.1.fits"
    if not path.exists():
        pytest.skip("the redrock templates are absent")
    with fits.open(path) as hdus:
        header, vectors = hdus[0].header, hdus[0].data.astype(float)
    wave = 10 ** (header["CRVAL1"] + header["CDELT1"] * np.arange(vectors.shape[1]))
    part = (wave > low) & (wave < high)
    flux = f_lambda(np.concatenate([[1450.0], wave[part]]) if wave[part][0] > 1450 else wave[part])[-part.sum() :]
    design = (vectors[:, part] / flux).T
    solution = np.linalg.lstsq(design, np.ones(len(flux)), rcond=None)[0]
    assert np.std(design @ solution - 1) < rms


def _sdss_colours(z):
    filters = pytest.importorskip("speclite.filters")
    wave = np.arange(2900.0, 11300.0, 2.0)
    flux = spectrum(z, wavelength=wave)
    curves = [filters.load_filter(f"sdss2010-{band}") for band in "ugri"]
    return -np.diff([ab_mag(flux, wave, np.interp(wave, c.wavelength, c.response, 0, 0)) for c in curves])


# Median u-g, g-r of SDSS quasars: round figures after Richards et al. (2001, AJ 121, 2308), good to about 0.1 mag.
@pytest.mark.parametrize(
    ("z", "u_g", "g_r"),
    [(0.5, 0.15, 0.1), (1.0, 0.15, 0.2), (1.5, 0.05, 0.15), (2.0, 0.1, 0.1), (2.5, 0.6, 0.1), (3.0, 1.3, 0.2)],
)
def test_colours_of_sdss_quasars(z, u_g, g_r):
    found = _sdss_colours(z)
    assert found[0] == pytest.approx(u_g, abs=0.2) and found[1] == pytest.approx(g_r, abs=0.15)


def test_high_redshift_quasars_drop_out_of_the_blue():
    """Selection boxes of Fan et al. (1999, AJ 118, 1): g - r > 1 from z 3.9, r - i > 0.6 at 4.8."""
    assert _sdss_colours(4.0)[1] > 1.0 and _sdss_colours(4.8)[2] > 0.6
    assert spectrum(6.0)[GRID < 6000].max() < 0.1 * spectrum(6.0)[GRID > 9000].min()


def test_rates_are_the_integral_of_the_spectrum():
    camera = load_camera(SHIPPED / "instrument")
    weights = np.vstack([subband_weights(camera.filters[name], camera.telescope) for name in ("NUV", "r", "GI")])
    z, av = np.array([0.1, 0.7, 2.3, 4.4, 6.0]), np.array([0.0, 0.1, 1.0, 0.05, 0.3])
    quasars = np.array([parameters_of(-20.0 - k, c2=0.3 * k, c6=-0.2) for k in range(5)])
    found = seds().rates(z, quasars, av, weights)
    direct = seds().spectra(z, quasars, np.ones(5), av)
    for row, flux in zip(found, direct, strict=True):
        np.testing.assert_allclose(row, [np.trapezoid(flux * w / 0.5, GRID) for w in weights], rtol=1e-4, atol=1e-300)
    assert seds().rates(z[:0], quasars[:0], av[:0], weights).shape == (0, 12)
    assert (seds().rates(z, quasars, av, 0 * weights) == 0).all()


def test_scale_and_extinction_multiply():
    dusty, clear = (seds().spectra([1.2], [parameters_of()], [3.0], [av])[0] for av in (0.7, 0.0))
    np.testing.assert_allclose(dusty / clear, 10 ** (-0.4 * 0.7 * odonnell(GRID)), rtol=1e-12)
    np.testing.assert_allclose(clear, 3.0 * spectrum(1.2), rtol=1e-12)


def test_numbers_that_make_no_spectrum_are_refused():
    for part, changed in (
        ("continuum", {"breaks": [1100, 900, 9730]}),
        ("continuum", {"slopes": [-0.5]}),
        ("families", {f"more{k}": NUMBERS["families"]["civ"] for k in range(9)}),
        ("lines", {"table": [[1216, 50, 10, "unknown"]]}),
    ):
        with pytest.raises(ValueError):
            QuasarSeds(NUMBERS | {part: NUMBERS[part] | changed}, IGM, odonnell(GRID))
