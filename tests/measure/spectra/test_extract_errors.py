"""Errors of extracted columns against their scatter where the sky's own error counts: strips of few pixels."""

import numpy as np
import pytest
from measure.slitless import READ_NOISE, SKY, below

from csstsim.base.rng import stream
from csstsim.measure.spectra.column_sums import FLOOR, summed_columns
from csstsim.measure.spectra.cutout import GOOD, INSIDE, Cutout

SIGMA = 5.0
TRIALS = 2000
HALF = 8.0  # px, of the aperture
ROWS = np.arange(-30, 31)


@pytest.mark.parametrize(
    ("response", "sides"),
    [
        pytest.param(1.0, (-1, 1), id="two strips"),
        pytest.param(0.5, (1,), id="one strip, half response"),
        pytest.param(1.0, (1,), id="one strip", marks=pytest.mark.slow),
        pytest.param(0.5, (-1, 1), id="two strips, half response", marks=pytest.mark.slow),
    ],
)
def test_pulls_have_width_one_where_the_sky_comes_from_a_few_pixels(sides, response):
    """One column: an aperture of 16 px, strips of 16. Widths to SIGMA, 8%; without the sky's error they are 22% off.

    Light counted at half response has the noise of half the electrons, and the read noise twice.
    """
    rng = stream(41, "strips", *sides, response)
    fractions = np.diff(below(np.append(ROWS - 0.5, ROWS[-1] + 0.5), 1.0))[None]
    inside = np.isin(np.sign(ROWS), (0, *sides))[None] | (np.abs(ROWS) <= HALF + 1)
    given, pulls = 400.0, {"electrons": [], "box": []}
    for _ in range(TRIALS):
        counted = rng.poisson(response * (SKY + given * fractions)) + rng.normal(0.0, READ_NOISE, fractions.shape)
        cutout = Cutout(
            np.where(inside, counted / response, 0.0), None, ROWS[None].astype(float), (INSIDE | GOOD) * inside,
            np.full(inside.shape, response),
        )  # fmt: skip
        found, _ = summed_columns(cutout, fractions, HALF, READ_NOISE)
        for name, values in pulls.items():
            values.append((found[name][0] - given) / found[f"{name}_err"][0])
    for values in pulls.values():
        assert np.isfinite(values).all()
        assert abs(np.mean(values)) < SIGMA / np.sqrt(TRIALS) + 0.1  # weights follow the fit: low by up to a tenth
        assert np.std(values) == pytest.approx(1.0, abs=SIGMA / np.sqrt(2 * TRIALS))


def columns_of(given, rng):
    """Return what is found of a spectrum of `given` (n,) electrons a column."""
    fractions = np.diff(below(np.append(ROWS - 0.5, ROWS[-1] + 0.5), 1.0))[None].repeat(len(given), axis=0)
    data = rng.poisson(SKY + given[:, None] * fractions) + rng.normal(0.0, READ_NOISE, fractions.shape)
    offset = ROWS[None].repeat(len(given), axis=0).astype(float)
    cutout = Cutout(data, None, offset, np.full(data.shape, INSIDE | GOOD), np.ones(data.shape))
    return summed_columns(cutout, fractions, HALF, READ_NOISE)[0]


@pytest.mark.parametrize("given", [0.0, 5.0, 60.0, 2000.0])
def test_means_weighted_by_their_errors_are_unbiased(given):
    """60 spectra of 200 columns. With a column's own noise in its error, faint ones are low by 6 to 7 sigma."""
    rng = stream(43, "weighted", given)
    differences = {"electrons": [], "box": []}
    for _ in range(60):
        found = columns_of(np.full(200, given), rng)
        for name, values in differences.items():
            weight = found[f"{name}_err"] ** -2
            values.append(np.sum(weight * (found[name] - given)) / np.sqrt(weight.sum()))
    for values in differences.values():
        assert abs(np.mean(values)) < SIGMA / np.sqrt(len(values))


def test_a_bright_line_has_the_noise_of_its_own_electrons():
    """40 spectra with a line of one column: its pulls have width one, those of the columns beside it, too."""
    given = np.full(41, 20.0)
    given[20] = 20_000.0
    rng, pulls = stream(44, "line"), []
    for _ in range(40):
        found = columns_of(given, rng)
        pulls.append((found["electrons"] - given) / found["electrons_err"])
    for column in (19, 20, 21):
        assert np.std(np.array(pulls)[:, column]) == pytest.approx(1.0, abs=SIGMA / np.sqrt(2 * len(pulls)))


@pytest.mark.parametrize("sigma", [1.0, 6.0, 10.0])
def test_light_in_the_strips_is_not_taken_for_sky(sigma):
    """Without noise an object of any width is the electrons put in, though its sky has a part of them."""
    fractions = np.diff(below(np.append(ROWS - 0.5, ROWS[-1] + 0.5), sigma))[None]
    seen, given = np.full(fractions.shape, INSIDE | GOOD), 5000.0
    cutout = Cutout(SKY + given * fractions, None, ROWS[None].astype(float), seen, np.ones(fractions.shape))
    found, _ = summed_columns(cutout, fractions, HALF, READ_NOISE)
    assert found["sky"][0] >= SKY
    for name in ("electrons", "box"):
        assert found[name][0] == pytest.approx(given, rel=5e-3)


def test_weights_make_the_electrons_of_their_pixels():
    """A trace a third of a pixel above a row, noisy pixels, one of them unusable: its weight is 0."""
    rng = np.random.default_rng(6)
    offset = ROWS[None] - 0.3
    fractions = np.diff(below(np.append(offset[0] - 0.5, offset[0, -1] + 0.5), 1.0))[None]
    seen = np.full(fractions.shape, INSIDE | GOOD)
    spoilt = int(np.argmin(np.abs(offset[0] - 1.0)))
    seen[0, spoilt] = INSIDE
    data = rng.poisson(SKY + 3000.0 * fractions).astype(float)
    data[0, spoilt] = 0.0
    found, weights = summed_columns(
        Cutout(data, None, offset, seen, np.ones(fractions.shape)), fractions, HALF, READ_NOISE
    )
    at = np.searchsorted(offset[0], weights.offset[0])
    assert weights.weight.shape == weights.offset.shape and np.array_equal(offset[0, at], weights.offset[0])
    assert np.abs(weights.offset).max() <= HALF + 1 and weights.weight[0, at == spoilt] == 0
    used = weights.weight * (data[:, at] - found["sky"][0])
    assert used.sum() == pytest.approx(found["electrons"][0], rel=1e-9)
    assert (weights.weight * fractions[:, at]).sum() == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("level", [0.0, -3.0, 1e-12])
@pytest.mark.parametrize("given", [0.0, 5000.0])
def test_a_frame_without_any_noise_has_errors_of_the_floor(level, given):
    """No sky, no read noise, a level below 0 by another bias: what was put in, to 1e-3, with errors above 0."""
    fractions = np.diff(below(np.append(ROWS - 0.5, ROWS[-1] + 0.5), 1.0))[None]
    seen = np.full(fractions.shape, INSIDE | GOOD)
    found, _ = summed_columns(
        Cutout(level + given * fractions, None, ROWS[None].astype(float), seen, np.ones(fractions.shape)),
        fractions,
        HALF,
        0.0,
    )
    for name in ("electrons", "box"):
        assert found[name][0] == pytest.approx(given, rel=1e-3, abs=1e-6)
    least = np.sqrt(FLOOR / (fractions**2).sum()) if given == 0 else np.sqrt(given)
    assert found["electrons_err"][0] > 0.99 * least and found["box_err"][0] >= found["electrons_err"][0]
