"""Injected objects found again: matching, bins with errors, the figure; `csstsim recover`."""
