"""`import csstsim` and `csstsim --help` import little; benchmarks/start_up.py measures the time saved."""

import subprocess
import sys

import pytest

HEAVY = {
    "numba",
    "astropy",
    "galsim",
    "matplotlib",
    "pydantic",
    "numpy",
    "scipy",
    "snakemake",
    "pyarrow",
    "yaml",
    "rich",
}
HELP = "from csstsim.command_line.main import main\ntry:\n    main(['--help'])\nexcept SystemExit:\n    pass"


@pytest.mark.parametrize("code", ["import csstsim", HELP, HELP.replace("--help", "chip', '--help")])
def test_heavy_libraries_are_not_imported(code):
    code += "\nimport sys; print(*sorted({name.split('.')[0] for name in sys.modules}), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stderr.split())
    assert "csstsim" in loaded and not loaded & HEAVY
