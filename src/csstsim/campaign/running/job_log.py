"""The first and last line of a job's log (the job; its time and memory), and a line for each chip or brick.

They are not printed on a terminal.
"""

from __future__ import annotations

import os
import re
import resource
import socket
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from csstsim import __version__

if TYPE_CHECKING:
    from collections.abc import Iterator

_START = time.monotonic()  # commands import this module first, so it is close to the start of the process
_FIRST = re.compile(r"csstsim \S+ \w+: .*, (\S+) pid (\d{1,9}), \S+Z")
_LAST = re.compile(r"^\w+ done: (\d{1,9}\.\d) s, CPU (\d{1,9}\.\d) s, memory (\d{1,9}) MB$", re.MULTILINE)
_PART = re.compile(r"^(?:chip|brick) (\d{1,9}) done: \d{1,9}\.\d s, CPU (\d{1,9}\.\d) s$", re.MULTILINE)
_EARLIER = re.compile(r"^(?:chip|brick) (\d{1,9}) was finished earlier: CPU (\d{1,9}\.\d) s$", re.MULTILINE)
ERROR = "csstsim: error:"  # beginning of the last line of a failed command


@dataclass(frozen=True)
class JobUsage:
    """Time and memory of a job, from its start to its end."""

    wall_s: float
    cpu_s: float  # user and system
    memory_mb: float  # maximum, mapped files included


@contextmanager
def job_log(verb: str | None, campaign: str, digest: str, job: str) -> Iterator[None]:
    """Print the first line of a job's log and, if the work inside succeeds, the last one.

    verb: the command; campaign: its name; digest: of its content; job: the exposure, chip or brick, as text.
    """
    to_log = sys.stdout is not None and not sys.stdout.isatty()
    if to_log:
        now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
        parts = [f"campaign {campaign} {digest[:8]}", job, f"{socket.gethostname()} pid {os.getpid()}", now]
        print(f"csstsim {__version__} {verb}: {', '.join(part for part in parts if part)}", flush=True)
    yield
    if to_log:
        usage = JobUsage(time.monotonic() - _START, time.process_time(), _peak_memory_mb())
        print(f"{verb} done: {usage.wall_s:.1f} s, CPU {usage.cpu_s:.1f} s, memory {usage.memory_mb:.0f} MB")


@contextmanager
def part_log(kind: str, number: int) -> Iterator[None]:
    """Print the time of one part of a job that makes several. kind: "chip" or "brick"."""
    wall_start = time.monotonic()
    cpu_start = time.process_time()
    yield
    if sys.stdout is not None and not sys.stdout.isatty():
        wall = time.monotonic() - wall_start
        cpu = time.process_time() - cpu_start
        print(f"{kind} {number} done: {wall:.1f} s, CPU {cpu:.1f} s", flush=True)


def finished_earlier(kind: str, number: int, cpu: float) -> str:
    """Return the log line of a part that an earlier attempt of the job finished. cpu: its CPU time [s]."""
    return f"{kind} {number} was finished earlier: CPU {cpu:.1f} s"


def parts(log: str) -> dict[int, float]:
    """Return {number: CPU time [s]} of the chips or bricks in a log; {} for a job of one chip or brick."""
    return {int(number): float(cpu) for number, cpu in _PART.findall(log)}


def earlier_parts(log: str) -> dict[int, float]:
    """Return {number: CPU time [s]} of chips or bricks finished by an earlier attempt, not in the job's CPU time."""
    return {int(number): float(cpu) for number, cpu in _EARLIER.findall(log)}


def read_usage(log: str) -> JobUsage | None:
    """Return the JobUsage in a log's last line; None if the job failed, still runs, or is of an older release."""
    last_lines = _LAST.findall(log)
    if not last_lines:
        return None
    wall_s, cpu_s, memory_mb = map(float, last_lines[-1])
    return JobUsage(wall_s, cpu_s, memory_mb)


def killed(log: str) -> int | None:
    """Return the pid of a log's process if it ran on this host and was killed before its last line; else None."""
    first = _FIRST.match(log)
    if not first:
        return None
    host, pid = first.groups()
    if host != socket.gethostname() or read_usage(log) or os.path.exists(f"/proc/{pid}"):
        return None
    return int(pid) if os.path.exists("/proc/self") else None


def _peak_memory_mb() -> float:
    """Return the peak resident memory [MB]; without /proc from getrusage, which includes the parent's memory."""
    try:
        with open("/proc/self/status") as file:
            return next(int(line.split()[1]) for line in file if line.startswith("VmHWM:")) / 1024
    except (OSError, StopIteration):
        size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return size / 2**20 if sys.platform == "darwin" else size / 1024
