"""What commands of a campaign get: the campaign in its folders, a job, jobs or bricks, and the first line of a log."""

from types import SimpleNamespace

import click
import pytest
from click.testing import CliRunner

from csstsim.command_line.options import (
    Finite,
    brick_opt,
    chip_opt,
    of_bricks,
    of_campaign,
    of_job,
    of_jobs,
    scratch_opt,
    stage,
)


class Opened:
    """What was opened, with which folders, and which jobs were asked for."""

    config = SimpleNamespace(name="mine", digest=lambda: "0123456789abcdef")

    def __init__(self, file, *folders, only=None):
        self.given = (file, *folders, only)

    def job(self, obsid, chip_id):
        self.asked = obsid, chip_id
        return Job(obsid, chip_id)


class Job:
    def __init__(self, *key):
        self.key = key

    def named(self):
        return _Named(self.key)


class _Named:
    def __init__(self, key):
        self.key = key

    def __enter__(self):
        return self

    def __exit__(self, kind, exc, trace):
        if exc is not None:
            exc.add_note(f"in {self.key}")


@pytest.fixture
def run(monkeypatch):
    """Return a function that runs a command made of decorators; it gives (what the command got, its click result)."""
    monkeypatch.setattr("csstsim.campaign.opened.OpenCampaign", Opened)

    def call(decorate, *words, **faults):
        seen = []

        def verb(*given, **named):
            seen.append((given, named))
            if faults:
                raise faults["error"]

        return seen, CliRunner().invoke(click.command("verb")(decorate(verb)), [str(word) for word in words])

    return call


@pytest.mark.parametrize(("value", "good"), [
    ("0", True), ("2.5", True), ("-0.1", False), ("2.6", False), ("nan", False), ("inf", False), ("x", False),
])  # fmt: skip
def test_a_number_is_finite_and_in_its_range(value, good):
    @click.command()
    @click.option("--number", type=Finite(0, 2.5))
    def verb(number):
        click.echo(repr(number))

    found = CliRunner().invoke(verb, ["--number", value])
    assert found.output.strip() == repr(float(value)) if good else found.exit_code == 2


@pytest.mark.parametrize(("value", "good"), [("1e300", True), ("inf", False), ("nan", False), ("-1", False)])
def test_a_number_without_a_limit_is_finite(value, good):
    verb = click.command()(click.option("--number", type=Finite(0))(lambda number: None))
    assert CliRunner().invoke(verb, ["--number", value]).exit_code == (0 if good else 2)


def test_a_campaign_is_opened_in_its_folders_and_for_its_jobs(run):
    for decorate, words, given, named in (
        (of_campaign, (), ("c", None, None, None), {}),
        (lambda f: of_campaign(scratch_opt(f)), ("--scratch", "s"), ("c", None, "s", None), {}),
        (lambda f: of_campaign(click.option("--output")(f)), ("--output", "o"), ("c", "o", None, None), {}),
        (lambda f: of_campaign(chip_opt(f)), ("--chip", 9), ("c", None, None, None), {"chip_id": 9}),
        (lambda f: of_campaign(brick_opt(f)), ("--brick", 0), ("c", None, None, None), {"pix": 0}),
    ):
        [((opened,), got)], result = run(decorate, "c", *words)
        assert (opened.given, got, result.exit_code) == (given, named, 0)


def test_scratch_may_be_the_environments(run, monkeypatch):
    monkeypatch.setenv("CSSTSIM_SCRATCH", "/disk")
    [((opened,), _)], _ = run(lambda f: of_campaign(scratch_opt(f)), "c")
    assert opened.given == ("c", None, "/disk", None)


def test_a_command_of_a_job_gets_it_and_names_it_in_errors(run):
    words = "c", "--obsid", "123", "--chip", 7
    [((opened, job), named)], result = run(of_job, *words)
    assert job.key == ("123", 7) and opened.given == ("c", None, None, ("123", (7,))) and named == {}
    first, last = result.output.splitlines()
    assert " verb: campaign mine 01234567, exposure 123 chip 7, " in first and last.startswith("verb done: ")
    error = ZeroDivisionError("no")
    _, failed = run(of_job, *words, error=error)
    assert failed.exception is error and error.__notes__ == ["in ('123', 7)"] and "done" not in failed.output


def test_a_command_of_jobs_gets_each_chip_once_in_the_order_given(run):
    words = "c", "--obsid", "123", "--chip", 9, "--chip", 7, "--chip", 9
    [((opened, jobs), named)], result = run(of_jobs, *words)
    assert [job.key for job in jobs] == [("123", 9), ("123", 7)] and named == {"resume": False}
    assert opened.given[-1] == ("123", (9, 7)) and "exposure 123 chip 9 7, " in result.output
    [(_, named)], _ = run(of_jobs, *words, "--resume")
    assert named == {"resume": True}
    for wrong in (("c", "--obsid", "123"), ("c", "--chip", 9), ("c", "--obsid", "123", "--chip", 0)):
        seen, result = run(of_jobs, *wrong)
        assert result.exit_code == 2 and seen == []


def test_a_command_of_bricks_gets_them_one_by_one(run):
    seen, result = run(of_bricks, "c", "--brick", 786431, "--brick", 0, "--brick", 0)
    assert [given[1:] for given, _ in seen] == [(786431,), (0,)]
    assert "campaign mine 01234567, brick 786431 0, " in result.output
    assert [line.split(":")[0] for line in result.output.splitlines()[1:]] == [
        "brick 786431 done", "brick 0 done", "verb done",
    ]  # fmt: skip
    for wrong in (-1, 786432):
        assert run(of_bricks, "c", "--brick", wrong)[1].exit_code == 2


def test_the_first_line_names_chip_or_brick_or_nothing(run):
    for decorate, words, what in (
        (lambda f: stage(chip_opt(f)), ("--chip", 9), ", chip 9, "),
        (lambda f: stage(brick_opt(f)), ("--brick", 5), ", brick 5, "),
        (stage, (), "01234567, "),
    ):  # fmt: skip
        _, result = run(decorate, "c", *words)
        assert what in result.output.splitlines()[0]
