"""Overscan, gain and saturation on fabricated frames; every channel has its own bias and gain."""

import numpy as np
import pytest
from support.even_response import EvenResponse

from csstsim.base.errors import InputError
from csstsim.base.rng import stream
from csstsim.detector.channels import ReadoutFrame
from csstsim.measure.calibration.calibrate import Corrections, Electronics, calibrate, overscan_level

SMALL = {
    "nx": 320, "ny": 160, "channels_x": 8, "channels_y": 2, "channel_nx": 40, "channel_ny": 80,
    "prescan": 5, "overscan": 30, "parallel_overscan": 8,
}  # fmt: skip


def make_frame(window, seed, read_noise=5.0):
    """A raw frame of known electrons: bias 450 + channel DN, gain 1.0 + channel / 100, read noise in electrons."""
    readout = ReadoutFrame(window=window, **SMALL)
    rng = stream(seed, "calibrate")
    x0, x1, y0, y1 = window
    electrons = rng.poisson(200.0, (y1 - y0, x1 - x0)).astype(np.float64)
    frame = readout.embed(electrons) + rng.normal(0.0, read_noise, readout.shape)
    gain = {}
    for block in readout.blocks:
        gain[block.channel] = 1.0 + block.channel / 100.0
        frame[block.whole] = frame[block.whole] / gain[block.channel] + 450.0 + block.channel
    return np.rint(frame).astype(np.uint16), readout, gain, electrons


@pytest.mark.parametrize("window", [(0, 320, 0, 160), (13, 250, 60, 150), (100, 101, 3, 80)])
def test_electrons_are_recovered_in_every_channel(window):
    frame, readout, gain, electrons = make_frame(window, 1)
    result = calibrate(frame, readout, Electronics(gain))
    assert result.electrons.dtype == np.float32 and result.electrons.shape == electrons.shape
    for block in readout.blocks:
        overscan = frame[block.serial_overscan]
        n = overscan.shape[0] * (overscan.shape[1] - 4)
        sigma = np.sqrt(25.0 + gain[block.channel] ** 2 / 12)  # read noise and rounding, electron
        assert abs(result.bias[block.channel] - 450.0 - block.channel) < 5 * sigma / np.sqrt(n) / gain[block.channel]
        assert abs(result.read_noise[block.channel] - sigma) < 5 * sigma / np.sqrt(2 * n)
        residual = (result.electrons[block.image] - electrons[block.image]).astype(float)
        error = sigma * np.sqrt(1 / residual.size + 1 / n)
        assert abs(residual.mean()) < 5 * error  # electron


def test_sigma_is_the_scatter_of_the_pixels():
    frame, readout, gain, _ = make_frame((0, 320, 0, 160), 2)
    result = calibrate(frame, readout, Electronics(gain))
    expected = np.sqrt(200.0 + 25.0)
    assert result.electrons.std() == pytest.approx(expected, rel=0.02)  # 51200 pixels: 5 sigma = 1.6 %
    assert np.sqrt(np.mean(result.sigma() ** 2.0)) == pytest.approx(expected, rel=0.01)


def test_charge_leaked_into_the_overscan_does_not_shift_the_bias():
    for from_right in (False, True):
        pixels = stream(3, "overscan").normal(460.0, 4.5, (300, 30)).round()
        pixels[:, [-1, -2] if from_right else [0, 1]] += 40.0  # deferred charge next to the active pixels
        pixels[7, 15] = 60000.0  # a cosmic ray
        level, scatter = overscan_level(pixels, from_right=from_right)
        assert abs(level - 460.0) < 5 * 4.5 / np.sqrt(300 * 26)
        assert scatter == pytest.approx(4.5, rel=0.05)


def test_saturation_from_the_converter_and_from_the_well():
    frame, readout, gain, _ = make_frame((0, 320, 0, 160), 4)
    block = readout.blocks[5]
    row, col = block.active[0].start + 3, block.active[1].start + 2
    frame[row, col] = 65535
    frame[row, col + 1] = 60000
    y, x = block.image[0].start + 3, block.image[1].start + 2
    assert np.argwhere(calibrate(frame, readout, Electronics(gain)).saturated).tolist() == [[y, x]]
    well = calibrate(frame, readout, Electronics(gain, full_well=50000.0)).saturated
    assert np.argwhere(well).tolist() == [[y, x], [y, x + 1]]


def test_bad_input_is_named():
    frame, readout, gain, _ = make_frame((0, 320, 0, 160), 5)
    with pytest.raises(InputError, match="GAIN03"):
        calibrate(frame, readout, Electronics(gain | {3: float("nan")}))
    with pytest.raises(InputError, match="shape"):
        calibrate(frame[1:], readout, Electronics(gain))


