"""A list of layers read, and changed by a caller."""

from pathlib import Path

import pytest
import yaml

from csstsim.base.errors import InputError
from csstsim.simulation.observation import changed_layers, load_observation

LIST = (
    {"scie_obs": {"exptime": 30.0, "field_dist": True}},
    {"CTE_effect": None},
    {"bias": {"bias_16channel": True}},
    {"gain": {"gain_16channel": {"a": [1, 2]}}},
)


def test_a_change_replaces_what_it_names_and_leaves_the_rest():
    changes = {
        "Scie_Obs": {"exptime": 60.0, "flat_fielding": False},
        "cte_effect": {"density_scale": 0.5},
        "BIAS": None,
    }
    found = changed_layers(changes, LIST, "list.yaml")
    assert list(found) == [
        {"scie_obs": {"exptime": 60.0, "field_dist": True, "flat_fielding": False}},
        {"CTE_effect": {"density_scale": 0.5}},
        {"gain": {"gain_16channel": {"a": [1, 2]}}},
    ]
    assert LIST[0] == {"scie_obs": {"exptime": 30.0, "field_dist": True}} and len(LIST) == 4


def test_the_changed_list_is_a_callers_own():
    found = changed_layers({}, LIST, "list.yaml")
    assert [next(iter(entry)) for entry in found] == ["scie_obs", "CTE_effect", "bias", "gain"]
    assert found[1] == {"CTE_effect": {}}
    found[3]["gain"]["gain_16channel"]["a"].append(3)
    assert LIST[3] == {"gain": {"gain_16channel": {"a": [1, 2]}}}


def test_without_a_list_that_of_the_file_is_changed(tmp_path):
    file = tmp_path / "own.yaml"
    file.write_text("layers:\n  - bias: {bias_16channel: true}\n  - gain:\n")
    assert list(load_observation(file).layers) == [{"bias": {"bias_16channel": True}}, {"gain": None}]
    found = changed_layers({"bias": {"bias_16channel": False}}, None, file)
    assert list(found) == [{"bias": {"bias_16channel": False}}, {"gain": {}}]


@pytest.mark.parametrize(("changes", "words"), [
    ({"gain": {}, "blooming": {}}, r"list\.yaml: layers: not a layer of the list \(got 'blooming'\); allowed: "
     r"scie_obs, CTE_effect, bias, gain; a list with others"),
    (["gain"], r"cannot be used \(got \['gain'\]\)"), ({"gain": 2.0}, r"cannot be used \(got \{'gain': 2\.0\}\)"),
    (dict.fromkeys(("scie_obs", "cte_effect", "bias", "gain")), r"list\.yaml: layers.*at least 1"),
])  # fmt: skip
def test_changes_that_cannot_be_used_are_refused(changes, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("list.yaml").write_text(yaml.safe_dump({"layers": [*LIST]}))
    with pytest.raises(InputError, match=words):
        changed_layers(changes, LIST, "list.yaml")


def test_a_layer_may_be_omitted_twice(tmp_path):
    file = tmp_path / "list.yaml"
    file.write_text(yaml.safe_dump({"layers": [*LIST]}))
    fewer = changed_layers({"CTE_effect": None}, None, file)
    again = changed_layers({"cte_effect": None, "bias": None}, fewer, file)
    assert [name for entry in again for name in entry] == ["scie_obs", "gain"]
    with pytest.raises(InputError, match=r"list\.yaml: layers: an earlier change omitted this layer \(got 'bias'\)"):
        changed_layers({"Bias": {}}, again, file)


@pytest.mark.parametrize(("text", "words"), [
    ("layers:\n  - {bias: {}, gain: {}}\n", r"one 'keyword: parameters' entry, not \['bias', 'gain'\]"),
    ("layers: []\n", "at least 1"), ("layers:\n  - {}\n", "one 'keyword: parameters' entry"),
    ("layers:\n  - bias:\nmore: 1\n", "more"),
])  # fmt: skip
def test_a_file_of_another_form_is_refused_with_its_page(tmp_path, text, words):
    file = tmp_path / "own.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=words) as refused:
        load_observation(file)
    assert str(file) in str(refused.value) and refused.value.page == "config/README.md"
