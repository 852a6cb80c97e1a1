"""Missing inputs of a job are made first, each once; existing ones are not, and a bias needs none."""

from support.mini_campaign import POINTINGS, write_campaign, write_scene

from csstsim.campaign.opened import OpenCampaign
from csstsim.stages import chip as chip_stage
from csstsim.stages import psf as psf_stage


def made(run, monkeypatch):
    """Return the names of what is said to be made for a campaign's first job, and of what is called to make it."""
    logged, called = [], []
    for name in ("psf", "psf_tables"):
        real = getattr(psf_stage, name)
        monkeypatch.setattr(psf_stage, name, lambda *args, f=real: (called.append(f.__name__), f(*args)))
    chip_stage.missing(run, run.jobs[0], logged.append)
    monkeypatch.undo()
    return [path.rsplit("/", 1)[-1] for path in logged], called


def test_each_thing_is_made_once(tmp_path, monkeypatch):
    run = OpenCampaign(write_scene(tmp_path, "Stars", [60.0], [60.0], 20.0))
    assert made(run, monkeypatch) == (["chip_09.h5"], ["psf", "psf_tables"])  # the set's tables come with it
    assert made(run, monkeypatch) == ([], [])
    run.paths.psf_tables(9).unlink()
    assert made(run, monkeypatch) == (["chip_09_tables.h5"], ["psf_tables"])


def test_a_bias_needs_nothing(tmp_path, monkeypatch):
    run = OpenCampaign(write_campaign(tmp_path, [POINTINGS[2]], select={"types": ["BIAS"], "chips": [9]}))
    assert made(run, monkeypatch) == ([], []) and not run.paths.output.exists()
