"""Every reader of hostile files reads them or refuses them in one line, within a time limit, and has no side effects.

`make fuzz` gives each reader many more (FUZZ_SECONDS, 8 s each) and prints how many.
"""

import os
import shutil
import time
from collections import Counter
from pathlib import Path

import pytest
from fuzz.targets import TARGETS
from fuzz.worker import Worker
from hypothesis import HealthCheck, Phase, given, seed, settings

COMPILING = 180.0  # s for the first file, which may find nothing compiled
SHORT = [name for name in TARGETS if not name.startswith(("universe", "instrument", "picture"))]
SHORT += ["instrument detector.yaml", "instrument psf.yaml"]


def tried(name, folder, *, examples, seconds=0.0, first=0):
    """Give a target hostile files, `examples` times its weight and again until `seconds` are over; return a Counter.

    Of the outcomes "read" and "refused". Raises AssertionError for the simplest file found that has another outcome.
    """
    target, folder, outcomes = TARGETS[name], folder / "given", Counter()
    folder.mkdir()
    path = Path(target.make(folder))
    reader, sound, listing = f"fuzz.readers:{target.reader}", path.read_bytes(), sorted(folder.parent.iterdir())
    worker, end = Worker(folder), time.monotonic() + seconds
    how = {"deadline": None, "database": None, "phases": (Phase.generate,), "print_blob": False}

    @settings(max_examples=max(int(examples * target.weight), 4), suppress_health_check=list(HealthCheck), **how)
    @given(target.spoil(sound))
    def give(data):
        path.write_bytes(data)
        outcome, text = worker(reader, path)
        outcomes[outcome] += 1
        if outcome == "fault":
            kept = shutil.copy(path, folder / f"fault{path.suffix}")
            raise AssertionError(f"{name}, {kept}: {text}")

    try:
        assert worker(reader, path, COMPILING) == ("read", ""), "the sound file must be readable"
        rounds = 0
        while rounds == 0 or time.monotonic() < end:
            seed(first + rounds)(give)()
            rounds += 1
    finally:
        worker.close()
    assert sorted(folder.parent.iterdir()) == listing, "something was written beside the folder"
    return outcomes


@pytest.mark.parametrize("name", SHORT)
@pytest.mark.thorough
def test_a_few_hostile_files(name, tmp_path):
    outcomes = tried(name, tmp_path, examples=16)
    assert outcomes.total() >= 4
    assert outcomes["refused"] or name == "log of a job"  # which may hold anything


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_many_hostile_files(name, tmp_path, capsys):
    seconds, first = float(os.environ.get("FUZZ_SECONDS", 8)), int(os.environ.get("FUZZ_SEED", 1))
    outcomes = tried(name, tmp_path, examples=50, seconds=seconds, first=first)
    with capsys.disabled():
        print(f"\n{name}: {outcomes['read']} read, {outcomes['refused']} refused", end="")
