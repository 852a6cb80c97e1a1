"""What the options of a command, and their defaults, come to be: arguments of the function that does the work.

Each line gives every option another value than its default, and once none of them.
"""

import importlib
import inspect
from dataclasses import asdict
from pathlib import Path

import click
import pytest
from support.commands import command, done
from support.mini import mini_camera
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.opened import OpenCampaign
from csstsim.report.quicklook.show import ShowOptions
from csstsim.studies.budget.redshift import report as redshift_report


@pytest.fixture
def handed(monkeypatch):
    """Return a function that runs a command line and returns what it gave to `module:function`, {parameter: value}."""

    def run(target, *words, result=None):
        module, name = target.split(":")
        module = importlib.import_module(f"csstsim.{module}")
        real, seen = getattr(module, name), []

        def instead(*given, **named):
            seen.append(inspect.signature(real).bind(*given, **named))
            return result

        with monkeypatch.context() as patch:
            patch.setattr(module, name, instead)
            done(*words)
        [bound] = seen
        bound.apply_defaults()
        found = dict(bound.arguments)
        for parameter in bound.signature.parameters.values():
            if parameter.kind is inspect.Parameter.VAR_KEYWORD:
                found |= found.pop(parameter.name)
        return found

    return run


@pytest.fixture
def idle(monkeypatch):
    """Let no command do its work: only its options can be refused."""
    for name in (
        "inject.inject.inject",
        "inject.place.place",
        "studies.budget.shear.command.budget",
        "studies.budget.shear.blind.blind",
        "studies.budget.shear.blind.reveal",
        "studies.release.score.score.score",
        "campaign.starter.init",
        "studies.compare.compare.compare",
        "studies.recreate.side_by_side.side_by_side",
    ):
        module, function = name.rsplit(".", 1)
        monkeypatch.setattr(importlib.import_module(f"csstsim.{module}"), function, lambda *given, **named: 0)


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    return write_campaign(tmp_path_factory.mktemp("handed"), POINTINGS[:1])


def test_inject(handed):
    least = handed("inject.inject:inject", "inject", "a.fits", "b.fits", "--catalogue", "c.csv", "--output", "o")
    wanted = {
        "frames": ("a.fits", "b.fits"), "table": "c.csv", "folder": "o", "campaign": None, "instrument": None,
        "realisation": 1, "light_curves": None, "psf": None, "zeropoint": None, "log": click.echo,
    }  # fmt: skip
    assert {name: least[name] for name in wanted} == wanted
    most = handed(
        "inject.inject:inject", "inject", "a.fits", "--catalogue", "c.csv", "--output", "o", "--campaign", "y.yaml",
        "--instrument", "cam", "--realisation", 0, "--light-curves", "l.csv", "--psf", "p.psf", "--zeropoint", 25.5,
    )  # fmt: skip
    wanted |= {
        "frames": ("a.fits",), "campaign": "y.yaml", "instrument": "cam", "realisation": 0, "light_curves": "l.csv",
        "psf": "p.psf", "zeropoint": 25.5,
    }  # fmt: skip
    assert {name: most[name] for name in wanted} == wanted


@pytest.mark.parametrize(("options", "changed"), [
    ((), {}), (("--min-separation", 7), {"min_separation": 7.0}), (("--grid", 1), {"spacing": 1.0}),
    (("--seed", 0), {"seed": 0}), (("--near", "k.csv"), {"near": "k.csv"}),
    (("--near", "k.csv", "--distance", 0.25, 3), {"near": "k.csv", "distance": (0.25, 3.0)}),
    (("--campaign", "y", "--instrument", "cam"), {"campaign": "y", "instrument": "cam"}),
    (("--apart", 7), {"min_separation": 7.0}), (("--beside", "k.csv"), {"near": "k.csv"}),  # earlier spellings
])  # fmt: skip
def test_place(handed, options, changed):
    found = handed("inject.place:place", "place", "f.fits", "t.csv", "--output", "o.csv", *options)
    wanted = {
        "frame": "f.fits", "objects": "t.csv", "target": "o.csv", "spacing": None, "min_separation": 0.0, "near": None,
        "distance": (0.5, 2.0), "seed": 1, "campaign": None, "instrument": None,
    } | changed  # fmt: skip
    found |= asdict(found["placement"])
    assert {name: found[name] for name in wanted} == wanted


