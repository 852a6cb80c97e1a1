"""Keys of a campaign file: defaults as they are documented, rules between keys, and where files are looked for."""

import json
import os
from pathlib import Path

import pytest
import yaml

from csstsim.base.errors import InputError
from csstsim.base.help_page import PAGES
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.config import Campaign, check_layout, load_campaign, make_campaign
from csstsim.campaign.thresholds import ONLY_EMBEDDED_SKY, ValidateConfig

LEAST = {"schema_version": 1, "name": "mine", "survey_table": "t.csv", "output": "out", "seed": 3}


def made(**changes):
    return make_campaign(LEAST | changes, "c.yaml")


def refused(**changes):
    with pytest.raises(InputError) as error:
        made(**changes)
    return str(error.value)


def test_keys_defaults_and_ranges_are_those_of_the_schema_that_is_shipped():
    shipped = json.loads((SHIPPED / "schema" / "campaign.json").read_text())
    keys = shipped["properties"]["variants"]["additionalProperties"].pop("propertyNames")["enum"]
    assert Campaign.model_json_schema() == shipped and {*keys, "variants"} == set(Campaign.model_fields)


def test_the_layout_of_a_file():
    assert check_layout(1) == 1 and made().schema_version == 1
    with pytest.raises(ValueError, match="an older layout than this csstsim reads, 1; to change: give schema_v"):
        check_layout(0)
    for version in (2, -1):
        with pytest.raises(ValueError, match="this csstsim reads layout 1; a newer file"):
            check_layout(version)
    assert "schema_version" in refused(schema_version=2)


@pytest.mark.parametrize(("changes", "said"), [
    ({"name": "-a"}, "name"), ({"name": "a b"}, "name"), ({"seed": -1}, "seed"), ({"seed": 2**63}, "seed"),
    ({"window": "region"}, "window: 'region' needs select.region (got 'region')"),
    ({"window": {"x0": 5, "x1": 5, "y0": 0, "y1": 1}}, "must exceed x0 = 5"),
    ({"window": {"x0": 0, "x1": 5, "y0": 7, "y1": 6}}, "must exceed y0 = 7"),
    ({"select": {"chips": "some"}}, "must be all, imaging, slitless or a list of chip numbers"),
    ({"select": {"filters": []}}, "select.filters: an empty list selects nothing; leave the key out for all (got [])"),
    ({"select": {"types": []}}, "select.types: an empty"), ({"select": {"obsids": []}}, "select.obsids: an empty"),
    ({"select": {"chips": []}}, "select.chips"), ({"select": {"chips": [3, 0]}}, "select.chips"),
    ({"select": {"region": {"ra": 360, "dec": 0, "radius": 1}}}, "select.region.ra"),
    ({"select": {"region": {"ra": 0, "dec": -90.1, "radius": 1}}}, "select.region.dec"),
    ({"select": {"region": {"ra": 0, "dec": 0, "radius": 0}}}, "select.region.radius"),
    ({"select": {"region": {"ra": 0, "dec": 0, "radius": 120.1}}}, "select.region.radius"),
    ({"truth": ["cat"]}, "must be [parquet] or [parquet, cat]"), ({"truth": ["parquet"] * 2}, "must be [parquet] or"),
    ({"variants": {"1a": {}}}, "1a: a name has letters, digits and _"), ({"variants": {"a-b": {}}}, "a-b: a name has"),
    ({"catalog": {"lensing": {"field": "none", "gamma2": 0.1}}}, "gamma1 and gamma2 need field: constant, not none"),
    ({"catalog": {"lensing": {"kappa": 0.1}}}, "kappa, gamma1 and gamma2 need field: constant, not cosmic"),
    ({"catalog": {"lensing": {"field": "constant", "gamma1": 0.36, "gamma2": -0.48, "kappa": 0.4}}}, "strong lensing"),
    ({"catalog": {"kind": "a:B", "lensing": {"field": "constant"}}}, "lensing is for the embedded universe"),
    ({"catalog": {"kind": "a:B", "structure": "none"}}, "structure is for the embedded universe"),
    ({"catalog": {"kind": "a:B", "bright_stars": True}}, "bright_stars is for the embedded universe"),
    ({"catalog": {"kind": "a:B", "components": "full"}}, "components is for the embedded universe"),
    ({"catalog": {"kind": "a:B", "satellites": True}}, "satellites is for the embedded universe"),
    ({"catalog": {"options": {"file": "a"}}}, "the embedded universe takes no options"),
    ({"measurement": {"calibration": "frames"}}, "masters must be given with calibration: frames"),
    ({"measurement": {"masters": "m"}}, "masters must be given with calibration: frames"),
    ({"measurement": {"contamination": {"table": "a.csv"}}}, "table goes with known_from: catalogue"),
    ({"psf": {"grid": 1}}, "psf.grid"), ({"psf": {"grid": 61}}, "psf.grid"), ({"psf": {"beta": 0}}, "psf.beta"),
    ({"psf": {"oversampling": 3}}, "psf.oversampling"), ({"measurement": {"cti_passes": 21}}, "measurement.cti_passes"),
    ({"validation": {"pull_width": [1.2, 0.9]}}, "must be two numbers, the smaller first"),
    ({"validation": {"pull_width": [-0.1, 0.9]}}, "must be two numbers"),
    ({"validation": {"pull_width": [0.9, 0.9]}}, "must be two numbers"),
    ({"validation": {"purity_min": 1.1}}, "validation.purity_min"),
    ({"validation": {"snr_min": 0}}, "validation.snr_min"),
])  # fmt: skip
def test_what_cannot_be_is_refused_by_its_key(changes, said):
    found = refused(**changes)
    assert found.startswith("c.yaml: ") and said in found, found


