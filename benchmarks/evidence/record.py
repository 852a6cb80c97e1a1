"""The record of a command: what a benchmark calls to print, evaluate and store its figures.

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=9)
    with Record(parser) as record:
        count = 50 if record.toy else 200_000
        worst = compare(count, record.options.seed)
        record.value("erfa", worst, "apparent directions against erfa.atciq", unit="uas", below=1)
        record.table("costs", ["objects", "CPU-s"], [[count, f"{seconds:.1f}"]])
        with record.printed("by_band"):  # what a function prints
            report_bands(count)
        save(record.figure("astrometry.png"))

A record is written when the script was called as benchmarks/commands.yaml says and ended well. Any other call prints
the same and writes nothing. `--toy`, which each script has, takes seconds and goes through all of the code; goals are
not evaluated at that size. The exit code is 1 if a goal is missed.
"""

import argparse
import datetime
import io
import math
import os
import resource
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType
from typing import Self, TextIO

from evidence import RECORDS, ROOT
from evidence.commands import Command, commands
from evidence.dependencies import depends

import yaml

PASS, FAIL = "pass", "fail"
SOURCES = ("src", "benchmarks/*.py", "builders", "tests", "config", "examples", "workflow")


@dataclass(frozen=True)
class Value:
    """One measured figure: `value` +- `error` [`unit`], what it is, the goal in words and its verdict."""

    value: float | int | str
    what: str
    unit: str = ""
    error: float | None = None
    goal: str = ""
    verdict: str = ""

    def __str__(self) -> str:
        number = f"{self.value:.4g}" if isinstance(self.value, float) else str(self.value)
        error = "" if self.error is None else f" +- {self.error:.2g}"
        goal = f" (goal: {self.goal}; {self.verdict or 'not evaluated'})" if self.goal else ""
        return f"{self.what}: {number}{error}{' ' + self.unit if self.unit else ''}{goal}"


def _plain(value: object) -> float | int | str:
    """Return a number of numpy as one of Python, with six digits."""
    if isinstance(value, str):
        return value
    number = float(value)  # type: ignore[arg-type]
    return int(number) if number.is_integer() and not isinstance(value, float) else float(f"{number:.6g}")


class _Tee(io.StringIO):
    """Writes to the screen, and keeps a copy."""

    def __init__(self, screen: TextIO, kept: io.StringIO):
        super().__init__()
        self._screen, self._kept = screen, kept

    def write(self, text: str) -> int:
        self._kept.write(text)
        return self._screen.write(text)

    def flush(self) -> None:
        self._screen.flush()


