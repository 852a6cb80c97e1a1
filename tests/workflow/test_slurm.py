"""The Slurm profile on a real Slurm of one node: same bits as locally, memory limits, a job cancelled and resumed."""

import re
import subprocess
from pathlib import Path

import pytest
from support.mini_campaign import POINTINGS, write_campaign
from support.one_node_slurm import POLLING, OneNodeSlurm, why_not
from support.running import running
from support.workflow_run import ROOT, command, content, level0_targets, make, measured, snakemake, with_prepared

pytestmark = [pytest.mark.slurm, pytest.mark.skipif(bool(reason := why_not()), reason=str(reason))]


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    with OneNodeSlurm(tmp_path_factory.mktemp("slurm")) as node:
        yield node


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    """The campaign run on this machine, start to finish."""
    campaign = make(tmp_path_factory.mktemp("local") / "campaign")
    snakemake(campaign, "--cores", "2")
    return campaign


def profile(node, *arguments):
    """Arguments after the campaign's: the profile, its scratch disk moved to the test's node."""
    return f"scratch={node.scratch}", "--workflow-profile", str(ROOT / "profiles/slurm"), *POLLING, *arguments


def submitted(text):
    """The Slurm ids in what Snakemake said."""
    return [int(jobid) for jobid in re.findall(r"SLURM jobid (\d+)", text)]


def test_the_profile_gives_the_same_bits(slurm, local, tmp_path):
    campaign = make(tmp_path / "campaign")
    said = snakemake(campaign, *profile(slurm))
    assert content(campaign) == content(local) and measured(campaign) == measured(local)
    # truth, PSF, three exposures, the first picture, the bricks, the report
    jobs = [slurm.job(jobid) for jobid in submitted(said)]
    assert len(jobs) == 8
    assert {job["NumCPUs"] for job in jobs} == {"1"}
    assert not list((campaign.parent / "out" / "chips").rglob("*")) and not list(slurm.on_node().iterdir())


def test_a_job_short_of_memory_is_tried_again_with_more(slurm, tmp_path):
    catalog = {
        "kind": "support.mini_campaign:Hungry",
        "options": {"ra": [60.0], "dec": [-40.0], "mag": [20.0], "mb": 3600},
    }
    campaign = write_campaign(tmp_path, POINTINGS[:1], catalog=catalog)
    said = snakemake(campaign, "chips=stages", *profile(slurm, *level0_targets(campaign)))
    chip = [slurm.job(jobid) for jobid in submitted(said)[1:]]  # after the PSF's
    assert [job["MinMemoryNode"] for job in chip] == ["3000M", "6000M"]
    assert [job["TimeLimit"] for job in chip] == ["01:08:00", "02:16:00"]
    assert [job["JobState"] for job in chip] == ["FAILED", "COMPLETED"]
    assert "exceeded memory limit" in Path(chip[0]["StdOut"]).read_text()
    assert len(content(campaign)) == 1


def test_stages_hand_on_by_way_of_a_scratch_nobody_else_sees_and_go_on_after_a_cancelled_job(slurm, local, tmp_path):
    campaign = with_prepared(make(tmp_path / "campaign"), local)
    arguments = "chips=stages", *profile(slurm, "--group-components", "chip=3", "brick=4")
    line, environment = command(campaign, *arguments, "--retries", "0")
    first = tmp_path / "first"
    with open(first, "w") as file:
        head = subprocess.Popen(line, env=environment, stdout=file, stderr=subprocess.STDOUT)
    try:
        environment = running("render", head, campaign).environ()
        assert {environment[f"{library}_NUM_THREADS"] for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")} == {"1"}
        jobid = environment["SLURM_JOB_ID"]
        assert list(slurm.on_node().rglob("select.parquet")), "a job at work has intermediates on its node"
        slurm.ask("scancel", jobid)
        assert head.wait(timeout=300) != 0
    finally:
        if head.poll() is None:
            head.kill()
    assert slurm.job(jobid)["JobState"] == "CANCELLED"
    assert not list(slurm.on_node().iterdir())
    assert len(content(campaign)) < len(content(local))
    said = snakemake(campaign, *arguments)
    assert content(campaign) == content(local) and measured(campaign) == measured(local)
    # two of three chips each, the cancelled one again, the first picture, the bricks, the report
    jobs = [slurm.job(jobid) for jobid in submitted(first.read_text() + said)]
    assert len(jobs) == 6
    assert {job["NumCPUs"] for job in jobs} == {"1"}
    # Intermediates went through the node's disk alone, and are gone from it
    assert not list((campaign.parent / "out" / "chips").rglob("*")) and not list(slurm.scratch.iterdir())
    assert not list(slurm.on_node().iterdir())
