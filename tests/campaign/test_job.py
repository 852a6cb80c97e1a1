"""The name of an exposure stays with the job: its layers get neither the name nor anything that leads to it."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from support.mini_campaign import write_campaign

from csstsim.campaign.job import Job
from csstsim.campaign.opened import OpenCampaign
from csstsim.instrument.chip import Window
from csstsim.instrument.pointing import Pointing
from csstsim.simulation.state import State
from csstsim.stages.chip import simulate

OBSID = "10300000001"


@pytest.fixture
def run(tmp_path):
    """A campaign of one bias exposure."""
    return OpenCampaign(write_campaign(tmp_path, select={"types": ["BIAS"], "chips": [9]}))


@pytest.fixture
def reaches(monkeypatch):
    """Whether a value leads to the obsid, as the benchmark looks for it."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "benchmarks")
    import obsid_path

    return lambda value: obsid_path.reaches(value, OBSID)


def test_what_layers_get_does_not_lead_to_the_obsid(run, reaches):
    job = run.job(OBSID, 9)
    assert reaches(job) and reaches([{"job": job}]) and reaches(f"exposure {OBSID}")
    for given in (job.exposure, State.blank(job.exposure), run.streams(job), run.streams(job).layer("bias")):
        assert not reaches(given)


def test_a_fault_inside_a_layer_is_told_with_layer_and_job(run, monkeypatch):
    def fails(state, param, rng):
        raise ZeroDivisionError

    job = run.job(OBSID, 9)
    monkeypatch.setattr(run.steps["BIAS"].step("bias").module, "apply", fails)
    with pytest.raises(ZeroDivisionError) as caught, job.named():
        simulate(run, job, log=str)
    assert caught.value.__notes__ == ["in layer bias", f"in obsid {OBSID}, chip 9"]


def test_the_digest_of_a_job_is_that_of_products_already_made():
    place = (6778.0, 0.0, 0.0), (0.0, 7.0, 3.0)
    pointing = Pointing("SCIE", 60.0, -40.0, -113.4333, "2027-06-26T20:35:58", 150.0, *place)
    exposure = SimpleNamespace(pointing=pointing, window=Window(100, 200, 50, 90), chip=SimpleNamespace(id=9))
    assert Job("10100000001", exposure).digest == "37b8d1accfa6e837"
    assert Job("10100000002", exposure).digest != Job("10100000001", exposure).digest
