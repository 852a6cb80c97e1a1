"""From wavefront to cells: closed forms of the Airy pattern, GalSim with aberrations, blur, centring."""

import functools
from dataclasses import replace

import galsim
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0, j1, jn_zeros

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.optics.psf.diffraction import Diffraction, blur, check_blur, windowed_centroid
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.optics.psf.psf_set import chip_optics, node_psf
from csstsim.optics.psf.wavefront import load_wavefront

CELL = 0.037  # arcsec
PARAMS = read_data(SHIPPED / "instrument" / "psf.yaml")
PERFECT = load_wavefront({**PARAMS, "static": [], "design": [[j] + [0] * 6 for j in range(4, 12)]}, parts=())
SHARP = np.ones_like  # kernel of no blur: point samples, times the area of a cell


def lam_over_d(wavelength):
    """In cells, for 2 m."""
    return np.degrees(wavelength * 1e-10 / 2.0) * 3600 / CELL


@functools.cache
def perfect(wavelength, cells=256):
    optics = Diffraction(wavelength, 2.0, CELL, PERFECT, cells)
    return optics, optics.transfer(np.zeros(8))


def distance(cells):
    axis = np.arange(cells) - (cells - 1) / 2
    return np.hypot(axis, axis[:, None])


@pytest.mark.parametrize("wavelength", [2650.0, 4500.0, 6328.0, 7400.0, 10300.0])
def test_perfect_optics_is_the_airy_pattern(wavelength):
    optics, transfer = perfect(wavelength)
    got = optics.image(transfer, SHARP)
    lam_d = lam_over_d(wavelength)
    v = np.pi * distance(256) / lam_d
    peak = np.pi / 4 / lam_d**2
    # 2e-4 of the peak: the edge of the pupil on 260 to 700 samples
    assert got == pytest.approx(peak * (2 * j1(v) / v) ** 2, abs=2e-4 * peak)
    # In the wings, where the pattern is 1e-5 of its peak, the mean over a ring to 5%
    ring = (distance(256) > 90) & (distance(256) < 120)
    assert got[ring].mean() == pytest.approx((peak * (2 * j1(v) / v) ** 2)[ring].mean(), rel=0.05)
    dark = optics.image(transfer, SHARP, centre=(jn_zeros(1, 1)[0] / np.pi * lam_d - 0.5, -0.5))[128, 128]
    assert dark < 1e-4 * peak


@pytest.mark.parametrize("wavelength", [2800.0, 6328.0, 9500.0])
@pytest.mark.parametrize("cells", [32, 256])
def test_box_holds_the_encircled_energy_of_the_airy_pattern(wavelength, cells):
    optics, transfer = perfect(wavelength)
    image = optics.image(transfer, np.sinc)
    low = 128 - cells // 2
    got = image[low : low + cells, low : low + cells].sum()

    def within(angle):  # the circle through the square's side at this angle: 1 - J0^2 - J1^2 (Born & Wolf, 8.5.2)
        v = np.pi * cells / 2 / np.cos(angle) / lam_over_d(wavelength)
        return 1 - j0(v) ** 2 - j1(v) ** 2

    expected = 4 / np.pi * quad(within, 0, np.pi / 4, limit=400)[0]
    assert got == pytest.approx(expected, abs=5e-5)  # fraction of the star's light


def test_small_box_of_its_own_is_the_middle_of_the_large_one():
    large = np.sinc, perfect(6328.0)
    small = np.sinc, perfect(6328.0, 32)
    images = [optics.image(transfer, kernel) for kernel, (optics, transfer) in (large, small)]
    assert images[1] == pytest.approx(images[0][112:144, 112:144], abs=2e-4 * images[0].max())


