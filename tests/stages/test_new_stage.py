"""The stage of docs/extension_points.md, in a copy of the code: five files make it known to all that reads stages."""

import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.stage_records import PRODUCTS, STAGE_OF, STAGES
from csstsim.campaign.costs import load_costs
from csstsim.campaign.opened import OpenCampaign
from csstsim.delivery.contents import CHECKED
from csstsim.measure.bricks.hats import ABOUT

ROOT = Path(__file__).resolve().parents[2]
STAGE = Path(__file__).with_name("new_stage")  # what the page shows
COPIED = "src/csstsim", "config", "workflow", "Snakefile"
LINKED = "survey_tables", "examples", "builders", "profiles", "pyproject.toml"
EXPOSURE = "--obsid", "10100000001"


def insert(file, text, before):
    """Put a text before the only place where another stands."""
    old = file.read_text()
    assert old.count(before) == 1, (file, before)
    file.write_text(old.replace(before, text + before))


@pytest.fixture(scope="module")
def extended(tmp_path_factory):
    """The root of a copy of the code with the stage of the page."""
    root = tmp_path_factory.mktemp("extended")
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, root / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copyfile(source, root / name)
    for name in LINKED:
        (root / name).symlink_to(ROOT / name)
    shutil.copyfile(STAGE / "count.py", root / "src/csstsim/stages/count.py")
    records = root / "src/csstsim/base/stage_records.py"
    record = (STAGE / "record.txt").read_text()
    insert(records, textwrap.indent(f"{record.rstrip()},\n", "    "), '    Stage(\n        name="extract",')
    commands = root / "src/csstsim/command_line/rules.py"
    insert(commands, (STAGE / "command.txt").read_text() + "\n\n", "RULES = (\n")
    text = commands.read_text().replace("RULES = (\n", "RULES = (\n    count,")
    commands.write_text(text.replace("import Finite, ", "import Finite, of_exposure, "))
    with (root / "workflow/rules/calibrate.smk").open("a") as file:
        file.write("\n\n" + (STAGE / "rule.smk").read_text())
    with (root / "config/costs.yaml").open("a") as file:
        file.write("\n" + (STAGE / "cost.yaml").read_text())
    return root


def run(root, *words):
    """Return what a program says with the code of a folder, and its exit code."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        words, env=os.environ | {"PYTHONPATH": str(root / "src"), "PATH": path, "COLUMNS": "200"}, cwd=root,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.stdout + done.stderr, done.returncode


def test_a_new_stage_is_known_to_the_help_plan_status_verify_and_rules(extended, tmp_path):
    campaign = write_campaign(tmp_path, POINTINGS[:2], select={"types": ["SCIE"], "chips": [9]})
    logged = {
        verb: run(extended, "csstsim", *words)
        for verb, words in {
            "help": ["--help"], "plan": ["plan", campaign], "status": ["status", campaign],
            "count": ["count", campaign, *EXPOSURE], "other": ["count", campaign, "--obsid", "1"],
        }.items()
    }  # fmt: skip
    assert re.search(
        r"measure .*\n  count +Count the measured sources of an exposure\.\n  extract", logged["help"][0]
    ), logged
    assert re.search(r"count +. +2 +. +1\.6 ", logged["plan"][0]), logged["plan"]
    assert "counted exposures: 0 of 2" in logged["status"][0]
    text, code = logged["count"]
    assert code == 2 and "not made yet; `csstsim measure" in text, text  # the command reads what the record says
    text, code = logged["other"]
    assert code == 2 and "not a science exposure of this campaign (got '1')" in text, text
    line = "snakemake", "-n", "--directory", tmp_path, "--config", f"campaign={campaign}"
    text, code = run(extended, *map(str, line))
    assert code == 0 and re.search(r"^count +2$", text, re.MULTILINE), text
    assert f"{tmp_path}/out/counts/10100000001.json" in text


def test_verify_misses_and_knows_the_product_of_a_new_stage(extended, tmp_path):
    program = """
import sys
from csstsim.campaign.opened import OpenCampaign
from csstsim.delivery.contents import of_campaign
from csstsim.delivery.products import products
for product in products(of_campaign(OpenCampaign(sys.argv[1]))):
    print(product.kind, product.path, product.need)
"""
    campaign = write_campaign(tmp_path, POINTINGS[:1], select={"types": ["SCIE"], "chips": [9]})
    text, code = run(extended, sys.executable, "-c", program, str(campaign))
    assert code == 0 and text.splitlines()[-1] == f"counted exposures {tmp_path}/out/counts/10100000001.json yes"


def test_the_rules_read_the_inputs_of_the_records(tmp_path):
    """All that science exposures have, images and spectra: the arrows of Snakemake's graph of rules are the inputs."""
    select, kept = {"types": ["SCIE"], "chips": [9, 29]}, {"keep_calibrated": True}
    campaign = write_campaign(tmp_path, POINTINGS[:1], select=select, measurement=kept)
    line = "snakemake", "--rulegraph", "--directory", tmp_path, "--config", f"campaign={campaign}"
    text, code = run(ROOT, *map(str, line))
    assert code == 0, text
    names = {node: name.removesuffix("_spectra") for node, name in re.findall(r'(\d+)\[label = "(\w+)"', text)}
    found = {(names[before], names[after]) for before, after in re.findall(r"(\d+) -> (\d+)", text)}
    there = STAGES.keys() & set(names.values())
    assert there == STAGES.keys() - {"chip", "masters", "variants"}
    inputs = {(before, stage) for stage in there for before in STAGES[stage].inputs}
    assert {arrow for arrow in found if there.issuperset(arrow)} == inputs


def test_each_record_names_what_there_is(tmp_path):
    """Inputs, costs, properties of a campaign and functions; the paths of products have the words of their unit."""
    opened = OpenCampaign(write_campaign(tmp_path, POINTINGS[:1]))
    words = {
        "job": {"obsid", "chip", "stem"}, "exposure": {"obsid"}, "chip": {"chip"}, "brick": {"pix", "dir"},
        "campaign": set(),
    }  # fmt: skip
    known = list(STAGES)
    for number, stage in enumerate(STAGES.values()):
        assert set(stage.inputs) <= set(known[:number]) and set(stage.costs) <= load_costs().keys()
        assert hasattr(opened, stage.made_for) and stage.recipe in {"", *STAGES}
        assert (ROOT / "src/csstsim/stages" / f"{stage.name}.py").is_file()
        for product in stage.products:
            assert set(re.findall(r"\{(\w+)\}", product.path)) <= words[stage.unit]
            assert PRODUCTS[product.name] is product and not STAGE_OF[product.name].instead_of
    assert set(CHECKED) == {stage.name for stage in STAGES.values() if stage.kept != "no" and not stage.instead_of}
    assert len({product.path for product in PRODUCTS.values()}) == len(PRODUCTS) and len(ABOUT) == 4
