"""`csstsim doctor`: a sound installation, and each kind of faulty one."""

import importlib.metadata
import json
import os
import subprocess
import sys
from types import SimpleNamespace

import numba
import pytest
from click.testing import CliRunner
from support.mini_campaign import write_campaign

from csstsim.base.process import shipped_kernels
from csstsim.campaign.costs import Cost, default_workflow, expected
from csstsim.campaign.opened import OpenCampaign
from csstsim.campaign.plan import plan
from csstsim.campaign.running.status import read_status, wanted
from csstsim.command_line import doctor
from csstsim.command_line.doctor import installation, machine, of_campaign
from csstsim.command_line.doctor.finding import OK, PROBLEM, WARNING
from csstsim.command_line.main import main


def found(check, *arguments):
    """Return [(verdict, what, text)] of a check."""
    return [(finding.verdict, finding.what, finding.text) for finding in check(*arguments)]


def test_a_good_installation(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(machine, "free_disk", lambda path: 50e9)
    monkeypatch.setattr(machine, "free_memory", lambda: 8e9)
    for name in machine.THREADS:
        monkeypatch.delenv(name, raising=False)
    said = CliRunner().invoke(main, ["doctor"])
    assert said.exit_code == 0, said.output
    lines = said.output.splitlines()
    assert all(line.startswith("ok ") for line in lines), said.output
    for what in ("csstsim", "libraries", "data", "numba cache", "cores", "disk", "memory"):
        assert sum(line.startswith(f"ok       {what}: ") for line in lines) == 1, what
    assert CliRunner().invoke(main, ["doctor", "-q"]).output == ""
    assert list(tmp_path.iterdir()) == []


def test_one_problem_ends_with_1_whatever_is_good_after_it(monkeypatch):
    """And it is all that -q prints; a warning alone ends with 0."""
    monkeypatch.setattr(machine, "free_disk", lambda path: 50e9)
    monkeypatch.setattr(machine, "free_memory", lambda: 8e9)
    monkeypatch.setattr(machine, "cores", lambda: 4)
    for name in machine.THREADS:
        monkeypatch.delenv(name, raising=False)
    for value, verdict, code in (("many", "problem", 1), ("5", "warning", 0)):
        monkeypatch.setenv("OMP_NUM_THREADS", value)
        said, quiet = (CliRunner().invoke(main, ["doctor", *words]) for words in ((), ("-q",)))
        lines = [line for line in said.output.splitlines() if " numba cache: " not in line]
        verdicts = [line.split()[0] for line in lines]
        assert said.exit_code == quiet.exit_code == code and verdicts[-1] == "ok" and verdicts.count(verdict) == 1
        assert [line for line in quiet.output.splitlines() if line in lines] == [lines[verdicts.index(verdict)]]


def test_a_good_campaign_leaves_no_trace(tmp_path):
    file = write_campaign(tmp_path)
    verdicts = found(of_campaign.of_campaign, file)
    assert [(verdict, what) for verdict, what, _ in verdicts] == [(OK, "campaign"), (OK, "disk"), (OK, "memory")]
    assert f"{len(OpenCampaign(file).jobs)} Level-0 files" in verdicts[0][2]
    assert not (tmp_path / "out").exists()


def test_a_bad_campaign(tmp_path):
    said = CliRunner().invoke(main, ["doctor", str(write_campaign(tmp_path, colour=1))])
    assert said.exit_code == 1 and "Traceback" not in said.output
    last = said.output.splitlines()[-1]
    assert last.startswith("problem  campaign: ") and all(word in last for word in ("colour", "README.md"))


def versions(monkeypatch, **changes):
    """Let importlib.metadata say other versions: None for a library that is not installed."""
    real = importlib.metadata.version

    def version(name):
        if name in changes and changes[name] is None:
            raise importlib.metadata.PackageNotFoundError(name)
        return changes.get(name) or real(name)

    monkeypatch.setattr(importlib.metadata, "version", version)


def test_a_library_that_is_missing_old_or_broken(monkeypatch):
    versions(monkeypatch, sep=None, numpy="1.26.4")
    real = installation.importlib.import_module

    def broken(name):
        if name == "hpgeom":
            raise ImportError("numpy.core.multiarray\nfailed to import")
        return real(name)

    monkeypatch.setattr(installation.importlib, "import_module", broken)
    faults = {what: text for verdict, what, text in found(installation.libraries) if verdict == PROBLEM}
    assert set(faults) == {"library sep", "library numpy", "library hpgeom"}
    assert faults["library sep"].startswith("missing: pip install 'sep>=")
    assert "1.26.4" in faults["library numpy"] and "pip install 'numpy>=2" in faults["library numpy"]
    assert "multiarray failed to import" in faults["library hpgeom"]


def test_libraries_are_those_of_the_project_without_its_extras():
    names = {requirement.name for requirement in installation.requirements()}
    assert {"numpy", "click", "pyyaml"} <= names and not names & {"jplephem", "pytest"}


def test_what_a_check_did_not_think_of_is_a_problem(monkeypatch):
    def broken():
        raise ZeroDivisionError("nobody thought of it")
        yield

    monkeypatch.setattr(installation, "data", broken)
    findings = [finding for finding in doctor.examine() if finding.verdict == PROBLEM]
    assert [(f.what, f.text) for f in findings] == [("broken", "ZeroDivisionError: nobody thought of it")]


def cache_findings(**environment):
    """Return what the check of numba's cache says in a process of its own."""
    code = (
        "from csstsim.command_line.doctor.installation import numba_cache\n"
        "for f in numba_cache(): print(f.verdict, f.text)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | environment, capture_output=True, text=True, check=True
    )
    return done.stdout


def test_the_cache_that_is_asked_for_is_used_or_a_warning(tmp_path):
    assert cache_findings(NUMBA_CACHE_DIR=str(tmp_path)) == (
        f"ok {tmp_path}: nothing is compiled yet: the first runs take 90 CPU s longer\n"
    )
    (tmp_path / "file").write_text("no folder")
    said = cache_findings(NUMBA_CACHE_DIR=f"{tmp_path}/file")
    assert said.startswith(f"warning NUMBA_CACHE_DIR={tmp_path}/file cannot be used, ")


def test_compiled_code_that_comes_with_csstsim_is_counted_or_the_reason_against_it_said(tmp_path):
    about = {"versions": shipped_kernels.versions(), "features": [], "target": ["", "", ""], "functions": 242}
    (tmp_path / "about.json").write_text(json.dumps(about))
    here = {"NUMBA_CACHE_DIR": str(tmp_path), "CSSTSIM_KERNELS": str(tmp_path)}
    assert cache_findings(**here) == f"ok {tmp_path}: 0 compiled here; 242 come with csstsim\n"
    about["versions"]["numba"] = "0.1"
    (tmp_path / "about.json").write_text(json.dumps(about))
    said = cache_findings(**here).splitlines()
    assert "nothing is compiled yet" in said[0]
    assert said[1] == (
        f"ok compiled code that comes with csstsim is not used: numba is {numba.__version__}, it is for 0.1"
    )


def test_no_place_for_compiled_code_is_a_problem(tmp_path):
    (tmp_path / "file").write_text("no folder")
    only = "numba.core.caching.UserProvidedCacheLocator"  # as where neither the source nor the home can be written
    said = cache_findings(NUMBA_CACHE_DIR=f"{tmp_path}/file", NUMBA_CACHE_LOCATOR_CLASSES=only)
    assert said.startswith("problem cannot cache function") and "set NUMBA_CACHE_DIR" in said


def test_a_cache_that_cannot_be_written_any_more_is_a_problem(monkeypatch):
    monkeypatch.setattr(installation, "write_fault", lambda folder: "Read-only file system")
    [(verdict, _, text)] = found(installation.numba_cache)
    assert verdict == PROBLEM and "Read-only file system" in text and "NUMBA_CACHE_DIR" in text


def test_compiled_functions_are_counted(tmp_path):
    code = "import numpy as np; from csstsim.base.counter import object_keys; object_keys(np.uint64(1), np.arange(2))"
    environment = {"NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", code], env=os.environ | environment, check=True)
    assert cache_findings(**environment) == f"ok {tmp_path}: 1 compiled\n"