@pytest.mark.parametrize("noll", [7, 9, None])
def test_aberrated_psf_agrees_with_galsim(noll):
    """Index, amplitude and sign: an odd term of the other sign would show the image turned by 180 degrees."""
    if noll is None:
        waves = np.array([0.0] * 4 + [0.05, 0.04, -0.06, 0.05, 0.03, -0.04, 0.05, 0.06])
    else:
        waves = 0.15 * (np.arange(12) == noll)
    optics, _ = perfect(6328.0, 64)
    got = optics.image(optics.transfer(632.8 * waves[4:]), SHARP)
    peer = galsim.OpticalPSF(lam=632.8, diam=2.0, aberrations=list(waves), oversampling=3, pad_factor=4)
    expected = peer.drawImage(nx=64, ny=64, scale=CELL, method="no_pixel", dtype=float).array
    assert got == pytest.approx(expected, abs=2e-3 * expected.max())  # 1e-3: GalSim's interpolation between samples
    assert np.abs(got[::-1, ::-1] - expected).max() > 0.1 * expected.max()


def test_small_wavefront_errors_give_marechals_strehl():
    optics, flat = perfect(6328.0, 32)
    rms = 8.0  # nm
    phase = 2 * np.pi * rms / 632.8
    centre = (-0.5, -0.5)  # a sample on the star
    for noll in range(8):
        coefficients = rms * (np.arange(8) == noll)
        peaks = [optics.image(t, SHARP, centre)[16, 16] for t in (optics.transfer(coefficients), flat)]
        assert peaks[0] / peaks[1] == pytest.approx(1 - phase**2, abs=2 * phase**4)


def test_jitter_and_diffusion_convolve_with_gaussians():
    optics, transfer = perfect(6328.0, 64)
    params = {"jitter": 0.05, "diffusion": 6.0}
    kernel = blur(params, CELL, 5.0, cell=False)
    got = optics.image(transfer, kernel)
    variance = (0.05 / CELL) ** 2 + (6.0 / 5.0) ** 2  # cells^2
    cut = 1 / lam_over_d(6328.0)

    def integrand(f, r):  # Hankel transform of (OTF of a clear disc) x (OTF of a Gaussian)
        clear = 2 / np.pi * (np.arccos(f / cut) - f / cut * np.sqrt(1 - (f / cut) ** 2))
        return 2 * np.pi * f * clear * np.exp(-2 * np.pi**2 * variance * f**2) * j0(2 * np.pi * f * r)

    for row, column in ((32, 32), (31, 34), (36, 30), (32, 40), (20, 32)):
        expected = quad(integrand, 0, cut, args=(distance(64)[row, column],), limit=400)[0]
        assert got[row, column] == pytest.approx(expected, abs=1e-4 * got.max())  # edge of the pupil


def test_pixel_response_is_the_exact_integral_over_a_pixel():
    optics = Diffraction(4500.0, 2.0, CELL, load_wavefront(PARAMS), 64)
    transfer = optics.transfer(np.full(12, 5.0))
    table = pixel_response(optics.image(transfer, np.sinc), 2)
    direct = optics.image(transfer, lambda f: 2 * np.sinc(2 * f), centre=(-0.5, -0.5))  # samples at whole cells
    assert table.shape == (63, 63)
    assert table == pytest.approx(direct[1:, 1:], abs=3e-5 * table.max())  # the pupil's envelope over a pixel


@pytest.fixture(scope="module")
def shipped_node():
    wavefront = load_wavefront(PARAMS)
    optics = [Diffraction(w, 2.0, CELL, wavefront, 64) for w in (2700.0, 2900.0, 3050.0, 3150.0)]
    coefficients = wavefront.coefficients(25000.0, -20000.0)
    kernel = blur(PARAMS, CELL, 5.0)
    return optics, coefficients, kernel, *node_psf(optics, coefficients, kernel)


