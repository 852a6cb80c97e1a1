"""Run the commands whose records are stale, or all at the size of seconds.

    python benchmarks/evidence/run.py                     what is stale, cheapest and oldest first (make evidence)
    python benchmarks/evidence/run.py --minutes 30        for at most that many CPU-minutes, by their last costs
    python benchmarks/evidence/run.py --all               all (make evidence ALL=1)
    python benchmarks/evidence/run.py astrometry cti      these, if they are stale
    python benchmarks/evidence/run.py --list              what is stale and why; nothing runs
    python benchmarks/evidence/run.py --toy               every command at the size of seconds (make toys); renews the
                                                          records of those whose values are as before
    python benchmarks/evidence/run.py --folder MCTI=path  a folder that a command needs

A record is written as its command ends, so a run that is stopped goes on where it was. Figures that moved by more than
their errors are printed, old and new. The exit code is 1 if a command failed or a goal is missed.
"""

import argparse
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from pathlib import Path

if __name__ == "__main__":  # started as a script, the folder on the path is this one
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from evidence import ROOT
from evidence.commands import Command, commands
from evidence.dependencies import remove_old
from evidence.listing import state, verdict
from evidence.pages import used
from evidence.record import FAIL, path, read
from evidence.renewal import is_time, keep_toy, renew

UNKNOWN_COST = 300.0  # CPU-s of a command that was never recorded
TOY_TIMEOUT = 900  # s of wall time, on a busy machine
NO_ERROR = 1e-3  # relative change that is told of a figure without an error
TIMES = 0.2  # the same of CPU seconds
TAIL = 25  # lines of the output of what failed
LINE = 240  # characters of a line that tells what moved


def _environment() -> dict[str, str]:
    """Return the environment: programs of this interpreter's folder first, as pages name them."""
    folder = str(Path(sys.executable).parent)
    return os.environ | {"PATH": f"{folder}{os.pathsep}{os.environ['PATH']}"}


def moved(old: dict, new: dict) -> list[str]:
    """Return a line for each figure that moved by more than its error, and for each goal whose verdict turned."""
    lines = []
    for name, value in new["values"].items():
        before = old["values"].get(name)
        if before is None:
            continue
        a, b = before["value"], value["value"]
        if isinstance(a, str) or isinstance(b, str):
            differs = a != b
        else:
            relative = TIMES if is_time(value.get("unit", "")) else NO_ERROR
            error = math.hypot(before.get("error", 0.0), value.get("error", 0.0))
            differs = abs(b - a) > (error if "error" in value else relative * max(abs(a), abs(b)))
        turned = before.get("verdict") != value.get("verdict")
        if differs or turned:
            verdicts = f" ({before.get('verdict', '-')} to {value.get('verdict', '-')})" if turned else ""
            lines.append(f"{value['what']}: {a} to {b} {value.get('unit', '')}{verdicts}")
    for name, table in new["tables"].items():
        was = old["tables"].get(name, "").split("\n")
        rows = [row for row in table.split("\n") if row not in was]
        if rows and was != [""]:
            lines.append(f"table {name}: {len(rows)} rows differ, the first is now {rows[0]}")
    return lines


def _run(command: Command, words: list[str], timeout: float | None, show: bool) -> tuple[int, str, float]:
    """Run the words; return the exit code, what was printed, and seconds."""
    start = time.monotonic()
    words = [sys.executable if words[0] == "python" else words[0], *words[1:]]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    process = subprocess.Popen(words, cwd=ROOT, env=_environment(), text=True, **pipes)
    said = []
    try:
        if show:
            for line in process.stdout or ():
                said.append(line)
                print("    " + line, end="", flush=True)
            code = process.wait()
        else:
            text, _ = process.communicate(timeout=timeout)
            said, code = [text], process.returncode
    except subprocess.TimeoutExpired:
        process.kill()
        text, _ = process.communicate()
        said, code = [text, f"ended after {timeout} s"], 124
    return code, "".join(said), time.monotonic() - start


def _toy(command: Command) -> dict | None:
    """Run a command at the size of seconds; return what it wrote, None if it failed."""
    path(command.name, toy=True).unlink(missing_ok=True)
    code, _, _ = _run(command, command.toy_words, TOY_TIMEOUT, False)
    return read(command.name, toy=True) if code == 0 else None


def _renewed(command: Command) -> str:
    """Renew the records that share a toy run that has ended; return lines that tell what moved."""
    said = ""
    again = cache(partial(_toy, command))  # serves all that share it
    results = [(one, read(one.name, toy=True)) for one in commands().values() if one.toy_words == command.toy_words]
    for one, result in results:
        if result and (lines := renew(one, result, lambda name=one.name: again() and read(name, toy=True))):
            said += f"    values of {one.name} moved since its record was made; it is stale:\n"
            said += "".join(f"        {line[:LINE]}\n" for line in lines[:TAIL])
    return said


