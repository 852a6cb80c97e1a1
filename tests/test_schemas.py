"""The schemas for editors: named in the first line of each shipped file, which they accept; faults that they see."""

import json
from pathlib import Path

import pytest
import yaml

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
ROOT = Path(__file__).parents[1]
FILES = [
    path for folder in ("config", "examples") for path in sorted((ROOT / folder).rglob("*.yaml"))
    if {"survey_table", "layers"} & set(yaml.safe_load(path.read_text())) and "results" not in path.parts
]  # fmt: skip
SCIENCE = ROOT / "config" / "observations" / "science.yaml"


def faults(path, changes=None):
    """Return what the schema that a file names says of its content."""
    first = path.read_text().splitlines()[0]
    assert first.startswith("# yaml-language-server: $schema=")
    schema = json.loads((path.parent / first.partition("=")[2]).read_text())
    content = yaml.safe_load(path.read_text()) | (changes or {})
    return [error.message for error in jsonschema.Draft202012Validator(schema).iter_errors(content)]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_shipped_file_names_a_schema_that_accepts_it(path):
    assert faults(path) == []


def test_there_are_campaigns_and_observations():
    assert len(FILES) > 25 and SCIENCE in FILES


@pytest.mark.parametrize(
    "changes",
    [
        {"seeed": 1},
        {"seed": "one"},
        {"fidelity": "fast"},
        {"psf": {"grid": 0}},
        {"variants": {"a": {"b": 1}}},
    ],
)
def test_faults_of_a_campaign_are_seen(changes):
    assert faults(ROOT / "config" / "campaign.yaml", changes)


@pytest.mark.parametrize(
    "layer",
    [{"cosmic_rays": {"rate": 1}}, {"gain": 3}, {"cte_effect": {"no_such": 1}}, {"prescan_overscan": {"x": 1}}],
)
def test_faults_of_a_layer_are_seen(layer):
    assert faults(SCIENCE, {"layers": [layer]})


def test_layers_of_ones_own_are_accepted():
    assert not faults(SCIENCE, {"layers": [{"my_lab.layer": {"anything": 1}}, {"gain": None}]})
