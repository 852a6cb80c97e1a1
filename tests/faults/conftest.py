"""The undisturbed run with which all faults are compared, and the table of results."""

import pytest
from faults.small_run import SmallRun

ROWS = []


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    return SmallRun(tmp_path_factory.mktemp("faults"))


@pytest.fixture
def tell():
    """Add a row to the table: fault, at which moments, what happened. To be called when nothing was found lost."""

    def add(fault, moments, happened):
        ROWS.append((fault, moments, happened, "nothing"))

    return add


def pytest_terminal_summary(terminalreporter):
    if ROWS:
        terminalreporter.write_sep("-", "faults; products afterwards bit-identical to an undisturbed run")
        for row in (("fault", "moments", "what happened", "lost"), ("---",) * 4, *ROWS):
            terminalreporter.write_line(f"| {' | '.join(row)} |")
