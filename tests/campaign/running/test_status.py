"""`csstsim status`: wanted and finished products, the pace, the time left, failed jobs."""

import io
import os
import socket
import subprocess
import sys
import time

import pytest
from rich.console import Console
from support.commands import command, done, refused
from support.mini_campaign import write_campaign

from csstsim.campaign.costs import default_workflow, expected
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.plan import duration
from csstsim.campaign.products import kinds as table
from csstsim.campaign.running import status
from csstsim.campaign.running.status import (
    MAX_FAILURES,
    KindProgress,
    Status,
    failures,
    lines,
    pace,
    read_status,
    wanted,
)
from csstsim.delivery.contents import YES, of_campaign
from csstsim.delivery.products import products

HOUR = 3600.0


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return OpenCampaign(write_campaign(tmp_path_factory.mktemp("status"), select={"chips": [9, 29]}))


def said(*arguments):
    return done("status", *arguments).splitlines()


def made(moments, cpu=60.0, missing=0, name="Level-0 files"):
    """A kind of which one was made at each of the moments."""
    costs = {(f"{name}/{i}",): cpu for i in range(len(moments) + missing)}
    return KindProgress(name, costs, dict(zip(costs, moments, strict=False)))


def touch(products, moment=None):
    """Write the files of products."""
    for path in (path for files in products for path in files):
        os.makedirs(os.path.dirname(path), exist_ok=True)
        with open(path, "wb") as file:
            file.write(b"12345")
        if moment is not None:
            os.utime(path, (moment, moment))


def test_what_is_wanted_are_products_that_verify_looks_for(run):
    """And nothing the workflow runs is left out: the CPU time of all is the plan's."""
    kinds = wanted(run)
    needed = {str(product.path) for product in products(of_campaign(run)) if product.need == YES}
    assert set().union(*(kind.files() for kind in table(run).values())) == needed
    assert {path for costs in kinds.values() for files in costs for path in files} == needed
    assert list(kinds)[:3] == ["truth bricks", "PSF sets", "Level-0 files"] and "spectra" in kinds
    jobs = default_workflow(expected(run)).values()
    assert sum(sum(paths.values()) for paths in kinds.values()) == pytest.approx(
        sum(cost.cpu_s for costs in jobs for cost in costs.values())
    )


def test_nothing_made_yet_then_some_then_all(run):
    output = said(run.file)
    assert f"Level-0 files: 0 of {len(run.jobs)}" in output and not run.paths.output.exists()
    assert "not known yet" in output[-1]
    kinds = wanted(run)
    start = time.time() - 600
    touch(kinds["truth bricks"], start)
    touch(kinds["PSF sets"], start + 60)
    temporary = run.paths.output / "psf" / ".chip_09.host.1.tmp.h5"
    temporary.write_bytes(b"")
    output = said(run.file)
    assert "PSF sets: 2 of 2" in output and any(" left" in line for line in output)
    for paths in kinds.values():
        touch(paths, start + 120)
    output = said(run.file, "--watch", 1)  # which ends
    size = 5 * len({path for costs in kinds.values() for files in costs for path in files}) / 1e9
    assert output[-2:] == [f"{run.paths.output}: {size:.3g} GB", "all products exist"]
    elsewhere = said(run.file, "--output", run.paths.output.parent / "elsewhere")
    assert "report: 0 of 1" in elsewhere


def test_variants_count_as_their_base_does(tmp_path):
    """Their products are waited for and take room, their failed jobs are named; no log takes room."""
    file = write_campaign(tmp_path, variants={"one": {"seed": 4}})
    run = OpenCampaign(file)
    products = wanted(run)
    made = [next(iter(products[kind])) for kind in ("Level-0 files", "one: Level-0 files")]
    touch(made)
    for folder in (run.paths.output, run.paths.output / "variants" / "one"):
        (folder / "logs" / "psf").mkdir(parents=True)
        (folder / "logs" / "psf" / "9.log").write_text(f"csstsim: error: no room in {folder.name}\n")
    found = read_status(run, products)
    assert found.disk == 5 * sum(map(len, made))
    assert {line for _, line in found.failed} == {f"csstsim: error: no room in {name}" for name in ("out", "one")}
    assert {kind.name: len(kind.made) for kind in found.kinds if kind.made} == {
        "Level-0 files": 1, "one: Level-0 files": 1,
    }  # fmt: skip


def test_a_product_exists_if_all_of_its_files_do(tmp_path):
    """An image that `measurement.joint` asks for later is missing."""
    joint = OpenCampaign(write_campaign(tmp_path, select={"chips": [9]}, measurement={"joint": True}))
    products = wanted(joint)
    table, residual = next(iter(products["measured tables"]))
    for path, count in ((table, 0), (residual, 1)):
        touch([(path,)])
        (measured,) = (kind for kind in read_status(joint, products).kinds if kind.name == "measured tables")
        assert len(measured.made) == count, path


