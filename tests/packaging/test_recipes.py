"""The recipes of packaging/ agree with pyproject.toml, the Makefile, each other and docs/install.md."""

import re
import tomllib

import pytest
import yaml
from packaging.requirements import Requirement

from csstsim.base.shipped import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CONDA = yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text())
DOCKER = (ROOT / "packaging/Dockerfile").read_text()
APPTAINER = (ROOT / "packaging/csstsim.def").read_text()
MAKEFILE = (ROOT / "Makefile").read_text()
PAGE = (ROOT / "docs/install.md").read_text()
CONDA_NAMES = {"astropy": "astropy-base", "matplotlib": "matplotlib-base", "snakemake": "snakemake-minimal"}


def steps(name):
    """Return the commands of a section of the Apptainer definition."""
    section = re.search(rf"(?ms)^%{name}\n(.*?)(?=^%|\Z)", APPTAINER)[1]
    return [line.strip() for line in section.splitlines() if line.strip()]


def requirements(names):
    return {one.name: str(one.specifier) for one in map(Requirement, names)}


def test_conda_has_the_requirements_of_the_wheel():
    run = requirements(CONDA["requirements"]["run"])
    assert run.pop("python") == PROJECT["requires-python"]
    wheel = requirements(PROJECT["dependencies"])
    assert run == {CONDA_NAMES.get(name, name): version for name, version in wheel.items()}
    assert CONDA["requirements"]["host"][0] == f"python {PROJECT['requires-python']}"


def test_conda_has_the_command_and_the_address_of_the_project():
    [[name, target]] = PROJECT["scripts"].items()
    assert CONDA["build"]["python"]["entry_points"] == [f"{name} = {target}"]
    assert CONDA["about"]["homepage"] == PROJECT["urls"]["Homepage"]
    assert CONDA["about"]["license"] == PROJECT["license"]


def test_apptainer_does_what_docker_does():
    runs = [one.replace("/tmp/csstsim", "/csstsim-build") for one in re.findall(r"(?m)^RUN (.*)$", DOCKER)]
    system, environment, *package = [one.replace("/opt/csstsim/bin/", "") for one in steps("post")]
    assert runs[:3] == [system, environment, " && ".join(package)]
    assert re.search(r"(?m)^FROM (.*)$", DOCKER)[1] == re.search(r"(?m)^From: (.*)$", APPTAINER)[1]
    [copied] = re.findall(r"(?m)^COPY (.*)$", DOCKER)
    assert [line.split()[0] for line in steps("files")] == copied.split()[:-1]
    assert "export PATH=/opt/csstsim/bin:$PATH" in steps("environment")


def test_docker_is_sent_what_it_copies():
    ignored = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line and line[0] != "#"]
    [copied] = re.findall(r"(?m)^COPY (.*)$", DOCKER)
    assert ignored == ["*", *(f"!{name}" for name in copied.split()[:-1])]


@pytest.mark.parametrize("name", ["wheel", "wheelhouse", "image", "apptainer", "conda"])
def test_each_recipe_is_one_command_of_the_page(name):
    assert re.search(rf"(?m)^{name}:", MAKEFILE) and f"make {name}" in PAGE


def test_files_that_the_makefile_names_exist():
    named = re.findall(r"(?m)^\t.* (packaging/\S+)", MAKEFILE)
    assert len(named) == 3 and all((ROOT / word).exists() for word in named)


def test_extras_of_the_page_are_those_of_the_package():
    assert set(re.findall(r"csstsim\[(\w+)\]", PAGE)) <= set(PROJECT["optional-dependencies"])