@pytest.mark.parametrize(("gain", "lines", "key"), [(1e308, (0.0, 0.0), "GAIN"), (1.0, None, "NLQ")])
def test_what_a_header_may_not_say_of_a_channel(gain, lines, key):
    frame, readout, gains, _ = make_frame((0, 320, 0, 160), 1)
    last = readout.blocks[-1].channel
    nonlinearity = {channel: (0.0, 0.0) for channel in gains} | {last: lines}
    nonlinearity = {channel: pair for channel, pair in nonlinearity.items() if pair}
    with pytest.raises(InputError, match=f"{key}{last:02d}"):
        calibrate(frame, readout, Electronics(gains | {last: gain}, nonlinearity=nonlinearity, full_well=90_000))


@pytest.mark.parametrize("part", [0.0, 0.15, 0.37, 0.5, 0.81])
def test_the_level_is_known_to_a_part_of_a_digit(part):
    """Whole DN of a level in between: the mean of 300,000 is good to 0.013 DN (5 sigma), whatever the part."""
    pixels = (460.0 + part + stream(4, "part of a digit").normal(0.0, 1.4, (10_000, 32))).round()
    level, _ = overscan_level(pixels)
    assert abs(level - 460.0 - part) < 5 * np.hypot(1.4, 12**-0.5) / np.sqrt(10_000 * 30)


@pytest.mark.parametrize("fraction", [1.0, 0.5, 0.25])
def test_sigma_is_the_scatter_where_light_was_lost(fraction):
    """Electrons are divided by the fraction that was counted, and their noise with them: read noise, too."""
    frame, readout, gain, _ = make_frame((0, 320, 0, 160), 6)
    result = calibrate(frame, readout, Electronics(gain), Corrections(response=EvenResponse(fraction, 320)))
    assert result.electrons.mean() == pytest.approx(200.0 / fraction, rel=0.01)
    assert result.electrons.std() == pytest.approx(np.sqrt(np.mean(result.sigma() ** 2.0)), rel=0.02)


@pytest.mark.parametrize("from_right", [False, True])
def test_a_little_leaked_charge_is_left_out_next_to_the_active_pixels(from_right):
    """8 DN, less than two sigma, which no clipping sees, in the two columns next to them: 0.5 DN on the mean of all."""
    pixels = stream(7, "leak").normal(460.0, 4.5, (3000, 30))
    pixels[:, [-1, -2] if from_right else [0, 1]] += 8.0
    level, _ = overscan_level(pixels.round(), from_right=from_right)
    assert abs(level - 460.0) < 5 * 4.5 / np.sqrt(3000 * 26)


def test_an_offset_of_the_bias_is_in_electrons():
    frame, readout, gain, _ = make_frame((0, 320, 0, 160), 8)
    offset = {block.channel: 1.0 + block.channel for block in readout.blocks}
    plain, moved = (
        calibrate(frame, readout, Electronics(gain), Corrections(offset=given)).electrons for given in (None, offset)
    )
    for block in readout.blocks:
        assert (plain - moved)[block.image] == pytest.approx(offset[block.channel], abs=1e-3)


def test_each_dn_is_what_the_equations_say_of_it():
    """All 65536 values over the channels, each with its own zero, gain and polynomial, in double precision."""
    readout = ReadoutFrame(window=(0, 320, 0, 160), **SMALL)
    frame = stream(9, "bias").normal(450.0, 3.0, readout.shape).round().astype(np.uint16)
    active = np.arange(160 * 320).reshape(160, 320) * 65535 // (160 * 320 - 1)
    for block in readout.blocks:
        frame[block.active] = active[block.image]
    gain = {n: 1.0 + n / 50 for n in range(1, 17)}
    curves = {n: (-1e-7 * n, 0.0) for n in gain}
    well = 60_000.0
    result = calibrate(frame, readout, Electronics(gain, nonlinearity=curves, adc_max=65000, full_well=well))
    for block in readout.blocks:
        n, dn = block.channel, active[block.image]
        signal, quadratic = (dn - result.bias[n]) * gain[n], curves[n][0]
        root = (-1 + np.sqrt(1 + 4 * quadratic * np.clip(signal, 0, well + quadratic * well**2))) / (2 * quadratic)
        beyond = (signal - well - quadratic * well**2) / (1 + 2 * quadratic * well)
        charge = np.where(signal < 0, signal, np.where(beyond > 0, well + beyond, root))
        assert result.electrons[block.image] == pytest.approx(charge, rel=3e-7, abs=2e-4)
        full = (charge >= well) | (dn >= 65000)
        edge = np.abs(charge - well) < 0.05  # a rounding decides
        assert np.array_equal(result.saturated[block.image][~edge], full[~edge])


@pytest.mark.parametrize("window", [(0, 320, 7, 8), (319, 320, 0, 160)])
def test_one_row_or_column_all_of_it_saturated(window):
    frame, readout, gain, _ = make_frame(window, 10)
    for block in readout.blocks:
        frame[block.active] = 65535
    result = calibrate(frame, readout, Electronics(gain, full_well=90_000.0))
    assert result.saturated.all() and (result.electrons > 60_000).all()


