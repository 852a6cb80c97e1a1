"""The number of slabs of a spectrum: roughness is an amplitude, and the fewest allowed ones are used."""

import numpy as np
import pytest

from csstsim.render.settings import load_numbers
from csstsim.render.slitless.slab_counts import allowed_error, fewest, roughness

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
    assert allowed_error(np.array([1.0, 1e9]), 4, 0.1) == pytest.approx([0.1, 2 * error.psf[4]])
