"""Statements of docs/limits.md about windows: light and detector are the chip's, noise is the window's own."""

import numpy as np
import pytest
from astropy.table import Table
from support.mini_campaign import write_campaign

import csstsim
from csstsim.instrument.chip import Window

OBSID, CHIP, SIGMA = "10100000001", 9, 5.0
WINDOW = Window(30, 100, 40, 110)
LIGHT = 1e-4  # of a pixel's light: far wings are on a mesh that begins with the window
DIGIT = 1.0  # DN: light that differs by so much may round otherwise
RANDOM = dict.fromkeys(("cosmic_rays", "detector_defects", "poisson_and_dark", "readout_noise", "CTE_effect"))
PATTERNS = dict.fromkeys(("PRNU_effect", "brighter_fatter", "blooming", "CTE_effect", "nonlinearity", "cosmic_rays"))


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Return (the whole chip, a window of it), Simulations that give expected light."""
    folder, rng, near = tmp_path_factory.mktemp("windows"), np.random.default_rng(6), 4.0 / 3600.0
    table = Table({
        "ra": 60.0 + rng.uniform(-near, near, 40), "dec": -40.0 + rng.uniform(-near, near, 40),
        "mag_r": rng.uniform(18.0, 26.0, 40), "type": ["star", "galaxy"] * 20, "size": [0.0, 0.4] * 20,
    })  # fmt: skip
    sim = csstsim.Simulation(write_campaign(folder), cache=folder / "cache").aim(60.0, -40.0, CHIP, size=None)
    sim = sim.replace(catalog=table, fidelity="noise_free")
    return sim, sim.replace(window=(WINDOW.x0, WINDOW.x1, WINDOW.y0, WINDOW.y1))


def test_a_window_has_the_light_of_its_chip(pair):
    whole, part = (sim.light(OBSID, CHIP).image for sim in pair)
    np.testing.assert_allclose(part, whole[WINDOW.slices], rtol=LIGHT)


def test_a_window_has_the_detector_of_its_chip(pair):
    whole, part = (sim.replace(layers=RANDOM).chip(OBSID, CHIP) for sim in pair)
    assert np.abs(part.image.astype(float) - whole.image[WINDOW.slices]).max() <= DIGIT
    assert [part.header[f"GAIN{n:02d}"] for n in range(1, 17)] == [whole.header[f"GAIN{n:02d}"] for n in range(1, 17)]


def test_a_window_has_noise_of_its_own(pair):
    noise = []
    for sim in pair:
        frame, light = (
            sim.replace(layers=PATTERNS | {"detector_defects": None}).chip(OBSID, CHIP),
            sim.light(OBSID, CHIP),
        )
        noise.append((frame.electrons - light.image) / np.sqrt(light.image))
    one, two = noise[0][WINDOW.slices].ravel(), noise[1].ravel()
    assert abs(np.corrcoef(one, two)[0, 1]) * np.sqrt(one.size) < SIGMA
