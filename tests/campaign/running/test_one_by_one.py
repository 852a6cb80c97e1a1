"""Several chips in one process: what was finished before a fault is not made again, and only that."""

import os
import time
from pathlib import Path

import pytest
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.errors import CsstsimError, InputError
from csstsim.base.files.atomic import atomic_path
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.products import kinds
from csstsim.campaign.running.job_log import earlier_parts, parts
from csstsim.campaign.running.one_by_one import (
    RULES,
    failed_chips,
    failed_since_start,
    one_by_one,
    record_missing_psf,
    remove_second_names,
    start_workflow,
)

CHIPS = 8, 9, 14
BIAS = POINTINGS[2].split(",")[0]


@pytest.fixture
def file(tmp_path):
    return write_campaign(tmp_path, [POINTINGS[2]], select={"types": ["BIAS"], "chips": list(CHIPS)})


def attempt(file, fail_at=None, rule="level0", resume=True):
    """Make the jobs of the file's exposure, up to a chip that fails; return the chips that were made."""
    run, made = OpenCampaign(file), []

    def make(job):
        if job.chip.id == fail_at:
            raise KeyboardInterrupt("the node dies")
        made.append(job.chip.id)
        for path in kinds(run)[rule].files_of(job):
            with atomic_path(path) as temporary:
                temporary.write_text(f"{job.key} {os.urandom(4).hex()}")

    if fail_at is None:
        one_by_one(run, rule, run.jobs, make, resume)
    else:
        with pytest.raises(KeyboardInterrupt):
            one_by_one(run, rule, run.jobs, make, resume)
    return made


def texts(file):
    run = OpenCampaign(file)
    return {path: Path(path).read_text() for path in kinds(run)["level0"].files() if os.path.exists(path)}


def remove(file):
    """Remove all products, as Snakemake does with those of a job that failed."""
    for path in texts(file):
        os.unlink(path)


def test_an_attempt_goes_on_where_the_one_before_failed(file):
    assert attempt(file, fail_at=14) == [8, 9]
    before = texts(file)
    remove(file)
    assert attempt(file) == [14]
    after = texts(file)
    assert len(after) == 2 * len(CHIPS)
    assert before.items() <= after.items()
    assert not any((file.parent / "out" / "chips").iterdir()), "nothing is left"
    assert attempt(file) == list(CHIPS), "a finished job is made anew"


def test_the_log_says_what_the_earlier_attempt_took(file, capsys):
    """Each chip its own CPU time: together at most that of the attempt, not of what the process did before it."""
    sum(range(10**7))
    start = time.process_time()
    attempt(file, fail_at=14)
    took = time.process_time() - start
    remove(file)
    capsys.readouterr()
    attempt(file)
    said = capsys.readouterr().out
    assert earlier_parts(said).keys() == {8, 9} and parts(said).keys() == {14}
    assert all(cpu >= 0 for cpu in earlier_parts(said).values())
    assert start > 0.2 and sum(earlier_parts(said).values()) <= took + 0.1  # of two chips, rounded to 0.1 s


def test_the_next_attempt_has_every_file_that_a_chip_left(tmp_path):
    """Also those that are no outputs of the rule: cosmic rays, and the truth as text under a name of its own."""
    given = {"types": ["BIAS"], "chips": [8, 9]}
    file = write_campaign(tmp_path, [POINTINGS[2]], select=given, level0_names="C3", truth=["parquet", "cat"])
    run = OpenCampaign(file)
    folder = run.paths.level0(run.jobs[0]).parent
    folder.mkdir(parents=True)
    fails = [9]

    def make(job):
        if job.chip.id in fails:
            raise KeyboardInterrupt
        paths = run.paths
        for path in (*kinds(run)["level0"].files_of(job), paths.level0_cosmic(job), paths.level0_catalogue(job)):
            path.write_text(f"{job.key}")

    with pytest.raises(KeyboardInterrupt):
        one_by_one(run, "level0", run.jobs, make, resume=True)
    left = {path.name: path.read_text() for path in folder.iterdir()}
    for path in folder.iterdir():
        path.unlink()
    fails.clear()
    one_by_one(run, "level0", run.jobs, make, resume=True)
    found = {path.name: path.read_text() for path in folder.iterdir()}
    assert len(left) == 5 and left.items() <= found.items() and len(found) == 10


def test_files_taken_again_are_newer_than_their_inputs(file):
    attempt(file, fail_at=9)
    for path in (file.parent / "out" / "chips").rglob("*.fits"):
        os.utime(path, (1, 1))
    remove(file)
    attempt(file, fail_at=14)
    assert all(Path(path).stat().st_mtime > 1 for path in texts(file))


def test_another_recipe_is_not_taken(file):
    attempt(file, fail_at=14)
    file.write_text(file.read_text().replace("seed: 3", "seed: 4"))
    assert attempt(file) == list(CHIPS)


@pytest.mark.slow
def test_without_hard_links_all_is_made_again(file, monkeypatch):
    def refuse(*_):
        raise PermissionError("no hard links")

    monkeypatch.setattr(os, "link", refuse)
    attempt(file, fail_at=14)
    assert not any(path.is_file() for path in (file.parent / "out" / "chips").rglob("*"))
    assert attempt(file) == list(CHIPS)


