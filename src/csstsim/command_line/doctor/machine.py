"""Checks of the machine: disk, memory, cores, and the environment variables that limit threads."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.command_line.doctor import OK, PROBLEM, WARNING, Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from csstsim.base.types import PathLike

DISK = 5e9  # bytes the demo takes
MEMORY = 4e9  # bytes: the most that a whole chip with every layer takes, and room beside it
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def disk_and_memory() -> Iterator[Finding]:
    """Disk here, and memory."""
    free = free_disk(".")
    here = Path.cwd()
    few = f"; the demo takes {DISK / 1e9:.0f} GB: free some, or work elsewhere"
    yield Finding(WARNING if free < DISK else OK, "disk", f"{gb(free)} free in {here}{few if free < DISK else ''}")
    memory = free_memory()
    few = f"; a whole chip takes up to {MEMORY / 1e9:.0f} GB: end other programs, or give the campaign a window"
    little = memory < MEMORY
    yield Finding(WARNING if little else OK, "memory", f"{gb(memory)} free{few if little else ''}")


def threads() -> Iterator[Finding]:
    """Cores that this process may use, and the variables that say how many threads libraries start."""
    have = cores()
    limits = {name: os.environ[name] for name in THREADS if name in os.environ}
    for name, value in limits.items():
        value = value.split(",")[0].strip()  # OpenMP's list: the first is of the outermost level
        if not value.isdecimal() or int(value) == 0:
            yield Finding(PROBLEM, "threads", f"{name}={value} is not a number: export {name}=1, or unset it")
        elif int(value) > have:
            yield Finding(WARNING, "threads", f"{name}={value} on {have} cores: export {name}=1, or unset it")
    set_ = ", ".join(f"{name}={value}" for name, value in limits.items())
    yield Finding(
        OK, "cores", f"{have}; {set_ or 'no limit of threads is set'}; the workflow gives each job one thread"
    )


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def free_memory() -> int:
    """Return the bytes of free memory: the machine's, or its container's or batch job's if these are fewer."""
    pages = "SC_AVPHYS_PAGES" if "SC_AVPHYS_PAGES" in os.sysconf_names else "SC_PHYS_PAGES"
    found = os.sysconf(pages) * os.sysconf("SC_PAGE_SIZE")
    lines = _lines("/proc/meminfo")
    found = next((int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")), found)
    own = next((line[3:].strip() for line in _lines("/proc/self/cgroup") if line.startswith("0::")), "/")
    for folder in {Path("/sys/fs/cgroup"), Path("/sys/fs/cgroup") / own.lstrip("/")}:
        most, used = (next(iter(_lines(folder / f"memory.{name}")), "max").strip() for name in ("max", "current"))
        if most.isdecimal() and used.isdecimal():
            found = min(found, int(most) - int(used))
    return max(found, 0)


def _lines(path: PathLike) -> list[str]:
    """Return the lines of a file, none if it cannot be read."""
    try:
        with open(path) as file:
            return file.readlines()
    except OSError:
        return []


def free_disk(path: PathLike) -> int:
    """Return the bytes free on the disk of a path, which need not exist yet."""
    return shutil.disk_usage(nearest_existing_parent(path)).free


def nearest_existing_parent(path: PathLike) -> Path:
    """Return the path itself if it exists, or its nearest parent that does."""
    path = Path(path).absolute()
    return next(place for place in (path, *path.parents) if place.exists())


def write_fault(path: PathLike) -> str | None:
    """Try to write in a folder, or in the parent where it would be made; return why that fails, or None."""
    try:
        tempfile.TemporaryFile(dir=nearest_existing_parent(path)).close()
    except OSError as error:
        return error.strerror or str(error)
    return None


def gb(size: float) -> str:
    """Return a number of bytes as a person reads it."""
    return f"{size / 1e9:.3g} GB"
