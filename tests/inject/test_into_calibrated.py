"""Light in a calibrated image: rate, error and saturation in closed form."""

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.inject.calibrated import Planes, check_planes, into_calibrated
from csstsim.inject.light import Light
from csstsim.instrument.chip import Window
from csstsim.measure.calibration.bad_pixels import BAD, FULL

TIME, SHARE = 100.0, 0.5
WINDOW = Window(0, 4, 0, 3)


def planes(sci=0.0, err=0.3):
    dq = np.zeros(WINDOW.shape, np.uint8)
    dq[0, 0] = BAD
    return Planes(np.full(WINDOW.shape, sci, np.float32), np.full(WINDOW.shape, err, np.float32), dq)


def light_at(pixel, electrons):
    electrons = np.array(electrons, np.float32)
    return Light(np.array(pixel), electrons, electrons, None, None, None)


def test_an_electron_stands_for_those_that_the_response_lost():
    given = planes()
    made = into_calibrated(
        given, light_at([0, 5], [400.0, 900.0]), TIME, background=0.2, limit=9e4, response=np.full(2, SHARE, np.float32)
    )
    sci, err, dq = made
    assert sci.ravel()[[0, 5]] == pytest.approx([8.0, 18.0]) and np.count_nonzero(sci) == 2
    assert err.ravel()[[0, 5]] == pytest.approx(np.sqrt(0.09 + np.array([400.0, 900.0]) / (SHARE * TIME) ** 2))
    assert np.array_equal(dq, given[2]) and err.ravel()[1] == np.float32(0.3)
    assert not any(np.shares_memory(new, old) for new, old in zip(made, given, strict=True)) and not given[0].any()


def test_a_full_pixel_has_what_the_well_holds():
    sci, _, dq = into_calibrated(planes(), light_at([5, 6], [6e4, 8e4]), TIME, background=1.0, limit=7e4)
    assert sci.ravel()[5] == pytest.approx(600.0) and sci.ravel()[6] == pytest.approx(7e4 / TIME - 1.0)
    assert dq.ravel()[5] == 0 and dq.ravel()[6] == FULL and dq[0, 0] == BAD


def test_what_no_image_may_have():
    good, header = planes(), {"BUNIT": "electron/s"}
    check_planes("image", good, header, WINDOW)
    for fault, key in (
        ((good, {}), "BUNIT"), ((planes(err=0.0), header), "ERR"), ((planes(err=np.nan), header), "ERR"),
        ((good._replace(sci=good.sci[:1]), header), "SCI"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=key):
            check_planes("image", *fault, WINDOW)


def test_a_full_pixel_keeps_its_bits_and_holds_less_light_where_the_response_is_small():
    """The well is of counted electrons: 7e4 of them stand for 14e4 of light; the other pixel just fills it."""
    given = planes(sci=5.0)
    given[2].ravel()[6] = BAD
    made = into_calibrated(
        given, light_at([5, 6], [69_400.0, 8e4]), TIME, background=1.0, limit=7e4, response=np.full(2, SHARE, "f4")
    )  # fmt: skip
    sci, _, dq = made
    most = 7e4 / (SHARE * TIME) - 1.0
    assert sci.ravel()[[5, 6]] == pytest.approx([5.0 + 69_400 / (SHARE * TIME), most]) and sci.ravel()[4] == 5.0
    assert dq.ravel()[5:7].tolist() == [0, BAD | FULL] and sci.ravel()[5] < most


def test_light_below_zero_takes_rate_and_leaves_the_error():
    sci, err, _ = into_calibrated(planes(sci=1.0), light_at([7], [-30.0]), TIME, background=0.0, limit=7e4)
    assert sci.ravel()[7] == pytest.approx(0.7) and err.ravel()[7] == np.float32(0.3)


@pytest.mark.parametrize(("err", "dq"), [(np.inf, 3), (-0.3, 3), (0.3, 2)])
def test_errors_and_bits_that_no_image_may_have(err, dq):
    sci, errors, bits = planes(err=err)
    with pytest.raises(InputError, match="ERR" if dq == 3 else "DQ"):
        check_planes("image", Planes(sci, errors, bits[:dq]), {"BUNIT": "electron/s"}, WINDOW)
