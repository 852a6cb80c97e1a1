"""Mixtures of PSFs as cells and as transforms against closed forms, and integrals of splines over pixels."""

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.special import ndtr

from csstsim.render.pixel_sums import pixel_sums
from csstsim.render.psf_mixture import BINS, Mixer, mixer_of, transform
from csstsim.render.psf_table import spline_coefficients

PER_PX, CELLS = 4, 128
SIGMA, OFF = (1.3, 0.8), (0.7, -0.4)  # px, along x and y


def lopsided():
    """Cell integrals of an elliptical Gaussian off the middle of the box."""
    edges = (np.arange(CELLS + 1) - CELLS / 2) / PER_PX
    across, up = (np.diff(ndtr((edges - at) / s)) for at, s in zip(OFF, SIGMA, strict=True))
    return np.outer(up, across).astype(np.float32)


@pytest.mark.parametrize("size", [48, 20, 12])
def test_a_transform_is_that_of_the_psf_over_the_pixel(size):
    """A Gaussian off its position, convolved with a pixel, at frequencies j / size; periods below the box fold none."""
    cells = spline_coefficients(lopsided())[0].astype(np.float32)
    last = size // 2
    found = transform(cells, size, PER_PX, last)
    assert found.shape == (2 * last + 1, last + 1) and found.dtype == np.complex64
    fx, fy = np.arange(last + 1) / size, np.arange(-last, last + 1)[:, None] / size
    wanted = np.exp(-2 * np.pi**2 * ((SIGMA[0] * fx) ** 2 + (SIGMA[1] * fy) ** 2)) * np.sinc(fx) * np.sinc(fy)
    wanted = wanted * np.exp(-2j * np.pi * (fx * OFF[0] + fy * OFF[1]))
    assert np.abs(found - wanted).max() < 1e-3


def test_a_mixture_is_the_sum_of_nodes_and_sub_bands(psf):
    mixer = Mixer(psf)
    assert mixer.half == 16.0 and mixer_of(mixer) is mixer and isinstance(mixer_of(psf), Mixer)
    node, fraction = np.array([2, 0, 3]), np.array([[1.0, 0.0, 20.0, 0.0], [0.0] * 4, [0.0, 300.0, 0.0, 4.0]])
    wanted = sum(
        fraction[k, b] * spline_coefficients(psf.node(n)[b])[0] for k, n in enumerate(node) for b in range(4)
    )  # fmt: skip
    cells = mixer.mixed_cells(node, fraction)
    assert cells == pytest.approx(wanted, rel=1e-5, abs=1e-6 * wanted.max())
    part = mixer.mixed_cells(node, fraction, slice(40, 70), slice(50, 66))
    assert np.array_equal(part, cells[40:70, 50:66])
    assert mixer.light(node, fraction, False) == pytest.approx((fraction * psf.flux[node]).sum())
    assert mixer.light(node, fraction, True) == pytest.approx((wanted * mixer.core).sum(), rel=1e-5)
    assert mixer.light(node, fraction, True) < mixer.light(node, fraction, False)
    whole = mixer.mixed_transforms(node, fraction, 48, 20)
    alone = transform(cells, 48, PER_PX, 20)
    assert whole.shape == (41, 21) and np.abs(whole - alone).max() < 1e-4 * cells.sum()
    cored = mixer.mixed_transforms(node, fraction, 48, 20, cored=True)
    assert cored[20, 0].real == pytest.approx(mixer.light(node, fraction, True), rel=1e-3)


def test_the_core_ends_where_the_wing_takes_over(psf):
    """All of a cell within 0.7 of the box's half side, none beyond 0.95, half of it about the middle."""
    core, axis = Mixer(psf).core, (np.arange(CELLS) + 0.5 - CELLS / 2) / PER_PX
    r = np.hypot(axis, axis[:, None])
    assert (core[r < 0.7 * 16] == 1).all() and (core[r > 0.95 * 16] == 0).all()
    assert core[np.abs(r - 0.825 * 16) < 0.05] == pytest.approx(0.5, abs=0.03)


def test_the_envelope_is_the_largest_amplitude_from_a_frequency_on(psf):
    """Of the narrowest Gaussian in use, along an axis or a diagonal; a bin has what lies above the one before."""
    found = Mixer(psf).envelope(np.array([0, 1]), np.array([[1.0] * 4, [0.0] * 4]))
    assert found.shape == BINS.shape and (np.diff(found) <= 0).all()
    low, high = (np.exp(-2 * (np.pi * 0.8 * f) ** 2) for f in (BINS + 1 / 32, BINS * BINS[0] / BINS[1]))
    some = (BINS > 0.05) & (BINS < 0.5)
    assert (found[some] <= high[some] + 1e-3).all() and (found[some] >= (low * np.sinc(BINS))[some] - 2e-3).all()


@pytest.mark.parametrize("step", [1, 2, 4])
def test_integrals_of_splines_over_pixels(step):
    """By scipy's integral of each B-spline: pixels of four cells, from any position, also beyond the cells."""
    cells = np.random.default_rng(3).uniform(0, 1, (9, 7)).astype(np.float32)

    def fraction(start, cell):
        spline = BSpline.basis_element(np.arange(4) - 1.5 + cell + 0.5, extrapolate=False)
        low, high = max(start, cell - 1.0), min(start + 4, cell + 2.0)
        return float(spline.integrate(low, high)) if low < high else 0.0

    start_y, start_x, shape = -2.3, 1.45, (6, 5)
    found = pixel_sums(cells, start_y, start_x, 4, step, np.empty(shape, np.float32))
    up = np.array([[fraction(start_y + step * row, cell) for cell in range(9)] for row in range(shape[0])])
    across = np.array([[fraction(start_x + step * column, cell) for cell in range(7)] for column in range(shape[1])])
    assert found == pytest.approx(up @ cells @ across.T, abs=1e-5)
