"""CPU time of a chip by layer, by rendering method and by function (`csstsim chip --profile`)."""

from __future__ import annotations

import cProfile
import pstats
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from csstsim.catalog.table import ObjectTable
    from csstsim.simulation.state import State

FUNCTIONS = 15  # reported


def profiled(make: Callable[[], State | None], log: Callable[[str], object]) -> None:
    """Call `make`, which returns the State of a finished chip, and report the time by layer, method and function.

    Nothing is reported if `make` returns None: the chip was not simulated. `log` prints a line. A function's seconds
    are wall time, without the functions that it calls. Profiling slows Python down by some tens of per cent; it does
    not slow compiled loops.
    """
    profiler = cProfile.Profile()
    state = profiler.runcall(make)
    if state is None:  # a variant, whose file is a copy of the base's
        return
    log("\nlayer                          CPU s")
    for name, _, cpu in state.header["timing"]:
        log(f"{name:<28} {cpu:>7.2f}")
    if state.truth is not None and len(state.truth):
        _log_methods(state.truth, log)
    log("\nfunction                                                      calls  wall s")
    for where, calls, seconds in _slowest_functions(profiler):
        log(f"{where:<58} {calls:>8} {seconds:>6.2f}")


def _log_methods(truth: ObjectTable, log: Callable[[str], object]) -> None:
    log("\nmethod         objects    electrons    CPU s")
    for method in np.unique(truth["method"]):
        rows = truth["method"] == method
        electrons, ms = (truth[name][rows].sum(dtype=float) for name in ("electrons", "ms"))
        log(f"{method:<12} {rows.sum():>9} {electrons:>12.3g} {ms / 1000:>8.2f}")


def _slowest_functions(profiler: cProfile.Profile) -> Iterator[tuple[str, int, float]]:
    """Yield (file, line and name; calls; seconds without called functions) of the slowest functions, slowest first."""
    entries = pstats.Stats(profiler).stats.items()  # type: ignore[attr-defined] # the stubs lack it
    for (file, line, name), (_, calls, seconds, _, _) in sorted(entries, key=lambda e: -e[1][2])[:FUNCTIONS]:
        where = "/".join(Path(file).parts[-2:])
        yield f"{where}:{line} {name}" if line else name, calls, seconds