def test_a_bar_is_as_long_as_what_is_made():
    """At a terminal: of 30 places 3/4, none and all; below the bars the lines about all kinds."""
    kinds = [made([1.0] * count, missing=missing, name=name) for count, missing, name in
             ((3, 1, "a"), (0, 5, "b"), (7, 0, "c"))]  # fmt: skip
    found = Status(kinds, None, 2_000_000_000, [])
    text = io.StringIO()
    Console(file=text, width=100, no_color=True).print(status._bars(found, "out"))
    *bars, disk, left = text.getvalue().splitlines()
    assert [line.split()[0] for line in bars] == ["a", "b", "c"]
    assert [line.count("━") for line in bars] == [22, 0, 30]
    assert [" ".join(line.split()[-3:]) for line in bars] == ["3 of 4", "0 of 5", "7 of 7"]
    assert disk.startswith("out: 2 GB") and "not known yet" in left


def test_from_within_the_folder_and_with_products_on_another_disk(run, tmp_path, monkeypatch):
    (tmp_path / "disk" / "measure").mkdir(parents=True)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "measure").symlink_to(tmp_path / "disk" / "measure")
    monkeypatch.chdir(tmp_path / "out")
    here = OpenCampaign(run.file, ".")
    products = wanted(here)
    touch(products["measured tables"])
    (measured,) = (kind for kind in read_status(here, products).kinds if kind.name == "measured tables")
    assert len(measured.made) == len(run.imaging_jobs) > 0


def test_a_folder_that_is_a_file_and_one_that_goes_meanwhile(run, tmp_path):
    (tmp_path / "file").write_text("")
    refused("status", run.file, "--output", tmp_path / "file")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "level0").symlink_to(tmp_path / "out")  # a circle
    (tmp_path / "out" / "seven").write_text("7 bytes")
    assert read_status(OpenCampaign(run.file, tmp_path / "out"), {}).disk == 2 * 7
    (tmp_path / "out" / "psf").symlink_to(tmp_path / "nowhere")
    assert "report: 0 of 1" in said(run.file, "--output", tmp_path / "out")


@pytest.mark.parametrize("shift", [0.0, 5 * HOUR, -5 * HOUR])
def test_pace_and_time_left_whatever_the_clock_says(shift):
    """One product of 60 CPU s every 30 s: two cores."""
    now = time.time() + shift
    kind = made([now - 30.0 * i for i in range(20)], missing=100)
    found = pace([kind])
    assert found.cpu / found.span == pytest.approx(2.0)
    assert found.counts == {"Level-0 files": 19}
    assert Status([kind], found, 0, []).left == pytest.approx(100 * 60 / 2.0)


def test_only_the_last_hour_counts_and_a_night_does_not():
    now = time.time()
    lately = [now - 60.0 * i for i in range(10)]
    before = [now - 10 * HOUR - 5.0 * i for i in range(100)]
    assert pace([made([*lately, *before])]) == pace([made(lately)])
    slower = [now - 120.0 * i for i in range(33)]  # an hour, and the four minutes of four jobs
    faster = [slower[-1] - 10.0 * i for i in range(1, 500)]
    assert pace([made([*slower, *faster])]) == pace([made(slower)])
    # an hour's gap of work that never paused: jobs of hours
    hours = pace([made([now - 2 * HOUR * i for i in range(3)], cpu=2 * HOUR)])
    assert hours.cpu / hours.span == pytest.approx(1.0)


def test_work_that_has_only_begun_and_a_file_of_the_future_leave_it_to_the_work_before():
    now = time.time()
    before = [now - 10 * HOUR - 30.0 * i for i in range(10)]
    for odd in (now, now + 1000 * HOUR):
        found = pace([made([odd, *before])])
        assert found.cpu / found.span == pytest.approx(2.0) and found.last == odd


@pytest.mark.parametrize("moments", [[], [1e9], [1e9, 1e9], [1e9, 1e9 + 10 * HOUR]])
def test_too_few_products_have_no_pace(moments):
    kind = made(moments, missing=3)
    assert pace([kind]) is None
    status = Status([kind], None, 0, [])
    assert status.left is None and any("not known yet" in line for line in lines(status, "out"))


def test_kinds_that_cost_more_count_more():
    now = time.time()
    cheap = made([now - 100 + i for i in range(0, 100, 10)], cpu=1.0, name="PSF sets")
    dear = made([now], cpu=491.0, missing=1)
    found = pace([cheap, dear])
    assert found.cpu == 9 + 491 and found.span == pytest.approx(100.0)
    status = Status([cheap, dear], found, 0, [])
    assert status.left == pytest.approx(491 / 5.0)
    assert "36 an hour" in lines(status, "out")[1] and "an hour" not in lines(status, "out")[0]  # all are made


def test_idle_is_said():
    now = time.time()
    kind = made([now - 7 * HOUR, now - 7 * HOUR - 60], missing=1)
    found = lines(Status([kind], pace([kind]), 0, []), "out")
    assert any(line.startswith("no new product for 7.0 h") for line in found)