@pytest.mark.parametrize("disk, memory, verdicts", [(1e9, 8e9, [WARNING, OK]), (50e9, 2e9, [OK, WARNING])])
def test_little_room(monkeypatch, disk, memory, verdicts):
    monkeypatch.setattr(machine, "free_disk", lambda path: disk)
    monkeypatch.setattr(machine, "free_memory", lambda: memory)
    assert [verdict for verdict, *_ in found(machine.disk_and_memory)] == verdicts


def test_room_for_a_campaign(tmp_path, monkeypatch):
    run = OpenCampaign(write_campaign(tmp_path))
    need, status = sum(plan(run).disk.values()), read_status(run, wanted(run))
    for free, verdict in ((0.99 * need, PROBLEM), (1.05 * need, WARNING), (2 * need, OK)):
        monkeypatch.setattr(of_campaign, "free_disk", lambda path, free=free: free)
        assert [v for v, *_ in found(of_campaign.output, run.paths.output, need, status)] == [verdict]
    most = max(cost.memory_mb for jobs in expected(run).values() for cost in jobs.values()) * 1e6
    monkeypatch.setattr(of_campaign, "cores", lambda: 2)
    for free, verdict in ((0.9 * most, PROBLEM), (1.5 * most, WARNING), (2.1 * most, OK)):
        monkeypatch.setattr(of_campaign, "free_memory", lambda free=free: free)
        [(said, _, text)] = found(of_campaign.memory, expected(run))
        assert said == verdict and (verdict != WARNING or "snakemake --cores 1, not 2" in text)