def toys(names: Iterable[str], jobs: int) -> int:
    """Run commands at the size of seconds, some at once; return the number that failed. A run that two share is one."""
    chosen = list(
        {tuple(command.toy_words): command for command in reversed([commands()[name] for name in names])}.values()
    )
    chosen.reverse()
    pages = used()
    failed = []
    with ThreadPoolExecutor(jobs) as pool:
        runs = {command.name: pool.submit(_run, command, command.toy_words, TOY_TIMEOUT, False) for command in chosen}
        for name, run in runs.items():
            code, said, seconds = run.result()
            skipped = [line for line in said.splitlines() if line.startswith("skipped: ")]
            verdict_ = "ok" if code == 0 else f"FAILED, exit code {code}"
            print(f"{verdict_:8} {seconds:6.1f} s  {name}", *skipped, sep="\n    ", flush=True)
            if not code:
                print(_renewed(commands()[name]), end="", flush=True)
            else:
                failed.append(name)
                print("      " + "\n      ".join(said.splitlines()[-TAIL:]))
                print(f"      pages that show it: {', '.join(pages.get(name, ['none']))}")
    named = f"; failed: {', '.join(failed)}" if failed else ""
    print(f"{len(chosen) - len(failed)} of {len(chosen)} commands ran at toy size{named}")
    return len(failed)


def order(chosen: Iterable[Command]) -> list[Command]:
    """Return commands cheapest and oldest first, each behind those whose results it reads."""

    def key(command: Command) -> tuple[float, str]:
        known = read(command.name)
        return (known["cpu_seconds"], str(known["date"])) if known else (UNKNOWN_COST, "")

    waiting, found = sorted(chosen, key=key), []
    while waiting:
        names = {command.name for command in waiting}
        ready = [command for command in waiting if not names.intersection(command.after)]
        if not ready:
            raise SystemExit(f"commands.yaml: {', '.join(sorted(names))} wait for each other")
        found.append(ready[0])
        waiting.remove(ready[0])
    return found


def evidence(chosen: list[Command], minutes: float, folders: dict[str, str]) -> int:
    """Run commands in full and tell what moved; return the number that failed, miss a goal or could not run."""
    pages, left, bad = used(), minutes * 60, []
    for command in order(chosen):
        where = f"pages: {', '.join(pages.get(command.name, ['none']))}"
        if lacking := command.lacks(folders):
            print(f"{command.name}: cannot run here: {', '.join(lacking)}; {where}")
            bad.append(command.name)
            continue
        old = read(command.name)
        cost = old["cpu_seconds"] if old else UNKNOWN_COST
        if cost > left:
            print(f"{command.name}: left for another time ({cost:.0f} CPU-s); {where}")
            continue
        print(f"{command.name}: {command.full}", flush=True)
        remove_old(command)
        code, _, seconds = _run(command, command.words(folders), None, True)
        new = read(command.name)
        if new is None or new == old:
            print(f"  FAILED with exit code {code}, nothing recorded; {where}")
            bad.append(command.name)
            continue
        left -= new["cpu_seconds"]
        if fault := keep_toy(command, partial(_toy, command)):
            print(f"  {fault}")
        print(f"  {new['cpu_seconds']:.0f} CPU-s, {seconds:.0f} s; {where}")
        for line in moved(old, new) if old else ():
            print(f"  moved: {line}")
        if verdict(new) == FAIL:
            bad.append(command.name)
            print(f"  GOALS MISSED; {where}")
    return len(bad)


def main() -> int:
    """Run what is asked for; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="COMMAND", help="names of benchmarks/commands.yaml; default: all")
    parser.add_argument("--all", action="store_true", help="also those whose records are current")
    parser.add_argument("--minutes", type=float, default=math.inf, help="CPU-minutes that may be spent")
    parser.add_argument("--list", action="store_true", help="tell what is stale; exit code 1 if anything is")
    parser.add_argument("--toy", action="store_true", help="run at the size of seconds; nothing is recorded")
    parser.add_argument("--jobs", type=int, default=2, help="commands at once with --toy")
    parser.add_argument("--folder", action="append", default=[], metavar="NAME=PATH", help="what a command needs")
    asked = parser.parse_args()
    known = commands()
    if unknown := set(asked.names) - known.keys():
        parser.error(f"no such command: {', '.join(sorted(unknown))}; benchmarks/commands.yaml has {', '.join(known)}")
    if not all("=" in pair for pair in asked.folder):
        parser.error("--folder takes NAME=PATH")
    names = asked.names or list(known)
    if asked.toy:
        return int(toys(names, asked.jobs) > 0)
    states = {name: state(known[name]) for name in names}
    stale = [name for name, (how, _) in states.items() if how != "current"]
    failing = [name for name in names if verdict(read(name)) == FAIL]
    if asked.list:
        for name in stale:
            how, parts = states[name]
            print(f"{name}: {how}" + (f": {', '.join(parts)}" if parts else ""))
        for name in failing:
            print(f"{name}: misses a goal")
        print(f"{len(names)} commands, {len(stale)} not current, {len(failing)} miss a goal")
        return int(bool(stale or failing))
    chosen = [known[name] for name in (names if asked.all else stale)]
    bad = evidence(chosen, asked.minutes, dict(pair.split("=", 1) for pair in asked.folder))
    return int(bad > 0 or bool(set(failing) - {command.name for command in chosen}))


if __name__ == "__main__":
    sys.exit(main())
