"""The version has one home, csstsim/__init__.py; what repeats it agrees. docs/versions.md states what the code has."""

import re
import tomllib

import table_schema
import yaml

from csstsim import __version__
from csstsim.base.shipped import ROOT
from csstsim.campaign.config import NEWEST
from csstsim.optics.psf import psf_file
from csstsim.render import psf_table

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PAGE = (ROOT / "docs" / "versions.md").read_text()


def test_the_package_takes_the_version_from_the_code():
    assert "version" in PROJECT["project"]["dynamic"]
    assert PROJECT["tool"]["hatch"]["version"]["path"] == "src/csstsim/__init__.py"
    assert re.fullmatch(r"\d+\.\d+\.\d+", __version__)


def test_files_that_repeat_the_version():
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == __version__
    assert yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text())["context"]["version"] == __version__


def test_the_changes_begin_with_this_version():
    headings = re.findall(r"(?m)^## (.+)$", (ROOT / "CHANGES.md").read_text())
    assert next(heading for heading in headings if heading != "Unreleased") == __version__
    assert "Unreleased" not in headings[1:]


def test_a_release_is_about_a_page_of_changes():
    for part in re.split(r"(?m)^(?=## )", (ROOT / "CHANGES.md").read_text())[1:]:
        assert part.count("\n") <= 100, part.split("\n")[0]


def test_the_page_has_the_versions_of_files():
    rows = {row.split("|")[1].strip(): row for row in PAGE.splitlines() if row.startswith("| ")}
    assert f"`schema_version` {NEWEST} |" in rows["campaign"]
    assert f"| {table_schema.VERSION} |" in rows["tables, `config/schema/tables.json`"]
    assert f"`format` {psf_file.FORMAT} |" in rows["PSF set, `psf/chip_*.h5`"]
    assert f"`format` {psf_table.FORMAT} |" in rows["tables of a PSF set"]


def test_the_page_lists_every_old_name():
    """As many rows as there are promises in the code, and the same versions."""
    code = "".join(path.read_text() for path in sorted((ROOT / "src").rglob("*.py")))
    assert sorted(set(re.findall(r'goes="([\d.]+)"', code))) == sorted(set(re.findall(r"(?m)\| ([\d.]+) \|$", PAGE)))
    for option in re.findall(r'"(--[a-z-]+)": "--', code):
        assert option in PAGE
