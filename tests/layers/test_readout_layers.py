"""Each readout layer against its closed form."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from support.readout_state import change_exposure, flat_state, plain_layers, run

from csstsim.base.rng import Streams, stream
from csstsim.base.shipped import SHIPPED
from csstsim.detector.channels import ReadoutFrame
from csstsim.layers import bias, gain, poisson_and_dark, prescan_overscan, quantization_and_output
from csstsim.simulation.sim_steps import SimSteps

RNG = Streams(3, "1", 9, "layer")


@pytest.mark.parametrize(
    ("counted_mean", "expected"), [(0.0, 30.0), (30.0, 0.0), (12.5, 17.5)], ids=["expected", "counted", "mixed"]
)
def test_mean_equals_variance(camera, counted_mean, expected):
    """800 x 800 pixels; 5 sigma. 30 e- in all, dark 0.02 e-/s x 150 s on top."""
    state = flat_state(camera, expected, window=(0, 800, 0, 800))
    total = counted_mean + expected + camera.detector.dark * 150.0
    if counted_mean:
        state.counted = stream(1, "photons").poisson(counted_mean, state.image.shape).astype(np.int32)
    state = poisson_and_dark.apply(state, poisson_and_dark.Param(), RNG)
    n = state.image.size
    assert state.counted is None
    assert np.array_equal(state.image, np.rint(state.image))
    assert abs(state.image.mean(dtype=float) - total) < 5 * np.sqrt(total / n)
    assert abs(state.image.var(dtype=float) - total) < 5 * np.sqrt((total + 2 * total**2) / n)


def test_dark_current_is_of_the_exposures_time(small):
    state = poisson_and_dark.apply(flat_state(small, exptime=0.0), poisson_and_dark.Param(), RNG)
    assert (state.image == 0).all()
    state = poisson_and_dark.apply(flat_state(small, exptime=5e4), poisson_and_dark.Param(), RNG)
    expected = 5e4 * small.detector.dark
    assert abs(state.image.mean(dtype=float) - expected) < 5 * np.sqrt(expected / state.image.size)
    with pytest.raises(ValueError, match="greater than or equal to 0"):
        poisson_and_dark.Param(exptime=-1)


def test_forgotten_counted_electrons_are_refused(small):
    state = flat_state(small)
    state.counted = np.ones(state.image.shape, np.int32)
    with pytest.raises(ValueError, match="poisson_and_dark must come before"):
        prescan_overscan.apply(state, prescan_overscan.Param(), RNG)


@pytest.mark.parametrize("window", [None, (31, 33, 10, 40), (255, 256, 63, 64)])
def test_bias_and_gain_per_channel_or_chip(small, window):
    for many in (True, False):
        state = prescan_overscan.apply(flat_state(small, 0.0, window=window), prescan_overscan.Param(), RNG)
        state = bias.apply(state, bias.Param(bias_16channel=many), RNG)
        levels = np.array(state.header["bias"])
        assert len(levels) == 16
        assert len(set(levels)) == (16 if many else 1)
        assert (abs(levels - 500.0) <= 10.0).all()
        state = gain.apply(state, gain.Param(gain_16channel=many), RNG)
        gains = np.array(state.header["gain"])
        assert len(set(gains)) == (16 if many else 1)
        assert (abs(gains / 1.1 - 1) <= 0.01).all()
        assert state.unit == "DN"
        wanted = {np.float32(np.float32(b) / g) for b, g in zip(levels, gains, strict=True)}
        assert set(np.unique(state.image).tolist()) <= {
            float(v) for w in wanted for v in (w, np.nextafter(w, 0), np.nextafter(w, 999))
        }


def test_a_channel_keeps_its_levels_and_a_chip_its_own(small):
    """From exposure to exposure the same; of another chip or seed others; read noise and dark the other way round."""

    def levels(seed, obsid, chip):
        state = run(flat_state(small, 100.0, chip=chip), plain_layers(), seed=seed, obsid=obsid)
        return np.concatenate([state.header["bias"], state.header["gain"]]), state.image

    first, image = levels(5, "1", 9)
    again, other_image = levels(5, "2", 9)
    assert np.array_equal(first, again)
    # Per pixel two exposures differ by the noise of both, whatever the levels: their correlation is 0 within 5 sigma
    frame = ReadoutFrame.of(small.detector, None)
    for block in frame.blocks:
        one, other = (part[block.active].astype(float).ravel() for part in (image, other_image))
        assert abs(np.corrcoef(one, other)[0, 1]) < 5 / np.sqrt(one.size)
    assert (
        not np.intersect1d(first, levels(5, "1", 10)[0]).size and not np.intersect1d(first, levels(6, "1", 9)[0]).size
    )


def test_digitising_counts_what_it_clips(small):
    state = prescan_overscan.apply(flat_state(small, 100.0), prescan_overscan.Param(), RNG)
    state.image[0, 0], state.image[5, :3] = 1e6, -4.0
    state = quantization_and_output.apply(state, quantization_and_output.Param(layout="mosaic"), RNG)
    assert state.image.dtype == np.uint16
    assert state.image[0, 0] == 65535
    assert (state.header["clipped_high"], state.header["clipped_low"], state.header["layout"]) == (1, 3, "mosaic")


def test_a_chip_is_written_with_one_gain(small):
    """Electrons by the one gain are those by the channel's own, within the rounding of both, half a DN each."""
    state, other = (run(flat_state(small, 3000.0), plain_layers()[:-1]) for _ in range(2))
    gains, noise = np.array(state.header["gain"]), state.header["read_noise"]
    state = quantization_and_output.apply(state, quantization_and_output.Param(layout="chip"), RNG)
    other = quantization_and_output.apply(other, quantization_and_output.Param(), RNG)
    one = state.header["one_gain"]
    assert np.ptp(gains) > 0 and one == pytest.approx(gains.mean(), rel=1e-12)
    assert state.header["gain"] == [one] * 16 and state.header["one_read_noise"] == pytest.approx(noise[0], rel=1e-12)
    assert "one_gain" not in other.header and other.header["gain"] == gains.tolist()
    for block in ReadoutFrame.of(small.detector, None).blocks:
        pair = [image[block.whole].astype(float) for image in (state.image, other.image)]
        assert abs(pair[0] * one - pair[1] * gains[block.channel - 1]).max() < 1.1 * one
        assert abs(pair[0] - pair[1]).max() > 3 or abs(gains[block.channel - 1] / one - 1) < 1e-3


