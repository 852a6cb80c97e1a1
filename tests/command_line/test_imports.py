"""The stages of a chip import no library they do not need, which would cost more than their own work."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.mini_campaign import write_campaign

NEVER = {"astropy", "galsim", "healpy", "matplotlib", "pandas", "rich", "sep", "snakemake"}
OPENING = NEVER | {"h5py", "hpgeom", "numba", "pyarrow", "scipy"}  # what a campaign is opened without
FORBIDDEN = {
    "select": NEVER | {"h5py", "scipy.interpolate", "scipy.linalg", "scipy.optimize", "scipy.fft"},
    "render": NEVER | {"hpgeom"},
    "readout": NEVER | {"h5py", "hpgeom", "pyarrow", "scipy.interpolate", "scipy.linalg", "scipy.optimize"},
    "level0": NEVER | {"h5py", "hpgeom", "numba", "scipy"},
}
JOB = "--obsid", "10100000001", "--chip", "9"
RUN = """
import sys
class Watch:  # what is looked for also counts where it is not installed
    def find_spec(name, path=None, target=None):
        if name == "pandas":
            print(name, file=sys.stderr)
sys.meta_path.insert(0, Watch)
from csstsim.command_line.main import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    assert not end.code, end.code
print(*sys.modules, file=sys.stderr)
"""


def loaded(*arguments, code=RUN):
    """Return the modules that a process had loaded when it ended."""
    folder = str(Path(__file__).parents[2] / "src")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([folder, os.environ.get("PYTHONPATH", "")])}
    line = [sys.executable, "-c", code, *map(str, arguments)]
    done = subprocess.run(line, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return set(done.stderr.split())


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Written, with what is made once."""
    file = write_campaign(tmp_path_factory.mktemp("imports"), window={"x0": 0, "x1": 32, "y0": 0, "y1": 32})
    from csstsim.campaign.opened import OpenCampaign
    from csstsim.stages.chip import missing

    run = OpenCampaign(file)
    missing(run, run.job(JOB[1], 9), lambda text: None)
    return file


@pytest.mark.thorough
def test_each_stage_in_turn(campaign):
    for verb, forbidden in FORBIDDEN.items():
        modules = loaded(verb, campaign, *JOB)
        assert f"csstsim.stages.{verb}" in modules and "numpy" in modules
        assert not (modules & forbidden), (verb, modules & forbidden)


def test_a_brick(campaign):
    """Astropy reads the map of dust."""
    modules = loaded("truth", campaign, "--brick", 0)
    assert "csstsim.catalog.truth_bricks" in modules and not modules & (NEVER - {"astropy"}), modules & NEVER


@pytest.mark.parametrize("verb", FORBIDDEN)
def test_the_help_of_a_stage(verb):
    assert not loaded(verb, "--help") & (OPENING | {"numpy", "pydantic", "yaml", "fitsio"})


def test_a_campaign_is_opened_and_its_windows_found_without_compiled_code(campaign):
    code = f"""
import sys
from csstsim.campaign.opened import OpenCampaign
run = OpenCampaign(sys.argv[1])
job = run.job("{JOB[1]}", 9)
job.wcs.world_to_pixel(*job.footprint())
run.recipe(job)
print(*sys.modules, file=sys.stderr)
"""
    modules = loaded(campaign, code=code)
    assert "csstsim.optics.geometry.few_points" in modules and not modules & OPENING
