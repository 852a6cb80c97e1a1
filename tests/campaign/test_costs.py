"""Expected costs of jobs: the list of jobs, how their costs grow, an unusable file."""

import pytest
from mini_campaign import POINTINGS, THIN, write_campaign, write_scene

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.campaign.costs import (
    FILE,
    INSTEAD,
    STAGES,
    Cost,
    _exposures,
    each_once,
    expected,
    expected_objects,
    load_costs,
)
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.plan import SNAKEMAKE, _chain, wall

WHOLE = 9216 * 9232 / 1e6  # megapixels of a chip


def campaign(folder, **changes):
    return OpenCampaign(write_campaign(folder, **({"select": {"chips": [9, 29]}} | changes)))


def test_each_job_of_the_workflow_has_a_cost(tmp_path):
    run = campaign(tmp_path)
    costs = expected(run)
    science = {job.key for job in run.jobs if job.pointing.type == "SCIE"}
    everything = {job.key for job in run.jobs}
    assert science < everything  # bias frames too
    assert costs["select"].keys() == costs["render"].keys() == science
    assert costs["readout"].keys() == costs["level0"].keys() == costs["chip"].keys() == everything
    assert costs["measure"].keys() == {job.key for job in run.imaging_jobs}
    assert costs["extract"].keys() == {job.key for job in run.slitless_jobs}
    assert costs["merge"].keys() == costs["validate"].keys() == run.merge_bricks.keys()
    assert costs["truth"].keys() == {pix for job in run.jobs if job.key in science for pix in run.truth_bricks(job)}
    assert costs["psf"].keys() == {9, 29} and costs["report"].keys() == {None}
    assert "calibrate" not in costs and "masters" not in costs
    assert all(cost.cpu_s > 0 and cost.memory_mb > 100 for jobs in costs.values() for cost in jobs.values())
    assert costs.keys() - each_once(costs).keys() == set(INSTEAD)
    assert costs["exposure"].keys() == {obsid for obsid, _ in everything}
    chips = {key: costs["chip"][key] for key in everything if key[0] == min(everything)[0]}
    exposure = costs["exposure"][min(everything)[0]]
    assert max(cost.cpu_s for cost in chips.values()) < exposure.cpu_s < sum(cost.cpu_s for cost in chips.values())
    assert exposure.memory_mb == max(cost.memory_mb for cost in chips.values())
    for verb, jobs in (("measure", run.imaging_jobs), ("extract", run.slitless_jobs)):
        assert costs[f"{verb}_exposure"].keys() == {job.obsid for job in jobs}
    kept = campaign(tmp_path, measurement={"keep_calibrated": True})
    assert expected(kept)["calibrate"].keys() == costs["measure"].keys()


def test_costs_grow_with_pixels_objects_and_fidelity(tmp_path):
    small = campaign(tmp_path, window={"x0": 0, "x1": 64, "y0": 0, "y1": 128})
    whole, poor = campaign(tmp_path), campaign(tmp_path, fidelity="reference")
    halves, wholes = (expected_objects(run, run.imaging_jobs) for run in (small, whole))
    assert all(wholes[key] == pytest.approx(2 * count) for key, count in halves.items())
    limited = campaign(tmp_path, catalog={"mag_limit": 20})
    assert all(count < wholes[key] / 10 for key, count in expected_objects(limited, limited.imaging_jobs).items())
    for rule in (*STAGES, "chip", "measure"):
        for key, cost in expected(small)[rule].items():
            more = expected(whole)[rule][key]
            assert more.cpu_s >= cost.cpu_s and more.memory_mb > cost.memory_mb
    drawn = {key: cost for key, cost in expected(whole)["render"].items() if key in wholes}
    assert drawn and all(expected(poor)["render"][key].cpu_s > cost.cpu_s for key, cost in drawn.items())
    assert expected(poor)["readout"] == expected(whole)["readout"]


