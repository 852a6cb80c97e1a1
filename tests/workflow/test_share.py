"""Campaigns of one seed share truth bricks and PSF sets: made once, linked by each, refused if they are another's."""

from types import SimpleNamespace

import pytest
import yaml
from support.commands import command, done
from support.mini_campaign import POINTINGS, write_campaign
from support.workflow_run import content, level0_targets, planned, snakemake

from csstsim.base.errors import InputError
from csstsim.campaign.costs import expected
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.plan import plan
from csstsim.stages.parts.shared import make_or_link

pytestmark = pytest.mark.thorough
FIRST = POINTINGS[0]
SECOND = "10100000002,SCIE,60.15,-40.0,-113.0,2027-11-20T01:12:00,150"  # another orientation, on the same bricks


def make(folder, pointings, **changes):
    folder.mkdir()
    return write_campaign(folder, pointings, **changes)


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Two campaigns and the state of their shared folder {path: (inode, bytes)} after the first.

    The first is made in this process, the second by the workflow.
    """
    folder = tmp_path_factory.mktemp("share")
    share = folder / "common"
    one, two = (make(folder / name, [line], share=str(share)) for name, line in (("one", FIRST), ("two", SECOND)))
    done("chip", one, *OpenCampaign(one).jobs[0].options.split())
    before = files(share)
    alone, linked = (expected(OpenCampaign(campaign))["truth"] for campaign in (one, two))
    assert all(linked[pix].cpu_s < alone[pix].cpu_s / 2 for pix in linked)
    assert plan(OpenCampaign(two)).counts["truth bricks, PSF sets shared"] == len(OpenCampaign(two).sky_bricks) + 1
    snakemake(two, "chips=whole", "--cores", "2", *level0_targets(two))
    assert expected(OpenCampaign(two))["truth"] == linked
    return one, two, share, before


def files(folder):
    return {path: (path.stat().st_ino, path.read_bytes()) for path in folder.rglob("*") if path.is_file()}


def test_the_second_campaign_makes_no_brick_and_no_set(pair):
    one, two, share, before = pair
    assert OpenCampaign(one).sky_bricks == OpenCampaign(two).sky_bricks
    assert len(before) == len(OpenCampaign(one).sky_bricks) + 2  # a set with its tables
    assert files(share) == before
    logs = [path for kind in ("truth", "psf") for path in (two.parent / "out" / "logs" / kind).iterdir()]
    assert len(logs) == len(OpenCampaign(two).sky_bricks) + 1
    assert all("shared, not made" in log.read_text() for log in logs)


@pytest.mark.slow
def test_both_have_the_bits_that_they_have_alone(pair, tmp_path):
    for name, line, campaign in zip(("one", "two"), (FIRST, SECOND), pair, strict=False):
        alone = make(tmp_path / name, [line])
        for job in OpenCampaign(alone).jobs:
            done("chip", alone, *job.options.split())
        assert content(campaign) == content(alone) and len(content(alone)) == 1


def test_the_second_campaign_makes_the_first_run_no_job_again(pair):
    one, two, *_ = pair
    for campaign in (one, two):
        assert planned(campaign, "chips=whole", "--cores", "1", *level0_targets(campaign)) == set()


@pytest.mark.parametrize(("changes", "verb", "key"), [
    ({"seed": 4}, "truth", "seed"),
    ({"catalog": {"lensing": {"field": "constant", "gamma1": 0.1}}}, "truth", "lensing"),
    ({"psf": {"grid": 3}}, "psf", "grid"),
])  # fmt: skip
def test_what_another_campaign_would_make_otherwise_is_refused(pair, tmp_path, changes, verb, key):
    _, _, share, before = pair
    other = make(tmp_path / "other", [FIRST], share=str(share), **changes)
    where = ["--brick", OpenCampaign(other).sky_bricks[0]] if verb == "truth" else ["--chip", 9]
    found = command(verb, other, *where)
    assert found.exit_code == 2 and key in found.output and "share another folder" in found.output
    assert str(share) in found.output and files(share) == before


def test_a_brick_of_another_release_is_refused(pair, tmp_path, monkeypatch):
    other = make(tmp_path / "other", [FIRST], share=str(pair[2]))
    monkeypatch.setattr("csstsim.catalog.truth_bricks.release", lambda: "0.0")
    found = command("truth", other, "--brick", OpenCampaign(other).sky_bricks[0])
    assert found.exit_code == 2 and "share another folder" in found.output


def test_what_is_removed_or_made_again_leaves_the_shared_file(pair):
    one, _, share, before = pair
    run = OpenCampaign(one)
    pix = run.sky_bricks[0]
    run.paths.truth(pix).unlink()
    done("truth", one, "--brick", pix)
    assert files(share) == before and run.paths.truth(pix).samefile(run.in_share(run.paths.truth(pix)))


def test_of_two_campaigns_at_once_the_first_file_stays(tmp_path):
    own, common = tmp_path / "out" / "a", tmp_path / "share" / "a"
    own.parent.mkdir()
    checked = []

    def make():  # while this one works, the other campaign puts its own there
        own.write_text("mine")
        common.parent.mkdir()
        common.write_text("the other's")

    run = SimpleNamespace(in_share=lambda path: common)
    make_or_link(run, own, make, checked.append, lambda text: None)
    assert checked == [common] and common.read_text() == "the other's" and own.samefile(common)
    assert [path.name for path in own.parent.iterdir()] == ["a"]


@pytest.mark.parametrize("share", ["out", "out/common"])
def test_a_shared_folder_inside_the_output_folder_is_refused(tmp_path, share):
    file = make(tmp_path / "inside", [FIRST])
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | {"share": share}))
    with pytest.raises(InputError, match="inside the output folder"):
        OpenCampaign(file)
