"""What docs/install.md shows, followed: wheels without a network, an image. Minutes, and hundreds of MB: -m slow."""

import os
import re
import shutil
import subprocess

import pytest

from csstsim import __version__
from csstsim.base.shipped import ROOT

pytestmark = pytest.mark.slow
USE = "csstsim --version && csstsim doctor && csstsim init my_sky && csstsim plan my_sky/campaign.yaml"


def block(heading):
    """Return the commands of the first block below a heading of the page."""
    return re.search(rf"(?ms)^## {heading}\n.*?^```bash\n(.*?)^```", (ROOT / "docs/install.md").read_text())[1]


def recipe(target):
    """Return the commands of a target of the Makefile."""
    text = re.search(rf"(?m)^{target}:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text())[1]
    return text.replace("$(BIN)/", "").replace("$(DOCKER)", "docker")


def run(script, folder, **variables):
    done = subprocess.run(
        ["bash", "-ec", script], cwd=folder, env=os.environ | {"PYTHONPATH": ""} | variables,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_wheels_are_installed_and_used_without_a_network(tmp_path):
    run((recipe("kernels") + recipe("wheelhouse")).replace("results/", f"{tmp_path}/"), ROOT)
    said = run(f"{block('Offline')}{USE}", tmp_path, PIP_CONFIG_FILE="/dev/null", PIP_NO_INDEX="1", PIP_FIND_LINKS="")
    assert f"csstsim {__version__} (commit " in said and "\nproblem" not in said
    assert " 0 compiled here; " in said and " come with csstsim" in said


def test_the_image_is_built_and_used(tmp_path):
    if not shutil.which("docker") or subprocess.run(["docker", "info"], capture_output=True, check=False).returncode:
        pytest.skip("no docker, or its service does not run")
    run(recipe("kernels") + recipe("wheel") + recipe("image"), ROOT)
    said = run(f'docker run --rm -v "$PWD:/data" csstsim sh -c "{USE}"', tmp_path)
    assert f"csstsim {__version__} (commit " in said and "\nproblem" not in said
