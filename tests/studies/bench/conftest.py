"""A PSF set of 3 x 3 nodes in the r band, made once, with the files that `csstsim bench` keeps next to it."""

import argparse
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def bench_folder(tmp_path_factory):
    from csstsim.studies.bench import setting

    folder = tmp_path_factory.mktemp("bench")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(setting, "GRID", 3)
        setting.make_setting(folder, "r")
    return folder


@pytest.fixture
def record(monkeypatch):
    """A record that is written nowhere."""
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "benchmarks")
    monkeypatch.setattr(sys, "argv", ["no_command.py"])
    from evidence.record import Record

    return Record(argparse.ArgumentParser(), [])
