"""The workflow: its graph, and the same bits for one core, two cores, and a job killed and resumed."""

import signal
import subprocess
from pathlib import Path

import pytest
import yaml
from click.testing import CliRunner
from support.mini_campaign import POINTINGS, write_campaign
from support.running import running
from support.workflow_run import (
    ROOT,
    command,
    content,
    dry_run,
    level0_targets,
    make,
    measured,
    planned,
    snakemake,
    with_prepared,
)

from csstsim.campaign.opened import OpenCampaign
from csstsim.command_line.main import main

FEW = POINTINGS[0], POINTINGS[2]  # a science exposure and a bias


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """One core, start to finish, up to the report, each chip in four stages: the default; what render made is kept."""
    campaign = make(tmp_path_factory.mktemp("workflow") / "one", FEW, keep="light")
    snakemake(campaign, "--cores", "1")
    return campaign


def test_the_whole_chain_makes_what_it_promises(undisturbed):
    run = OpenCampaign(undisturbed)
    assert len(content(undisturbed)) == len(run.jobs) + 1 == 5  # a science exposure and a bias, two chips; orders
    assert run.paths.report.exists()
    assert [path.stem for path in (run.paths.output / "look").iterdir()] == ["10100000001_09"]
    for pix in run.merge_bricks:
        assert run.paths.merge(pix).exists() and run.paths.validate(pix).exists()
    assert {p.name for p in run.paths.merge_catalogue.iterdir()} == {"dataset", "hats.properties", "partition_info.csv"}
    assert len(run.slitless_jobs) == 1
    for job in run.slitless_jobs:
        assert run.paths.spectra(*job.key).exists() and run.paths.level0_orders(job).exists()
    assert left_of(undisturbed) == {"render.fits", "drawn.parquet", "orders.parquet"}, "others are dropped"


def left_of(campaign):
    return {path.name for path in (campaign.parent / "out" / "chips").rglob("*") if path.is_file()}


@pytest.mark.thorough
def test_what_is_removed_from_a_finished_campaign_is_made_again(undisturbed, tmp_path):
    chip = {"readout", "level0_spectra"}  # what render made is there
    later = {"measure", "merge", "validate", "report"}
    after = {
        "level0/*/*_29_*.orders.parquet": chip | {"extract", "report"},
        "level0/10300000001/*.truth.parquet": {"readout", "level0", "report"},
        "measure/*.parquet": later,
        "chips/*_29/render.fits": chip | {"select", "render_spectra", "extract", "report"},
        "merge/dataset/*/*/Npix=*.parquet": later - {"measure"},
        "merge/partition_info.csv": {"report"},
        "validate/*.png": {"validate", "report"},
        "spectra/*.png": {"extract", "report"},
        "report/verdict.json": {"report"},
    }  # fmt: skip
    out = undisturbed.parent / "out"
    for pattern, rules in after.items():
        path = next(p for p in sorted(out.rglob("*")) if p.match(str(out / pattern)))
        path.rename(tmp_path / "removed")
        try:
            assert planned(undisturbed) == rules, path
        finally:
            (tmp_path / "removed").rename(path)
    assert planned(undisturbed) == set()


READOUT = {"readout", "level0", "level0_spectra", "look"}
CHIP = {"select", "render", "render_spectra"} | READOUT
AFTER = {"measure", "extract", "merge", "validate", "report"}
# One key of each section of the campaign file, and the rules that run again
KEYS = {
    "seed": (4, {"truth"} | CHIP | AFTER),
    "select": ({"chips": [9]}, {"report"}),  # a chip less to report of
    "window": ({"x0": 0, "x1": 100, "y0": 0, "y1": 128}, CHIP | AFTER),
    "catalog.mag_limit": (22.0, CHIP | AFTER),
    "catalog.lensing": ({"field": "constant", "kappa": 0.01}, {"truth"} | CHIP | AFTER),
    "astrometry.planets": (True, CHIP | AFTER),
    "psf.grid": (3, {"psf"} | CHIP | AFTER),
    "fidelity": ("preview", CHIP | AFTER),
    "keep": ("nothing", set()),
    "measurement.cti_passes": (1, AFTER),
    "measurement.keep_calibrated": (True, {"calibrate"}),
    "measurement.joint": (True, {"measure", "merge", "validate", "report"}),
    "validation.snr_min": (6.0, {"validate", "report"}),
}
# A file that the campaign names: a text, and what stands there instead
FILES = {
    "table.csv": (",150\n", ",151\n", CHIP | AFTER),
    "instrument/psf.yaml": ("\n", "\n# a word\n", {"psf"} | CHIP | AFTER),
    "instrument/cti.yaml": ("\n", "\n# a word\n", READOUT | AFTER),
    "instrument/detector.yaml": ("value: 1.1\n", "value: 1.2\n", READOUT | AFTER),  # gain
    "universe/stars.yaml": ("\n", "\n# a word\n", {"truth"} | CHIP | AFTER),
}


