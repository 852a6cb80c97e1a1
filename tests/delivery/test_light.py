"""Charge in an image against its truth's sum: conserved through every layer, windows and clipping included."""

import numpy as np
import pytest
from commands import done
from mini_campaign import POINTINGS, write_scene
from small_delivery import science

from csstsim.campaign.opened import OpenCampaign
from csstsim.delivery.light import charge_of, light_faults
from csstsim.io.level0 import read_level0
from csstsim.io.truth import read_truth

PLACES = ([20.0, 60.0, 90.5], [30.0, 64.0, 100.0])


def made(folder, mag=19.0, layers=None, **changes):
    """Draw three stars; return (Level0, truth) of their frame."""
    if layers is not None:
        changes["observations"] = {"SCIE": str(science(folder, **layers))}
    file = write_scene(folder, "Stars", *PLACES, mag, pointing=POINTINGS[0], **changes)
    run = OpenCampaign(file)
    (job,) = run.jobs
    done("chip", file, "--obsid", job.obsid, "--chip", job.chip.id)
    return read_level0(run.paths.level0(job)), read_truth(run.paths.level0_truth(job))


def expected(budget):
    arrived = sum(budget[name] for name in ("light", "dark", "rays", "defects"))
    return arrived - budget["trapped"] - budget["bloomed"]


@pytest.mark.parametrize(
    "changes",
    [
        {"layers": {"CTE_effect": {"density_scale": 100.0, "serial": True}}},
        {"layers": {"CTE_effect": {"density_scale": 1.0}}, "window": {"x0": 30, "x1": 101, "y0": 40, "y1": 90}},
        {"layers": {"quantization_and_output": {"layout": "mosaic", "compress": True, "mask": True}}},
        {"fidelity": "noise_free"},
    ],
)
def test_charge_is_conserved(tmp_path, changes):
    """Within 4 sigma of readout, bias and shot noise (fixed seed), without the tolerance for what is uncounted."""
    file, truth = made(tmp_path, **changes)
    budget, charge = truth.meta["electrons"], charge_of(file, truth.meta["full_well"])
    assert charge.clipped == 0 and budget["light"] > budget["objects"] > 0
    sigma = (charge.error**2 + budget["light"] + budget["dark"]) ** 0.5
    assert abs(charge.electrons - expected(budget)) < 4 * sigma
    assert list(light_faults(file, truth)) == []


def test_a_readout_without_noise_has_that_of_rounding(tmp_path):
    """Where the overscan is one number, a pixel's charge is still known to 12**-0.5 DN alone."""
    file, truth = made(tmp_path)
    file.__dict__["_stored"] = np.full_like(file._stored, 500)
    variance = 0.0
    for channel in file.channels():
        pixels = channel.active.size + channel.serial_overscan.size + channel.parallel_overscan.size
        variance += file.gain[channel.number] ** 2 / 12 * pixels * (1 + pixels / channel.serial_overscan.size)
    charge = charge_of(file, truth.meta["full_well"])
    assert charge.electrons == 0.0 and charge.error == pytest.approx(variance**0.5, rel=1e-6)


def test_clipped_pixels_hide_charge_up_to_the_full_well(tmp_path):
    file, truth = made(tmp_path, mag=14.0)
    budget, charge = truth.meta["electrons"], charge_of(file, truth.meta["full_well"])
    lost = expected(budget) - charge.electrons
    assert charge.clipped > 20 and 0 < lost <= charge.clipped * (truth.meta["full_well"] - charge.clipped_at)
    assert list(light_faults(file, truth)) == []


@pytest.mark.parametrize(("name", "change"), [("light", 1.02), ("light", 0.98), ("objects", 1.001)])
def test_a_budget_that_does_not_hold(tmp_path_factory, name, change):
    folder = tmp_path_factory.getbasetemp() / "budget"
    folder.mkdir(exist_ok=True)
    file, truth = made(folder, mag=19.0)
    truth.meta["electrons"][name] *= change
    assert len(list(light_faults(file, truth))) == 1


def test_a_bright_star_moved_away_is_missed(tmp_path):
    """Pixels of the brightest star replaced by their neighbours' sky, as a stale image would have them."""
    file, truth = made(tmp_path, mag=18.0)
    stored = np.array(file._stored)
    stored[stored > np.median(stored) + 200] = np.median(stored)
    file.__dict__["_stored"] = stored
    (fault,) = light_faults(file, truth)
    assert "the image holds" in fault
