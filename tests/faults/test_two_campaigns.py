"""Two campaigns with one output folder, and one campaign started twice."""

import pytest
import yaml
from faults.small_run import ended
from support.running import running

pytestmark = pytest.mark.faults


def other_campaign(small_run, **changes):
    """Write a campaign beside the small one that writes into the same folder; return its file."""
    file = small_run.folder / "other.yaml"
    file.write_text(yaml.safe_dump(yaml.safe_load(small_run.file.read_text()) | changes))
    return file


@pytest.mark.parametrize("moment", ["finished", "at work"])
def test_another_campaign_is_refused(small_run, tell, tmp_path, moment):
    small_run.back_before("report" if moment == "finished" else "measure")
    file = other_campaign(small_run, seed=4)
    head = None
    if moment == "at work":
        head, _ = small_run.start()
        running("measure", head, small_run.file)
    code, said = small_run.run(folder=tmp_path, file=file)  # Snakemake's own lock sees its working directory alone
    assert code == 2 and "campaign.json" in said and "another campaign" in said and "Traceback" not in said, said
    small_run.assert_nothing_wrong()
    if head:
        assert ended(head) == 0
    else:
        small_run.resume()
    small_run.assert_as_undisturbed()
    tell("two campaigns in one output folder", f"the first {moment}", "the second is refused before it writes anything")


def test_the_same_campaign_started_twice(small_run, tell):
    small_run.back_before("measure")
    head, _ = small_run.start()
    running("measure", head, small_run.file)
    code, said = small_run.run()
    assert code == 1 and "cannot be locked" in said, said
    assert ended(head) == 0
    small_run.assert_as_undisturbed()
    tell("one campaign started twice", "measure", "the second start is refused by Snakemake; the first goes on")