class Record:
    """Collects a benchmark's figures; a context manager around its work.

    `options` are the parsed arguments of `parser`, to which `--toy` is added. `toy` tells that seconds are enough;
    `results` is the folder for files that the command needs, another one at that size.
    """

    def __init__(self, parser: argparse.ArgumentParser, arguments: Sequence[str] | None = None):
        parser.add_argument("--toy", action="store_true", help="the size that takes seconds; nothing is recorded")
        given = sys.argv[1:] if arguments is None else list(arguments)
        self.options = parser.parse_args(given)
        self.toy: bool = self.options.toy
        self.results = ROOT / "results" / ("toy" if self.toy else "")
        self.values: dict[str, Value] = {}
        self.tables: dict[str, str] = {}
        self.figures: list[str] = []
        self.skipped: dict[str, str] = {}
        call = [sys.argv[0], *given]
        known = commands().values()
        self.commands = [command for command in known if command.is_run_by(call, self.toy)]  # toy runs may be shared
        self.command: Command | None = self.commands[0] if self.commands else None
        self.depends = depends(self.command) if self.command and not self.toy else {}  # when the work started

    def value(
        self,
        name: str,
        value: float | int | str,
        what: str,
        *,
        unit: str = "",
        error: float | None = None,
        below: float | None = None,
        above: float | None = None,
        goal: bool | None = None,
    ) -> None:
        """Print and store a figure. `below` and `above` are its goal, both inclusive; `goal`: one judged elsewhere.

        Raises ValueError for a figure that is not finite, or a name used twice.
        """
        number = _plain(value)
        if not isinstance(number, str) and not math.isfinite(number):
            if not self.toy:
                raise ValueError(f"{name}: {what} is {number}")
            number = str(number)  # of too few objects
        if name in self.values or name in self.tables:
            raise ValueError(f"two figures of one record are named {name!r}")
        limits = [f"at most {below:g}"] if below is not None else []
        limits += [f"at least {above:g}"] if above is not None else []
        missed = (
            (goal is not None and not goal)
            or (below is not None and value > below)
            or (above is not None and value < above)
        )
        text = " and ".join(limits) or ("met" if goal is not None else "")
        verdict = "" if not text or self.toy else FAIL if missed else PASS
        spread = None if error is None else float(f"{error:.6g}")
        self.values[name] = Value(number, what, unit, spread, text, verdict)
        print(self.values[name], flush=True)

    def table(self, name: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Print and store a table; cells are text as a page shows it, or numbers that are text as they are."""
        if name in self.values or name in self.tables:
            raise ValueError(f"two figures of one record are named {name!r}")
        if any(len(row) != len(header) for row in rows):
            raise ValueError(f"table {name!r} has rows of other lengths than its header")
        lines = [f"| {' | '.join(map(str, row))} |" for row in (header, *rows)]
        self.tables[name] = text = "\n".join([lines[0], "|" + "---|" * len(header), *lines[1:]])
        print(f"\n{text}\n", flush=True)

    @contextmanager
    def printed(self, name: str) -> Iterator[None]:
        """Store what is printed within, a Markdown table or plain text, as a table; it is printed as usual."""
        if name in self.values or name in self.tables:
            raise ValueError(f"two figures of one record are named {name!r}")
        screen, kept = sys.stdout, io.StringIO()
        with redirect_stdout(_Tee(screen, kept)):
            yield
        self.tables[name] = "\n".join(line.rstrip() for line in kept.getvalue().strip("\n").split("\n"))

    def figure(self, name: str) -> Path:
        """Return the path for a picture: in docs/figures if it is recorded, otherwise in the folder of results."""
        folder = ROOT / "docs" / "figures" if self.command and not self.toy else self.results / "figures"
        folder.mkdir(parents=True, exist_ok=True)
        self.figures.append(name)
        return folder / name

    def skip(self, what: str, why: str) -> None:
        """Say that a part did not run. A record that lacks a part is not written."""
        self.skipped[what] = why
        print(f"skipped: {what}: {why}", flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            return
        failed = [name for name, value in self.values.items() if value.verdict == FAIL]
        if self.toy:
            for command in self.commands:
                write(command, self)
            print(f"toy size: {len(self.values)} values, {len(self.tables)} tables, {len(self.figures)} pictures")
        elif self.command and not self.skipped:
            write(self.command, self)
        else:
            print("not recorded: " + (", ".join(self.skipped) or "this is not a call of commands.yaml"))
        if failed:
            print("goals missed: " + ", ".join(failed))
            sys.exit(1)


def cpu_seconds() -> float:
    """Return the CPU seconds of this process and of those that it waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def _git(*words: str) -> str:
    run = subprocess.run(["git", *words], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    return run.stdout.strip()


def commit() -> str:
    """Return the commit that is checked out; with a + if sources differ from it."""
    return _git("rev-parse", "--short=8", "HEAD") + ("+" if _git("status", "--porcelain", "--", *SOURCES) else "")


def machine() -> str:
    """Return the processor's name and the number of its cores."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    name = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), os.uname().machine)
    return f"{name}, {os.cpu_count()} cores"


class _Dumper(yaml.SafeDumper):
    """Writes tables as blocks of lines."""


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None)


_Dumper.add_representer(str, _text)


def path(name: str, toy: bool = False) -> Path:
    """Return the file of a command's record; that of its run at the size of seconds is not kept in the repository."""
    return (ROOT / "results" / "toy" / "records" if toy else RECORDS) / f"{name}.yaml"


def write(command: Command, record: Record) -> None:
    """Write a record."""
    values = {name: asdict(value) for name, value in record.values.items()}
    content = {
        "command": command.full,
        "commit": commit(),
        "date": datetime.date.today().isoformat(),
        "machine": machine(),
        "cpu_seconds": round(cpu_seconds(), 1),
        "values": {name: {k: v for k, v in each.items() if v not in ("", None)} for name, each in values.items()},
        "tables": record.tables,
        "figures": record.figures,
        "depends": record.depends,
    }
    if record.skipped:  # of a toy run
        content["skipped"] = list(record.skipped)
    file = store(command.name, content, record.toy)
    print(f"{'written' if record.toy else 'recorded'}: {file.relative_to(ROOT)}")


def store(name: str, content: dict, toy: bool = False) -> Path:
    """Write a record's content; return its file."""
    file = path(name, toy)
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part")
    part.write_text(yaml.dump(content, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=160))
    part.replace(file)
    return file


def read(name: str, toy: bool = False) -> dict | None:
    """Return a record's content; None if there is none."""
    file = path(name, toy)
    return yaml.load(file.read_text(), yaml.CSafeLoader) if file.exists() else None
