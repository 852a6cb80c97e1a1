"""Where a chip's CPU time goes: by layer, by rendering method and by function (`csstsim chip --profile`)."""

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

FUNCTIONS = 15


def profiled(make: Callable[[], State | None], say: Callable[[str], object]) -> None:
    """Call `make`, which returns the State of a finished chip, and report the time by layer, function and method.

    None, of a chip that need not be run, has no report.

    `say` takes lines. A function's seconds are wall time, without those of the functions it calls. Profiling slows
    Python down by some tens of per cent, compiled loops not at all.
    """
    profiler = cProfile.Profile()
    state = profiler.runcall(make)
    if state is None:  # of a variant: the file is the base's
        return
    say("\nlayer                          CPU s")
    for name, _, cpu in state.header["timing"]:
        say(f"{name:<28} {cpu:>7.2f}")
    if state.truth is not None and len(state.truth):
        _say_methods(state.truth, say)
    say("\nfunction                                                      calls  wall s")
    for place, calls, own in _functions(profiler):
        say(f"{place:<58} {calls:>8} {own:>6.2f}")


def _say_methods(truth: ObjectTable, say: Callable[[str], object]) -> None:
    say("\nmethod         objects    electrons    CPU s")
    for method in np.unique(truth["method"]):
        mine = truth["method"] == method
        light, ms = (truth[name][mine].sum(dtype=float) for name in ("electrons", "ms"))
        say(f"{method:<12} {mine.sum():>9} {light:>12.3g} {ms / 1000:>8.2f}")


def _functions(profiler: cProfile.Profile) -> Iterator[tuple[str, int, float]]:
    """Yield (where, calls, own seconds) of the functions that took longest."""
    entries = pstats.Stats(profiler).stats.items()  # type: ignore[attr-defined] # the stubs lack it
    for (file, line, name), (_, calls, own, _, _) in sorted(entries, key=lambda e: -e[1][2])[:FUNCTIONS]:
        where = "/".join(Path(file).parts[-2:])
        yield f"{where}:{line} {name}" if line else name, calls, own