def test_room_for_a_campaign_is_for_its_variants_too(tmp_path, monkeypatch):
    """Each makes frames of its own; what is there already is known."""
    file = write_campaign(tmp_path, variants={"one": {"seed": 4}, "two": {"seed": 5}})
    each = [sum(plan(OpenCampaign(f"{file}{name}")).disk.values()) for name in ("", "@one", "@two")]
    given = []

    def output(folder, need, status):
        given.append((folder, need, status.disk, status.done))
        return ()

    monkeypatch.setattr(of_campaign, "output", output)
    run = OpenCampaign(file)
    made = run.paths.level0(run.jobs[0])
    made.parent.mkdir(parents=True)
    made.write_bytes(b"0" * 2880)
    verdicts = found(of_campaign.of_campaign, file)
    assert given == [(run.paths.output, pytest.approx(sum(each), rel=1e-12), 2880, False)] and min(each) > 0
    assert [what for _, what, _ in verdicts] == ["campaign", "memory"]
    jobs = sum(map(len, default_workflow(expected(run)).values()))
    assert verdicts[0][2] == f"{file}: {len(run.jobs)} Level-0 files, {jobs} jobs"


def test_the_largest_job_may_be_that_of_a_variant(tmp_path, monkeypatch):
    """One of whole chips, of a campaign of small windows."""
    window = {"x0": 0, "x1": 16, "y0": 0, "y1": 16}
    file = write_campaign(tmp_path, window=window, variants={"whole": {"window": None}}, instrument=None)
    small, whole = (
        max(
            cost.memory_mb for jobs in default_workflow(expected(OpenCampaign(name))).values() for cost in jobs.values()
        )
        for name in (file, f"{file}@whole")
    )
    assert whole > 1.2 * small
    monkeypatch.setattr(of_campaign, "cores", lambda: 1)
    for free, verdict in ((1.1 * small, PROBLEM), (1.1 * whole, OK)):
        monkeypatch.setattr(of_campaign, "free_memory", lambda free=free: free * 1e6)
        assert [said for said, what, _ in found(of_campaign.of_campaign, file) if what == "memory"] == [verdict]