# The others go the same ways, and tests/test_recipe.py has what those hand on
QUICK = "psf.grid", "instrument/detector.yaml", "measurement.cti_passes", "validation.snr_min"


def some(names):
    """Those of QUICK, and the others as slow ones."""
    return [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in names]


@pytest.mark.parametrize("key", some(KEYS))
def test_what_a_changed_key_of_a_finished_campaign_makes_again(undisturbed, key):
    """Snakemake's own decision, by the parameters and inputs of each rule, and no rule more."""
    value, rules = KEYS[key]
    data = yaml.safe_load(undisturbed.read_text())
    section, _, name = key.partition(".")
    data[section] = (data.get(section) or {}) | {name: value} if name else value
    assert planned_with(undisturbed, undisturbed, yaml.safe_dump(data)) == rules


@pytest.mark.parametrize("file", some(FILES))
def test_what_a_changed_file_of_a_finished_campaign_makes_again(undisturbed, file):
    path = undisturbed.parent / file
    old, new, rules = FILES[file]
    assert planned_with(undisturbed, path, path.read_text().replace(old, new)) == rules


def planned_with(campaign, path, text):
    """Return the rules that would run if this text stood in a file of the campaign."""
    before = path.read_text()
    assert text != before
    path.write_text(text)
    try:
        return planned(campaign, "--profile", str(ROOT / "profiles" / "default"))
    finally:
        path.write_text(before)


def test_a_slip_in_the_name_of_a_setting_is_refused(tmp_path):
    code, said = dry_run(make(tmp_path / "slip"), "campaing=mine.yaml")
    assert code and "--config campaing: unknown; allowed: campaign, chips, scratch" in said


@pytest.mark.parametrize(("chips", "log"), [
    pytest.param("stages", "level0", marks=pytest.mark.slow),  # as those of the campaign killed and resumed below
    pytest.param("whole", "chip", marks=pytest.mark.slow),
])  # fmt: skip
def test_two_cores_and_larger_jobs_give_the_same_bits(undisturbed, tmp_path, chips, log):
    campaign = with_prepared(make(tmp_path / "two", FEW), undisturbed)
    snakemake(campaign, f"chips={chips}", "--cores", "2", *level0_targets(campaign))
    assert content(campaign) == content(undisturbed)
    assert (campaign.parent / "out" / "logs" / log).exists()
    assert not left_of(campaign), "intermediates are dropped"


@pytest.mark.slow
def test_exposures_made_and_measured_by_a_process_each_give_the_same_bits(undisturbed, tmp_path):
    campaign = with_prepared(make(tmp_path / "exposures", FEW), undisturbed)
    snakemake(campaign, "chips=exposure", "--cores", "2")
    assert content(campaign) == content(undisturbed) and measured(campaign) == measured(undisturbed)
    logs = campaign.parent / "out" / "logs"
    made = {path.name for path in logs.iterdir()}
    assert {"exposure", "measure_exposure", "extract_exposure"} < made and not {"chip", "measure", "extract"} & made
    assert not left_of(campaign), "there are no intermediates"
    assert planned(campaign, "chips=exposure") == set()
    removed = next((campaign.parent / "out" / "measure").iterdir())
    removed.unlink()
    assert planned(campaign, "chips=exposure") == {"measure_exposure_0", "merge", "validate", "report"}


