"""Where a chip's CPU time goes: by layer, by rendering method and by function (`csstsim chip --profile`)."""

import cProfile
import pstats
from pathlib import Path

import numpy as np

FUNCTIONS = 15


def profiled(make, say):
    """Call `make`, which returns the State of a finished chip, and report the time by layer, function and method.

    `say` takes lines. A function's seconds are wall time, without those of the functions it calls. Profiling slows
    Python down by some tens of per cent, compiled loops not at all.
    """
    profiler = cProfile.Profile()
    state = profiler.runcall(make)
    say("\nlayer                          CPU s")
    for name, _, cpu in state.header["timing"]:
        say(f"{name:<28} {cpu:>7.2f}")
    if len(state.truth or ()):
        _say_methods(state.truth, say)
    say("\nfunction                                                      calls  wall s")
    for place, calls, own in _functions(profiler):
        say(f"{place:<58} {calls:>8} {own:>6.2f}")


def _say_methods(truth, say):
    say("\nmethod         objects    electrons    CPU s")
    for method in np.unique(truth["method"]):
        mine = truth["method"] == method
        light, ms = (truth[name][mine].sum(dtype=float) for name in ("electrons", "ms"))
        say(f"{method:<12} {mine.sum():>9} {light:>12.3g} {ms / 1000:>8.2f}")


def _functions(profiler):
    """Yield (where, calls, own seconds) of the functions that took longest."""
    entries = pstats.Stats(profiler).stats.items()
    for (file, line, name), (_, calls, own, _, _) in sorted(entries, key=lambda e: -e[1][2])[:FUNCTIONS]:
        where = "/".join(Path(file).parts[-2:])
        yield f"{where}:{line} {name}" if line else name, calls, own