@pytest.mark.slow
def test_a_product_cut_short_by_a_kill_is_not_kept(file):
    attempt(file, fail_at=9)
    [kept] = (file.parent / "out" / "chips").glob("*/*")
    kept.rename(kept.with_name(f"{kept.name}.part"))
    assert attempt(file) == list(CHIPS)


def test_without_resume_nothing_is_taken_or_kept(file):
    attempt(file, fail_at=14)
    assert attempt(file, resume=False) == list(CHIPS)
    for folder in (file.parent / "out" / "chips").iterdir():
        folder.rename(folder.with_name("gone"))
    attempt(file, fail_at=14, resume=False)
    assert [folder.name for folder in (file.parent / "out" / "chips").iterdir()] == ["gone"]


def test_a_process_whose_parent_was_killed_keeps_what_it_made(file, monkeypatch):
    """Snakemake does not know that the job is finished: it removes the files and starts it again."""
    parents = iter([5, 1])
    with monkeypatch.context() as patch:
        patch.setattr(os, "getppid", lambda: next(parents))
        attempt(file)
    remove(file)
    assert attempt(file) == []
    assert len(texts(file)) == 2 * len(CHIPS)


def test_a_finished_campaign_forgets(file):
    attempt(file, fail_at=14)
    remove_second_names(OpenCampaign(file))
    assert attempt(file) == list(CHIPS)


@pytest.mark.parametrize("resume", [True, False])
@pytest.mark.parametrize(
    ("fault", "raised"),
    [(InputError("no light", file="stars.csv"), InputError), (RuntimeError("a library"), CsstsimError)],
)
def test_a_chip_that_fails_does_not_take_the_others(file, fault, raised, resume):
    run, made = OpenCampaign(file), []

    def make(job):
        if job.chip.id == 9:
            raise fault
        made.append(job.chip.id)
        for path in kinds(run)["level0"].files_of(job):
            with atomic_path(path) as temporary:
                temporary.write_text("made")

    with pytest.raises(raised, match=rf"1 chip of 3 failed, the others are finished: chip 9: .*{fault}") as seen:
        one_by_one(run, "level0", run.jobs, make, resume)
    assert made == [8, 14] and isinstance(seen.value, InputError) == (raised is InputError)
    obsid = run.jobs[0].obsid
    assert failed_since_start(run) == resume and failed_chips(run, "level0") == set()
    assert failed_chips(run, "level0", start=True) == ({(obsid, 9)} if resume else set())
    if resume:  # the next start of the workflow makes the two in one job, and the third by itself
        start_workflow(run)
        assert failed_chips(run, "level0") == {(obsid, 9)} and failed_chips(run, "measure") == set()
        assert not failed_since_start(run)
        remove(file)
        assert attempt(file) == [9]


def test_a_bug_among_faults_of_the_input_is_a_bug(file):
    """Only if all chips fail by their input does the command end as for a wrong input."""
    run = OpenCampaign(file)
    faults = {8: InputError("no light"), 9: RuntimeError("a library"), 14: InputError("no sky")}

    def make(job):
        raise faults[job.chip.id]

    with pytest.raises(CsstsimError, match="3 chips of 3 failed") as seen:
        one_by_one(run, "level0", run.jobs, make)
    assert not isinstance(seen.value, InputError) and "chip 9: RuntimeError: a library" in str(seen.value)
    faults[9] = InputError("no time")
    with pytest.raises(InputError, match="chip 8: no light; chip 9: no time; chip 14: no sky"):
        one_by_one(run, "level0", run.jobs, make)


def test_a_psf_set_that_cannot_be_made_sets_its_chip_apart_in_every_exposure_of_the_sky(tmp_path):
    """Not other chips, and not in calibrations: the jobs of exposures would wait for it."""
    select = {"types": ["SCIE", "BIAS"], "chips": [8, 9]}
    run = OpenCampaign(write_campaign(tmp_path, POINTINGS, select=select))
    record_missing_psf(run, 9, InputError("no wavefront"))
    found = {rule: failed_chips(run, rule, start=True) for rule in RULES}
    sky = {(row.split(",")[0], 9) for row in POINTINGS if ",SCIE," in row}
    assert found == {rule: set() for rule in RULES} | {"level0": sky} and len(sky) == 2
    assert failed_since_start(run)


def test_pairs_that_are_declared_missing(tmp_path):
    """They are left out of the campaign, and asked for they are refused with the reason; names must be right."""
    select = {"types": ["BIAS"], "chips": list(CHIPS), "missing": {f"{BIAS}_09": "the amplifier burnt out"}}
    run = OpenCampaign(write_campaign(tmp_path, [POINTINGS[2]], select=select))
    assert [job.chip.id for job in run.jobs] == [8, 14]
    with pytest.raises(InputError, match=r"declared missing.*burnt out"):
        run.job(BIAS, 9)
    for number, wrong in enumerate(("1_09", f"{BIAS}_99", BIAS, "_9")):
        (folder := tmp_path / str(number)).mkdir()
        with pytest.raises(InputError, match="OBSID_CHIP"):
            _ = OpenCampaign(write_campaign(folder, [POINTINGS[2]], select=select | {"missing": {wrong: "why"}})).jobs