@pytest.mark.slow
def test_a_chip_that_always_fails_does_not_take_its_exposure(undisturbed, tmp_path):
    """Its PSF set is damaged: the next run makes the other. It is declared missing. Mended, it has the same bits."""
    campaign, how = with_prepared(make(tmp_path / "damaged", FEW), undisturbed), ("chips=exposure", "--keep-going")
    bad = next((campaign.parent / "out" / "psf").glob("*29*.h5"))
    sound = bad.read_bytes()
    bad.write_bytes(sound[: len(sound) // 2])
    said = snakemake(campaign, *how, "--cores", "2", fails=True)
    assert "made by themselves from now on" in said
    said = snakemake(campaign, *how, "--cores", "2", fails=True)
    made = {path.name for path in (campaign.parent / "out").rglob("*_09_*.fits")}
    assert made and {path.name for path in (undisturbed.parent / "out").rglob("*_09_*.fits")} == made
    assert [path.stem for path in (campaign.parent / "out" / "measure").iterdir()] == ["10100000001_09"]
    status = CliRunner().invoke(main, ["status", str(campaign)]).output
    assert "failed:" in status and "chip_29" in status
    text = campaign.read_text()
    declared = yaml.safe_load(text)
    declared["select"]["missing"] = {"10100000001_29": "its PSF set is damaged"}
    campaign.write_text(yaml.safe_dump(declared))
    snakemake(campaign, *how, "--cores", "2")
    assert "its PSF set is damaged" in (campaign.parent / "out" / "report" / "index.html").read_text()
    for path in (campaign.parent / "out" / "psf").glob("*29*"):  # of no use to a receiver
        path.rename(tmp_path / path.name)
    verified = CliRunner().invoke(main, ["verify", str(campaign), "--manifest"]).output
    manifest = campaign.parent / "out" / "MANIFEST.missing"
    assert "sound" in verified, verified
    assert manifest.read_text().splitlines()[1:] == ["10100000001\t29\tits PSF set is damaged"]
    campaign.write_text(text)
    for path in tmp_path.glob("*.h5"):
        path.rename(bad.parent / path.name)
    bad.write_bytes(sound)
    snakemake(campaign, *how, "--cores", "2")
    assert content(campaign) == content(undisturbed) and measured(campaign) == measured(undisturbed)
    assert planned(campaign, "chips=exposure") == set()


@pytest.mark.parametrize("how", ["chips=whole", "chips=exposure", "scratch=/tmp"])
def test_light_is_kept_by_the_four_stages_only(tmp_path, how):
    code, said = dry_run(make(tmp_path / "kept", keep="light"), how)
    assert code and "keep: needs chips in stages" in said


def test_an_unknown_size_of_jobs_is_refused(tmp_path):
    code, said = dry_run(make(tmp_path / "odd"), "chips=halves")
    assert code and "chips: halves; allowed: stages, whole, exposure" in said


@pytest.mark.thorough
def test_a_killed_and_resumed_campaign_gives_the_same_bits(undisturbed, tmp_path):
    """One chip, killed while it is rendered."""
    campaign = with_prepared(make(tmp_path / "killed", FEW), undisturbed)
    target = level0_targets(campaign)[0]
    line, environment = command(campaign, "--cores", "1", target)
    process = subprocess.Popen(line, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        victim = running("render", process, campaign)
        victim.send_signal(signal.SIGKILL)
        assert process.wait(timeout=600) != 0
    finally:
        if process.poll() is None:
            process.kill()
    assert not content(campaign)
    snakemake(campaign, "--cores", "1", "--rerun-incomplete", target)
    name = Path(target).name
    assert content(campaign) == {name: content(undisturbed)[name]}


@pytest.mark.thorough
def test_calibration_campaign_has_no_sky_stages():
    wanted = {"stages": {"render", "readout", "level0"}, "whole": {"chip"}, "exposure": {"exposure_0"}}
    for chips, rules in wanted.items():
        jobs = planned(ROOT / "config" / "calibration.yaml", f"chips={chips}", "--directory", str(ROOT))
        assert jobs == {*rules, "masters"}  # lamps light the flats: no truth, select or psf


def test_bad_campaign_is_one_clear_error(tmp_path):
    campaign = write_campaign(tmp_path, colour=1)
    line, environment = command(campaign, "--cores", "1")
    done = subprocess.run(line, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode != 0
    assert "colour" in done.stdout + done.stderr and "Traceback" not in done.stdout + done.stderr
    assert not (tmp_path / "out").exists()
