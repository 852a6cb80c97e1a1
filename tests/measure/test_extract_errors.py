"""Errors of extracted columns against their scatter where the sky's own error counts: strips of few pixels."""

import numpy as np
import pytest
from slitless import READ_NOISE, SKY, below

from csstsim.measure import extract
from csstsim.rng import stream

SIGMA = 5.0
TRIALS = 2000
HALF = 4.0  # px, of the aperture
ROWS = np.arange(-30, 31)


@pytest.mark.parametrize("sides", [(-1, 1), (1,)], ids=["two strips", "one strip"])
@pytest.mark.parametrize("response", [1.0, 0.5])
def test_pulls_have_width_one_where_the_sky_comes_from_a_few_pixels(sides, response):
    """One column: an aperture of 8 px, strips of 16. Widths to SIGMA, 8%; without the sky's error they were 12% off.

    Light counted at half response has the noise of half the electrons, and the read noise twice.
    """
    rng = stream(41, "strips", *sides, response)
    shares = np.diff(below(np.append(ROWS - 0.5, ROWS[-1] + 0.5), 1.0))[None]
    inside = np.isin(np.sign(ROWS), (0, *sides))[None] | (np.abs(ROWS) <= HALF + 1)
    given, pulls = 400.0, {"electrons": [], "box": []}
    for _ in range(TRIALS):
        counted = rng.poisson(response * (SKY + given * shares)) + rng.normal(0.0, READ_NOISE, shares.shape)
        cutout = extract._Cutout(
            np.where(inside, counted / response, 0.0), None, ROWS[None].astype(float), inside,
            np.zeros(inside.shape, bool), inside, np.full(inside.shape, response),
        )  # fmt: skip
        found = extract._measured(cutout, shares, HALF, READ_NOISE)
        for name, values in pulls.items():
            values.append((found[name][0] - given) / found[f"{name}_err"][0])
    for values in pulls.values():
        assert np.isfinite(values).all()
        assert abs(np.mean(values)) < SIGMA / np.sqrt(TRIALS) + 0.1  # weights follow the fit: low by up to a tenth
        assert np.std(values) == pytest.approx(1.0, abs=SIGMA / np.sqrt(2 * TRIALS))
