"""Every reader of hostile files reads them or refuses them in one line, within a time limit, and has no side effects.

`make fuzz` gives each reader many more (FUZZ_SECONDS, 8 s each) and prints how many.
"""

import os

import pytest
from fuzz.targets import TARGETS
from fuzz.trial import tried

SHORT = [name for name in TARGETS if not name.startswith(("universe", "instrument", "picture"))]
SHORT += ["instrument detector.yaml", "instrument psf.yaml"]


@pytest.mark.parametrize("name", SHORT)
def test_a_few_hostile_files(name, tmp_path):
    tally = tried(name, TARGETS[name], _folder(tmp_path), examples=16)
    assert tally["read"] + tally["refused"] >= 4
    assert tally["refused"] or name == "log of a job"  # which may hold anything


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_many_hostile_files(name, tmp_path):
    seconds = float(os.environ.get("FUZZ_SECONDS", 8))
    first = int(os.environ.get("FUZZ_SEED", 1))
    assert tried(name, TARGETS[name], _folder(tmp_path), examples=50, seconds=seconds, random_seed=first)["read"] >= 0


def _folder(tmp_path):
    (tmp_path / "given").mkdir()
    return tmp_path / "given"
