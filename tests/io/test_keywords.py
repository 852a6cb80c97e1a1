"""Header values of the orbit and of the channels, against closed forms and by name."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.units import EARTH_GM_KM3_S2, EARTH_RADIUS_KM
from csstsim.io.keywords import _exposure, header_values
from csstsim.io.level0 import Level0


@pytest.mark.parametrize("exptime", [0.0, 150.0, 1500.0])
def test_a_circular_orbit_goes_on_during_the_exposure(make_pointing, exptime):
    """By its mean motion: place, velocity and height at the end, to a metre."""
    radius = EARTH_RADIUS_KM + 400.0
    speed = np.sqrt(EARTH_GM_KM3_S2 / radius)
    pointing = make_pointing(
        exptime=exptime, sat_position=(radius, 0.0, 0.0), sat_velocity=(0.0, 0.6 * speed, 0.8 * speed)
    )
    values = _exposure(pointing)
    turn = speed / radius * exptime
    place = radius * np.array([np.cos(turn), 0.6 * np.sin(turn), 0.8 * np.sin(turn)])
    velocity = speed * np.array([-np.sin(turn), 0.6 * np.cos(turn), 0.8 * np.cos(turn)])
    for k, axis in enumerate("xyz"):
        assert values[f"position_end_{axis}"] == pytest.approx(place[k], abs=1e-3)
        assert values[f"velocity_end_{axis}"] == pytest.approx(velocity[k], abs=1e-6)
        assert values[f"position_start_{axis}"] == pointing.sat_position[k]
    assert values["altitude_start"] == pytest.approx(400.0) and values["altitude_end"] == pytest.approx(400.0, abs=1e-3)
    assert (values["mjd_end"] - values["mjd_start"]) * 86400 == pytest.approx(exptime, abs=1e-4)


def test_a_bias_in_electrons_is_said_in_dn(camera, make_pointing):
    state = SimpleNamespace(
        header={"bias": [500.0, 480.0], "gain": [1.1, 1.2]}, pointing=make_pointing(), chip=camera.chips[9],
        window=SimpleNamespace(x0=0, x1=10, y0=5, y1=20), mask=None, telescope=camera.telescope,
        wcs=SimpleNamespace(distortion=None),
    )  # fmt: skip
    values = header_values(state, {}, "channels")
    assert values["bias_adu"] == pytest.approx([500 / 1.1, 400.0])
    assert [values[f"window_{end}"] for end in ("x_first", "x_last", "y_first", "y_last")] == [1, 10, 6, 20]


def test_the_terms_of_the_nonlinearity_are_told_apart():
    header = {"NLQ01": -1e-7, "NLC01": 2e-13, "NLQ02": -3e-7, "NLC02": 4e-13, "NLQ03": 1.0, "GAIN01": 1.1}
    file = Level0(Path("x.fits"), {}, header, SimpleNamespace(n_channels=3), "channels", None)
    assert file.nonlinearity == {1: (-1e-7, 2e-13), 2: (-3e-7, 4e-13)}
    assert file.gain == {1: 1.1}