def channel_statistics(pair, region):
    """Return (mean, half the variance of the difference, pixels) of a region of two frames, as float."""
    one, other = (image[region].astype(float) for image in pair)
    return (one.mean() + other.mean()) / 2, np.var(one - other) / 2, one.size


@pytest.mark.parametrize("size", ["small", "real"])
def test_photon_transfer(small, camera, size):
    """Mean, variance, read noise and gain of each channel from a pair of flat frames, within 5 sigma.

    Per pixel, in DN: mean (bias + s) / g, variance (s + ron^2) / g^2 + 1/12, s = sky + dark; in the overscan s = 0.
    The error of a variance from n differences is variance x sqrt(2 / n); Poisson kurtosis adds under 1% of it.
    """
    camera, window = (small, None) if size == "small" else (camera, (1152, 2304, 4616, 9232))
    sky, dark, ron = 900.0, 3.0, camera.detector.read_noise
    states = [run(flat_state(camera, sky, window=window), plain_layers(), obsid=obsid) for obsid in ("1", "2")]
    pair = [state.image for state in states]
    frame = ReadoutFrame.of(camera.detector, states[0].window)
    for block in frame.blocks:
        g, b = (states[0].header[name][block.channel - 1] for name in ("gain", "bias"))
        mean, variance, n = channel_statistics(pair, block.active)
        over_mean, over_variance, m = channel_statistics(pair, block.serial_overscan)
        noise2 = ron**2 / g**2 + 1 / 12
        signal2 = (sky + dark) / g**2 + noise2
        assert abs(mean - (b + sky + dark) / g) < 5 * np.sqrt(signal2 / (2 * n))
        assert abs(variance - signal2) < 5 * signal2 * np.sqrt(2 / n)
        assert abs(over_mean - b / g) < 5 * np.sqrt(noise2 / (2 * m))
        assert abs(over_variance - noise2) < 5 * noise2 * np.sqrt(2 / m)
        recovered = (mean - over_mean) / (variance - over_variance)
        error = np.hypot(signal2 * np.sqrt(2 / n), noise2 * np.sqrt(2 / m)) / (signal2 - noise2)
        assert abs(recovered / g - 1) < 5 * np.hypot(error, np.sqrt(signal2 / (2 * n)) / mean)
        read_noise = recovered * np.sqrt(max(over_variance - 1 / 12, 0.0))
        assert abs(read_noise / ron - 1) < 5 * np.hypot(error, np.sqrt(1 / (2 * m)) * noise2 / (noise2 - 1 / 12))


