"""kill -9 of a stage below Snakemake, of Snakemake alone, and of both, as in a power failure."""

import os
import signal

import pytest
from faults.small_run import CHIP, OBSID, ended
from support.running import running

pytestmark = pytest.mark.faults


def test_a_stage_is_killed(small_run, tell):
    small_run.back_before("select")
    head, said = small_run.start()
    running("render", head, small_run.file).send_signal(signal.SIGKILL)
    assert ended(head) == 1 and f"render {OBSID} chip {CHIP:02d}" in said.read_text()
    small_run.assert_nothing_wrong()
    small_run.resume()
    small_run.assert_as_undisturbed()
    tell("kill -9 of a stage in the workflow", "render", "the run ends with exit code 1; the same command goes on")


@pytest.mark.parametrize("verb, all_of_it", [("level0", True), ("measure", False)])
def test_snakemake_is_killed(small_run, tell, verb, all_of_it):
    small_run.back_before("select" if verb == "level0" else verb)
    head, _ = small_run.start()
    stage = running(verb, head, small_run.file)
    if all_of_it:
        os.killpg(head.pid, signal.SIGKILL)
        stage.wait(timeout=60)
    else:
        head.kill()  # its stage goes on, unwatched
        assert stage.is_running()
    assert ended(head) == -signal.SIGKILL
    small_run.assert_nothing_wrong()
    small_run.refused("cannot be locked", "--unlock")
    small_run.resume("--unlock")
    small_run.resume()
    small_run.assert_as_undisturbed()
    tell(
        "kill -9 of Snakemake" + (" and its jobs" if all_of_it else " alone"), verb,
        "the next start says that the folder is locked and names --unlock; after it the same command goes on",
    )  # fmt: skip
