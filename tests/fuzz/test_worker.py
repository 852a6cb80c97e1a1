"""The watch over hostile inputs sees what it is there for."""

import pytest
from fuzz.worker import Worker


@pytest.fixture(scope="module")
def worker(tmp_path_factory):
    folder = tmp_path_factory.mktemp("watched") / "given"
    folder.mkdir()
    made = Worker(folder, seconds=3.0)
    yield made
    made.close()


@pytest.mark.parametrize(
    ("name", "outcome", "words"),
    [
        ("reads", "read", ""),
        ("refuses", "refused", "spoiled"),
        ("raises", "fault", "KeyError"),
        ("hangs", "fault", "still at it"),
        ("dies", "fault", "died with -11"),
        ("asks_for_all_memory", "fault", "MemoryError"),
        ("hides_that_memory_ran_out", "fault", "asked for more than"),
        ("writes_beside", "fault", "escaped"),
        ("writes_within", "read", ""),
        ("runs_a_command", "fault", "os.system"),
        ("starts_a_process", "fault", "subprocess.Popen"),
        ("speaks_in_colours", "fault", "no short printable line"),
    ],
)
def test_outcome(worker, name, outcome, words):
    found, text = worker(f"fuzz.culprits:{name}", worker.folder / "x.yaml")
    assert found == outcome and words in text
    assert not (worker.folder.parent / "beside").exists()