def test_rounding_noise_is_counted(small):
    """At a read noise of 1 e- the 1/12 DN^2 is a tenth of the variance: eight times the error of 16384 pixels."""
    quiet = replace(small.detector, read_noise=1.0)
    states = [flat_state(small), flat_state(small)]
    for state in states:
        change_exposure(state, chip=replace(state.chip, detector=quiet))
    states = [run(state, plain_layers(off=["poisson_and_dark"]), obsid=str(i)) for i, state in enumerate(states, 1)]
    frame = ReadoutFrame.of(quiet, None)
    excess = []
    for block in frame.blocks:
        _, variance, _ = channel_statistics([state.image for state in states], block.active)
        excess.append(variance - (1.0 / states[0].header["gain"][block.channel - 1]) ** 2)
    assert abs(np.mean(excess) - 1 / 12) < 5 * 0.91 * np.sqrt(2 / 16384)
    assert np.mean(excess) > 3 * 0.91 * np.sqrt(2 / 16384)


def test_shipped_lists_have_every_layer_in_the_order_of_the_design_and_of_the_paper():
    names = {
        name: [step.name for step in SimSteps(SHIPPED / "observations" / f"{name}.yaml")]
        for name in ("science", "science_paper", "bias", "dark", "led_flat")
    }
    first = ["scie_obs", "sky_background", "prnu_effect", "cosmic_rays", "poisson_and_dark", "brighter_fatter"]
    charge, last = ["blooming", "cte_effect", "prescan_overscan"], ["bias", "readout_noise", "gain"]
    end = ["quantization_and_output"]
    assert names["science"] == [*first, "detector_defects", *charge, "nonlinearity", *last, *end]
    assert names["science_paper"] == [*first, "detector_defects", "nonlinearity", *charge, *last, *end]
    for name, lit in (("bias", []), ("dark", []), ("led_flat", ["led_calib_model"])):
        left = [layer for layer in names["science"] if layer in names[name]]
        assert names[name] == [*lit, *left]


def test_a_bias_exposure_has_no_light(small):
    state = run(flat_state(small, type="BIAS", exptime=0.0), plain_layers(off=["poisson_and_dark"]))
    g = np.mean(state.header["gain"])
    assert abs(state.image.mean() - np.mean(np.divide(state.header["bias"], state.header["gain"]))) < 5 * 5 / g / 150


def test_the_header_says_how_much_dark_current_there_is(small):
    state = poisson_and_dark.apply(flat_state(small, exptime=300.0), poisson_and_dark.Param(), RNG)
    assert state.header == {"dark_electrons": pytest.approx(300.0 * small.detector.dark)}
    assert small.detector.dark > 0


class Levels:
    """Streams whose uniform numbers from -1 to 1 are known: channel n gets n / 16 of the way, the chip -0.6."""

    def channel(self, number, name):
        return SimpleNamespace(uniform=lambda low, high: low + (high - low) * number / 16)

    def chip(self, name):
        return SimpleNamespace(uniform=lambda low, high: low + (high - low) * 0.2)


