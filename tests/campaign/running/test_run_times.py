"""The table of what jobs took and should have taken, of logs written here; every cell is worked out by hand."""

from types import SimpleNamespace

import pytest

from csstsim.campaign.costs import Cost
from csstsim.campaign.running import run_times
from csstsim.campaign.running.job_log import JobUsage

LOGS = {
    "render/a.log": "csstsim ...\nrender done: 100.0 s, CPU 40.0 s, memory 300 MB\n",
    "render/b.log": "csstsim ...\nrender done: 50.0 s, CPU 80.0 s, memory 500 MB\n",
    "measure/a.log": "measure done: 10.0 s, CPU 6.0 s, memory 90 MB\n",
    "merge/a.log": "merge done: 1.0 s, CPU 3.0 s, memory 70 MB\n",
    "psf/a.log": "csstsim: error: no room\n",
}
# One more job of render is planned than was logged; merge is not planned
COSTS = {
    "render": {1: Cost(20.0, 200.0), 2: Cost(30.0, 800.0), 3: Cost(40.0, 100.0)}, "measure": {1: Cost(12.0, 45.0)},
    "psf": {1: Cost(1e6, 1.0)},
}  # fmt: skip
ALL = {"wall [s]": 161.0, "CPU [s]": 129.0, "expected [s]": 72.0, "mean / expected": 1.79}
EACH = {"wall [s]": 40.2, "CPU [s]": 32.2, "expected [s]": 18.0, "mean / expected": 1.79}  # of 4 files


@pytest.fixture
def run(tmp_path, monkeypatch):
    for name, text in LOGS.items():
        path = tmp_path / "logs" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setattr(run_times, "expected", lambda run: COSTS)
    return SimpleNamespace(paths=SimpleNamespace(output=tmp_path), jobs=range(4))


def test_each_rule_all_and_each_file_have_a_row(run):
    heads = (
        "step", "jobs", "wall [s]", "CPU [s]", "CPU of a job: mean", "maximum", "expected [s]", "mean / expected",
        "memory of a job: mean", "largest", "expected [MB]", "largest / expected",
    )  # fmt: skip
    rows = {
        "measure": (1, 10.0, 6.0, 6.0, 6.0, 12.0, 0.5, 90, 90, 45, 2.0),
        "merge": (1, 1.0, 3.0, 3.0, 3.0, None, None, 70, 70, None, None),
        "render": (2, 150.0, 120.0, 60.0, 80.0, 30.0, 2.0, 400, 500, 800, 0.62),
    }
    assert run_times.run_times(run) == [
        *(dict(zip(heads, (name, *row), strict=True)) for name, row in rows.items()), {"step": "all"} | ALL,
        {"step": "all, for a Level-0 file"} | EACH,
    ]  # fmt: skip


def test_logs_are_read_by_rule_and_those_without_an_end_left_out(run):
    (run.paths.output / "logs" / "stray.log").write_text(LOGS["measure/a.log"])
    found = run_times.measured(run.paths.output)
    assert found == {
        "measure": [JobUsage(10.0, 6.0, 90.0)], "merge": [JobUsage(1.0, 3.0, 70.0)],
        "render": [JobUsage(100.0, 40.0, 300.0), JobUsage(50.0, 80.0, 500.0)],
    }  # fmt: skip


def test_without_logs_nothing_is_expected(tmp_path, monkeypatch):
    monkeypatch.setattr(run_times, "expected", None)
    assert run_times.run_times(SimpleNamespace(paths=SimpleNamespace(output=tmp_path), jobs=range(4))) == []