@pytest.mark.parametrize("options", [
    ("--grid", 9, "--min-separation", 9), ("--grid", 9, "--near", "k"), ("--min-separation", 0, "--near", "k"),
    ("--grid", 0.5), ("--distance", 1, 2), ("--distance", 1, 2, "--grid", 9), ("--min-separation", -1),
    ("--near", "k", "--distance", -1, 2), ("--grid", "nan"), ("--seed", -1), ("--apart", 0, "--near", "k"),
])  # fmt: skip
def test_options_of_place_exclude_each_other(idle, options):
    assert command("place", "f.fits", "t.csv", "--output", "o.csv", *options).exit_code == 2


@pytest.mark.parametrize("options", [
    ("--zeropoint", 51), ("--zeropoint", -1), ("--zeropoint", "inf"), ("--realisation", -1),
])  # fmt: skip
def test_numbers_of_an_injection_have_a_range(idle, options):
    found = command("inject", "f.fits", "--catalogue", "c", "--output", "o", *options)
    assert found.exit_code == 2 and options[0] in found.output


def test_recover(handed):
    names = "injected", "original", "output", "campaign", "instrument", "truth"
    found = handed("inject.recovery.recover:recover", "recover", "i.fits", "o.fits")
    assert [found[name] for name in names] == ["i.fits", "o.fits", None, None, None, None]
    given = "--output", "out", "--campaign", "y", "--instrument", "cam", "--truth", "t.parquet"
    found = handed("inject.recovery.recover:recover", "recover", "i.fits", "o.fits", *given)
    assert [found[name] for name in names] == ["i.fits", "o.fits", "out", "y", "cam", "t.parquet"]


def test_budget_of_shear(handed):
    run = "studies.budget.shear.command:budget"
    signature = list(handed(run, "budget", "shear").values())
    assert signature[:2] == [None, "results/budget_shear"]
    wanted = {"only_plan": False, "fields": None, "samples": None, "effects": None, "estimators": None}
    found = handed(run, "budget", "shear")
    assert {name: found[name] for name in wanted} == wanted
    found = handed(
        run, "budget", "shear", "p.yaml", "--output", "o", "--plan", "--fields", 2, "--samples", "a, b", "--effects",
        "c", "--estimators", "hsm,own",
    )  # fmt: skip
    assert list(found.values())[:2] == ["p.yaml", "o"]
    wanted = {"only_plan": True, "fields": 2, "samples": ["a", "b"], "effects": ["c"], "estimators": ["hsm", "own"]}
    assert {name: found[name] for name in wanted} == wanted


def test_blind_and_reveal(handed):
    found = handed(
        "studies.budget.shear.blind:blind", "budget", "shear", "p.yaml", "--blind", "k.json", "--fields", 3, "--whole"
    )
    assert [*found.values()][:3] == ["p.yaml", "k.json", "results/budget_shear"]
    assert (found["count"], found["whole"]) == (3, True)
    found = handed("studies.budget.shear.blind:blind", "budget", "shear", "--blind", "k.json", "--output", "o")
    assert [*found.values()][:3] == [None, "k.json", "o"] and (found["count"], found["whole"]) == (None, False)
    found = handed(
        "studies.budget.shear.blind:reveal", "budget", "shear", "--reveal", "k.json", "a.csv", "--output", "o"
    )
    assert [value for value in found.values() if isinstance(value, str)] == ["k.json", "a.csv", "o"]


@pytest.mark.parametrize("options", [
    ("--blind", "k", "--reveal", "k", "a"), ("--blind", "k", "--plan"), ("--blind", "k", "--samples", "a"),
    ("--blind", "k", "--effects", "a"), ("--reveal", "k", "a", "--estimators", "own"), ("--whole",),
    ("--reveal", "k", "a", "--plan"), ("--reveal", "k", "a", "--whole"), ("--fields", 0),
])  # fmt: skip
def test_a_blind_test_goes_with_little_else(idle, options):
    assert command("budget", "shear", *options).exit_code == 2


