"""LED exposures: the light of the lamps, errors of a wrong list, and recovery of the flat."""

import numpy as np
import pytest
from support.readout_state import flat_state, run

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.base.shipped import SHIPPED
from csstsim.detector.prnu import multiply
from csstsim.instrument.filter import GRID
from csstsim.layers import led_calib_model
from csstsim.optics.throughput.flat import FlatField
from csstsim.optics.throughput.led import load_leds
from csstsim.simulation.exposure import Losses
from csstsim.simulation.sim_steps import SimSteps

STREAMS = Streams(5, "1", 9, "led_calib_model")


def lit(camera, types, times, chip=9):
    state = flat_state(camera, chip=chip)
    param = led_calib_model.Param(LED_TYPE=types, LED_TIME=times)
    return led_calib_model.apply(state, param, STREAMS)


def test_light_of_lamps_adds_in_proportion_to_time(small):
    one, two, both = (
        lit(small, *x).image for x in ((["590"], [7.0]), (["670"], [20.0]), (["590", "670"], [7.0, 20.0]))
    )
    np.testing.assert_allclose(both, one + two, rtol=1e-6)
    np.testing.assert_allclose(lit(small, ["590"], [14.0]).image, 2 * one, rtol=1e-6)
    expected = (
        7.0 * 2000 * small.filters["r"].at(5900.0)
    )  # photons / s of leds.yaml through the filter, flat over the line
    assert one.mean(dtype=float) == pytest.approx(expected, rel=0.1)  # the flat is 1 within some per cent


def test_a_filter_shuts_lamps_out(small):
    assert not lit(small, ["275"], [30.0]).image.any()  # r
    assert lit(small, ["275"], [30.0], chip=12).image.min() > 1000  # NUV


def test_header_says_what_was_lit_and_what_was_guessed(small):
    header = lit(small, ["760", "880"], [1.0, 2.5]).header
    assert header["led_type"] == ["760", "880"] and header["led_time"] == [1.0, 2.5] and header["led_guessed"] == "880"
    assert lit(small, ["1050"], [1.0]).header["led_guessed"] == "none"


@pytest.mark.parametrize(
    ("types", "times", "match"),
    [(["555"], [1.0], "LED_TYPE.*555.*275, 310"), (["590"], [151.0], "longer than the exposure of 2027")],
)
def test_unknown_lamps_and_long_times_are_refused(small, types, times, match):
    with pytest.raises(InputError, match=match):
        lit(small, types, times)


def test_numbers_of_the_flat_are_checked_before_any_work(small, make_pointing):
    from dataclasses import replace

    wrong = replace(small, leds=small.leds | {"flat": {}})
    with pytest.raises(InputError, match=r"leds\.yaml"):
        led_calib_model.check(led_calib_model.Param(), wrong, make_pointing(type="FLAT"))


@pytest.mark.parametrize(
    ("types", "times", "match"),
    [
        (["590"], [1.0, 2.0], "1 lamps, LED_TIME 2 times"), (["590", "590"], [1.0, 2.0], "twice"),
        (["590"], [-1.0], "within 0"), ([], [], "at least 1"), (["590"], [float("nan")], "finite"),
    ],
)  # fmt: skip
def test_impossible_lists_are_refused(types, times, match):
    with pytest.raises(ValueError, match=match):
        led_calib_model.Param(LED_TYPE=types, LED_TIME=times)


