"""Whole catalogues: empty, one object, twins, a crowd; the bits do not depend on who draws."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest
from exposure import ARCMIN2, FIDELITIES, X, Y, crowd

pytestmark = pytest.mark.thorough

CROWD_MEMORY = 2.5e9  # bytes, on top, for 1e6 objects
CROWD_CPU = 300.0  # s, to end what hangs


@pytest.mark.parametrize("fidelity", [*FIDELITIES, "reference"])
def test_none_and_one(expose, fidelity):
    none = expose([], [], fidelity)
    assert len(none.table) == 0 and not none.light.any()
    one = expose(X, Y, fidelity)
    assert len(one.table) == 1 and one.table["fraction"][0] == pytest.approx(0.96, abs=0.03)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_duplicate_ids(expose, fidelity):
    """Twins of one id are each drawn, with electrons of their own."""
    n = 30 if fidelity == "noise_free" else 1000
    got = expose(np.full(n, X), Y, fidelity, id=np.zeros(n, int), electrons=1e3)
    assert len(got.table) == n
    assert got.table["drawn"].mean() == pytest.approx(958.4, abs=5 * np.sqrt(958.4 / 1000) + 1)
    if got.counted is not None:  # Poisson: mean = variance, 5 sigma of 1000
        assert got.table["drawn"].var(ddof=1) == pytest.approx(958.4, rel=5 * np.sqrt(2 / 999))
        assert len(np.unique(got.table["drawn"])) > 50


@pytest.mark.parametrize("ids", [[-1, -(2**63)], [2**63 - 1, 0]])
def test_ids_at_the_ends_of_their_range(expose, ids):
    assert (expose([X, X], Y, id=np.array(ids)).table["drawn"] > 9000).all()


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_the_order_of_a_catalogue_does_not_matter(expose, fidelity):
    """Counted electrons to the bit, expected ones to the rounding of float32 sums."""
    n = 20 if fidelity == "noise_free" else 50
    x, y, columns = crowd(n)
    columns |= {"id": np.arange(n), "electrons": np.geomspace(1, 1e5, n)}
    one = expose(x, y, fidelity, **columns)
    other = expose(x[::-1], y[::-1], fidelity, **{name: column[::-1] for name, column in columns.items()})
    if one.counted is not None:
        assert np.array_equal(one.counted, other.counted)
    assert other.image == pytest.approx(one.image, rel=1e-5, abs=1e-5 * float(one.image.max()))


def drawn_elsewhere(psf, fidelity, count, **environment):
    """Return what another process draws of a crowd (exposure.main)."""
    program = [sys.executable, str(Path(__file__).with_name("exposure.py")), str(psf.path), fidelity, str(count)]
    done = subprocess.run(program, env=os.environ | environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.parametrize("fidelity", ["standard", pytest.param("noise_free", marks=pytest.mark.slow)])
def test_the_same_bits_in_another_process_with_other_threads(expose, psf_r, fidelity):
    """Both planes and every column of the truth but the time it took."""
    threads = 2 if numba.config.NUMBA_NUM_THREADS == 1 else 1
    count = 30 if fidelity == "noise_free" else 2000
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")  # here it is one: tests/conftest.py
    other = drawn_elsewhere(psf_r, fidelity, count, NUMBA_NUM_THREADS=str(threads), **dict.fromkeys(names, "2"))
    x, y, columns = crowd(count, window=ARCMIN2)
    here = expose(x, y, fidelity, window=ARCMIN2, **columns)
    assert here.digest() == other["digest"]
    assert expose(x, y, fidelity, window=ARCMIN2, **columns).digest() == other["digest"]
    if fidelity == "standard":
        assert expose(x, y, fidelity, window=ARCMIN2, key=2, **columns).digest() != other["digest"]


@pytest.mark.slow
@pytest.mark.parametrize("fidelity", ["standard", "preview"])
def test_a_million_objects_in_a_square_arc_minute(psf_r, fidelity):
    """In bounded memory and time; 4% of the light is beyond the PSF's box, a little off the window."""
    about = drawn_elsewhere(psf_r, fidelity, 1_000_000)
    assert about["bytes"] < CROWD_MEMORY and about["cpu_s"] < CROWD_CPU
    assert about["drawn"] / about["electrons"] == pytest.approx(0.95, abs=0.02)
