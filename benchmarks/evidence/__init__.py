"""Records: what a command measured, on which commit and day, and what it depends on.

    commands.py      the commands of benchmarks/commands.yaml, each with the size that takes seconds
    record.py        what a benchmark calls to print, evaluate and store its figures
    dependencies.py  the modules and data files that a command reaches, and their digests
    renewal.py       what keeps a record current when code changes and its values do not: the toy run
    pages.py         figures of records in the pages
    listing.py       the page of all commands: age, verdict, cost, values
    run.py           runs what is stale (`make evidence`), or all commands at the size of seconds (`make toys`)

A benchmark is started as a script, and some share code with builders and tests: importing this package makes
`benchmarks`, `builders` and `tests` importable.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
RECORDS = ROOT / "benchmarks" / "records"
SCRIPTS = tuple(ROOT / name for name in ("benchmarks", "builders", "tests"))  # modules outside the package

sys.path += [str(folder) for folder in SCRIPTS if str(folder) not in sys.path]
