"""The number of slabs of a spectrum: roughness is an amplitude, and the fewest allowed ones are used."""

import numpy as np
import pytest

from csstsim.render.error_model import allowed_error
from csstsim.render.settings import load_numbers
from csstsim.render.slitless.slab_counts import fewest, fewest_by_order, roughness

BINS = 2000


def test_roughness_is_none_of_a_flat_spectrum_one_of_lines_and_goes_with_a_lines_height():
    flat, line = np.ones(BINS), np.zeros(BINS)
    line[::100] = 1.0
    inner = slice(20, -20)  # a running mean falls off at the ends
    assert roughness(np.pad(flat[None], ((0, 0), (7, 7)), mode="edge"))[0] < 0.1
    assert roughness(line[None, inner])[0] > 0.9
    ripple = np.sin(np.arange(BINS) * 2 * np.pi / 4.0)  # faster than the running mean
    weak = roughness(1.0 + np.outer([0.0, 0.05, 0.1, 0.2], ripple))
    rms = np.sqrt(weak**2 - weak[0] ** 2)[1:]
    assert rms / rms[0] == pytest.approx([1.0, 2.0, 4.0], rel=0.02)


def test_the_fewest_that_are_allowed():
    error = load_numbers().error
    counts = np.array(sorted(error.slabs))
    for rough in (0.0, 0.1, 1.0):
        wrong = np.array([error.slabs_flat[n] + rough * error.slabs[n] for n in counts])
        for k, n in enumerate(counts):
            assert fewest(np.array([rough]), np.array([wrong[k] * 1.001]))[0] == counts[np.argmax(wrong <= wrong[k])]
            assert fewest(np.array([rough]), np.array([0.0]))[0] == counts[-1] and n in counts
    # At S/N 1 all of eps is allowed, at any S/N twice what the stored PSF is off
    assert allowed_error(np.array([1.0, 1e9]), error, 4, 0.1) == pytest.approx([0.1, 2 * error.psf[4]])


def test_orders_need_slabs_by_their_share_of_the_light():
    """Of an object whose allowed error is 1e-3 the brightest order may have all of it, others half over their share."""
    error, rough = load_numbers().error, 0.02
    counts = sorted(error.slabs)

    def wanted(allowed, rough):
        fits = [n for n in counts if error.slabs_flat[n] + rough * error.slabs[n] <= allowed]
        return fits[0] if fits else counts[-1]

    electrons = np.array([[100.0, 20.0, 1.0, 0.0], [3.0, 3.0, 300.0, 30.0], [0.0, 0.0, 0.0, 0.0]])
    allowed, short = np.array([1e-3, 2e-4, 1e-3]), np.array([False, False, True, False])
    found = fewest_by_order(electrons, np.full(3, rough), short, allowed)
    limit = [[1e-3, 2.5e-3, 5e-2, 1e9], [1e-2, 1e-2, 2e-4, 1e-3], [1e6] * 4]
    expected = [[wanted(v, 1.0 if s else rough) for v, s in zip(row, short, strict=True)] for row in limit]
    assert found.tolist() == expected and len(np.unique(found)) >= 3


def test_roughness_of_lines_is_one_at_most_and_of_no_light_none():
    line = np.zeros((3, 400))
    line[0, 200], line[1, ::2] = 5.0, 3.0
    found = roughness(line)
    assert found[0] == 1.0 and found[2] == 0.0
    # every other bin: 7 or 6 of 13 bins are lit, so that each is 18 / 13 off, of a mean power of 4.5
    assert found[1] == pytest.approx(18 / 13 / np.sqrt(4.5) / 0.77, rel=0.01)


def test_the_stored_psf_sets_the_error_of_bright_spectra():
    error = load_numbers().error
    psf = error.psf
    found = [allowed_error(np.array([0.0, 10.0, 1e9]), error, cells, 0.2) for cells in (4, 2, 8)]
    assert found[0] == pytest.approx([2e8, 0.02, 2 * psf[4]]) and found[1] == pytest.approx([2e8, 0.02, 2 * psf[2]])
    assert found[2].tolist() == found[0].tolist()