def test_budget_of_redshift(campaign, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(redshift_report, "budget", lambda *given: seen.append(given))
    done("budget", "redshift", campaign)
    done(
        "budget", "redshift", campaign, "--also", campaign, "--also", campaign, "--spectra", "s", "--answer", "a.csv",
        "--band", "r", "--output", tmp_path,
    )  # fmt: skip
    (runs, *least), (all_runs, *most) = seen
    assert least == ["results/budget_redshift", None, None, "i", click.echo] and len(runs) == 1
    assert most == [str(tmp_path), "s", "a.csv", "r", click.echo]
    assert [run.file for run in all_runs] == [campaign] * 3


def test_release(handed, campaign):
    found = list(handed("studies.release.campaign_crate:campaign_crate", "release", "crate", campaign).values())
    assert isinstance(found[0], OpenCampaign) and found[1:] == [click.echo, (), "CC-BY-4.0"]
    words = "--author", "A. N. Other", "--author", "B", "--licence", "CC0-1.0"
    found = list(handed("studies.release.campaign_crate:campaign_crate", "release", "crate", campaign, *words).values())
    assert found[2:] == [("A. N. Other", "B"), "CC0-1.0"]
    found = list(handed("studies.release.pack:pack", "release", "pack", campaign, "--output", "o", *words).values())
    assert found[0].file == campaign and found[1:] == ["o", click.echo, ("A. N. Other", "B"), "CC0-1.0"]
    found = list(handed("studies.release.pack:pack", "release", "pack", campaign, "--output", "o").values())
    assert found[3:] == [(), "CC-BY-4.0"]


def test_score(handed):
    line = "release", "score", "c.cat", "--truth", "t", "--output", "o"
    found = list(handed("studies.release.score.score:score", *line).values())
    assert found == ["c.cat", "t", "o", click.echo, (), None, 0.3]
    more = "--map", "ra=A", "--map", "dec=B", "--band", "r", "--radius", 0.01
    found = list(handed("studies.release.score.score:score", *line, *more).values())
    assert found[4:] == [("ra=A", "dec=B"), "r", 0.01]


def test_init(handed):
    found = list(handed("campaign.starter:init", "init", "d").values())
    assert found == ["d", click.echo, None, None]
    assert list(handed("campaign.starter:init", "init", "d", "--catalogue", "c.csv").values())[2:] == ["c.csv", None]
    assert list(handed("campaign.starter:init", "init", "d", "--example", "lens").values())[2:] == [None, "lens"]


def test_aim(handed):
    found = handed("campaign.aiming:aim", "aim", "-1.5", "-2.25")
    wanted = {
        "ra": -1.5, "dec": -2.25, "output": None, "instrument": SHIPPED / "instrument", "chips": (), "filters": (),
        "pa": 0.0, "shifts": (), "times": (), "exptime": 150.0, "obsid": "10100000001",
    }  # fmt: skip
    assert {name: found[name] for name in wanted} == wanted
    found = handed(
        "campaign.aiming:aim", "aim", 10, 2, "--chip", 8, "--chip", 9, "--filter", "g", "--pa", -113.5,
        "--dither", 1, -2, "--dither", 3, 4, "--time", "t1", "--exptime", 60, "--obsid", "123456789",
        "--instrument", "cam", "--output", "o",
    )  # fmt: skip
    wanted |= {
        "ra": 10.0, "dec": 2.0, "output": "o", "instrument": "cam", "chips": (8, 9), "filters": ("g",), "pa": -113.5,
        "shifts": ((1.0, -2.0), (3.0, 4.0)), "times": ("t1",), "exptime": 60.0, "obsid": "123456789",
    }  # fmt: skip
    assert {name: found[name] for name in wanted} == wanted


def test_import_pointings(handed):
    target = "campaign.pointing_lists.import_pointings:import_pointings"
    found = handed(target, "import-pointings", "l.csv", "--output", "t.csv", result=0)
    wanted = {
        "path": "l.csv", "output": "t.csv", "like": None, "mapping": None, "maps": (), "sets": (), "pa_sense": None,
        "pa_zero": None, "pa_north": None, "directions": None, "first_obsid": None, "tolerance": None,
    }  # fmt: skip
    assert {name: found[name] for name in wanted} == wanted
    found = handed(
        target, "import-pointings", "l.csv", "--output", "t.csv", "--map", "ra=A", "--map", "dec=B", "--set", "pa=0",
        "--mapping", "m.yaml", "--pa-sense", "west", "--pa-zero", 90, "--pa-north", "galactic", "--directions", "icrs",
        "--first-obsid", "100000000", "--tolerance", 0.5, result=0,
    )  # fmt: skip
    wanted |= {
        "mapping": "m.yaml", "maps": ("ra=A", "dec=B"), "sets": ("pa=0",), "pa_sense": "west", "pa_zero": 90.0,
        "pa_north": "galactic", "directions": "icrs", "first_obsid": "100000000", "tolerance": 0.5,
    }  # fmt: skip
    assert {name: found[name] for name in wanted} == wanted


def test_bench(handed):
    least = list(handed("studies.bench.command:bench", "bench").values())
    assert least[:6] == ["results/bench", "r", None, False, None, 1] and least[6:] == [print, False]
    words = "--output", "o", "--quick", "--filter", "GV", "--methods", "a,b", "--objects", 2, "--seed", 0, "--shapes"
    most = list(handed("studies.bench.command:bench", "bench", *words).values())
    assert most[:6] == ["o", "GV", "a,b", True, 2, 0] and most[7] is True
    found = list(handed("studies.bench.command:chart", "bench", "--chart", "a.csv", "--chart", "b.csv").values())
    assert found[:2] == ["results/bench", ("a.csv", "b.csv")]
    found = handed("studies.bench.readout.layers:readout", "bench", "--readout", "--mcti", "M")
    assert next(iter(found.values())) == Path("results/bench") and found["mcti"] == "M"


def test_show(handed):
    found = handed("report.quicklook.show:show", "show", "f.fits", result="f.png")
    assert list(found.values()) == ["f.fits", None, ShowOptions()]
    found = handed(
        "report.quicklook.show:show", "show", "f.fits", "--output", "o.png", "--stretch", "log", "--limits", -1, 2.5,
        "--region", 1, 2, 3, 4, "--inset", 5, 6, 7, "--truth", "--truth-table", "t", "--limit", 3, "--size", 300,
        "--subtract-overscan", result="o.png",
    )  # fmt: skip
    options = ShowOptions(
        stretch="log", limits=(-1.0, 2.5), region=(1, 2, 3, 4), inset=(5, 6, 7), truth=True, truth_table="t", limit=3,
        size=300, subtract_overscan=True,
    )  # fmt: skip
    assert list(found.values()) == ["f.fits", "o.png", options]


def test_recreate_and_compare(handed):
    recreate = "studies.recreate.recreate:recreate"
    found = list(handed(recreate, "recreate", "f.fits", "t.cat", "--output", "o").values())
    assert found == ["f.fits", "t.cat", "o", click.echo, None, None]
    more = "--instrument", "cam", "--seed", 0
    assert list(handed(recreate, "recreate", "f.fits", "t.cat", "--output", "o", *more).values())[4:] == ["cam", 0]
    assert list(handed("studies.compare.compare:compare", "compare", "a", "b").values()) == ["a", "b", print, False]
    found = handed("studies.compare.compare:compare", "compare", "a", "b", "--provenance")
    assert list(found.values()) == ["a", "b", print, True]
    beside = "studies.recreate.side_by_side:side_by_side"
    found = handed(beside, "compare", "a", "b", "--truth", "t", "--instrument", "cam", result=0)
    assert list(found.values()) == ["a", "b", "t", print, "cam"]


@pytest.mark.parametrize("options", [(), ("--truth", "t")])
def test_a_difference_ends_with_1(monkeypatch, options):
    monkeypatch.setattr("csstsim.studies.compare.compare.compare", lambda *given: 3)
    monkeypatch.setattr("csstsim.studies.recreate.side_by_side.side_by_side", lambda *given: 2)
    assert command("compare", "a", "b", *options).exit_code == 1


def test_rows_that_were_refused_end_with_1(monkeypatch):
    module = importlib.import_module("csstsim.campaign.pointing_lists.import_pointings")
    for count, code in ((0, 0), (2, 1)):
        monkeypatch.setattr(module, "import_pointings", lambda *given, count=count, **named: count)
        assert command("import-pointings", "l.csv", "--output", "t.csv").exit_code == code


def test_status(handed, campaign, tmp_path):
    found = list(handed("campaign.running.status:show", "status", campaign).values())
    assert found[1:] == [None, print] and found[0].paths.output == campaign.parent / "out"
    found = handed("campaign.running.status:show", "status", campaign, "--watch", 7, "--output", tmp_path)
    found = list(found.values())
    assert found[1] == 7 and found[0].paths.output == tmp_path


def test_fit_grating(monkeypatch):
    seen = []
    monkeypatch.setattr("csstsim.optics.gratings.trace_fit.fit_file", lambda *given: seen.append(given) or "FIT")
    monkeypatch.setattr("csstsim.optics.gratings.trace_fit.fit_report", lambda fit: [fit, "two"])
    assert done("fit-grating", "s.csv", "--output", "G.conf") == "FIT\ntwo\n"
    done("fit-grating", "s.csv", "--output", "G.conf", "--sensitivity", "GI")
    assert seen == [("s.csv", "G.conf", None), ("s.csv", "G.conf", "GI")]


def test_export_grating(monkeypatch, camera, tmp_path):
    """Both gratings of a chip, each with its piece."""
    seen = []

    def write(*given):
        seen.append(given)
        return [Path(f"{given[1].name}.conf"), Path("more")], 2.5e-4

    monkeypatch.setattr("csstsim.instrument.grismconf.write_grismconf", write)
    said = done("export-grating", 2, "--output", tmp_path).splitlines()
    assert len(said) == len(seen) == 2 and all(line.endswith(".conf: wavelengths within 2.5e-04 px") for line in said)
    for (folder, grating, piece, chip, _), (own, where) in zip(seen, camera.gratings[2].pieces, strict=True):
        assert (folder, grating.name, piece, chip.id) == (str(tmp_path), own.name, where, 2)
    seen.clear()
    mini_camera(tmp_path, nx=128, ny=128, channel_nx=16, channel_ny=64)
    done("export-grating", 2, "--output", tmp_path, "--instrument", tmp_path / "instrument")
    assert len(seen) == 2 and {given[3].detector.nx for given in seen} == {128}
    found = command("export-grating", 9, "--output", tmp_path)
    assert found.exit_code == 2 and "CHIP: no gratings in front of this chip (got 9); allowed: 1, 2, 3" in found.output


def test_check_counts_the_chips_of_a_campaign_and_plan_opens_the_sky(campaign, monkeypatch):
    assert done("check", campaign) == f"{campaign}: good; 1 chip of 1 exposure\n"
    seen = []
    monkeypatch.setattr("csstsim.campaign.plan.print_plan", lambda run, sky: seen.append((run.file, sky)))
    monkeypatch.setattr(OpenCampaign, "open_truth", lambda run: seen.append("truth"))
    done("plan", campaign)
    done("plan", campaign, "--sky", "s.csv")
    assert seen == ["truth", (campaign, None), "truth", (campaign, "s.csv")]


@pytest.mark.parametrize(("words", "good"), [
    (("--radius", 0.01), True), (("--radius", 10), True), (("--radius", 0.009), False), (("--radius", 10.1), False),
    (("--radius", "nan"), False),
])  # fmt: skip
def test_the_reach_of_a_match_has_a_range(idle, words, good):
    line = "release", "score", "c.cat", "--truth", "t", "--output", "o"
    assert command(*line, *words).exit_code == (0 if good else 2)


@pytest.mark.parametrize(("words", "good"), [
    (("init", "d", "--example", "lens"), True), (("init", "d", "--example", "lens", "--catalogue", "c.csv"), False),
    (("compare", "a", "b", "--provenance"), True), (("compare", "a", "b", "--instrument", "cam"), False),
    (("compare", "a", "b", "--truth", "t", "--instrument", "cam"), True),
    (("compare", "a", "b", "--truth", "t", "--provenance"), False),
    (("place", "f", "t", "--output", "o", "--near", "k", "--distance", 0, 2), True),
    (("budget", "shear", "--blind", "k", "--whole"), True), (("budget", "shear", "--plan", "--samples", "a"), True),
    (("inject", "f", "--catalogue", "c", "--output", "o", "--zeropoint", 50), True),
])  # fmt: skip
def test_options_that_go_together_and_those_that_do_not(idle, words, good):
    assert command(*words).exit_code == (0 if good else 2)
