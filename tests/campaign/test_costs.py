"""Expected costs of jobs: the list of jobs, how their costs grow, an unusable file."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.mini_campaign import POINTINGS, THIN, write_campaign, write_scene

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.base.stage_records import STAGES
from csstsim.campaign import costs as rules
from csstsim.campaign.costs import (
    ALTERNATIVES,
    FILE,
    Cost,
    CostTerms,
    _exposures,
    default_workflow,
    expected,
    expected_objects,
    load_costs,
)
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.plan import SNAKEMAKE_START, _chain, wall_time
from csstsim.universe.galaxies.galaxies import cumulative_counts
from csstsim.universe.stars.stars import expected_counts

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
    assert costs.keys() - default_workflow(costs).keys() == set(ALTERNATIVES)
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
    for rule in ("select", "render", "readout", "level0", "chip", "measure"):
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


def test_the_limits_of_jobs_are_above_what_is_expected_of_whole_chips(tmp_path):
    """In memory and time, on Slurm. Spectra of the reference take more than a day: only the third attempt is enough."""
    kinds = ("BIAS", 0), ("DARK", 150), ("FLAT", 150)
    rows = [
        f"1030000000{k},{kind},0,0,0,2027-11-20T{k + 2:02}:00:00,{time}" for k, (kind, time) in enumerate(3 * kinds)
    ]
    rows.append("10100000001,SCIE,300.0,-59.9,10,2027-11-20T01:08:00,150")
    whole = {"instrument": None, "universe": None, "psf": {"grid": 10}, "measurement": {"keep_calibrated": True}}
    run, rules = OpenCampaign(write_campaign(tmp_path, rows, select={"chips": [9, 29]}, **whole)), set()
    for fidelity in ("preview", "standard", "noise_free", "reference"):
        run.config = run.config.model_copy(update={"fidelity": fidelity})
        for rule, jobs in default_workflow(expected(run)).items():
            stage = STAGES[rule]
            minutes = stage.minutes_in.get(fidelity, stage.minutes)
            limits = {("10100000001", 29): 3 * minutes} if (rule, fidelity) == ("render", "reference") else {}
            assert all(cost.memory_mb < 0.9 * stage.memory_mb for cost in jobs.values()), rule
            assert all(cost.cpu_s < 0.9 * 60 * limits.get(key, minutes) for key, cost in jobs.items()), (rule, fidelity)
            rules.add(rule)
    assert rules == {stage.name for stage in STAGES.values() if stage.costs and not stage.instead_of}


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
    cpu = sum(cost.cpu_s for jobs in default_workflow(costs).values() for cost in jobs.values())
    chain = _chain(costs)
    assert wall_time(costs, 1) == pytest.approx(SNAKEMAKE_START + cpu)
    assert wall_time(costs, 10**9) == pytest.approx(SNAKEMAKE_START + chain)
    one_each = [max(cost.cpu_s for cost in costs[rule].values()) for rule in ("select", "render", "readout", "level0")]
    assert sum(one_each) < chain < cpu


def test_a_cost_is_a_sum_of_terms_and_what_is_not_there_is_0():
    numbers = CostTerms(cpu_s={"job": 2.0, "mpix": 0.5, "image": 9.0}, memory_mb={"job": 300.0, "kobject": 10.0})
    assert numbers.cost({"job": 1, "mpix": 8.0, "kobject": 3.0, "brick": 5}) == Cost(6.0, 330.0)


def job(obsid, number, kind="SCIE", chip="imaging", size=(2000, 500)):
    window = SimpleNamespace(nx=size[0], ny=size[1])
    return SimpleNamespace(
        obsid=obsid, key=(obsid, number), chip=SimpleNamespace(id=number, kind=chip), window=window,
        pointing=SimpleNamespace(type=kind),
    )  # fmt: skip


SKY, SPECTRUM, HALF = job("1", 9), job("1", 21, chip="slitless"), job("2", 9, size=(1000, 500))
DARK, FLAT = job("3", 9, "DARK"), job("4", 9, "FLAT", size=(100, 100))


def made_up(**changes):
    """Return what costs reads of an OpenCampaign of two imaging frames, a slitless one, a dark and a flat."""
    config = SimpleNamespace(
        psf=SimpleNamespace(grid=3), fidelity="preview", measurement=SimpleNamespace(keep_calibrated=False)
    )
    layered = "render", "readout", "level0"
    stages = {"SCIE": layered, "DARK": layered[1:], "FLAT": layered}
    given = {
        "jobs": [SKY, SPECTRUM, HALF, DARK, FLAT], "imaging_jobs": (SKY, HALF), "slitless_jobs": (SPECTRUM,),
        "has_orders": lambda job: job is SPECTRUM, "has_stage": lambda p, stage: stage in stages[p.type],
        "sky_bricks": [7, 30], "sky_chips": [9, 21], "merge_bricks": {7: [SKY, HALF], 30: [SKY]},
        "calibration_jobs": {9: [DARK] * 4}, "config": config,
    } | changes  # fmt: skip
    science = [*given["imaging_jobs"], *given["slitless_jobs"]]
    given |= {"science_jobs": science, "calibrated_jobs": (), "reports": [None] if science else []}
    return SimpleNamespace(**(given | changes))


def entries(run):
    """Return {entry of the file: {key: quantities}} of the jobs of a campaign."""
    found = {}
    for stage, entry, key, quantities in rules._job_quantities(run):
        assert entry in stage.costs and key not in found.setdefault(entry, {})
        found[entry][key] = quantities
    return found


def test_the_quantities_of_each_chip_are_its_own(monkeypatch):
    """SKY has a megapixel, HALF half of one; spectra are named apart, calibrations have neither select nor objects."""
    monkeypatch.setattr(rules, "expected_objects", lambda run, jobs: {("1", 9): 4000.0, ("1", 21): 500.0})
    run = made_up(calibrated_jobs=(SKY, HALF))
    by_job = {}
    for entry, jobs in entries(run).items():
        for key, quantities in jobs.items():
            by_job.setdefault(key, {})[entry] = quantities
    sky = {"job": 1, "mpix": 1.0, "kobject": 4.0, "preview": 4.0}
    chip = "select", "render", "readout", "level0", "chip"
    assert by_job["1", 9] == dict.fromkeys((*chip, "calibrate", "measure"), sky)
    spectra = {"job": 1, "mpix": 1.0, "kobject": 0.5, "preview": 0.5}
    names = "select_spectra", "render_spectra", "readout", "level0_spectra", "chip_spectra", "extract"
    assert by_job["1", 21] == dict.fromkeys(names, spectra)
    none = {"job": 1, "mpix": 0.5, "kobject": 0.0, "preview": 0.0}
    assert by_job["2", 9] == dict.fromkeys((*chip, "calibrate", "measure"), none)
    assert by_job["3", 9].keys() == {"readout", "level0", "chip"}
    assert by_job["4", 9].keys() == {"render", "readout", "level0", "chip"} and by_job["4", 9]["chip"]["mpix"] == 0.01
    assert "calibrate" not in entries(made_up())


def test_the_quantities_of_bricks_share_out_frames_but_read_them_whole(monkeypatch):
    monkeypatch.setattr(rules, "expected_objects", lambda run, jobs: {})
    found = entries(made_up())
    seven = {"job": 1, "frame": 2, "read_mpix": 1.5, "mpix": 1.0}  # half of SKY, all of HALF
    thirty = {"job": 1, "frame": 1, "read_mpix": 1.0, "mpix": 0.5}
    assert found["merge"] == found["validate"] == {7: seven, 30: thirty}


def test_the_quantities_of_what_is_made_once(monkeypatch):
    monkeypatch.setattr(rules, "expected_objects", lambda run, jobs: {jobs[2].key: 1e3 * len(jobs)})
    found = entries(made_up())
    assert found["truth"] == {7: {"job": 1}, 30: {"job": 1}}
    nodes = {"job": 1, "image": 36}  # 3 x 3 at 4 wavelengths
    assert found["psf"] == {9: nodes, 21: nodes}
    assert found["chip_spectra"]["1", 21]["kobject"] == 3.0  # the slitless job is the third
    assert found["masters"] == {9: {"job": 1, "mpix": 1.0, "read_mpix": 4.0}}
    report = {"job": 1, "read_mpix": pytest.approx(3.51), "brick": 2}  # all five frames are shown
    assert found["report"] == {None: report}


def test_the_report_shows_thirty_frames_or_a_whole_exposure(monkeypatch):
    monkeypatch.setattr(rules, "expected_objects", lambda run, jobs: {})
    for exposures, shown in ((60, 30), (1, 60), (2, 30), (3, 30)):
        jobs = [job(str(k % exposures), k) for k in range(60)]
        run = made_up(jobs=jobs, imaging_jobs=tuple(jobs), slitless_jobs=(), merge_bricks={}, calibration_jobs={})
        assert entries(run)["report"][None]["read_mpix"] == pytest.approx(shown)
    assert "report" not in entries(made_up(jobs=[DARK], imaging_jobs=(), slitless_jobs=(), merge_bricks={}))


def test_objects_expected_are_those_of_each_place_down_to_the_limit(tmp_path):
    """Galaxies of the shipped counts, thinned, and stars of each exposure's own place: more of them at low latitude."""
    rows = POINTINGS[0], POINTINGS[1].replace("60.1505,-40.0003", "266.0,-20.0")
    run = OpenCampaign(write_campaign(tmp_path, rows))
    found = expected_objects(run, run.jobs)
    area, stars = (128 * 0.074 / 3600) ** 2, run.universe.numbers["stars"]
    for one in run.jobs:
        wanted = expected_counts(one.pointing.ra, one.pointing.dec, stars, stars["limits"][1])
        assert found[one.key] == pytest.approx(area * (THIN * 3600 + float(wanted)), rel=1e-3)
    assert found["10100000002", 9] > 10 * found["10100000001", 9]
    bright = OpenCampaign(write_campaign(tmp_path, rows, catalog={"mag_limit": 21.5}))
    mag, counts = cumulative_counts(run.universe.numbers["galaxies"])
    for one in bright.jobs:
        wanted = expected_counts(one.pointing.ra, one.pointing.dec, stars, 21.5)
        galaxies = float(np.interp(21.5, mag, counts))
        found = expected_objects(bright, bright.jobs)[one.key]
        assert found == pytest.approx(area * (galaxies + float(wanted)), rel=1e-6)
    assert expected_objects(bright, ()) == {}
    beyond = OpenCampaign(write_campaign(tmp_path, rows, catalog={"mag_limit": 40.0}))
    assert expected_objects(beyond, beyond.jobs) == pytest.approx(expected_objects(run, run.jobs), rel=1e-12)


