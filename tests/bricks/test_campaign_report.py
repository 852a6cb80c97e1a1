"""`csstsim report` on campaigns run through the commands: links, verdict, exit codes, calibration, a missing file."""

import json
from urllib.parse import unquote

import pytest
from mini_campaign import POINTINGS, write_campaign
from report_page import Reader, command, done

from csstsim.campaign import OpenCampaign


def relative_links(page):
    reader = Reader(page.read_text(encoding="utf-8"))
    return [href for href in reader.values("a", "href") if not href.startswith("#")]


def test_links_lead_to_the_files_of_the_campaign(reported):
    _, run, _ = reported
    page = run.paths.report
    targets = {(page.parent / unquote(link)).resolve() for link in relative_links(page)}
    assert all(target.is_file() for target in targets)
    expected = [run.paths.level0(job.pointing, job.chip.id) for job in run.jobs]
    expected += [path(pix) for pix in run.merge_bricks for path in (run.paths.merge, run.paths.validate)]
    assert {path.resolve() for path in expected} <= targets


def test_the_verdict_is_printed_and_strict_ends_with_1_only_when_a_gate_fails(reported):
    file, run, said = reported
    path = run.paths.validate(next(iter(run.merge_bricks)))
    verdict = run.paths.report.with_name("verdict.json")
    assert json.loads(verdict.read_text())["passed"] is not False and "FAIL" not in said
    assert command("report", file, "--strict").exit_code == 0
    before = path.read_text()
    result = json.loads(before)
    result["gates"][0] |= {"value": 0.5, "threshold": 0.95, "passed": False}
    path.write_text(json.dumps(result))
    try:
        assert command("report", file).exit_code == 0
        strict = command("report", file, "--strict")
        assert (
            strict.exit_code == 1
            and f"FAIL brick {result['brick']}, completeness, r: 0.5 against 0.95" in strict.output
        )
        assert json.loads(verdict.read_text())["passed"] is False
        assert json.loads(verdict.read_text())["gates"][0]["value"] == 0.5
    finally:
        path.write_text(before)
        done("report", file)


def test_many_figures_are_linked_instead_of_embedded(reported, monkeypatch):
    file, run, _ = reported
    before = run.paths.report.stat().st_size
    monkeypatch.setattr("csstsim.campaign_report.EMBEDDED", 0)
    done("report", file)
    text = run.paths.report.read_text()
    assert len(text) < before and "Validation of brick" not in text
    assert sum(link.endswith(".png") for link in relative_links(run.paths.report)) == 2 * len(run.merge_bricks)
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
    assert found.exit_code == 2 and str(path) in found.output and len(found.output.splitlines()) == 1
    assert f"csstsim validate {file} --brick {path.stem}`" in found.output


def test_a_stage_without_the_one_before_it_says_what_makes_that(tmp_path):
    """A command that the message names leads on to the next one."""
    file = write_campaign(tmp_path, [POINTINGS[0]], select={"chips": [9]})
    run = OpenCampaign(file)
    (job,), (pix, *_) = run.jobs, run.merge_bricks
    where = f"{file} --obsid {job.pointing.obsid} --chip 9`"
    merged = command("merge", file, "--brick", pix)
    measured, calibrated = (command(name, file, *job.options.split()) for name in ("measure", "calibrate"))
    assert {found.exit_code for found in (merged, measured, calibrated)} == {2}
    assert f"csstsim measure {where}" in merged.output
    assert f"csstsim chip {where}" in measured.output and f"csstsim chip {where}" in calibrated.output


@pytest.mark.parametrize("kind", ["BIAS", "DARK"])
def test_calibration_frames_alone(tmp_path, kind):
    pointing = f"10300000001,{kind},0,0,0,2027-11-20T02:00:00,{0 if kind == 'BIAS' else 100}"
    file = write_campaign(tmp_path, [POINTINGS[0], pointing], select={"types": [kind], "chips": [9, 29]})
    run = OpenCampaign(file)
    for job in run.jobs:
        done("chip", file, "--obsid", job.pointing.obsid, "--chip", job.chip.id)
    said = done("report", file, "--strict")
    assert "No gate could be judged" in said
    reader = Reader(run.paths.report.read_text())
    assert len(reader.values("image", "href")) == 2
    assert len([link for link in relative_links(run.paths.report) if link.endswith(".fits")]) == 2
