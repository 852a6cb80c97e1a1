"""A catalogue scored against the truth of a benchmark pack: `csstsim release score`."""
