"""Levels of channels drawn by layers: their spread, both sides, independence; masks stay with the image."""

from dataclasses import replace

import numpy as np
import pytest
from support.readout_state import flat_state, run

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.detector.channels import ReadoutFrame
from csstsim.detector.mask import CLIPPED
from csstsim.layers import bias, gain, nonlinearity, prescan_overscan, quantization_and_output

SIGMA = 5.0
SEEDS = 40


@pytest.fixture(scope="module")
def levels(small):
    """Deviations of 16 channels under 40 seeds, over their spread: {name: (640,)}."""
    detector = replace(small.detector, nonlinearity_cubic=-1e-13, nonlinearity_spread=0.3)
    camera = replace(small, chips={9: replace(small.chips[9], detector=detector)})
    found = {"bias": [], "gain": [], "quadratic": [], "cubic": []}
    for seed in range(SEEDS):
        rng = Streams(seed, "1", 9, "any")
        state = prescan_overscan.apply(flat_state(camera, 100.0), prescan_overscan.Param(), rng)
        nonlinearity.apply(state, nonlinearity.Param(nonlinearity_16channel=True), rng)
        header = gain.apply(bias.apply(state, bias.Param(), rng), gain.Param(), rng).header
        found["bias"].append((np.array(header["bias"]) - detector.bias) / detector.bias_spread)
        found["gain"].append((np.array(header["gain"]) / detector.gain - 1) / detector.gain_spread)
        for name in ("quadratic", "cubic"):
            value = getattr(detector, f"nonlinearity_{name}")
            ratio = np.array(header[f"nonlinearity_{name}"]) / value
            found[name].append((ratio - 1) / detector.nonlinearity_spread)
    return {name: np.ravel(values) for name, values in found.items()}


@pytest.mark.parametrize("name", ["bias", "gain", "quadratic", "cubic"])
def test_levels_are_uniform_within_their_spread(levels, name):
    values = levels[name]
    assert np.abs(values).max() <= 1 + 1e-9 and len(set(np.round(values, 9))) == len(values)
    assert abs(values.mean()) < SIGMA / np.sqrt(3 * len(values))
    assert values.std() == pytest.approx(3**-0.5, abs=SIGMA * np.sqrt(0.8 / 12 / len(values)))


def test_levels_of_one_thing_say_nothing_of_another_and_one_polynomial_has_one_scale(levels):
    for one, other in (("bias", "gain"), ("bias", "quadratic"), ("gain", "quadratic")):
        assert abs(np.corrcoef(levels[one], levels[other])[0, 1]) < SIGMA / np.sqrt(len(levels[one]))
    assert levels["cubic"] == pytest.approx(levels["quadratic"], abs=1e-9)


def test_the_mask_goes_into_the_readout_frame_and_knows_what_was_clipped(small):
    rng, state = Streams(3, "1", 9, "any"), flat_state(small, 100.0)
    state.mask = np.zeros(state.image.shape, np.uint8)
    state.mask[5, 7], state.image[5, 7] = 3, 1e6
    state = prescan_overscan.apply(state, prescan_overscan.Param(), rng)
    assert state.mask.shape == state.image.shape
    assert (state.mask[state.image == 1e6] == 3).all() and np.count_nonzero(state.mask) == 1
    state.image[state.image == 0] = -5.0
    below = state.image < 0
    state = quantization_and_output.apply(state, quantization_and_output.Param(), rng)
    assert np.array_equal(state.mask & CLIPPED > 0, below | (state.image == small.detector.adc_max))
    assert state.header["clipped_high"] == 1 and state.header["clipped_low"] == below.sum()


def test_without_a_mask_nothing_is_marked(small):
    state = run(flat_state(small, 100.0), [])
    assert prescan_overscan.apply(state, prescan_overscan.Param(), Streams(3, "1", 9, "any")).mask is None


def test_each_pixel_of_the_readout_frame_gets_the_polynomial_of_its_channel(small):
    """Prescan and overscan, too: charge that is left over comes out there."""
    detector = replace(small.detector, nonlinearity_cubic=-1e-13, nonlinearity_spread=0.3)
    camera = replace(small, chips={9: replace(small.chips[9], detector=detector)})
    rng, charge = Streams(3, "1", 9, "any"), 30_000.0
    state = prescan_overscan.apply(flat_state(camera, 100.0), prescan_overscan.Param(), rng)
    state.image[:] = charge
    header = nonlinearity.apply(state, nonlinearity.Param(nonlinearity_16channel=True), rng).header
    wanted = np.zeros(state.image.shape)
    for block in ReadoutFrame.of(detector, state.window).blocks:
        quadratic, cubic = (header[f"nonlinearity_{name}"][block.channel - 1] for name in ("quadratic", "cubic"))
        wanted[block.whole] = charge * (1 + charge * (quadratic + charge * cubic))
    np.testing.assert_allclose(state.image, wanted, rtol=3e-7)
    assert len(np.unique(state.image)) == 16


def test_the_signal_must_rise_in_the_channel_that_bends_most(small, make_pointing):
    """A slope of 0.1 at full well for the chip's polynomial: below 0 in a channel that bends 30% more."""
    detector = replace(
        small.detector, nonlinearity_quadratic=-0.45 / small.detector.full_well, nonlinearity_cubic=0.0,
        nonlinearity_spread=0.3,
    )  # fmt: skip
    camera = replace(small, detector=detector)
    nonlinearity.check(nonlinearity.Param(), camera, make_pointing())
    with pytest.raises(InputError, match="the signal falls with charge"):
        nonlinearity.check(nonlinearity.Param(nonlinearity_16channel=True), camera, make_pointing())
