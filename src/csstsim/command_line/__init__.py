"""The command line: parse, call, exit.

May import: studies, api, inject, delivery, stages, campaign, simulation, layers, report, render, measure, io, optics,
catalog, universe, instrument, detector, base.
"""

import os

# Before numpy is loaded. Huge pages save a chip's kernels 4% of their time, 0.4 CPU s. But where memory is full of
# cached files the system moves these about to make room for each array: 2.4 CPU s a chip (r, whole)
os.environ.setdefault("NUMPY_MADVISE_HUGEPAGE", "0")