def test_each_channel_has_its_own_bias_and_gain(small):
    """Pixel by pixel; the mosaic's channels are 1 to 8 from the left below, 16 to 9 above."""
    state, numbers = flat_state(small), small.detector
    state.image = np.full(ReadoutFrame.of(numbers, None).shape, 40.0, np.float32)
    bias.apply(state, bias.Param(), Levels())
    levels = numbers.bias + numbers.bias_spread * (np.arange(1, 17) / 8 - 1)
    assert state.header["bias"] == pytest.approx(levels)
    rows, columns = (n // k for n, k in zip(state.image.shape, (2, 8), strict=True))
    in_channel = np.vstack([np.repeat(order, columns) * np.ones((rows, 1)) for order in (levels[:8], levels[:7:-1])])
    np.testing.assert_allclose(state.image, 40.0 + in_channel, rtol=1e-6)
    state.image[:] = 40.0
    gain.apply(state, gain.Param(), Levels())
    gains = numbers.gain * (1 + numbers.gain_spread * (np.arange(1, 17) / 8 - 1))
    in_channel = np.vstack([np.repeat(order, columns) * np.ones((rows, 1)) for order in (gains[:8], gains[:7:-1])])
    np.testing.assert_allclose(state.image, 40.0 / in_channel, rtol=1e-6)
    assert state.header["gain"] == pytest.approx(gains) and state.unit == "DN"
    bias.apply(state, bias.Param(bias_16channel=False), Levels())
    assert state.header["bias"] == pytest.approx([numbers.bias - 0.6 * numbers.bias_spread] * 16)


@pytest.mark.parametrize("overscan", [3, 0])
def test_the_most_that_a_bias_map_adds_beside_the_level(overscan):
    """Two rows of two channels of 4 x 5 active pixels, 2 of prescan, 1 row of parallel overscan; numbers by hand.

    Channel 1 has 3 e- more on its active pixels, the overscan of all is 1 e- high.
    """
    readout = ReadoutFrame((0, 8, 0, 10), 8, 10, 2, 2, 4, 5, 2, overscan, 1)
    structure = np.zeros(readout.shape, np.float32)
    for block in readout.blocks:
        structure[block.serial_overscan] = 1.0
    structure[readout.blocks[0].active] = 3.0
    # Of a block the sum is 15 of 54 pixels: 39 e- from a level of 1; with the light 3 x 20 above the level of 0
    wanted = 75.0 + 3 * 39.0 if overscan else 60.0
    assert bias._largest_sum(structure, readout) == wanted
    assert bias._largest_sum(-structure, readout) == wanted
    structure[:] = 0.0
    structure[readout.blocks[0].active], structure[readout.blocks[0].prescan] = 3.0, -4.0
    assert bias._largest_sum(structure, readout) == 60.0  # of the light; of the block 60 less 10 x 4


def test_the_noise_of_a_chip_is_the_rms_of_its_channels(small):
    """Without gains in the header nothing is scaled."""
    state = prescan_overscan.apply(flat_state(small, 300.0), prescan_overscan.Param(), RNG)
    state.header["read_noise"] = [1.0] * 8 + [7.0] * 8
    param = quantization_and_output.Param(layout="chip", sip=True, compress=True)
    state = quantization_and_output.apply(state, param, RNG)
    assert state.header["one_read_noise"] == pytest.approx(5.0) and "one_gain" not in state.header
    assert state.header["sip"] is True and state.header["compress"] is True and state.header["layout"] == "chip"
    assert set(np.unique(state.image)) == {0, 300}


def test_a_list_that_says_nothing_means_the_layers_usual_numbers():
    assert bias.Param().bias_16channel is True and gain.Param().gain_16channel is True
    usual = quantization_and_output.Param()
    assert (usual.layout, usual.mask, usual.compress, usual.sip) == ("channels", False, False, False)
    state_of = quantization_and_output.Param.model_validate
    with pytest.raises(ValueError, match="layout"):
        state_of({"layout": "tiles"})
