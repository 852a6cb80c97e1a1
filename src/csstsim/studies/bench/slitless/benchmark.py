"""The benchmark of dispersed light: `csstsim bench` with a grating's filter."""

from csstsim.studies.bench.slitless.cases import make_spectrum_cases
from csstsim.studies.bench.slitless.measures import GOALS, NAMES, errors
from csstsim.studies.bench.slitless.methods import METHODS, standard
from csstsim.studies.bench.slitless.truth import SpectrumTruth
from csstsim.studies.bench.sweep import Bench

SLITLESS = Bench(
    METHODS,
    make_spectrum_cases,
    SpectrumTruth,
    standard,
    errors,
    NAMES,
    GOALS,
    ("flux", "along_px", "size2", "line_px"),
)
