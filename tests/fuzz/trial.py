"""Try one target with many hostile files, and collect the outcomes."""

import shutil
import time
from collections import Counter
from pathlib import Path

from fuzz.worker import Worker
from hypothesis import HealthCheck, Phase, given, seed, settings

COMPILING = 180.0  # s for the first file, which may find nothing compiled
TALLIES = {}  # of each target tried in this session: Counter of outcomes


def tried(name, target, folder, *, examples, seconds=float("inf"), random_seed=0):
    """Give a target hostile files, a multiple of `examples` until `seconds` are over; return the outcomes' Counter.

    Raises AssertionError for the simplest file found that has another outcome than "read" or "refused".
    """
    path = Path(target.make(folder))
    sound, tally = path.read_bytes(), TALLIES.setdefault(name, Counter())
    listing = sorted(folder.parent.iterdir())
    worker, end = Worker(folder), time.monotonic() + seconds
    try:
        sound_one = worker(target.function, path, COMPILING)
        assert sound_one == ("read", ""), "the sound file must be readable"

        @settings(max_examples=max(int(examples * target.weight), 4), deadline=None, database=None,
                  phases=(Phase.generate,), print_blob=False, suppress_health_check=list(HealthCheck))  # fmt: skip
        @given(target.spoil(sound))
        def give(data):
            path.write_bytes(data)
            outcome, text = worker(target.function, path)
            tally[outcome] += 1
            if outcome == "fault":
                kept = shutil.copy(path, folder / f"fault{path.suffix}")
                raise AssertionError(f"{name}, {kept}: {text}")

        rounds = 0
        while rounds == 0 or (seconds < float("inf") and time.monotonic() < end):
            seed(random_seed + rounds)(give)()
            rounds += 1
    finally:
        worker.close()
    assert sorted(folder.parent.iterdir()) == listing, "something was written beside the folder"
    return tally
