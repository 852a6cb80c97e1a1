"""What the workflow says on the terminal: a line a job, a failed job's error, and input errors as the CLI has them."""

import logging
import subprocess
from types import SimpleNamespace

import pytest
from snakemake_interface_logger_plugins.common import LogEvent
from support.mini_campaign import POINTINGS, write_campaign
from support.workflow_run import command

from snakemake_logger_plugin_csstsim import LogHandler

SETTINGS = {"quiet": set(), "show_failed_logs": True, "debug_dag": False, "nocolor": True, "stdout": False}


def handler(**settings):
    plain = dict.fromkeys(("dryrun", "verbose", "printshellcmds"), False)
    return LogHandler(SimpleNamespace(**(SETTINGS | plain | settings)), None)


def record(event, message="", **values):
    made = logging.makeLogRecord({"msg": message, "levelno": logging.INFO, "levelname": "INFO"} | values)
    if event:
        made.event = event
    return made


def job(number, rule, **wildcards):
    return record(LogEvent.JOB_INFO, jobid=number, rule_name=rule, wildcards=wildcards)


def test_each_finished_job_is_a_line_with_its_place_in_the_campaign(capsys):
    log = handler()
    stats = {"render": 2, "level0": 1, "all": 1, "total": 4}
    for each in (
        record(None, "Building DAG of jobs..."), record(None, "Using shell: /bin/bash"),
        record(LogEvent.RUN_INFO, "a table", stats=stats), job(1, "render", obsid="10100000001", chip="09"),
        job(2, "merge", pix="550615", dir="550000"), job(0, "all"),
        record(LogEvent.JOB_STARTED, jobs=[1, 2]), record(LogEvent.SHELLCMD, cmd="csstsim render ..."),
        record(LogEvent.JOB_FINISHED, "Finished jobid: 2", job_id=2), record(LogEvent.PROGRESS, done=1, total=4),
        record(LogEvent.JOB_FINISHED, "Finished jobid: 1", job_id=1), record(LogEvent.PROGRESS, done=2, total=4),
        record(LogEvent.JOB_FINISHED, "Finished jobid: 0", job_id=0), record(LogEvent.PROGRESS, done=4, total=4),
        record(None, "Complete log(s): x.log"), record(None, "Words of a later Snakemake about its own work."),
        record(None, "a warning", levelno=logging.WARNING, levelname="WARNING"),
    ):  # fmt: skip
        log.emit(each)
    lines = capsys.readouterr().err.splitlines()
    assert [line.rsplit("  ", 1)[0] for line in lines[1:3]] == [
        "1/3  merge brick 550615",
        "2/3  render 10100000001 chip 09",
    ]
    assert lines[0] == "3 jobs: 2 render, 1 level0" and lines[1].endswith(" s")
    assert lines[3:] == ["a warning"]


def test_where_no_job_runs_snakemakes_answer_is_shown(capsys):
    log = handler()
    for text in ("Building DAG of jobs...", "Nothing to be done (all requested files are present and up to date)."):
        log.emit(record(None, text))
    assert capsys.readouterr().err.startswith("Nothing to be done")


def test_the_first_picture_is_named_by_its_file(capsys):
    log, info = handler(), job(1, "look", obsid="10100000001", chip="09")
    info.output = ["out/look/10100000001_09.png"]
    log.emit(info)
    for each in (record(LogEvent.JOB_FINISHED, job_id=1), record(LogEvent.PROGRESS, done=1, total=3)):
        log.emit(each)
    assert "a first picture: out/look/10100000001_09.png" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("step\ncsstsim: error: a.fits: damaged\n", "  csstsim: error: a.fits: damaged"),
        ("Traceback\nZeroDivisionError\n", "  Traceback\n  ZeroDivisionError"),
    ],
)
def test_a_failed_job_shows_the_error_of_its_log(tmp_path, capsys, text, shown):
    path = tmp_path / "readout.log"
    path.write_text(text)
    log = handler()
    log.emit(job(1, "readout", obsid="10100000001", chip="09"))
    log.emit(record(LogEvent.JOB_ERROR, jobid=1, rule_name="readout", log=[str(path)]))
    assert capsys.readouterr().err == f"FAILED readout 10100000001 chip 09\n{shown}\n  log: {path}\n"


def failed(log, number, rule, path, status):
    """Emit what Snakemake says of a command that ended with a status."""
    log.emit(job(number, rule, obsid="10100000001", chip="09"))
    log.emit(record(LogEvent.ERROR, f"RuleException:\nCommand 'x' returned non-zero exit status {status}."))
    log.emit(record(LogEvent.JOB_ERROR, jobid=number, rule_name=rule, log=[str(path)]))


@pytest.mark.parametrize(("text", "status"), [("csstsim 0.1.0 render ...\n\nAborted!\n", 1), ("", 143)])
def test_an_interrupted_job_has_not_failed(tmp_path, capsys, text, status):
    """Ctrl-C, and SIGTERM."""
    path = tmp_path / "render.log"
    path.write_text(text)
    log = handler()
    log.emit(record(LogEvent.RUN_INFO, "a table", stats={"render": 1, "total": 1}))
    failed(log, 1, "render", path, status)
    log.emit(record(LogEvent.ERROR, "WorkflowError:\nAt least one job did not complete successfully."))
    assert capsys.readouterr().err.splitlines()[1:] == ["interrupted render 10100000001 chip 09"]


def test_how_a_job_ended_is_shown_where_its_log_has_no_error(tmp_path, capsys):
    path = tmp_path / "render.log"
    path.write_text("")
    log = handler()
    failed(log, 1, "render", path, 137)
    said = capsys.readouterr().err
    assert "exit status 137" in said and "FAILED render" in said
    path.write_text("csstsim: error: a.fits: damaged\n")
    failed(log, 2, "render", path, 2)
    said = capsys.readouterr().err
    assert "exit status" not in said and "FAILED render" in said and "damaged" in said
    log.emit(record(LogEvent.ERROR, "RuleException:\nof no job"))
    log.emit(record(LogEvent.JOB_FINISHED, job_id=5))
    assert "of no job" in capsys.readouterr().err


def test_a_dry_run_is_shown_as_snakemake_shows_it(capsys):
    handler(dryrun=True).emit(record(None, "Building DAG of jobs..."))
    assert capsys.readouterr().err == "Building DAG of jobs...\n"


def test_a_fault_of_the_input_is_the_line_of_the_command_and_its_exit_code(tmp_path):
    line, environment = command(write_campaign(tmp_path, POINTINGS[:1], seed=-3), "--cores", "1")
    done = subprocess.run(line, env=environment, capture_output=True, text=True, check=False)
    errors = [line for line in done.stderr.splitlines() if "error" in line.lower()]
    assert done.returncode == 2 and len(errors) == 1 and "Traceback" not in done.stderr
    assert errors[0].startswith("csstsim: error: ") and "seed: input should be greater than or equal to 0" in errors[0]
