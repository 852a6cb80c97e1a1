"""Exposures made in Python: own noise, one detector; two of the same time differ by noise alone."""

import numpy as np
import pytest
from astropy.table import Table
from support.mini_campaign import write_campaign

import csstsim
from csstsim.detector import mask
from csstsim.stages.chip import simulate

CHIP, SIGMA = 9, 5.0
EXPTIME, READOUT_BITS = 150.0, 1 / 12  # s; variance of rounding, DN^2
PLAIN = dict.fromkeys(
    ("cosmic_rays", "detector_defects", "PRNU_effect", "brighter_fatter", "blooming", "CTE_effect", "nonlinearity")
)  # left out: what is left is Poisson and read noise
NO_NOISE = dict.fromkeys(("cosmic_rays", "detector_defects", "poisson_and_dark", "readout_noise", "CTE_effect"))
OBSIDS = [f"3030000000{n}" for n in range(1, 5)]


@pytest.fixture(scope="module")
def sim(tmp_path_factory):
    """A mini campaign with forty stars of r = 18 to 24."""
    folder = tmp_path_factory.mktemp("exposures")
    rng, near = np.random.default_rng(6), 4.0 / 3600.0
    table = Table({
        "ra": 60.0 + rng.uniform(-near, near, 40), "dec": -40.0 + rng.uniform(-near, near, 40),
        "mag_r": rng.uniform(18.0, 24.0, 40),
    })  # fmt: skip
    return csstsim.Simulation(write_campaign(folder), cache=folder / "cache").replace(catalog=table)


def aimed(sim, obsid, **how):
    return sim.aim(60.0, -40.0, CHIP, size=None, obsid=obsid, **how)


def correlation(one, two):
    """Return the correlation of two images' values, in units of its error."""
    return np.corrcoef(one.ravel(), two.ravel())[0, 1] * np.sqrt(one.size)


def test_the_difference_of_a_pair_has_twice_the_variance(sim):
    """At one time the light is the same bits: a - b has mean 0 and variance 2 (light + dark + read noise^2 + rounding),
    the mean of four a quarter of one's; neither pairs nor frames are correlated. 5 sigma each."""
    plain = sim.replace(layers=PLAIN)
    frames = [aimed(plain, obsid).chip(obsid, CHIP).electrons.astype(float) for obsid in OBSIDS]
    free = plain.replace(fidelity="noise_free")
    light = aimed(free, OBSIDS[0]).light(OBSIDS[0], CHIP).image
    assert np.array_equal(light, aimed(free, OBSIDS[3]).light(OBSIDS[3], CHIP).image)
    detector = plain._run.camera.detector
    variance = light + detector.dark * EXPTIME + detector.read_noise**2 + detector.gain**2 * READOUT_BITS
    a, b, c, d = ((frame - light - detector.dark * EXPTIME) / np.sqrt(variance) for frame in frames)
    count, pull = a.size, (a - b) / np.sqrt(2)
    assert abs(pull.mean()) < SIGMA / np.sqrt(count)
    error = np.sqrt((2 + 1 / light.min()) / count)  # 1 / light: the fourth moment of a Poisson number
    assert abs(pull.var() - 1) < SIGMA * error
    assert abs(((a + b + c + d) ** 2).mean() / 4 - 1) < SIGMA * error
    assert abs(correlation(a - b, c - d)) < SIGMA and abs(correlation(a, b)) < SIGMA


def test_the_detector_is_one(sim):
    """Response, gains, bias and defects are those of the chip, bit by bit; rays are new; another seed has another."""
    still = sim.replace(layers=NO_NOISE, fidelity="noise_free")
    one, two = (aimed(still, obsid).chip(obsid, CHIP).raw for obsid in OBSIDS[:2])
    assert np.array_equal(one, two)
    assert (aimed(still.replace(seed=4), OBSIDS[0]).chip(OBSIDS[0], CHIP).raw != one).any()
    marked = sim.replace(layers={"quantization_and_output": {"mask": True}})
    with pytest.warns(UserWarning, match="towards the Earth"):
        pair = aimed(marked, "30300000101", exptime=2000.0, exposures=2)
    masks = [simulate(pair._run, job, log=str)[0].mask for job in pair._run.jobs]
    fixed = mask.HOT | mask.DEAD | mask.BAD_COLUMN
    assert (masks[0] & fixed).any() and np.array_equal(masks[0] & fixed, masks[1] & fixed)
    rays = [each & mask.COSMIC_RAY for each in masks]
    assert all(ray.any() for ray in rays) and not np.array_equal(*rays)