def test_a_frame_is_shared_out_among_the_bricks_it_touches(monkeypatch):
    monkeypatch.chdir(SHIPPED.parent)
    run, numbers = OpenCampaign("examples/ten_images.yaml"), load_costs()["validate"].cpu_s
    assert len(run.merge_bricks) > 10 * 3
    on_bricks = sum(
        (cost.cpu_s - numbers["job"] - numbers["frame"] * len(run.merge_bricks[pix])) / numbers["mpix"]
        for pix, cost in expected(run)["validate"].items()
    )
    assert on_bricks == pytest.approx(10 * WHOLE)


def test_objects_of_a_catalogue_of_ones_own_are_not_counted(tmp_path):
    run = OpenCampaign(write_scene(tmp_path, "Stars", [60.0], [60.0], 20.0))
    assert expected_objects(run, run.imaging_jobs) == {} and "truth" not in expected(run)


def test_calibration_frames_alone_have_neither_psf_nor_report(tmp_path):
    run = OpenCampaign(write_campaign(tmp_path, [POINTINGS[2]], select={"types": ["BIAS"], "chips": [9]}))
    assert expected(run).keys() == {"readout", "level0", "chip", "exposure"}


def test_the_shipped_figures_are_those_measured_of_a_whole_r_chip():
    """CPU within a fifth, memory within a tenth of commands run alone (README, docs/slurm.md)."""
    quantities = {"job": 1, "mpix": WHOLE, "kobject": 72.6, "standard": 72.6}
    for rule, cpu, memory in (("render", 3.4, 1700), ("measure", 12, 1600), ("chip", 6.8, 1820)):
        cost = load_costs()[rule].cost(quantities)
        assert cost.cpu_s == pytest.approx(cpu, rel=0.2) and cost.memory_mb == pytest.approx(memory, rel=0.1)
    assert load_costs()["truth"].cost({"job": 1}) == Cost(11.0, 720.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("image: 0.23", "picture: 0.23", "psf.memory_mb"),
        ("masters:", "master:", "master"),
        ("  confidence: D\n", "", "confidence"),
        ("{job: 11.0}", "{job: much}", "truth.cpu_s.job"),
        ("{job: 11.0}", "{}", "truth.cpu_s"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_by_key(tmp_path, old, new, words):
    text = FILE.read_text()
    assert old in text
    file = tmp_path / "costs.yaml"
    file.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=words) as refused:
        load_costs(file)
    assert str(file) in str(refused.value)


def test_an_exposure_in_one_process_starts_once_and_holds_a_chip_at_a_time():
    chips = {("1", 8): Cost(10.0, 300.0), ("1", 9): Cost(20.0, 500.0), ("2", 8): Cost(5.0, 200.0)}
    assert _exposures(chips, 2.0) == {"1": Cost(28.0, 500.0), "2": Cost(5.0, 200.0)}


def test_objects_expected_are_counts_times_the_area_of_a_window(tmp_path):
    """Galaxies of 20 an arcmin2 on 128 x 128 px of 0.074 arcsec: half a one, and the stars, which are fewer."""
    run = OpenCampaign(write_campaign(tmp_path))
    objects = expected_objects(run, run.jobs)
    galaxies = THIN * (128 * 0.074 / 60) ** 2
    assert all(galaxies < count < 1.5 * galaxies for count in objects.values()) and len(objects) == len(run.jobs)


def test_many_cores_do_not_shorten_the_longest_chain(tmp_path):
    """One core takes all CPU time, any number at least the chain of jobs that wait for each other."""
    costs = expected(OpenCampaign(write_campaign(tmp_path, select={"chips": [8, 9]})))
    cpu = sum(cost.cpu_s for jobs in each_once(costs).values() for cost in jobs.values())
    chain = _chain(costs)
    assert wall(costs, 1) == pytest.approx(SNAKEMAKE + cpu) and wall(costs, 10**9) == pytest.approx(SNAKEMAKE + chain)
    one_each = [max(cost.cpu_s for cost in costs[rule].values()) for rule in ("select", "render", "readout", "level0")]
    assert sum(one_each) < chain < cpu
