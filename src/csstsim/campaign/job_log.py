"""The first and the last line of a job's log: whose it is, and what the process took. At a terminal neither is said."""

import os
import re
import resource
import socket
import sys
import time
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime

from csstsim import __version__

_START = time.monotonic()  # the commands import this first: nearly the start of the process
_FIRST = re.compile(r"csstsim \S+ \w+: .*, (\S+) pid (\d{1,9}), \S+Z")
_LAST = re.compile(r"^\w+ done: (\d{1,9}\.\d) s, CPU (\d{1,9}\.\d) s, memory (\d{1,9}) MB$", re.MULTILINE)
ERROR = "csstsim: error:"  # how the line begins that a command says instead of the last one


@dataclass(frozen=True)
class Took:
    """What a job took, from its start to its end."""

    wall_s: float
    cpu_s: float  # user and system
    memory_mb: float  # most at a time, mapped files included


@contextmanager
def job_log(verb, campaign, digest, what):
    """Say the first line of a job's log; if what is done under it succeeds, the last one.

    verb: the command; campaign: its name; digest: of its content; what: the exposure, chip or brick, in words.
    """
    talks = sys.stdout is not None and not sys.stdout.isatty()
    if talks:
        now = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
        parts = [f"campaign {campaign} {digest[:8]}", what, f"{socket.gethostname()} pid {os.getpid()}", now]
        print(f"csstsim {__version__} {verb}: {', '.join(part for part in parts if part)}", flush=True)
    yield
    if talks:
        took = Took(time.monotonic() - _START, time.process_time(), _peak_memory_mb())
        print(f"{verb} done: {took.wall_s:.1f} s, CPU {took.cpu_s:.1f} s, memory {took.memory_mb:.0f} MB")


def took(log):
    """Return the Took that a log ends with, or None: the job failed, is at work, or is of an older release."""
    found = _LAST.findall(log)
    return Took(*map(float, found[-1])) if found else None


def killed(log):
    """Return the pid of the process of this host that a log is of, if it is gone and left no last line; or None."""
    first = _FIRST.match(log)
    if not first or first[1] != socket.gethostname() or took(log) or os.path.exists(f"/proc/{first[2]}"):
        return None
    return int(first[2]) if os.path.exists("/proc/self") else None


def _peak_memory_mb():
    """Return the largest resident memory; not that of getrusage, if it can be helped, in which a parent has a share."""
    try:
        with open("/proc/self/status") as file:
            return next(int(line.split()[1]) for line in file if line.startswith("VmHWM:")) / 1024
    except (OSError, StopIteration):
        size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return size / 2**20 if sys.platform == "darwin" else size / 1024