def test_a_product_is_shared_if_another_campaign_made_it_or_has_it(tmp_path):
    """One's own file and the shared one are two links; a third is another campaign's."""
    own, common = tmp_path / "own", tmp_path / "common"
    run = SimpleNamespace(in_share=lambda path: common)
    assert not rules._is_shared(run, own) and not rules._is_shared(SimpleNamespace(in_share=lambda path: None), own)
    common.touch()
    assert rules._is_shared(run, own)
    own.hardlink_to(common)
    assert not rules._is_shared(run, own)
    (tmp_path / "other").hardlink_to(common)
    assert rules._is_shared(run, own)


def test_what_is_shared_costs_a_link_and_what_the_base_makes_nothing(tmp_path, monkeypatch):
    numbers = load_costs()
    monkeypatch.setattr(rules, "expected_objects", lambda run, jobs: {})
    of_base = ("chip", ("1", 21)), ("merge", 30)
    monkeypatch.setattr(rules, "made_by_base", lambda run, rule, key: (rule, key) in of_base)
    shared = tmp_path / "psf21"
    shared.touch()
    paths = SimpleNamespace(truth=lambda pix: tmp_path / f"truth{pix}", psf=lambda chip: tmp_path / f"psf{chip}")
    run = made_up(paths=paths, in_share=lambda path: path.with_name(path.name) if path == shared else None)
    monkeypatch.setattr(rules, "_is_shared", lambda run, path: path == shared)
    found = expected(run)
    assert found["psf"] == {9: numbers["psf"].cost({"job": 1, "image": 36}), 21: numbers["shared"].cost({"job": 1})}
    assert found["truth"] == dict.fromkeys((7, 30), numbers["truth"].cost({"job": 1}))
    assert found["merge"].keys() == {7} and found["validate"].keys() == {7, 30}
    assert ("1", 21) not in found["chip"] and ("1", 21) in found["level0"]
    assert found["exposure"]["1"] == found["chip"]["1", 9]  # its other chip is the base's
    assert found["extract_exposure"] == {"1": found["extract"]["1", 21]}
    assert found["measure_exposure"].keys() == {"1", "2"} and "calibrate" not in found
