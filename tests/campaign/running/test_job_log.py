"""The first and last line of a job's log."""

import io
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest
from support.commands import command
from support.mini_campaign import write_campaign

from csstsim import __version__
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.running import job_log as module
from csstsim.campaign.running.job_log import JobUsage, job_log, part_log, parts, read_usage

FIRST = re.compile(
    rf"csstsim {re.escape(__version__)} (\w+): campaign mini ([0-9a-f]{{8}}), ([\w ]+), "
    r"\S+ pid (\d+), \d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ"
)


def test_a_log_begins_with_whose_it_is_and_ends_with_what_it_took(tmp_path):
    file = write_campaign(tmp_path)
    job = OpenCampaign(file).jobs[0]
    where = "--obsid", job.obsid, "--chip", 9, "--chip", 9  # once is enough
    log = tmp_path / "chip.log"
    program = "import sys; from csstsim.command_line.main import main; main(sys.argv[1:])"
    with open(log, "w") as out:
        line = [sys.executable, "-c", program, "chip", file, *where]
        process = subprocess.Popen([*map(str, line)], stdout=out, stderr=subprocess.STDOUT)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = status
    text = log.read_text()
    assert status == 0, text
    first = FIRST.fullmatch(text.splitlines()[0])
    assert first.groups() == (
        "chip", OpenCampaign(file).config.digest()[:8], f"exposure {job.obsid} chip 9", str(process.pid)
    )  # fmt: skip
    end = read_usage(text)
    assert text.splitlines()[-1].startswith("chip done: ")
    total = used.ru_utime + used.ru_stime
    assert total - 0.3 < end.cpu_s <= total + 0.1, "the interpreter ends at once"
    assert parts(text).keys() == {9} and 0 < parts(text)[9] <= end.cpu_s
    assert 100 < end.memory_mb <= used.ru_maxrss / 1024 + 1 and end.wall_s > 0
    # what benchmarks/overhead.py reads is as it was
    stages = re.findall(r"^(\w+): [\d.]+ s, [\d.]+ CPU-s$", text, re.MULTILINE)
    assert stages == ["select", "render", "readout", "level0", "writing"]


def test_commands_that_make_nothing_and_jobs_that_fail(tmp_path):
    file = write_campaign(tmp_path)
    for verb in ("plan", "check", "status"):
        found = command(verb, file)
        assert found.exit_code == 0 and "pid" not in found.output and "done:" not in found.output
    assert command("check", file).output.count("\n") == 1
    (obsid, chip), *_ = (job.key for job in OpenCampaign(file).jobs)
    failed = command("measure", file, "--obsid", obsid, "--chip", chip)
    assert failed.exit_code == 2 and read_usage(failed.output) is None
    first, error = failed.output.splitlines()
    assert FIRST.fullmatch(first)[1] == "measure" and error.startswith("csstsim: error: ")


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("out", [Terminal(), None])
def test_a_terminal_or_nobody_is_told_nothing(monkeypatch, out):
    monkeypatch.setattr("sys.stdout", out)
    with job_log("psf", "mini", "0123456789abcdef", "chip 9"):
        pass
    assert out is None or out.getvalue() == ""


def test_each_part_of_a_job_has_a_line_that_is_not_the_last(capsys):
    for chip in (8, 29):
        with part_log("chip", chip):
            sum(range(10**6))
    with pytest.raises(ValueError), part_log("chip", 30):
        raise ValueError
    said = capsys.readouterr().out
    assert parts(said).keys() == {8, 29} and read_usage(said) is None


def test_took_reads_the_last_line_and_nothing_else():
    line = "render done: 12.3 s, CPU 11.9 s, memory 1733 MB"
    assert read_usage(f"csstsim 0.1.0 render: ...\nrender: 12.3 s, 11.9 CPU-s\n{line}\n") == JobUsage(
        12.3, 11.9, 1733.0
    )
    for text in ("", "render: 12.3 s, 11.9 CPU-s", line[:-1], f"x{'9' * 400} done: 1 s", line.replace("12.3", "1.2.3")):
        assert read_usage(text) is None


STATUS = "Name:\tpython\nVmPeak:\t 4096000 kB\nVmSize:\t 3072000 kB\nVmHWM:\t 2048000 kB\nVmRSS:\t 1024000 kB\n"
NO_PEAK = STATUS.replace("VmHWM", "VmHUM")


@pytest.mark.parametrize(
    ("status", "platform", "memory"),
    [(STATUS, "linux", 2000), (NO_PEAK, "linux", 3000), (None, "linux", 3000), (None, "darwin", 3)],
    ids=["peak", "no peak", "no file", "macOS"],
)
def test_the_memory_of_a_job_is_the_most_that_was_resident_at_a_time(monkeypatch, capsys, status, platform, memory):
    """In kB, as Linux says; where it does not, getrusage's: in kB, of macOS in bytes."""

    def opened(path):
        assert path == "/proc/self/status"
        if status is None:
            raise FileNotFoundError(path)
        return io.StringIO(status)

    monkeypatch.setattr(module, "open", opened, raising=False)
    monkeypatch.setattr(module.sys, "platform", platform)
    monkeypatch.setattr(module.resource, "getrusage", lambda who: SimpleNamespace(ru_maxrss=3_072_000))
    with job_log("render", "mini", "0123456789abcdef", "chip 9"):
        pass
    assert read_usage(capsys.readouterr().out).memory_mb == memory


def test_times_of_a_job_are_from_its_start_and_those_of_a_part_its_own(monkeypatch, capsys):
    wall, cpu = iter([100.0, 107.5, 120.0]), iter([20.0, 23.0, 31.0])
    clocks = SimpleNamespace(monotonic=lambda: next(wall), process_time=lambda: next(cpu))
    monkeypatch.setattr(module, "time", clocks)
    monkeypatch.setattr(module, "_START", 90.0)
    with job_log("render", "mini", "0123456789abcdef", "chip 9"), part_log("chip", 9):
        pass
    first, part, last = capsys.readouterr().out.splitlines()
    assert "campaign mini 01234567, chip 9, " in first and part == "chip 9 done: 7.5 s, CPU 3.0 s"
    assert last.startswith("render done: 30.0 s, CPU 31.0 s, memory ")
    again = read_usage(f"{last}\nrender done: 1.0 s, CPU 2.0 s, memory 3 MB\n")
    assert again == JobUsage(1.0, 2.0, 3.0), "an attempt after another"
