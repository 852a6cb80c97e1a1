"""Checks of the machine: disk, memory, cores, and the environment variables that limit threads."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.files.output_folder import nearest_existing_parent
from csstsim.command_line.doctor.finding import OK, PROBLEM, WARNING, Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from csstsim.base.types import PathLike

DEMO_DISK = 5e9  # bytes of the demo's products
CHIP_MEMORY = 4e9  # bytes: maximum of a full chip with every layer, and a reserve
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def disk_and_memory() -> Iterator[Finding]:
    """Check the free disk of the current folder, and the free memory."""
    disk = free_disk(".")
    advice = f"; the demo takes {DEMO_DISK / 1e9:.0f} GB: free disk space, or work in another folder"
    low = disk < DEMO_DISK
    yield Finding(WARNING if low else OK, "disk", f"{gb(disk)} free in {Path.cwd()}{advice if low else ''}")
    memory = free_memory()
    advice = f"; a full chip takes up to {CHIP_MEMORY / 1e9:.0f} GB: end other programs, or give the campaign a window"
    low = memory < CHIP_MEMORY
    yield Finding(WARNING if low else OK, "memory", f"{gb(memory)} free{advice if low else ''}")


def threads() -> Iterator[Finding]:
    """Check the variables that set the number of threads of libraries against the number of cores."""
    available = cores()
    limits = {name: os.environ[name] for name in THREADS if name in os.environ}
    for name, value in limits.items():
        value = value.split(",")[0].strip()  # OpenMP takes a list; its first number is for the outermost level
        if not value.isdecimal() or int(value) == 0:
            yield Finding(PROBLEM, "threads", f"{name}={value} is not a number: export {name}=1, or unset it")
        elif int(value) > available:
            yield Finding(WARNING, "threads", f"{name}={value} on {available} cores: export {name}=1, or unset it")
    settings = ", ".join(f"{name}={value}" for name, value in limits.items()) or "no limit of threads is set"
    yield Finding(OK, "cores", f"{available}; {settings}; the workflow gives each job one thread")


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def free_memory() -> int:
    """Return the free memory [bytes]: the minimum of the machine's and of its container's or batch job's."""
    pages = "SC_AVPHYS_PAGES" if "SC_AVPHYS_PAGES" in os.sysconf_names else "SC_PHYS_PAGES"
    free = os.sysconf(pages) * os.sysconf("SC_PAGE_SIZE")
    lines = _lines("/proc/meminfo")
    free = next((int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable:")), free)
    cgroup = next((line[3:].strip() for line in _lines("/proc/self/cgroup") if line.startswith("0::")), "/")
    for folder in {Path("/sys/fs/cgroup"), Path("/sys/fs/cgroup") / cgroup.lstrip("/")}:
        limit, used = (next(iter(_lines(folder / f"memory.{name}")), "max").strip() for name in ("max", "current"))
        if limit.isdecimal() and used.isdecimal():
            free = min(free, int(limit) - int(used))
    return max(free, 0)


def _lines(path: PathLike) -> list[str]:
    """Return the lines of a file; [] if it cannot be read."""
    try:
        with open(path) as file:
            return file.readlines()
    except OSError:
        return []


def free_disk(path: PathLike) -> int:
    """Return the free space [bytes] on the disk of a path, which need not exist yet."""
    return shutil.disk_usage(nearest_existing_parent(path)).free


def write_fault(path: PathLike) -> str | None:
    """Return why a folder, or the nearest existing parent of a new one, cannot be written; None if it can."""
    try:
        tempfile.TemporaryFile(dir=nearest_existing_parent(path)).close()
    except OSError as error:
        return error.strerror or str(error)
    return None


def gb(size: float) -> str:
    """Return a number of bytes as text, in GB."""
    return f"{size / 1e9:.3g} GB"