@pytest.mark.parametrize("changes", [
    {"name": "a.b-C_9"}, {"seed": 2**63 - 1}, {"window": {"x0": 0, "x1": 1, "y0": 7, "y1": 8}},
    {"select": {"region": {"ra": 0, "dec": -90, "radius": 120}}, "window": "region"},
    {"select": {"obsids": [10100000001]}},
    {"select": {"chips": [1]}}, {"truth": ["cat", "parquet"]}, {"variants": {"A_1": {}, "b": {}}},
    {"catalog": {"lensing": {"field": "constant", "gamma1": 0.36, "gamma2": -0.47, "kappa": 0.4}}},
    {"catalog": {"kind": "a:B", "bright_stars": False, "lensing": {"field": "none"}, "options": {"x": 1}}},
    {"measurement": {"calibration": "frames", "masters": "m", "cti_passes": 0}},
    {"psf": {"grid": 60, "oversampling": 4}},
    {"measurement": {"contamination": {"table": "a.csv", "known_from": "catalogue"}}},
    {"validation": {"pull_width": [0.0, 0.1], "purity_min": None}}, {"validation": {"pull_width": None}},
])  # fmt: skip
def test_what_can_be_is_taken(changes):
    found = made(**changes)
    if "obsids" in changes.get("select", {}):
        assert found.select.obsids == ("10100000001",)  # a number is a name here


def test_what_moves_and_varies_is_in_the_order_of_its_kinds():
    catalog = made(catalog={"satellites": True, "variable_quasars": True}).catalog
    assert set(catalog.changing) == {"satellites", "variable_quasars"} and made().catalog.changing == ()


@pytest.mark.parametrize(("kind", "name"), [
    ("SCIE", "science"), ("BIAS", "bias"), ("DARK", "dark"), ("FLAT", "led_flat"),
])  # fmt: skip
def test_layers_and_universe_are_those_shipped_if_none_are_given(kind, name):
    assert made().observation_file(kind) == SHIPPED / "observations" / f"{name}.yaml"
    assert made(observations={kind: "own.yaml"}).observation_file(kind) == Path("own.yaml")
    assert made().universe_folder == SHIPPED / "universe" and made(universe="u").universe_folder == Path("u")


def test_the_digest_is_of_what_decides_pixels():
    first = made().digest()
    assert len(first) == 16
    for key, value in {
        "seed": 4, "catalog": {"mag_limit": 20.0}, "astrometry": {"planets": True}, "psf": {"grid": 3},
        "fidelity": "preview",
    }.items():  # fmt: skip
        assert made(**{key: value}).digest() != first, key
    for key, value in {
        "name": "b", "output": "p", "survey_table": "u.csv", "validation": {"snr_min": 9.0}, "keep": "light",
        "select": {"chips": "all"}, "measurement": {"cti_passes": 1},
    }.items():  # fmt: skip
        assert made(**{key: value}).digest() == first, key


