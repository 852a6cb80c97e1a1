"""Records of measured figures: what makes one stale, what pages show, what is told when a figure moves."""

import argparse
import sys
from pathlib import Path

import numpy as np
import pytest
from support.evidence_probe import command, commands, dependencies, digests, listing, made, pages, probe_in, record, run

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def probe(tmp_path, monkeypatch):
    yield from probe_in(tmp_path, monkeypatch)


CHANGES = {
    "a comment": ("probe.py", "    return 1", "    # why\n    return 1", set()),
    "a docstring": ("probe.py", '    """Doc."""\n', '    """Other\n\n    words."""\n', set()),
    "an empty line": ("beside.py", "NAME", "\n\nNAME", set()),
    "a number": ("probe.py", "return 1", "return 1.01", {"benchmarks/probe.py"}),
    "a module that it imports": ("beside.py", "NAME", "OTHER = 1\nNAME", {"benchmarks/beside.py"}),
    "a data file that it names": ("numbers.yaml", "1", "2", {"benchmarks/numbers.yaml"}),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_makes_a_record_stale(probe, change):
    name, old, new, expected = CHANGES[change]
    before, path = digests(), probe / name
    assert set(before) == {f"benchmarks/{n}" for n in ("probe.py", "beside.py", "numbers.yaml")}
    path.write_text(path.read_text().replace(old, new, 1))
    digests()
    assert set(dependencies.changed(command(), before)) == expected


def test_imports_of_the_package_are_followed():
    astrometry = dependencies.depends(commands.commands()["astrometry"])
    assert {"benchmarks/astrometry.py", "csstsim.catalog", "csstsim.base"} == set(astrometry)
    flats = dependencies.depends(commands.commands()["flats"])  # SimSteps names layers, and the camera is data
    assert {"csstsim.layers", "csstsim.optics", "config/instrument", "config/observations"} <= set(flats)
    assert "csstsim.command_line" not in flats


def test_a_script_reaches_the_commands_that_it_names():
    chips = dependencies.depends(commands.commands()["chip_stages"])  # starts csstsim chip
    assert {"csstsim.command_line", "csstsim.detector", "csstsim.layers"} <= set(chips)
    assert not {"csstsim.studies.budget", "csstsim.studies.release", "csstsim.report", "Snakefile"} & set(chips)
    measured = dependencies.depends(commands.commands()["measure_chip"])  # names measure as well
    assert measured["csstsim.measure"] != chips["csstsim.measure"]
    everything = dependencies.depends(commands.commands()["slow_tests_base"])  # so does Snakemake
    assert {"csstsim.command_line", "csstsim.report", "Snakefile", "workflow/rules"} <= set(everything)


def test_what_other_code_made_is_removed(probe):
    half = probe.parent / "results" / "half" / "file"

    def after():
        half.parent.mkdir(parents=True, exist_ok=True)
        half.touch()
        digests()
        dependencies.remove_old(command(makes=("half",)))
        return half.exists()

    assert not after() and after()
    (probe / "beside.py").write_text("OTHER = 7\n")
    assert not after() and after()


def test_a_record_holds_values_goals_and_where_it_is_from(probe, monkeypatch, capsys):
    content = made(probe, monkeypatch, a=(1.23456789, {"error": 0.1, "unit": "mag", "below": 2}), n=(71758, {}))
    assert content["values"] == {
        "a": {"value": 1.23457, "what": "the a", "unit": "mag", "error": 0.1, "goal": "at most 2", "verdict": "pass"},
        "n": {"value": 71758, "what": "the n"},
    }
    assert content["command"] == "python benchmarks/probe.py" and content["cpu_seconds"] > 0
    assert content["depends"] == digests() and {"commit", "date", "machine"} <= set(content)
    assert "the a: 1.235 +- 0.1 mag (goal: at most 2; pass)" in capsys.readouterr().out


def test_what_is_not_the_command_is_not_recorded(probe, monkeypatch, capsys):
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed")
    monkeypatch.setattr(sys, "argv", [str(probe / "probe.py")])
    monkeypatch.chdir(probe.parent)
    with record.Record(parser, ["--seed", "3"]) as other:
        other.value("a", 1.0, "a")
    assert record.read("probe") is None and "not recorded" in capsys.readouterr().out
    with record.Record(argparse.ArgumentParser(), []) as other:
        other.skip("a peer", "not installed")
    assert record.read("probe") is None and "not recorded: a peer" in capsys.readouterr().out


def test_toy_size_judges_nothing_and_leaves_records_alone(probe, monkeypatch):
    assert made(probe, monkeypatch, "--toy", a=(float("nan"), {}), b=(5, {"below": 1})) is None
    assert record.read("probe", toy=True)["values"]["b"] == {"value": 5, "what": "the b", "goal": "at most 1"}


@pytest.mark.parametrize("goal", [{"below": 2}, {"above": 4}, {"goal": False}, {"goal": np.bool_(False)}])
def test_a_missed_goal_ends_with_exit_code_1_and_is_recorded(probe, monkeypatch, goal):
    with pytest.raises(SystemExit) as ended:
        made(probe, monkeypatch, a=(3.0, goal))
    assert ended.value.code == 1 and listing.verdict(record.read("probe")) == "fail"


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_figure_that_is_no_number_is_refused(probe, monkeypatch, value):
    with pytest.raises(ValueError, match="the a is"):
        made(probe, monkeypatch, a=(value, {}))
    assert record.read("probe") is None


FORMS = {
    "": "0.0012", ":.1g": "0.001", ":.2e": "1.23e-3", ":.1%": "0.1%", ":+.4f": "+0.0012", ":+-.4f": "0.0012 ± 0.0003",
    ":+-+.4f": "+0.0012 ± 0.0003", ":error:.4f": "0.0003",
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_a_page_shows_a_figure_in_its_form(probe, monkeypatch, form):
    made(probe, monkeypatch, a=(0.00123456, {"error": 0.0003}))
    link = f"(../benchmarks/records/probe.yaml#a{form})"
    faults = []
    assert pages.filled(f"within [1]{link} px", faults.append) == f"within [{FORMS[form]}]{link} px"
    assert not faults


def test_large_numbers_and_tables(probe, monkeypatch):
    made(probe, monkeypatch, n=(71758, {}), x=(14742.4, {}))
    assert pages.figure("probe", "n", None) == "71,758" and pages.figure("probe", "x", ":,.0f"[1:]) == "14,742"
    assert pages.figure("probe", "x", None) == "14,742"
    content = record.read("probe") | {"tables": {"t": "| a |\n|---|\n| 1 |"}}
    monkeypatch.setattr(pages, "record", lambda name, toy=False: content)
    text = "<!-- table probe.t -->\nold\n<!-- end table -->"
    assert pages.filled(text, print) == "<!-- table probe.t -->\n| a |\n|---|\n| 1 |\n<!-- end table -->"


def test_faults_of_pages_are_told(probe, monkeypatch):
    faults = []
    never = "[1](../benchmarks/records/probe.yaml#a)"
    assert pages.filled(never, faults.append) == never and not faults  # was never recorded
    made(probe, monkeypatch, a=(1.0, {}))
    for page in ("[1](benchmarks/records/probe.yaml#b)", "[1](benchmarks/records/other.yaml#a)",
                 "[1](benchmarks/records/probe.yaml#a:q)", "[1](benchmarks/records/probe.yaml#a:+-.2f)"):  # fmt: skip
        assert pages.filled(page, faults.append) == page and faults.pop()


def test_the_site_leads_to_the_command_and_marks_what_is_stale(probe, monkeypatch):
    made(probe, monkeypatch, a=(1.0, {}))
    text = "[0](../benchmarks/records/probe.yaml#a)"
    assert pages.for_site(text, "measure") == "[1](evidence.md#probe)"
    assert pages.for_site(text, "tutorials/shear") == "[1](../evidence.md#probe)"
    path = probe / "probe.py"
    path.write_text(path.read_text().replace("return 1", "return 2"))
    digests()
    pages.is_stale.cache_clear()
    assert pages.for_site(text, "measure") == "[1†](evidence.md#probe)"
    said = "\n".join(listing._section(command(), ["docs/measure.md"]))
    assert "Stale: changed since are `benchmarks/probe.py`" in said and "| the a | 1  |" in said


def test_what_moved_is_told_and_what_turned():
    def of(value, **more):
        return {"values": {"a": {"value": value, "what": "the a"} | more}, "tables": {}}

    assert run.moved(of(1.0, error=0.1), of(1.1, error=0.1)) == []
    assert run.moved(of(1.0, error=0.1), of(1.2, error=0.1)) == ["the a: 1.0 to 1.2 "]
    assert run.moved(of(1.0), of(1.0001)) == [] and run.moved(of(1.0), of(1.01))
    assert run.moved(of(1.0, unit="CPU-s"), of(1.15, unit="CPU-s")) == []
    assert run.moved(of(1.0, verdict="pass"), of(1.0, verdict="fail")) == ["the a: 1.0 to 1.0  (pass to fail)"]
    tables = {"values": {}, "tables": {"t": "| 1 |"}}, {"values": {}, "tables": {"t": "| 2 |"}}
    assert "1 rows differ" in run.moved(*tables)[0]


def test_commands_wait_for_what_they_read(monkeypatch):
    costs = {"cheap": 1.0, "dear": 100.0, "reader": 0.1}
    monkeypatch.setattr(run, "read", lambda name: {"cpu_seconds": costs.get(name, 1.0), "date": "2026-01-01"})
    chosen = [command("dear"), command("reader", after=("dear",)), command("cheap")]
    assert [each.name for each in run.order(chosen)] == ["cheap", "dear", "reader"]
    with pytest.raises(SystemExit, match="wait for each other"):
        run.order([command("a", after=("b",)), command("b", after=("a",))])


def test_every_command_is_a_script_with_a_record_and_no_script_is_left_out():
    known = commands.commands()
    for each in known.values():
        text = (ROOT / each.script).read_text()
        assert "Record(" in text, f"{each.script} writes no record"
        assert each.full.startswith("python benchmarks/") and set(each.after) <= set(known), each.name
    scripts = {each.script for each in known.values()}
    texts = {path: path.read_text() for path in sorted((ROOT / "benchmarks").glob("*.py"))}
    for path, text in texts.items():  # a script that another one starts has no record of its own
        started = any(path.name in other for file, other in texts.items() if file != path)
        if "__main__" in text and not started:
            assert f"benchmarks/{path.name}" in scripts, f"{path.name} is not in commands.yaml"


def test_a_command_knows_its_own_call_and_folders(monkeypatch):
    monkeypatch.chdir(ROOT)
    one = commands.Command("cti", "", "python benchmarks/cti.py --mcti MCTI", folders={"MCTI": "a checkout"})
    assert one.is_run_by(["benchmarks/cti.py", "--mcti", "/somewhere"], toy=False)
    assert not one.is_run_by(["benchmarks/cti.py"], toy=False) and not one.is_run_by(
        ["cti.py", "--mcti", "x"], toy=False
    )
    assert one.words({"MCTI": "/x"}) == ["python", "benchmarks/cti.py", "--mcti", "/x"]
    assert one.lacks({}) == ["folder MCTI: a checkout"] and one.lacks({"MCTI": "/x"}) == []
    assert command(modules=("no_such_module",), programs=("no-such-program",)).lacks({}) == [
        "Python module no_such_module", "program no-such-program",
    ]  # fmt: skip
