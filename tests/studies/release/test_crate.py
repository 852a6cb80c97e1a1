"""`csstsim release crate`: what it says of a finished campaign, and that the folder stays sound."""

import json
import shutil
from datetime import UTC, datetime

import pytest
import yaml
from support.commands import done, refused

from csstsim import __version__
from csstsim.base.shipped import ROOT
from csstsim.campaign.opened import OpenCampaign
from csstsim.studies.release.run_record import run_record
from release.crates import checked, validated


@pytest.fixture(scope="module")
def described(sound, tmp_path_factory):
    """(campaign file, output folder with manifest, two logs and crate) of a copy of the finished campaign."""
    copy = shutil.copytree(sound[0].parent, tmp_path_factory.mktemp("crate") / "campaign")
    file = copy / "campaign.yaml"
    file.write_text(file.read_text().replace(str(sound[0].parent), str(copy)))
    output = copy / "out"
    (output / "campaign.json").unlink(missing_ok=True)
    for rule, minute, took in (("measure", 5, 61.2), ("chip", 1, 30.0)):
        (output / "logs" / rule).mkdir(parents=True, exist_ok=True)
        (output / "logs" / rule / "a.log").write_text(
            f"csstsim {__version__} {rule}: campaign mini 0123abcd, chip 9, host pid 7, 2027-01-01T10:0{minute}:00Z\n"
            f"{rule} done: {took} s, CPU {took / 2:.1f} s, memory 100 MB\n"
        )
    assert "no manifest yet" in refused("release", "crate", file)
    done("verify", file, "--manifest")
    done("release", "crate", file)
    return file, output


def test_the_run_is_that_of_the_logs(described):
    entities, left = checked(described[1])
    run = entities["#run"]
    assert (run["startTime"], run["endTime"]) == ("2027-01-01T10:01:00+00:00", "2027-01-01T10:06:01+00:00")
    assert run["description"] == "2 jobs: 1 chip, 1 measure"
    assert entities[run["instrument"]["@id"]]["programmingLanguage"]["@id"].endswith("snakemake.readthedocs.io")
    found = run_record(described[1])
    assert found.cpu_s == pytest.approx(45.6) and found.start == datetime(2027, 1, 1, 10, 1, tzinfo=UTC)
    not_listed = {"ro-crate-metadata.json", "MANIFEST.content", "campaign.json"}
    assert all(name in not_listed or name.startswith("logs/") for name in left)
    assert run_record(described[1] / "level0") is None


def test_inputs_recipes_and_columns_are_in_it(described):
    folder = described[1] / "workflow"
    assert yaml.safe_load((folder / "inputs" / "campaign.yaml").read_text())["name"] == "mini"
    assert (folder / "inputs" / "table.csv").is_file() and (folder / "Snakefile").is_file()
    recipes, run = json.loads((folder / "recipes.json").read_text()), OpenCampaign(described[0])
    job = run.jobs[0]
    assert recipes["jobs"][f"{job.obsid}_{job.chip.id:02d}"]["level0"] == run.recipe(job, "level0")
    assert "tables" in json.loads((folder / "tables.json").read_text())


def test_the_folder_stays_sound(described):
    assert "sound" in done("verify", described[0])
    done("release", "crate", described[0])  # again


def test_by_the_validator(described):
    validated(described[1], "workflow-run-crate-0.5")


def test_the_citation_is_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == __version__ and citation["cff-version"] == "1.2.0"
    assert citation["license"] == "BSD-3-Clause" and len(citation["references"][0]["authors"]) == 29