def test_thresholds_of_the_embedded_sky_hold_for_another_only_if_given():
    limits = ValidateConfig(purity_min=0.7)
    own, shipped = limits.for_catalogue(False), limits.for_catalogue(True)
    assert shipped == limits and own.purity_min == 0.7 and own.snr_min == 5.0 and own.completeness_min == 0.95
    free = {name for name in ValidateConfig.model_fields if getattr(own, name) is None}
    assert free == set(ONLY_EMBEDDED_SKY) - {"purity_min"} and free == {
        "galaxy_completeness_min", "galaxy_mag_max", "pair_completeness_min", "counts_max", "lost_max", "twice_max",
    }  # fmt: skip


def written(folder, name="c.yaml", **changes):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(yaml.safe_dump(LEAST | changes))
    return folder / name


def test_files_are_beside_the_campaign_and_what_is_a_recipes_stays_as_written(tmp_path):
    file = written(
        tmp_path / "a", observations={"SCIE": "s.yaml"}, instrument="../camera", universe="u", share="../common",
        psf={"library": "lib"}, measurement={"calibration": "frames", "masters": "m"},
    )  # fmt: skip
    found = load_campaign(file)
    here = tmp_path / "a"
    assert (found.survey_table, found.output, found.universe) == (here / "t.csv", here / "out", here / "u")
    assert found.observations == {"SCIE": here / "s.yaml"} and found.share == tmp_path / "common"
    assert found.instrument == tmp_path / "camera"
    assert (found.psf.library, found.measurement.masters) == (Path("lib"), Path("m"))
    plain = load_campaign(written(here, "plain.yaml", output="/elsewhere"))
    assert (plain.instrument, plain.universe, plain.share, plain.output) == (None, None, None, Path("/elsewhere"))


def test_the_folder_of_a_changed_camera_is_beside_the_campaign(tmp_path):
    file = written(tmp_path, instrument={"folder": "camera", "detector.gain": 2.0})
    assert load_campaign(file).instrument == {"folder": tmp_path / "camera", "detector.gain": 2.0}
    file = written(tmp_path, instrument={"detector.gain": 2.0})
    assert load_campaign(file).instrument == {"detector.gain": 2.0}


def test_a_variant_is_read_from_the_file_of_its_base(tmp_path):
    file = written(tmp_path, psf={"grid": 4, "beta": 3.0}, variants={"v": {"psf": {"grid": 5}}})
    found = load_campaign(f"{file}@v")
    assert (found.psf.grid, found.psf.beta, found.variants, found.output) == (5, 3.0, {}, tmp_path / "out")
    assert load_campaign(file).psf.grid == 4 and load_campaign(file).variants == {"v": {"psf": {"grid": 5}}}


def test_variants_that_are_equal_are_refused(tmp_path):
    for variants, said in (
        ({"v": {"psf": {"beta": 2.0}}}, "variants.v: equal to the base"),
        ({"a": {"seed": 5}, "b": {"seed": 6}, "c": {"seed": 5}}, "variants.c: equal to the variant a"),
    ):
        with pytest.raises(InputError, match=said):
            load_campaign(written(tmp_path, variants=variants))


def test_a_folder_and_files_of_the_current_directory_are_told(tmp_path, monkeypatch):
    for name in ("b", "a", "d", "c"):
        written(tmp_path / "some", f"{name}.yaml")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="is a folder") as refused:
        load_campaign(tmp_path / "some")
    names = ", ".join(str(tmp_path / "some" / f"{name}.yaml") for name in "abc")
    assert str(refused.value).endswith(f"; allowed: {names}") and refused.value.page == PAGES["campaign"]
    with pytest.raises(InputError, match="is a folder; allowed: the file of a campaign"):
        load_campaign(tmp_path / "empty")
    monkeypatch.chdir(tmp_path)
    file = written(tmp_path / "a", survey_table="here.csv", observations={"BIAS": "bias.yaml"})
    load_campaign(os.path.relpath(file))  # found nowhere: said where it is read
    for name in ("here.csv", "bias.yaml"):
        Path(name).touch()
        with pytest.raises(InputError, match=rf"no file a/{name}, but {name} is in the current directory"):
            load_campaign("a/c.yaml")
        Path(name).unlink()
        (tmp_path / "a" / name).touch()
        load_campaign("a/c.yaml")
