"""What a campaign selects, and its plan."""

import pytest
from click.testing import CliRunner
from mini_campaign import write_campaign

from csstsim.campaign import OpenCampaign
from csstsim.catalog.astrometry import icrs
from csstsim.cli import main
from csstsim.errors import InputError
from csstsim.instrument.chip import Window
from csstsim.plan import plan


def centre(campaign, obsid="10100000001", chip=9, x=64.0, y=64.0):
    job = campaign.job(obsid, chip)
    ra, dec = icrs(*job.wcs.pixel_to_world(x, y), job.observer)
    return {"ra": float(ra), "dec": float(dec)}


def test_pairs_follow_the_table_and_the_chips(tmp_path):
    campaign = OpenCampaign(write_campaign(tmp_path, select={"chips": [9, 8]}))
    assert [job.key for job in campaign.jobs] == [
        (obsid, chip) for obsid in ("10100000001", "10100000002", "10300000001") for chip in (8, 9)
    ]
    assert {job.chip.id for job in campaign.science_jobs} == {8, 9}
    assert len(campaign.science_jobs) == 4  # the bias frame is not measured


def test_a_filter_or_an_obsid_narrows_the_selection(tmp_path):
    campaign = OpenCampaign(write_campaign(tmp_path, select={"filters": ["r"], "obsids": ["10100000002"]}))
    assert {job.key for job in campaign.jobs} == {("10100000002", 9), ("10100000002", 22)}  # both r chips


def test_a_region_keeps_the_pairs_it_touches_and_cuts_their_window(tmp_path):
    place = centre(OpenCampaign(write_campaign(tmp_path)))
    radius = 20.3 * 0.074 / 60  # 20.3 px
    select = {"types": ["SCIE", "BIAS"], "chips": [8, 9], "region": place | {"radius": radius}}
    campaign = OpenCampaign(write_campaign(tmp_path, select=select, window="region"))
    keys = {job.key: job.window for job in campaign.jobs}
    assert ("10100000001", 9) in keys and ("10100000001", 8) not in keys
    assert keys["10100000001", 9] == Window(43, 86, 43, 86)
    assert keys["10300000001", 9] == Window(0, 128, 0, 128)  # a bias frame sees no sky
    with pytest.raises(InputError, match="does not touch"):
        campaign.job("10100000001", 8)


def test_a_region_at_the_chips_corner_is_cut_at_its_edge(tmp_path):
    place = centre(OpenCampaign(write_campaign(tmp_path)), x=-5.0, y=-5.0)
    for radius_px, expected in ((9.5, Window(0, 6, 0, 6)), (6.0, None)):  # the corner is 7.1 px away
        select = {"types": ["SCIE"], "obsids": ["10100000001"], "chips": [9]}
        select["region"] = place | {"radius": radius_px * 0.074 / 60}
        campaign = OpenCampaign(write_campaign(tmp_path, select=select, window="region"))
        if expected is None:
            with pytest.raises(InputError, match=r"no .* pair is selected"):
                _ = campaign.jobs
        else:
            assert [job.window for job in campaign.jobs] == [expected]


def test_a_region_on_the_other_side_of_the_sky_selects_nothing(tmp_path):
    select = {"types": ["SCIE"], "region": {"ra": 240.0, "dec": 40.0, "radius": 60.0}}
    with pytest.raises(InputError, match=r"no .* pair is selected"):
        _ = OpenCampaign(write_campaign(tmp_path, select=select)).jobs


def test_plan_counts_what_the_workflow_would_run(tmp_path):
    campaign = OpenCampaign(write_campaign(tmp_path, select={"chips": [8, 9]}))
    counts, disk, cpu = plan(campaign)
    bricks, merged = counts["truth bricks"], counts["bricks touched"]
    # 4 science files: select, 3 stages, measure; 2 bias files: 2 stages; 2 PSF sets; merge, validate; truth; report
    assert counts["jobs"] == 4 * 5 + 2 * 2 + 2 + 2 * merged + bricks + 1
    assert counts["Level-0 files"] == 6 and counts["bricks fully covered"] == 0
    assert disk["PSF tables"] == 2 * 4 * 4 * 256 * 256 * 4 and cpu > 0
    shown = CliRunner().invoke(main, ["plan", str(campaign.file)])
    assert shown.exit_code == 0 and "truth bricks" in shown.output
    assert not campaign.paths.output.exists()


def test_a_change_that_moves_pixels_changes_the_recipe_and_no_other_does(tmp_path):
    def recipe(**changes):
        campaign = OpenCampaign(write_campaign(tmp_path, **changes))
        return campaign.recipe(campaign.job("10100000001", 9))

    base = recipe()
    assert recipe(name="other", validation={"snr_min": 7}, select={"chips": [8, 9]}, output="elsewhere") == base
    for change in ({"seed": 4}, {"catalog": {"mag_limit": 20}}, {"psf": {"grid": 3}}):
        assert recipe(**change) != base
    assert recipe(window={"x0": 0, "x1": 9, "y0": 0, "y1": 9}) != base
