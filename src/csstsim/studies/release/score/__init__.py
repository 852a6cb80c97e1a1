"""A catalogue judged by the truth of a benchmark pack: `csstsim release score`."""