@pytest.mark.parametrize("kind", [np.uint16, float])
@pytest.mark.parametrize("count", [1, 2, 7, 4000])
def test_level_and_scatter_are_those_of_the_clipped_pixels(kind, count):
    """By numpy's median, mean and std of the pixels themselves; of few, and where most are the same."""
    for spread in (0.0, 0.3, 6.0):
        pixels = stream(count, "scan").normal(450.3, spread, (count, 6)).round().astype(kind)
        pixels[0, 0] = 65535
        away = np.abs(pixels - np.median(pixels))
        kept = pixels[away <= 4 * max(1.4826 * np.median(away), 1.0)].astype(float)
        assert overscan_level(pixels) == pytest.approx((kept.mean(), kept.std()), rel=1e-12, abs=1e-12)


def test_without_overscan_the_levels_are_those_given():
    """Each channel its own bias and read noise; electrons exact."""
    readout = ReadoutFrame(window=(0, 320, 0, 160), **SMALL).of_file("chip")
    levels = {block.channel: (100.0 + block.channel, 5.0 + block.channel) for block in readout.blocks}
    frame = np.empty(readout.shape, np.uint16)
    for block in readout.blocks:
        frame[block.active] = 100 + block.channel + 50
    result = calibrate(frame, readout, Electronics(dict.fromkeys(levels, 1.5), levels=levels))
    np.testing.assert_allclose(result.electrons, 75.0, rtol=1e-6)
    assert result.bias == {n: level for n, (level, _) in levels.items()}
    assert result.read_noise == {n: noise for n, (_, noise) in levels.items()}
    with pytest.raises(InputError, match="overscan"):
        calibrate(frame, readout, Electronics(dict.fromkeys(levels, 1.5)))


class Slope:
    """Stands for optics.throughput.response.Response: rises from 0.4 by 0.002 a row and 0.001 a column."""

    def __init__(self, shape):
        self.map = (0.4 + 0.002 * np.arange(shape[0])[:, None] + 0.001 * np.arange(shape[1])).astype(np.float32)

    def rows(self, first, last):
        return self.map[first:last]

    def at(self, row, column):
        return self.map[row, column]


def test_a_response_is_that_of_each_pixel_and_of_the_nearest_one():
    frame, readout, gain, _ = make_frame((0, 320, 0, 160), 21)
    slope = Slope((160, 320))
    plain, result = (
        calibrate(frame, readout, Electronics(gain)),
        calibrate(frame, readout, Electronics(gain), Corrections(response=slope)),
    )
    np.testing.assert_allclose(result.electrons, plain.electrons / slope.map, rtol=1e-5)
    fraction = result.counted(np.array([10.4, 10.6, -5.0, 999.0]), np.array([100.0, 100.0, 3.4, 999.0]))
    assert fraction == pytest.approx([0.61, 0.611, 0.406, 0.4 + 0.318 + 0.319], abs=1e-6)
    assert plain.counted(np.zeros(3), np.zeros(3)).tolist() == [1.0, 1.0, 1.0]
    noise = np.array([result.read_noise[block.channel] for block in readout.blocks])
    block = readout.blocks[3]
    pixel = block.image[0].start + 5, block.image[1].start + 7
    light = max(plain.electrons[pixel], 0.0)
    assert result.sigma()[pixel] == pytest.approx(np.sqrt(light + noise[3] ** 2) / slope.map[pixel], rel=1e-4)


def test_structure_of_the_bias_is_subtracted_in_electrons():
    """20 e- more on the active pixels of one row, 5 on all of the overscan: levels and pixels without them."""
    frame, readout, gain, _ = make_frame((0, 320, 0, 160), 22)
    structure = np.zeros(readout.shape)
    for block in readout.blocks:
        structure[block.serial_overscan] = 5.0
    block = readout.blocks[2]
    rows, columns = block.active
    structure[rows.start + 3, columns] = 20.0
    plain, result = (
        calibrate(frame, readout, Electronics(gain)),
        calibrate(frame, readout, Electronics(gain), Corrections(structure=structure)),
    )
    for one in readout.blocks:
        n = one.channel
        assert result.bias[n] == pytest.approx(plain.bias[n] - 5.0 / gain[n], abs=0.05)
    difference = plain.electrons - result.electrons
    line, columns = block.image[0].start + 3, block.image[1]
    assert difference[line, columns] == pytest.approx(15.0, abs=0.1)
    difference[line, columns] = -5.0
    np.testing.assert_allclose(difference, -5.0, atol=0.1)


def test_defects_and_full_pixels_are_marks_of_their_own():
    frame, readout, gain, _ = make_frame((0, 320, 0, 160), 23)
    block = readout.blocks[0]
    frame[block.active][4, 6] = 65535
    bad = np.zeros((160, 320), bool)
    bad[7, 9] = True
    result = calibrate(frame, readout, Electronics(gain), Corrections(bad=bad))
    assert np.argwhere(result.bad).tolist() == [[7, 9]]
    position = block.image[0].start + 4, block.image[1].start + 6
    assert np.argwhere(result.saturated).tolist() == [list(position)]
    moved = calibrate(
        frame,
        readout,
        Electronics(gain),
        Corrections(correct=lambda electrons: np.multiply(electrons, 2, out=electrons)),
    )
    np.testing.assert_allclose(moved.electrons, 2 * result.electrons, rtol=1e-6)
