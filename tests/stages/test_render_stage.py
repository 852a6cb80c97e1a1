"""The render stage and the table of objects that it reads."""

import pytest
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import InputError
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.table import ObjectTable
from csstsim.stages.render import render


@pytest.mark.parametrize("part", ["campaign", "camera", "layers", "exposure"])
def test_objects_that_were_selected_for_another_configuration_are_refused(tmp_path, part):
    run = OpenCampaign(write_campaign(tmp_path, [POINTINGS[0]]))
    job = run.jobs[0]
    path, recipe = run.paths.stage(*job.key, "select.parquet"), run.recipe(job, "select")
    assert part in recipe
    path.parent.mkdir(parents=True)
    ObjectTable.complete({}, run.camera.bands).write(path, {"recipe": recipe | {part: "0123456789abcdef"}})
    with pytest.raises(InputError, match=f"{path.name}.*{part}") as refused:
        render(run, job)
    assert "0123456789abcdef" in str(refused.value)
    assert [file.name for file in path.parent.iterdir()] == [path.name]
