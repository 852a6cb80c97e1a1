"""`csstsim report` on campaigns run through the commands: links, verdict, exit codes, calibration, a missing file."""

import json
import re
import shutil
import socket
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import unquote

import pytest
from report_page import Reader
from support.commands import command, done
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.campaign.costs import Cost, expected
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.products import kinds
from csstsim.campaign.running.run_times import run_times
from csstsim.catalog.table import ObjectTable
from csstsim.io.output_owner import OWNER_FILE
from csstsim.io.paths import Paths
from csstsim.measure.bricks.validation.result_file import read_result, write_result
from csstsim.stages.report import _products
from csstsim.studies.compare.varying import steady_page


def relative_links(page):
    reader = Reader(page.read_text(encoding="utf-8"))
    return [href for href in reader.values("a", "href") if not href.startswith("#")]


def test_links_lead_to_the_files_of_the_campaign(reported):
    _, run, _ = reported
    page = run.paths.report
    targets = {(page.parent / unquote(link)).resolve() for link in relative_links(page)}
    assert all(target.is_file() for target in targets)
    expected = [run.paths.level0(job) for job in run.jobs]
    expected += [path(pix) for pix in run.merge_bricks for path in (run.paths.merge, run.paths.validate)]
    assert {path.resolve() for path in expected} <= targets


def test_every_product_is_linked_with_its_size_and_the_provenance_is_complete(reported):
    _, run, _ = reported
    text = run.paths.report.read_text(encoding="utf-8")
    targets = {(run.paths.report.parent / unquote(link)).resolve() for link in relative_links(run.paths.report)}
    for kind in kinds(run).values():
        made = {Path(path).resolve() for path in kind.files() if Path(path).is_file()} - {run.paths.report.resolve()}
        assert made <= targets, kind.name
    assert re.search(r"Level-0 files: 2 files, [\d.]+ [kMG]B", text)
    for word in (socket.gethostname(), "report written", "survey table", "scie_obs", "seed", "layers in order"):
        assert word in text
    later = re.sub(r"((?:report written|host)</th><td>).*?<", r"\g<1>other<", text)
    assert later != text and steady_page(later) == steady_page(text)


def test_many_files_of_a_kind_are_linked_by_their_folder(reported, monkeypatch):
    _, run, _ = reported
    monkeypatch.setattr("csstsim.stages.report.LINKED", 1)
    rows = {kind: links for kind, *_, links in _products(run)}
    assert [link.label for link in rows["Level-0 files"]] == ["the folder level0"]


def test_the_verdict_is_printed_and_strict_ends_with_1_only_when_a_gate_fails(reported):
    file, run, said = reported
    path = run.paths.validate(next(iter(run.merge_bricks)))
    verdict = run.paths.report.with_name("verdict.json")
    assert json.loads(verdict.read_text())["passed"] is not False and "FAIL" not in said
    assert command("report", file, "--strict").exit_code == 0
    before = path.read_text()
    result = read_result(path)
    result["gates"][0] |= {"value": 0.5, "threshold": 0.95, "passed": False}
    write_result(path, result)
    try:
        assert command("report", file).exit_code == 0
        strict = command("report", file, "--strict")
        assert strict.exit_code == 1 and ": completeness in r is 0.5 against 0.95" in strict.output
        assert json.loads(verdict.read_text())["passed"] is False
        assert json.loads(verdict.read_text())["gates"][0]["value"] == 0.5
    finally:
        path.write_text(before)
        done("report", file)


def test_many_figures_are_linked_instead_of_embedded(reported, monkeypatch):
    file, run, _ = reported
    before = run.paths.report.stat().st_size
    monkeypatch.setattr("csstsim.stages.report.EMBEDDED", 0)
    done("report", file)
    text = run.paths.report.read_text()
    assert len(text) < before and "Validation of brick" not in text
    links = [link for link in relative_links(run.paths.report) if link.endswith(".png")]
    assert len(links) == 3 * len(run.merge_bricks)  # beside the bricks' numbers, in their section, and as a product
    monkeypatch.undo()
    done("report", file)


def test_a_missing_validation_is_one_line(reported):
    file, run, _ = reported
    path = run.paths.validate(next(iter(run.merge_bricks)))
    kept = path.rename(path.with_suffix(".kept"))
    try:
        found = command("report", file)
    finally:
        kept.rename(path)
    assert found.exit_code == 2 and str(path) in found.output and len(found.stderr.splitlines()) == 1
    assert f"csstsim validate {file} --brick {path.stem}`" in found.output


def test_a_stage_without_the_one_before_it_says_what_makes_that(tmp_path):
    """A command that the message names leads on to the next one."""
    file = write_campaign(tmp_path, [POINTINGS[0]], select={"chips": [9]})
    run = OpenCampaign(file)
    (job,), (pix, *_) = run.jobs, run.merge_bricks
    where = f"{file} --obsid {job.obsid} --chip 9`"
    merged = command("merge", file, "--brick", pix)
    measured, calibrated = (command(name, file, *job.options.split()) for name in ("measure", "calibrate"))
    assert {found.exit_code for found in (merged, measured, calibrated)} == {2}
    assert f"csstsim measure {where}" in merged.output
    assert f"csstsim chip {where}" in measured.output and f"csstsim chip {where}" in calibrated.output


def verdict_of(result):
    """What changes a verdict by one letter."""
    return result.replace(b'"passed": null', b'"passed": true', 1)


