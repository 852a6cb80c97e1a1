"""Satellites: draws of a track that know nothing of each other, and every exposure with satellites of its own."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from scipy.stats import spearmanr

from csstsim.base.shipped import SHIPPED
from csstsim.universe.changing.numbers import numbers_of
from csstsim.universe.changing.satellites import crossing

START, BORESIGHT, RADIUS = 61000.0, (30.0, -40.0), np.radians(0.8)


def tracks(growth, start=START, boresight=BORESIGHT, seed=5):
    numbers = numbers_of(SHIPPED / "universe", "satellites") | {"growth": growth}
    return crossing(seed, start, 150.0, boresight, RADIUS, 2.0, numbers)


def test_the_draws_of_a_track_know_nothing_of_each_other():
    """Distance, speed, time, brightness at 1000 km, direction and side of a thousand tracks: no rank correlation."""
    many = tracks(5000.0)
    km, angle = many["distance"], np.radians(many["angle"])
    there, centre = SkyCoord(many["ra"] * u.deg, many["dec"] * u.deg), SkyCoord(*BORESIGHT, unit="deg")
    apart = centre.separation(there).deg
    right = apart * np.sin(there.position_angle(centre).rad - angle)  # positive: the boresight is to the right
    draws = {
        "distance": km, "speed": many["speed"] * km, "time": many["time"], "V": many["V"] - 5 * np.log10(km / 1000),
        "east": np.sin(angle), "north": np.cos(angle), "side": right, "apart": apart,
    }  # fmt: skip
    assert len(km) == 1000
    found = spearmanr(np.stack(list(draws.values())), axis=1).statistic - np.eye(len(draws))
    assert np.abs(found).max() < 5 / np.sqrt(len(km)), draws.keys()


@pytest.mark.parametrize(
    "other",
    [{"start": START + 1 / 86400}, {"boresight": (30.0, -40.00001)}, {"seed": 6}],
    ids=["a second later", "36 mas beside", "another seed"],
)
def test_every_exposure_has_satellites_of_its_own(other):
    """Ids, speeds and magnitudes of one are not those of another; the same exposure has the same."""
    one, again, another = tracks(60.0), tracks(60.0), tracks(60.0, **other)
    assert len(one["id"]) > 5 and len(another["id"]) > 5
    for name in ("id", "speed", "V", "ra", "time"):
        np.testing.assert_array_equal(one[name], again[name])
        assert not np.intersect1d(one[name], another[name]).size, name
