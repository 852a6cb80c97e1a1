"""Subsets of the light's layers and options: all fidelities draw the same light, and counted light is Poisson."""

import numpy as np
import pytest
from support.light_subsets import subsets

pytestmark = pytest.mark.thorough

SIGMA = 5.0
COUNT, QUICK = 240, 8  # subsets in all, and of those that `make test` draws: the first that GalSim does not draw


def check(chosen, folder):
    from support.light_subsets import departures

    found = [departures(subset, folder) for subset in chosen]
    for subset, values in zip(chosen, found, strict=True):
        assert all(abs(value) < SIGMA for value in values.values()), (str(subset), values)
    # Together, too: a departure that each of them hides
    for name in {name for values in found for name in values}:
        values = np.array([values[name] for values in found if name in values])
        assert abs(values.mean()) < SIGMA / np.sqrt(len(values)), (name, values)


def test_quick_subsets(tmp_path_factory):
    chosen = [subset for subset in subsets(COUNT) if subset.fidelity != "reference" and subset.band != "GV"]
    check(chosen[:QUICK], tmp_path_factory.mktemp("cache"))


def test_a_quick_spectrum(tmp_path_factory):
    chosen = [subset for subset in subsets(COUNT) if subset.fidelity == "standard" and subset.band == "GV"]
    check(chosen[:2], tmp_path_factory.mktemp("cache"))


def test_counted_light_without_any_loss(tmp_path_factory):
    """No flat, no shutter, no response of the pixels, behind a filter and behind a grating: nothing thins the light."""
    from support.light_subsets import Subset

    bare = frozenset({"flat_fielding", "shutter_effect", "PRNU_effect", "sky_background"})
    chosen = [
        Subset(band, "standard", kind, 19.0, bare) for band, kind in (("r", "disk"), ("r", "star"), ("GV", "star"))
    ]
    check(chosen, tmp_path_factory.mktemp("cache"))


@pytest.mark.slow
def test_all_subsets(tmp_path_factory):
    check(subsets(COUNT), tmp_path_factory.mktemp("cache"))