def test_node_is_centred_and_keeps_the_shift(shipped_node):
    optics, coefficients, kernel, images, tilt = shipped_node
    assert images.shape == (4, 64, 64)
    assert (images >= 0).all()
    centre = windowed_centroid(pixel_response(images.mean(axis=0), 2), 3.0)
    assert np.hypot(*centre) / 2 < 1e-4  # px
    assert np.hypot(*tilt) > 0.01  # coma moves it: the test would not notice otherwise
    raw = np.mean([o.image(o.transfer(coefficients), kernel) for o in optics], axis=0)
    assert np.array(windowed_centroid(pixel_response(raw, 2), 3.0)) / 2 == pytest.approx(tilt, abs=1e-3)


def test_a_detector_measures_the_true_place_at_every_pixel_phase(shipped_node):
    optics, coefficients, kernel, _, tilt = shipped_node
    transfers = [o.transfer(coefficients) for o in optics]
    errors = []
    for phase in np.array([(0, 0), (0.25, 0), (0.5, 0), (0, 0.5), (0.5, 0.5), (0.13, 0.71), (0.8, 0.37)]):
        centre = 2 * (tilt - phase)
        cells = np.mean([o.image(t, kernel, centre) for o, t in zip(optics, transfers, strict=True)], axis=0)
        pixels = cells.reshape(32, 2, 32, 2).sum(axis=(1, 3))
        errors.append(np.array(windowed_centroid(pixels, 1.5)) - phase)
    assert np.abs(errors).max() < 0.005  # px
    assert np.abs(np.mean(errors[:5], axis=0)).max() < 0.002


def test_nothing_compact_to_centre_is_an_error():
    ramp = np.zeros((31, 31))
    ramp[0, 0] = 1.0
    with pytest.raises(
        InputError,
        match=r"converge: .* psf\.yaml .* pixel_scale of telescope\.yaml",
    ):
        windowed_centroid(ramp + 1e-300, 3.0)


def test_noise_free_light_is_conserved_by_blur():
    optics, transfer = perfect(6328.0)
    sharp, soft = (optics.image(transfer, k).sum() for k in (np.sinc, blur(PARAMS, CELL, 5.0)))
    assert soft == pytest.approx(sharp, abs=5e-5)  # rings of the pattern straddle the edge of the box


def test_a_psf_in_cells_depends_on_ratios_alone(camera):
    """A 4 m telescope with half the scale, half the jitter, half as large pixels and half the diffusion: the same."""
    chip, filter_, wavefront = camera.chips[9], camera.filters["r"], load_wavefront(PARAMS)
    large = replace(chip.telescope, diameter_m=4.0, pixel_scale=0.037)
    other = replace(chip, telescope=large, detector=replace(chip.detector, pixel_um=5.0))
    half = PARAMS | {"jitter": PARAMS["jitter"] / 2, "diffusion": PARAMS["diffusion"] / 2}
    f = np.linspace(0.0, 0.5, 20)
    images, kernels = [], []
    for one, params in ((chip, PARAMS), (other, half)):
        optics, kernel = chip_optics(one, filter_, params, wavefront, 2, 64)
        coefficients = wavefront.coefficients(0.0, 0.0)
        images.append(optics[0].image(optics[0].transfer(coefficients), kernel))
        kernels.append(kernel(f))
    assert images[1] == pytest.approx(images[0], abs=1e-6 * images[0].max())
    assert kernels[1] == pytest.approx(kernels[0], rel=1e-12)


def test_jitter_and_diffusion_blur_together_as_squares():
    """1.4 px each are 1.98 px, within the largest blur of 2 px; 1.45 px each are not, nor is 2.01 px of one of them."""
    for jitter, diffusion, fine in ((1.4, 1.4, True), (1.45, 1.45, False), (2.01, 0.0, False), (0.0, 1.99, True)):
        params = PARAMS | {"jitter": jitter * 0.05, "diffusion": diffusion * 8.0}
        if fine:
            check_blur(params, 0.05, 8.0)
        else:
            with pytest.raises(InputError, match="too wide for its box"):
                check_blur(params, 0.05, 8.0)
