"""Each random number is used once: the draws of chips, calibration exposures and truth bricks are recorded.

Two numbers from the halves of one word, or two scatters from one stream, must not be correlated.
"""

import json
import os
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO
from itertools import combinations

import numpy as np
import pytest
from support import all_products, randomness
from support.randomness import Recorder, scenes

from csstsim.base import counter
from csstsim.base.rng import Streams
from csstsim.catalog.truth_bricks import _population
from csstsim.detector.cosmic_ray import Tracks, deposit
from csstsim.detector.random.normal import normal_row, normal_table
from csstsim.stages import psf as psf_stage
from csstsim.stages import truth as truth_stage

pytestmark = pytest.mark.thorough
SIGMAS = 5
# Without these names and functions a scene would not be the complete chip that it is taken for
READOUT = {"tracks", "diffusion", "shot", "defective pixels", "hot pixels", "dead pixels", "bad columns", "read"}
NAMES = {
    "imaging": {"photons", "prnu", "internal flat", "vignette", "traps 0", "release 1", "bias", "gain"} | READOUT,
    "grating, every option": {"photons", "prnu", "nonlinearity", "serial traps 16", "serial release 1"} | READOUT,
    "BIAS": READOUT, "DARK": READOUT, "FLAT": {"prnu", "internal flat"} | READOUT,
}  # fmt: skip
SOMETIMES = {"_deposit", "normal_row", "_tail", "poisson_row", "poisson", "draw_traps", "_transfer"}
ASKERS = {
    "imaging": {"object_keys", "_choose", "from_psf", "from_profile", "from_wing", "_count"} | SOMETIMES,
    "grating, every option": {"_visit_keys", "_by_bins", "_choose", "_assign", "_transfer_rows"} | SOMETIMES,
    "BIAS": {"_deposit", "normal_row"}, "DARK": {"_deposit", "poisson_row"}, "FLAT": SOMETIMES,
}  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """{scene: {faults, names, askers, words}} of a process without compiled code; PSF sets are made by compiled."""
    folder = tmp_path_factory.mktemp("randomness")
    with redirect_stdout(StringIO()):
        for _, run in scenes(folder):
            if run.jobs[0].pointing.type == "SCIE":
                psf_stage.psf(run, run.jobs[0].chip.id)
    program = [sys.executable, randomness.__file__, str(folder)]
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(program, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_no_random_number_of_a_chip_is_used_for_two_things(recorded):
    assert {name: about["faults"][:5] for name, about in recorded.items() if about["faults"]} == {}


def test_the_recorded_chips_are_complete(recorded):
    for wanted, seen in ((NAMES, "names"), (ASKERS, "askers")):
        assert {name: asked for name, given in wanted.items() if (asked := given - set(recorded[name][seen]))} == {}


def test_no_random_number_of_a_truth_brick_is_used_for_two_things(tmp_path, monkeypatch):
    recorder = Recorder()
    recorder.watch_names(monkeypatch.setattr)
    run = all_products.science(tmp_path)
    truth_stage.truth(run, all_products.BRICK, log=str)
    assert recorder.faults() == []
    kinds = {tuple(map(str, key[3:])) for key in recorder.names if key[1] == "brick"}
    assert kinds >= {
        ("stars", "cell"),
        ("stars", "type"),
        ("galaxies", "size"),
        ("galaxies", "mass"),
        ("quasars", "lines"),
    }


def test_the_recorder_sees_what_is_asked_for_twice(monkeypatch):
    recorder = Recorder()
    recorder.watch_names(monkeypatch.setattr)
    rng = Streams(1, "1", 9, "layer")
    for ask in (rng.exposure, rng.exposure_key, rng.object):
        recorder.begin()
        ask("a"), ask("b")
        assert recorder.faults() == []
        ask("a")
        assert len(recorder.faults()) == 1
    recorder.begin()
    for _ in range(2):  # the same pattern again, by the same line
        rng.chip("pattern")
    assert recorder.faults() == []
    rng.chip("pattern")
    assert len(recorder.faults()) == 1


def test_the_recorder_sees_words_and_halves_used_twice(monkeypatch):
    for name in ("word", "high", "low", "unit"):
        monkeypatch.setattr(counter, name, getattr(counter, name).py_func)
    recorder = Recorder()
    recorder.watch_words()
    key, one = np.uint64(7), np.uint64(1)
    with np.errstate(over="ignore"):
        bits = counter.word(key, one)
        counter.high(bits), counter.low(bits)
        assert recorder.faults() == []
        counter.unit(bits)
        assert len(recorder.faults()) == 2
        recorder.begin()
        counter.word(key, one)
        counter.word(key, one)
        assert len(recorder.faults()) == 1


def uncorrelated(one, other):
    """The correlation of n independent numbers is 0 within 1 / sqrt(n)."""
    return abs(np.corrcoef(one, other)[0, 1]) < SIGMAS / np.sqrt(len(one))


def test_electrons_of_a_ray_diffuse_along_x_and_y_apart():
    """Two halves of a word: 2^16 electrons from one point, 4 px of diffusion."""
    n, at = 2**16, np.array([32.2])
    still = np.zeros(1)
    pixel, electrons, _ = deposit((64, 64), Tracks(at, at, still, still, np.array([n])), 4.0, np.uint64(3))
    y, x = np.divmod(np.repeat(pixel, electrons), 64)
    assert len(x) == n
    assert (
        uncorrelated(x, y) and np.std(x) == pytest.approx(4.0, rel=0.02) and np.std(y) == pytest.approx(4.0, rel=0.02)
    )


def test_noise_of_a_pixel_is_not_its_neighbours():
    """Two pixels share a word: along a row, along a column, and of two keys."""
    rows = np.empty((4, 2**14), np.float32)
    halves = np.empty(2**14 + 2, np.uint32)
    for out, (key, y) in zip(rows, [(1, 0), (1, 1), (2, 0), (2**64 - 2, 0)], strict=True):
        normal_row(np.uint64(key), y, 0, halves, out, *normal_table())
    assert uncorrelated(rows[0, ::2], rows[0, 1::2]) and uncorrelated(rows[0, 1:-1:2], rows[0, 2::2])
    assert all(uncorrelated(*pair) for pair in combinations(rows, 2))


def test_scatters_of_a_galaxy_are_apart(tmp_path):
    """10,000 galaxies of one redshift, mass and type: what still differs is scatter, and each column has its own.

    Sizes are semi-major axes: the circle of equal area has the outline in it. Of the bulge's size those above
    half of the light, which are not held below the disk. Ranks: some are log-normal.
    """
    run = all_products.science(tmp_path)
    n = 10_000
    names = iter(range(100))
    streams = {}

    def rng(name):
        return streams.setdefault(name, np.random.Generator(np.random.Philox(key=next(names))))

    for kind in (0, 1):
        columns = _population(run.universe, run.camera).properties(
            rng, np.full(n, 0.7), np.full(n, 10.8), np.full(n, kind)
        )
        e = np.hypot(columns["e1"], columns["e2"])
        columns |= {name: columns[name] * np.sqrt((1 + e) / (1 - e)) for name in ("size_disk", "size_bulge")}
        free = columns["bulge_frac"] > 0.5
        assert free.sum() > 200
        disk, bulge = (np.argsort(np.argsort(columns[name][free])) for name in ("size_disk", "size_bulge"))
        assert uncorrelated(disk, bulge)
        share, size, angle = columns["bulge_frac"], columns["size_disk"], np.arctan2(columns["e2"], columns["e1"])
        ranks = [np.argsort(np.argsort(column)) for column in (share, size, angle)]
        assert all(uncorrelated(*pair) for pair in combinations(ranks, 2))
