"""Fixtures of the stability suite; warnings are errors there (pyproject.toml), so every NaN is noticed."""

import faulthandler
import resource
from pathlib import Path

import pytest
from exposure import Site

MEMORY = 3e9  # bytes that a test may map on top of what the process has
HANG = 240.0, 900.0  # s, of a test and of a slow one: ends the run with a traceback


@pytest.fixture(autouse=True)
def guard(request):
    """Bound memory and time: generous, to end what has gone wrong, not to measure."""
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (int(mapped + MEMORY), before[1]))
    faulthandler.dump_traceback_later(HANG[request.node.get_closest_marker("slow") is not None], exit=True)
    yield
    faulthandler.cancel_dump_traceback_later()
    resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.fixture(scope="session")
def expose(camera, psf_r, psf_tables):
    """Site.expose"""
    return Site(camera, psf_r, psf_tables).expose
