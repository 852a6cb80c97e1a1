"""The comparison with source-extractor: its measures against closed forms, verdicts that can fail, and a run of it."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from support.csst import PIXEL

from csstsim.base.rng import stream
from csstsim.catalog.table import GALAXY, STAR, ObjectTable
from csstsim.measure.bricks.validation.measured_frame import MeasuredFrame
from csstsim.measure.bricks.validation.trials import COLUMNS
from csstsim.measure.source_columns import SHARP

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
STEP = 0.5  # px


@pytest.fixture
def scripts(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import astromatic
    import source_extractor
    import source_extractor_compare

    return SimpleNamespace(programs=astromatic, command=source_extractor, compare=source_extractor_compare)


def gauss(sigma, n=81):
    axis = STEP * (np.arange(n) - n // 2)
    return np.exp(-0.5 * (axis[:, None] ** 2 + axis**2) / sigma**2) / (2 * np.pi * sigma**2)


def test_width_and_encircled_light_of_a_gaussian(scripts):
    """The width to a step of its fine grid; the light within a circle to 0.2%, its edge being cut out of cells."""
    for sigma in (0.7, 1.3):  # px; narrower than the PSF, and wider
        assert scripts.programs.fwhm(gauss(sigma), STEP) == pytest.approx(2.35482 * sigma, abs=STEP / 16)
    for radius in (4.0, 6.0, 9.0):
        exact = 1 - np.exp(-0.5 * (radius / 3.0) ** 2)
        assert scripts.command.encircled(gauss(3.0), radius) == pytest.approx(exact, abs=0.002)
    assert scripts.command.encircled(gauss(1.3), 1e3) == pytest.approx(1.0, abs=1e-6)


def code(compare, n=400, seed=1, *, light=1.0, lost=0):
    """Return a Code of one frame: n stars of S/N 5 to 500, the first `lost` not found, their light times `light`."""
    snr = np.geomspace(5.1, 490.0, n)
    noise = stream(seed, "test", "source-extractor").normal(size=n) / snr
    found = np.arange(n) >= lost
    columns = {name: np.zeros(n) for name in COLUMNS}
    columns |= {"snr": snr, "found": found, "sound": found, "light": np.where(found, light * (1 + noise), np.nan)}
    columns["galaxy"] = np.zeros(n, bool)
    return compare.Code([ObjectTable(columns)], [columns["light"]], [snr], [found], [1.7], [{"measure": 1.0}])


@pytest.mark.parametrize(
    "other, header, failing",
    [
        ({}, 0.0, None),
        ({"light": 1.01}, 0.0, None),
        ({"light": 1.03}, 0.0, "zero point, star by star"),
        ({"light": np.nan}, 0.0, "zero point, star by star"),
        ({"lost": 4}, 0.0, None),
        ({"lost": 30}, 0.0, "completeness"),
        ({}, 0.05, "MAGZERO"),
    ],
)
def test_differences_are_reported(scripts, record, other, header, failing):
    """1% and 4 of 400 are within what is allowed; 3% of light (0.032 mag), 30 stars and 0.05 mag are not."""
    compare = scripts.compare
    compare.report("r", code(compare), code(compare, seed=2, **other), np.full(9, header), record)
    different = [value.what for value in record.values.values() if value.verdict == "fail"]
    assert [failing in what for what in different] == [True] * (failing is not None)


def test_nothing_to_compare_does_not_agree(scripts, record, capsys):
    empty = [code(scripts.compare, n=0) for _ in range(2)]
    scripts.compare.report("r", *empty, np.zeros(0), record)
    assert record.values["r_zeropoint"].verdict == "fail"
    assert "100" not in capsys.readouterr().out


def test_detections_are_real_within_reach_of_truth(scripts):
    """A star reaches 2.5 px, a galaxy of 1 arcsec 6.8 px; the edge of the window and cosmic rays do not count."""
    truth = {"x": [50.0, 100.0], "y": [50.0, 100.0], "obj_type": [STAR, GALAXY], "bulge_frac": [0.0, 0.0]}
    truth |= {"size_disk": [0.0, 1.0], "size_bulge": [0.0, 0.0]}
    found = {"x": [52.0, 53.0, 106.0, 107.0, 3.0, 70.0], "y": [50.0, 50.0, 100.0, 100.0, 50.0, 70.0]}
    found |= {"snr": np.arange(6.0), "flags": [0, 0, 0, 0, 0, SHARP]}
    truth, found = (ObjectTable({k: np.array(v) for k, v in table.items()}) for table in (truth, found))
    frame = MeasuredFrame(truth, ObjectTable(dict(found), {"window": [0, 200, 0, 200], "filter": "r"}), 100, PIXEL)
    snr, real = scripts.compare.detections(frame)
    assert snr.tolist() == [0, 1, 2, 3]
    assert real.tolist() == [True, False, True, False]
    snr, real = scripts.compare.detections(MeasuredFrame(truth, frame.measured.take(slice(0, 0)), 100, PIXEL))
    assert len(snr) == len(real) == 0


def test_a_failing_program_is_quoted(scripts, tmp_path):
    broken = tmp_path / "broken"
    broken.write_text("#!/bin/sh\necho no such plane >&2\nexit 3\n")
    broken.chmod(0o755)
    with pytest.raises(RuntimeError, match="no such plane"):
        scripts.programs._run(tmp_path, str(broken), "image.fits", {})


@pytest.mark.slow
def test_the_programs_agree_on_a_small_window(scripts, tmp_path):
    """An r window of the demo's field at full depth, from the sky to the verdict: a CPU-minute."""
    if absent := scripts.programs.missing():
        pytest.skip(f"not installed: {', '.join(absent)}")
    campaign = scripts.command.default_campaign(tmp_path, 2500, scripts.command.OBSIDS[:1])
    line = [sys.executable, BENCHMARKS / "source_extractor.py", "--campaign", campaign]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("(goal: met; pass)") == 3