@pytest.mark.parametrize("chip", [9, 12, 15])  # r, NUV, y
def test_a_flat_exposure_divided_by_the_model_flat_is_flat_within_noise(small, chip):
    """Through the shipped list up to Poisson noise; chi2 of all pixels within 5 sigma of their number."""
    steps = SimSteps(SHIPPED / "observations" / "led_flat.yaml", "FLAT")
    state = flat_state(small, chip=chip)
    state = run(state, [step for step in steps if step.name in ("led_calib_model", "poisson_and_dark")], seed=5)
    field, leds = FlatField(small.leds, STREAMS.camera), load_leds(small.leds)
    param = next(step.param for step in steps if step.name == "led_calib_model")
    model = np.zeros(state.image.shape)
    for name, seconds in zip(param.LED_TYPE, param.LED_TIME, strict=True):
        seen = leds[name].line * state.filter.at(GRID)
        if seen.any():
            flat = field.led_map(state.chip, state.window, GRID, seen)
            model += seconds * leds[name].rate * np.trapezoid(seen, GRID) * flat
    level = state.image.mean(dtype=float)
    assert level > 5000
    ratio = (state.image - state.header["dark_electrons"]) / model
    chi2 = ((ratio - 1) ** 2 * model).sum()
    assert abs(chi2 - model.size) < 5 * np.sqrt(2 * model.size)
    assert abs(ratio.mean() - 1) < 5 / np.sqrt(model.sum())


def test_lamps_light_pixels_by_their_response(small):
    """With PRNU in the list each pixel counts its own share of the lamp's light, that of the sky's."""
    plain, state = lit(small, ["670"], [10.0]), flat_state(small, losses=Losses(prnu=True))
    seen = led_calib_model.apply(state, led_calib_model.Param(LED_TYPE=["670"], LED_TIME=[10.0]), STREAMS)
    ratio = seen.image / plain.image
    wanted = np.ones(ratio.shape, np.float32)
    multiply(wanted, state.window.x0, state.window.y0, state.chip.detector.prnu, STREAMS.chip_key("prnu"))
    np.testing.assert_allclose(ratio, wanted, rtol=1e-5)
    assert ratio.std() == pytest.approx(small.detector.prnu, rel=0.05)


def test_lamps_add_to_what_is_there_and_the_header_says_so(small):
    state = flat_state(small, 70.0)
    led_calib_model.apply(state, led_calib_model.Param(LED_TYPE=["590"], LED_TIME=[7.0]), STREAMS)
    np.testing.assert_allclose(state.image, 70.0 + lit(small, ["590"], [7.0]).image, rtol=1e-6)
    assert state.header["led_flag"] is True
    assert lit(small, ["275"], [30.0]).header["led_flag"] is True


def test_lamps_may_be_lit_for_all_of_the_exposure_and_no_longer_together(small):
    lit(small, ["590", "670"], [75.0, 75.0])
    pointing, param = flat_state(small).pointing, led_calib_model.Param(LED_TYPE=["590", "670"], LED_TIME=[75.5, 75.0])
    with pytest.raises(InputError, match=r"LED_TIME.*150\.5"):
        led_calib_model.check(param, small, pointing)
    with pytest.raises(InputError, match="unknown lamp"):
        led_calib_model.check(led_calib_model.Param(LED_TYPE=["591"], LED_TIME=[1.0]), small, pointing)
    led_calib_model.check(led_calib_model.Param(LED_TYPE=["670"], LED_TIME=[150.0]), small, pointing)


def test_a_list_without_numbers_lights_one_lamp_for_ten_seconds():
    assert led_calib_model.Param().model_dump() == {"LED_TYPE": ["670"], "LED_TIME": [10.0]}
    assert led_calib_model.Param(LED_TYPE=[670], LED_TIME=[1]).LED_TYPE == ["670"]
    with pytest.raises(ValueError, match="within 0 and 1e5 s"):
        led_calib_model.Param(LED_TYPE=["670"], LED_TIME=[100_001.0])
    led_calib_model.Param(LED_TYPE=["670"], LED_TIME=[0.0])


def test_a_lamp_that_is_not_lit_shines_no_light(small):
    assert not lit(small, ["590"], [0.0]).image.any()
    np.testing.assert_array_equal(lit(small, ["590", "670"], [0.0, 3.0]).image, lit(small, ["670"], [3.0]).image)
