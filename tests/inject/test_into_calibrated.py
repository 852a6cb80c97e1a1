"""Light in a calibrated image: rate, error and saturation in closed form."""

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.inject.calibrated import check_planes, into_calibrated
from csstsim.inject.light import Light
from csstsim.instrument.chip import Window
from csstsim.measure.calibration.bad_pixels import BAD, FULL

TIME, SHARE = 100.0, 0.5
WINDOW = Window(0, 4, 0, 3)


def planes(sci=0.0, err=0.3):
    dq = np.zeros(WINDOW.shape, np.uint8)
    dq[0, 0] = BAD
    return np.full(WINDOW.shape, sci, np.float32), np.full(WINDOW.shape, err, np.float32), dq


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
        (((good[0][:1], *good[1:]), header), "SCI"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=key):
            check_planes("image", *fault, WINDOW)
