"""-v and -q before and after the verb; the help page that an error names."""

import logging
import re

import pytest
from support.commands import command
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.help_page import PAGES, with_page
from csstsim.base.shipped import ROOT
from csstsim.catalog.open import TABLE_KIND

CHIP = "--obsid", POINTINGS[2].split(",")[0], "--chip", "9"  # a bias frame: the quickest chip


@pytest.fixture
def bias(tmp_path):
    return write_campaign(tmp_path, select={"types": ["BIAS"], "chips": [9]})


def test_quiet_prints_nothing_of_a_stage_but_its_errors(bias):
    loud = command("chip", bias, *CHIP)
    assert loud.exit_code == 0 and "readout:" in loud.stdout and "chip done:" in loud.stdout
    for line in (["-q", "chip", bias, *CHIP], ["chip", bias, *CHIP, "-q"], ["chip", "--quiet", bias, *CHIP]):
        quiet = command(*line)
        assert (quiet.exit_code, quiet.output) == (0, "")
    refused = command("-q", "chip", bias, "--obsid", "42", "--chip", 9)
    assert refused.exit_code == 2 and refused.stdout == "" and "42" in refused.stderr


def test_quiet_prints_what_was_asked_for(bias):
    profile = command("-q", "chip", bias, *CHIP, "--profile").stdout
    assert "layer" in profile and "function" in profile and "readout:" not in profile
    assert "bias_16channel" in command("-q", "layers", "bias").stdout
    assert "jobs" in command("plan", bias, "-q").stdout


@pytest.mark.parametrize("before", [True, False])
def test_verbose_says_what_is_read_and_written_with_its_time(bias, before):
    said = command(*(["-v"] if before else []), "chip", bias, *CHIP, *([] if before else ["--verbose"]))
    assert said.exit_code == 0
    lines = said.stderr.splitlines()
    read = next(line for line in lines if f" read {bias}: " in line)
    wrote = next(line for line in lines if " wrote " in line and "_L0_" in line and ".fits" in line)
    assert lines.index(read) < lines.index(wrote)
    size = f": {bias.stat().st_size / 1e3:.3g} kB in "
    assert size in read and all(re.search(r": [\d.]+ [kM]B in \d+\.\d\d\d s$", line) for line in (read, wrote))
    assert not any(".tmp" in line for line in lines)


def test_verbose_ends_with_its_command(bias):
    assert command("-v", "check", bias).stderr and not command("check", bias).stderr
    assert logging.getLogger("csstsim.files").handlers == []


def test_verbose_shows_the_traceback_behind_an_error(tmp_path):
    for line in (["-v", "check", tmp_path / "none.yaml"], ["check", tmp_path / "none.yaml", "-v"]):
        refused = command(*line)
        assert refused.exit_code == 2 and "Traceback" in refused.stderr
        assert refused.stderr.splitlines()[-1].startswith("csstsim: error: ")
    assert "Traceback" not in command("check", tmp_path / "none.yaml").stderr


def test_pages_are_there():
    pages = [page for page in PAGES.values() if not page.startswith("`")]
    assert pages and all((ROOT / page).is_file() for page in pages)


@pytest.mark.parametrize(
    "changes, page",
    [
        ({"colour": 1}, "config/README.md"),
        ({"select": {"obsids": ["42"]}}, "config/README.md"),
        ({"survey_table": "/nowhere.csv"}, "survey_tables/README.md"),
        ({"instrument": "/nowhere"}, "config/instrument/README.md"),
        ({"observations": {"BIAS": "/nowhere.yaml"}}, "config/README.md"),
        ({"catalog": {"kind": "nosuch.module:Class"}}, "`python -m pydoc csstsim.catalog.base`"),
        (
            {"catalog": {"kind": "support.mini_campaign:Stars"}, "select": {"types": ["SCIE"], "chips": [9]}},
            "csstsim.catalog.base`",
        ),
        (
            {"catalog": {"kind": TABLE_KIND, "options": {"columns": {"ra": [1.0]}}}, "select": {"types": ["SCIE"]}},
            "examples/my_catalogue/README.md",
        ),
    ],
)
def test_an_error_names_the_page_that_explains(tmp_path, changes, page, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = write_campaign(tmp_path, **({"select": {"types": ["BIAS"], "chips": [9]}} | changes))
    [line] = command("check", file).stderr.splitlines()
    assert line.endswith(page if page.endswith("`") else f"; see {ROOT / page}"), line


def test_the_page_is_told_from_where_one_stands(monkeypatch):
    monkeypatch.chdir(ROOT)
    assert command("check", "/nowhere.yaml").stderr.endswith("; see config/README.md\n")


def test_an_error_without_a_page_is_as_it_was():
    from csstsim.base.errors import InputError

    assert with_page(InputError("wrong", file="a.fits")) == "a.fits: wrong"
