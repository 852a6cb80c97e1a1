"""kill -9 of a Slurm node's daemon, alone and with all jobs on the node; the daemon is started again."""

import re

import pytest
from faults.small_run import ended
from support.one_node_slurm import POLLING, OneNodeSlurm, why_not
from support.running import running
from support.workflow_run import ROOT

pytestmark = [pytest.mark.faults, pytest.mark.skipif(bool(reason := why_not()), reason=str(reason))]


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    with OneNodeSlurm(tmp_path_factory.mktemp("slurm")) as node:
        yield node


@pytest.mark.parametrize("jobs_too", [False, True], ids=["daemon", "node"])
def test_a_node_daemon_is_killed(small_run, slurm, tell, jobs_too):
    small_run.back_before("select")
    profile = "--workflow-profile", str(ROOT / "profiles/slurm"), *POLLING
    head, said = small_run.start(f"scratch={slurm.scratch}", profile=profile)
    stage = running("render", head, small_run.file)
    slurm.kill_node(jobs_too)
    assert stage.is_running() != jobs_too or not stage.wait(timeout=60)
    slurm.start_node()
    for jobid in slurm.ask("squeue", "--noheader", "--states", "PENDING", "--format", "%i").split():
        slurm.ask("scontrol", "update", f"jobid={jobid}", "starttime=now")  # Slurm waits two minutes with it
    assert ended(head) == 0, said.read_text()
    small_run.assert_as_undisturbed()
    jobs = [slurm.job(jobid) for jobid in re.findall(r"SLURM jobid (\d+)", said.read_text())]
    again = int(jobs[0]["Restarts"]) + sum(job["JobState"] != "COMPLETED" for job in jobs)
    assert jobs[-1]["JobState"] == "COMPLETED" and (again > 0) == jobs_too
    assert not list(slurm.on_node().iterdir())
    happened = (
        "the job is started again, by Slurm or as a retry"
        if jobs_too
        else "the job goes on, the daemon that comes back finds it"
    )
    tell(
        "kill -9 of a Slurm node" + (" with its jobs" if jobs_too else "'s daemon"), "render", f"{happened}; no command"
    )