@pytest.mark.parametrize(
    ("product", "change", "words"),
    [
        ("validate", lambda raw: raw.replace(b'"bands"', b'"bandz"'), "damaged"),
        ("validate", verdict_of, "damaged"),
        ("validate", lambda raw: b"[]", "not the validation of a brick"),
        ("png", lambda raw: raw[:-1], "the PNG is damaged"),
        ("png", lambda raw: b"", "the PNG is damaged"),
        ("merge", lambda raw: raw[: len(raw) // 2], "parquet"),
        ("level0", lambda raw: raw[: len(raw) // 2], "cut short"),
    ],
)
def test_nothing_is_written_of_a_damaged_product(reported, product, change, words):
    file, run, _ = reported
    pix, job = next(iter(run.merge_bricks)), run.jobs[0]
    path = {
        "validate": run.paths.validate(pix), "png": run.paths.validate(pix).with_suffix(".png"),
        "merge": run.paths.merge(pix), "level0": run.paths.level0(job),
    }[product]  # fmt: skip
    before, written = path.read_bytes(), [run.paths.report, run.paths.report.with_name("verdict.json")]
    for made in written:
        made.unlink()
    path.write_bytes(change(before))
    try:
        found = command("report", file)
        assert not any(made.exists() for made in written)
    finally:
        path.write_bytes(before)
        done("report", file)
    assert found.exit_code == 2 and str(path) in found.output and words in found.output


def test_a_verdict_by_other_thresholds_or_of_another_brick_is_refused(reported, tmp_path):
    file, run, _ = reported
    stricter = file.with_name("stricter.yaml")
    (run.paths.output / OWNER_FILE).unlink(missing_ok=True)
    stricter.write_text(file.read_text() + "validation: {mag_bias_max: 0.001}\n")
    found = command("report", stricter)
    assert found.exit_code == 2 and "other thresholds" in found.output
    path = run.paths.merge(next(iter(run.merge_bricks)))
    before, table = path.read_bytes(), ObjectTable.read(path)
    table.write(path, table.meta | {"recipe": "another's"})
    try:
        found = command("report", file)
    finally:
        path.write_bytes(before)
    assert found.exit_code == 2 and str(path) in found.output and "another campaign" in found.output


def logged(folder, rule, name, took):
    """Write the log of a job."""
    (folder / "logs" / rule).mkdir(parents=True, exist_ok=True)
    (folder / "logs" / rule / f"{name}.log").write_bytes(b"csstsim ...\n" + took + b"\n")


def test_what_jobs_took_stands_beside_what_was_expected(reported):
    """Logs that are cut short, or of jobs that failed, are left out."""
    file, run, _ = reported
    out = run.paths.output
    logged(out, "readout", "1", b"readout done: 9.0 s, CPU 4.0 s, memory 200 MB")
    logged(out, "measure", "1", b"measure done: 29.5 s, CPU 20.0 s, memory 300 MB")
    logged(out, "measure", "cut", b"measure done: 29.5 s, CPU 2")
    logged(out, "psf", "odd", b"\xff\xfe")
    try:
        rows = {row["step"]: row for row in run_times(run)}
        done("report", file)
        assert "all, for a Level-0 file" in run.paths.report.read_text()
    finally:
        shutil.rmtree(out / "logs")
        done("report", file)
    costs = expected(run)
    measure, readout, whole = (rows[name] for name in ("measure", "readout", "all, for a Level-0 file"))
    assert "psf" not in rows and measure["jobs"] == 1
    assert measure["CPU of a job: mean"] == 20.0 and measure["largest"] == 300 and measure["wall [s]"] == 29.5
    should = costs["readout"][run.jobs[0].key]
    assert readout["mean / expected"] == round(4.0 / should.cpu_s, 2)
    assert readout["largest / expected"] == round(200 / should.memory_mb, 2)
    assert whole["CPU [s]"] == 24.0 / len(run.jobs) and whole["wall [s]"] == round(38.5 / len(run.jobs), 1)


def test_jobs_of_a_rule_are_expected_to_cost_the_mean_of_those_planned(tmp_path, monkeypatch):
    """Three readouts were measured, two are planned, of 10 and 20 s: 45 s, and not three times the dearest."""
    costs = {"readout": {1: Cost(10.0, 100), 2: Cost(20.0, 300)}}
    monkeypatch.setattr("csstsim.campaign.running.run_times.expected", lambda run: costs)
    for number in range(3):
        logged(tmp_path, "readout", str(number), b"readout done: 40.0 s, CPU 30.0 s, memory 200 MB")
    readout, whole, each = run_times(SimpleNamespace(paths=Paths(tmp_path), jobs=[1, 2]))
    assert readout["expected [s]"] == 15.0 and readout["mean / expected"] == 2.0 and readout["expected [MB]"] == 300
    assert whole["expected [s]"] == 45.0 and whole["mean / expected"] == 2.0 and each["expected [s]"] == 22.5


def test_no_logs_no_table(reported):
    assert run_times(reported[1]) == []


@pytest.mark.parametrize("kind", ["BIAS", "DARK"])
def test_calibration_frames_alone(tmp_path, kind):
    pointing = f"10300000001,{kind},0,0,0,2027-11-20T02:00:00,{0 if kind == 'BIAS' else 100}"
    file = write_campaign(tmp_path, [POINTINGS[0], pointing], select={"types": [kind], "chips": [9, 29]})
    run = OpenCampaign(file)
    for job in run.jobs:
        done("chip", file, "--obsid", job.obsid, "--chip", job.chip.id)
    said = done("report", file, "--strict")
    assert "No gate could be evaluated" in said
    reader = Reader(run.paths.report.read_text())
    assert len(reader.values("image", "href")) == 2
    assert len({link for link in relative_links(run.paths.report) if link.endswith(".fits")}) == 2
