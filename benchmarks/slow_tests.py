"""The slow tests of a folder: how many pass, are skipped and fail, and what each costs.

    python benchmarks/slow_tests.py tests/render [--only WORDS]

Runs `pytest -m slow` of a folder or file of tests; `--only` is pytest's `-k`. Exit code 1 if a test fails. One toy is
shared by all folders: a quick one of the slow tests of each but tests/workflow, in one process.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

from evidence.record import Record, cpu_seconds

ROOT = Path(__file__).parents[1]
FUZZED = re.compile(r"^.+: (\d+) read, (\d+) refused", re.MULTILINE)  # what tests/fuzz prints of each reader


def pytest(folder: str, *more: str | Path) -> tuple[int, str]:
    """Run the slow tests; return the exit code and what was printed."""
    line = [sys.executable, "-m", "pytest", "-m", "slow", "-p", "no:cacheprovider", folder, *map(str, more)]
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(line, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def outcome(case: ElementTree.Element) -> str:
    """Return "passed", "skipped" or "failed" of a test in pytest's XML."""
    kinds = {child.tag for child in case}
    return "failed" if kinds & {"failure", "error"} else "skipped" if "skipped" in kinds else "passed"


def main(record: Record) -> None:
    """Run the tests of the folder, and record what came of them."""
    folder, only = record.options.folder, record.options.only
    before = cpu_seconds()
    with tempfile.TemporaryDirectory() as results:
        file = Path(results) / "tests.xml"
        code, said = pytest(folder, f"--junitxml={file}", *(["-k", only] if only else []))
        if code not in (0, 1) or not file.exists():
            sys.exit(f"pytest ended with exit code {code}:\n{said[-2000:]}")
        cases = list(ElementTree.parse(file).iter("testcase"))
    record.value("collected", len(cases), f"slow tests of {folder}")
    counts, rows = Counter(map(outcome, cases)), []
    # The longest first; at toy size in an order that is the same in every run
    for case in cases if record.toy else sorted(cases, key=lambda case: -float(case.get("time", 0))):
        name = f"`{case.get('classname', '').split('.')[-1]}::{case.get('name')}`".replace("|", "")
        rows.append([name, outcome(case), f"{float(case.get('time', 0)):.1f}"])
    record.table("tests", ["test", "outcome", "s"], rows)
    record.value("passed", counts["passed"], "slow tests passed")
    for case in cases:
        if (skipped := case.find("skipped")) is not None:
            record.skip(str(case.get("name")), skipped.get("message", ""))
    record.value("cpu", cpu_seconds() - before, "all of them", unit="CPU-s")
    if fuzzed := [(int(read), int(refused)) for read, refused in FUZZED.findall(said)]:
        read, refused = map(sum, zip(*fuzzed, strict=True))
        record.value("files", read + refused, f"hostile files given to {len(fuzzed)} readers")
        record.value("read", read, "of them, read")
        record.value("refused", refused, "of them, refused")
    if counts["failed"]:
        print(said[-5000:])
    record.value("failed", counts["failed"], "slow tests failed", below=0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", help="folder or file of tests")
    parser.add_argument("--only", help="expression that names some of the tests, as pytest's -k")
    with Record(parser) as record:
        main(record)