def test_failed_jobs_are_named_newest_first(tmp_path):
    logs = tmp_path / "logs"
    texts = {
        "render/a.log": "csstsim 0.1.0 render: ...\nrender done: 1.0 s, CPU 1.0 s, memory 100 MB\n",
        "render/b.log": "csstsim 0.1.0 render: ...\ncsstsim: error: b: disk full\n",
        "measure/c.log": "x" * 100_000 + "\ncsstsim: error: c: \x1b[31mdamaged\nand a line after\n",
        "measure/d.log": "Traceback (most recent call last):\n  File\nValueError: what\n\n",
        "psf/e.log": "",
    }
    for i, (name, text) in enumerate(texts.items()):
        path = logs / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        os.utime(path, (1e9 + i, 1e9 + i))
    (logs / "psf" / "f.log").write_bytes(b"\xff\xfe\x00")
    assert failures(str(logs)) == [
        (str(logs / "measure/d.log"), "ValueError: what"),
        (str(logs / "measure/c.log"), "csstsim: error: c: ?[31mdamaged"),
        (str(logs / "render/b.log"), "csstsim: error: b: disk full"),
    ]
    for i in range(2 * MAX_FAILURES):
        (logs / "psf" / f"{i}.log").write_text("csstsim: error: again\n")
    assert len(failures(str(logs))) == MAX_FAILURES and failures(str(tmp_path / "none")) == []


def test_a_job_that_was_killed_outright_is_a_failure(tmp_path):
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    first = "csstsim 0.1.0 chip: campaign demo 0123abcd, exposure 1 chip 9, {} pid {}, 2027-11-20T01:08:00Z\n"
    here, last = socket.gethostname(), "chip done: 1.0 s, CPU 1.0 s, memory 100 MB\n"
    for name, text in {
        "killed": first.format(here, gone.pid) + "drawing\n" * 1000,
        "done": first.format(here, gone.pid) + last,
        "at_work": first.format(here, os.getpid()),
        "elsewhere": first.format(f"not-{here}", gone.pid),
    }.items():
        (tmp_path / f"{name}.log").write_text(text)
    ((path, line),) = failures(str(tmp_path))
    assert path.endswith("killed.log") and line == f"killed: process {gone.pid} ended without a message"


def test_failures_are_in_the_status_while_something_is_missing(run, tmp_path):
    log = tmp_path / "out" / "logs" / "psf" / "09.log"
    log.parent.mkdir(parents=True)
    log.write_text("csstsim: error: psf: no room\n")
    assert said(run.file, "--output", tmp_path / "out")[-1] == f"failed: {log}: csstsim: error: psf: no room"
    status = read_status(OpenCampaign(run.file, tmp_path / "out"), {"report": {}})
    assert status.done and not any("failed" in line for line in lines(status, "out"))


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "1e9", "soon"])
def test_watch_is_a_second_at_least(run, seconds):
    assert command("status", run.file, f"--watch={seconds}").exit_code == 2


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.4, "0 s"), (59, "59 s"), (60, "1.0 min"), (5400, "1.5 h"), (4e6, "1,111 h")]
)
def test_a_span_of_time_in_words(seconds, words):
    assert duration(seconds) == words


def test_a_status_in_words():
    """Of 4 frames at 10 CPU s 3 are made, of 2 tables at 100 s one: 110 s are left, at 2 CPU s a second."""
    frames = status.KindProgress("frames", dict.fromkeys("abcd", 10.0), {"a": 0.0, "b": 1.0, "c": 2.0})
    tables = status.KindProgress("tables", dict.fromkeys("ef", 100.0), {"e": 9.0})
    pace = status.Pace(60.0, 120.0, {"frames": 2, "tables": 1}, 1_000_000.0)
    found = status.Status([frames, tables], pace, 2_345_000_000, [("log", "no disk")], {("7", 9): "its amplifier"})
    assert not found.done and found.missing_cpu == 110.0 and found.left == 55.0
    assert status.lines(found, "out", 1_000_900.0) == [
        "frames: 3 of 4, 120 an hour", "tables: 1 of 2, 60 an hour", "out: 2.35 GB",
        "1.8 min of CPU time left, estimated; 55 s at the pace of the last 1.0 min of work",
        "declared missing: 7 chip 9: its amplifier", "failed: log: no disk",
    ]  # fmt: skip
    assert "no new product for 15.0 min: since 1970-01-12 13:46 UTC" in status.lines(found, "out", 1_000_901.0)
    slow = status.Status([frames, tables], None, 0, [])
    assert slow.left is None and status.summary(slow, "out", 0.0)[1].startswith("1.8 min of CPU time left, estimated; ")
    done = status.Status([status.KindProgress("frames", {"a": 1.0}, {"a": 5.0})], pace, 0, [("log", "no disk")])
    assert done.done and status.lines(done, "out", 0.0) == ["frames: 1 of 1", "out: 0 GB", "all products exist"]