def test_what_is_on_disk_needs_no_room(tmp_path, monkeypatch):
    """Of 10 GB 4 GB are there: 6 GB are to be written; none once all is done, or if more is there than expected."""
    monkeypatch.setattr(of_campaign, "free_disk", lambda path: 6.5e9)
    for done, disk, verdict, left in (
        (False, 3e9, PROBLEM, 7e9),
        (False, 4e9, WARNING, 6e9),
        (False, 5e9, OK, 5e9),
        (False, 11e9, OK, 0),
        (True, 1e9, OK, 0),
    ):
        [(said, what, text)] = found(of_campaign.output, tmp_path, 10e9, SimpleNamespace(done=done, disk=disk))
        assert (said, what) == (verdict, "disk") and text.startswith(f"{machine.gb(left)} to be written to {tmp_path}")


def test_the_largest_job_of_all_rules_counts(monkeypatch):
    monkeypatch.setattr(of_campaign, "free_memory", lambda: 1e9)
    costs = {"render": {1: Cost(1.0, 100.0), 2: Cost(1.0, 400.0)}, "readout": {1: Cost(1.0, 300.0)}}
    assert "a job of `render` takes up to 0.4 GB" in found(of_campaign.memory, costs)[0][2]


def test_rules_that_are_not_run_do_not_count(monkeypatch):
    monkeypatch.setattr(of_campaign, "free_memory", lambda: 1e9)
    costs = {"render": {1: Cost(1.0, 100.0)}, "exposure": {1: Cost(1.0, 5000.0)}}
    assert "a job of `render` takes up to 0.1 GB" in found(of_campaign.memory, costs)[0][2]


def test_an_output_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("no folder")
    [(verdict, what, text)] = found(of_campaign.output, tmp_path / "file" / "out", 1e9, None)
    assert (verdict, what) == (PROBLEM, "output") and str(tmp_path / "file") in text and "Not a directory" in text


def test_threads(monkeypatch):
    for name in machine.THREADS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(machine, "cores", lambda: 4)
    assert [verdict for verdict, *_ in found(machine.threads)] == [OK]
    for value, verdict in (
        ("4", OK),
        ("5", WARNING),
        ("0", PROBLEM),
        ("", PROBLEM),
        ("many", PROBLEM),
        ("-1", PROBLEM),
    ):
        monkeypatch.setenv("OMP_NUM_THREADS", value)
        assert verdict in [said for said, *_ in found(machine.threads)], value


def test_memory_of_a_container_counts(monkeypatch):
    files = {
        "/proc/meminfo": ["MemTotal: 9 kB\n", "MemAvailable:    2000000 kB\n"], "/proc/self/cgroup": ["0::/job\n"],
        "/sys/fs/cgroup/job/memory.max": ["1500000000\n"], "/sys/fs/cgroup/job/memory.current": ["400000000\n"],
        "/sys/fs/cgroup/memory.max": ["max\n"],
    }  # fmt: skip
    monkeypatch.setattr(machine, "_lines", lambda path: files.get(str(path), []))
    assert machine.free_memory() == 1_100_000_000
    files["/sys/fs/cgroup/job/memory.max"] = ["max\n"]
    assert machine.free_memory() == 2_048_000_000
    files.clear()
    assert machine.free_memory() > 0


def test_data_that_are_not_there_are_a_problem(tmp_path, monkeypatch):
    monkeypatch.setattr("csstsim.base.shipped.SHIPPED", tmp_path)
    [fault] = [finding for finding in doctor.examine() if finding.verdict == PROBLEM]
    assert fault.what == "data" and str(tmp_path) in fault.text


def test_a_folder_that_fails_without_a_reason_of_the_system_is_not_writable(monkeypatch, tmp_path):
    def fail(dir):
        raise OSError("quota")

    monkeypatch.setattr(machine.tempfile, "TemporaryFile", fail)
    assert machine.write_fault(tmp_path) == "quota"
