"""Windows of regions behind gratings, enough exposures for masters, one exposure time, dependences of recipes."""

import numpy as np
import pytest
import yaml
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.digest import digest
from csstsim.base.shipped import SHIPPED
from csstsim.campaign import opened as campaigns
from csstsim.campaign.opened import OpenCampaign
from csstsim.catalog.astrometry.reduction import icrs

OBSID = "10100000001"
WHOLE_PX = 2  # a window has whole pixels, and one more at its end


@pytest.mark.parametrize(("chip", "x"), [(1, 2500.0), (1, 7000.0), (2, 1500.0), (3, 6500.0)])
def test_a_region_behind_a_grating_has_the_spectra_of_its_middle(tmp_path, chip, x):
    """Zeroth and first order of an object there, from end to end, with the region's radius about them; no more."""
    shipped = {"instrument": None, "select": {"types": ["SCIE"], "chips": [chip]}}
    whole = OpenCampaign(write_campaign(tmp_path, **shipped)).job(OBSID, chip)
    ra, dec = (float(v) for v in icrs(*whole.wcs.pixel_to_world(x, 4000.0), whole.observer))
    radius = 50.0
    shipped["select"]["region"] = {"ra": ra, "dec": dec, "radius": radius * 0.074 / 60}
    run = OpenCampaign(write_campaign(tmp_path, window="region", **shipped))
    window, gratings = run.job(OBSID, chip).window, run.camera.gratings[chip]
    grating = next(g for g, (x0, x1, *_) in gratings.pieces if x0 <= x < x1)
    ends = []
    for order in (grating.orders[0], grating.orders[1]):
        p, q, r, s = order.lines(x, 4000.0)
        ends += [(x + p + q * wave, 4000.0 + r + s * wave) for wave in order.range]
    (low_x, low_y), (high_x, high_y) = np.min([*ends, (x, 4000.0)], axis=0), np.max([*ends, (x, 4000.0)], axis=0)
    wanted = np.clip([low_x - radius, high_x + radius], 0, 9216), [low_y - radius, high_y + radius]
    assert np.abs(np.array([window.x0, window.x1]) - wanted[0]).max() <= WHOLE_PX
    assert np.abs(np.array([window.y0, window.y1]) - wanted[1]).max() <= WHOLE_PX


@pytest.mark.parametrize(("frames", "enough"), [((3, 3, 3), True), ((3, 2, 3), False), ((2, 2, 2), False)])
def test_masters_want_three_whole_frames_of_each_kind(tmp_path, frames, enough):
    rows, number = [], 0
    for kind, first, count in zip(("BIAS", "DARK", "FLAT"), ("103", "104", "102"), frames, strict=True):
        for _ in range(count):
            number += 1
            exptime = 0 if kind == "BIAS" else 300
            rows.append(f"{first}{number:08d},{kind},0,0,0,2027-11-20T02:{number:02d}:00,{exptime}")
    select = {"types": ["BIAS", "DARK", "FLAT"], "chips": [9]}
    run = OpenCampaign(write_campaign(tmp_path, [*POINTINGS[:1], *rows], select=select))
    assert {chip: len(jobs) for chip, jobs in run.calibration_jobs.items()} == ({9: sum(frames)} if enough else {})


def test_the_layers_exposure_time_is_the_exposures(tmp_path):
    """Where the list asks for another time, Level-0 headers, noise and zero points follow: the pointing has it."""
    layers = yaml.safe_load((SHIPPED / "observations" / "science.yaml").read_text())
    for entry in layers["layers"]:
        for name in entry.keys() & {"scie_obs", "sky_background", "cosmic_rays", "poisson_and_dark"}:
            entry[name] = (entry[name] or {}) | {"exptime": 70.0}
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(layers))
    run = OpenCampaign(write_campaign(tmp_path, observations={"SCIE": str(tmp_path / "short.yaml")}))
    assert run.job(OBSID, 9).pointing.exptime == 70.0
    assert OpenCampaign(write_campaign(tmp_path)).job(OBSID, 9).pointing.exptime == 150.0


def test_recipes_hang_on_the_renderer_and_on_the_way_of_measuring(tmp_path, monkeypatch):
    base = OpenCampaign(write_campaign(tmp_path))
    job = base.job(OBSID, 9)
    other = OpenCampaign(write_campaign(tmp_path, measurement={"cti_passes": 1}))
    assert other.recipe(job) == base.recipe(job) and other.recipe(job, "measure") != base.recipe(job, "measure")
    kept = OpenCampaign(write_campaign(tmp_path, measurement={"keep_calibrated": True}))
    assert kept.recipe(job, "measure") == base.recipe(job, "measure")
    numbers = campaigns.load_numbers()
    standard = numbers.presets["standard"].model_copy(update={"eps": 0.2})
    changed = numbers.model_copy(update={"presets": numbers.presets | {"standard": standard}})
    monkeypatch.setattr(campaigns, "load_numbers", lambda: changed)
    again = OpenCampaign(write_campaign(tmp_path))
    assert again.recipe(job) != base.recipe(job)


def test_a_digest_is_of_the_content_not_of_the_order_of_keys():
    assert digest({"a": 1, "b": {"c": [1, 2], "d": 3}}) == digest({"b": {"d": 3, "c": [1, 2]}, "a": 1})
    others = {"a": 1, "b": 2}, {"a": 2, "b": 1}, {"a": 1}, {"b": 1}, {"a": [1, 2]}, {"a": [2, 1]}
    assert len({digest(other) for other in others}) == len(others)
