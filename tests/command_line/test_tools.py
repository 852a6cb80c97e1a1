"""What commands that are no stages hand on, and with which code they end."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from support.commands import command, done, refused
from support.mini_campaign import POINTINGS, write_campaign

from csstsim.command_line.doctor import machine, of_campaign
from csstsim.delivery import verify as delivery_verify
from csstsim.stages import shear as shear_stage


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A campaign with two variants."""
    variants = {"dim": {"catalog": {"mag_limit": 20.0}}, "plain": {"fidelity": "noise_free"}}
    return write_campaign(tmp_path_factory.mktemp("tools"), POINTINGS[:1], variants=variants)


@pytest.mark.parametrize(("faulty", "code"), [((), 0), (("plain",), 1), ((None,), 1)])
def test_a_campaign_is_verified_with_its_variants(campaign, monkeypatch, faulty, code):
    seen = []

    def check(run, folder, log, manifest):
        seen.append((run.variant, folder, manifest))
        return 2 if run.variant in faulty else 0

    monkeypatch.setattr(delivery_verify, "verify", check)
    assert command("verify", campaign).exit_code == code
    assert seen == [(name, campaign, False) for name in (None, "dim", "plain")]


def test_manifests_are_followed_by_contents_if_nothing_is_wrong(campaign, monkeypatch):
    from csstsim.studies.compare import content

    made = []
    monkeypatch.setattr(content, "write_contents", lambda folder: made.append(folder) or folder / "C")
    for faults in (0, 1):
        monkeypatch.setattr(delivery_verify, "verify", lambda run, folder, log, manifest, faults=faults: faults)
        made.clear()
        assert command("verify", campaign, "--manifest").exit_code == faults
        output = campaign.parent / "out"
        assert made == ([] if faults else [output, output / "variants" / "dim", output / "variants" / "plain"])
    monkeypatch.setattr(delivery_verify, "verify", lambda *_: 0)
    done("verify", campaign)
    assert made == []


def test_a_folder_is_verified_by_itself(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(delivery_verify, "verify", lambda *given: seen.append(given[:2]) or 0)
    done("verify", tmp_path)
    assert seen == [(None, tmp_path)]
    assert command("verify", tmp_path, "--output", tmp_path).exit_code == 2


@pytest.mark.parametrize(("good", "strict", "code"), [(True, True, 0), (False, False, 0), (False, True, 1)])
def test_shear_ends_with_1_only_if_it_is_strict(monkeypatch, good, strict, code):
    seen = []
    monkeypatch.setattr(shear_stage, "shear", lambda files, output, log: seen.append((files, output)) or good)
    found = command("shear", "a.yaml", "b.yaml", "--output", "x.json", *(["--strict"] if strict else []))
    assert found.exit_code == code and seen == [(("a.yaml", "b.yaml"), "x.json")]


@pytest.fixture
def idle_bench(monkeypatch):
    """Let `bench` do no work; return the list of the functions that it has called."""
    called = []
    for name in ("command.bench", "command.chart", "readout.layers.readout"):
        monkeypatch.setattr(f"csstsim.studies.bench.{name}", lambda *given, name=name, **named: called.append(name))
    return called


@pytest.mark.parametrize("way", [["--readout"], ["--chart", "a.csv"]])
@pytest.mark.parametrize("other", [["--quick"], ["--methods", "x"], ["--objects", "4"], ["--shapes"]])
def test_bench_refuses_choices_of_objects_where_none_are_drawn(idle_bench, way, other):
    assert command("bench", *way, *other).exit_code == 2 and idle_bench == []
    assert command("bench", *other).exit_code == 0 and idle_bench == ["command.bench"]


@pytest.mark.parametrize("options", [
    ["--readout", "--chart", "a.csv"], ["--mcti", "M"], ["--chart", "a.csv", "--mcti", "M"], ["--objects", "1"],
    ["--objects", "100001"], ["--seed", "-1"],
])  # fmt: skip
def test_bench_refuses_what_does_not_go_together(idle_bench, options):
    assert command("bench", *options).exit_code == 2 and idle_bench == []


def test_bench_has_three_ways(monkeypatch):
    """Each function gets its arguments in their places."""
    seen = []
    for name in ("command.bench", "command.chart", "readout.layers.readout"):
        monkeypatch.setattr(
            f"csstsim.studies.bench.{name}", lambda *given, name=name, **named: seen.append((name, given, named))
        )
    say = {"log": print}
    for options, wanted in (
        ((), ("command.bench", ("results/bench", "r", None, False, None, 1), say | {"shapes": False})),
        (("--objects", 2, "--seed", 0, "--quick", "--filter", "i", "--methods", "a", "--output", "o"),
         ("command.bench", ("o", "i", "a", True, 2, 0), say | {"shapes": False})),
        (("--objects", 100_000, "--shapes"),
         ("command.bench", ("results/bench", "r", None, False, 100_000, 1), say | {"shapes": True})),
        (("--chart", "a.csv", "--output", "o"), ("command.chart", ("o", ("a.csv",)), say)),
        (("--readout", "--mcti", "M"), ("readout.layers.readout", (Path("results/bench"),), say | {"mcti": "M"})),
        (("--readout", "--output", "o"), ("readout.layers.readout", (Path("o"),), say | {"mcti": None})),
    ):  # fmt: skip
        done("bench", *options)
        assert seen.pop() == wanted and not seen


@pytest.mark.parametrize(("differing", "code"), [(0, 0), (1, 1), (3, 1)])
def test_frames_and_folders_that_differ_end_with_1(monkeypatch, differing, code):
    seen = []
    monkeypatch.setattr("csstsim.studies.compare.compare.compare", lambda *given: seen.append(given) or differing)
    monkeypatch.setattr(
        "csstsim.studies.recreate.side_by_side.side_by_side", lambda *given: seen.append(given) or differing
    )
    for options in ((), ("--provenance",), ("--truth", "t.cat"), ("--truth", "t.cat", "--instrument", "cam")):
        assert command("compare", "before", "after", *options).exit_code == code
    assert seen == [
        ("before", "after", print, False), ("before", "after", print, True), ("before", "after", "t.cat", print, None),
        ("before", "after", "t.cat", print, "cam"),
    ]  # fmt: skip


def test_status_is_shown_once_or_watched(campaign, tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(
        "csstsim.campaign.running.status.show", lambda run, watch, log: seen.append((run.paths.output, watch, log))
    )
    done("status", campaign)
    done("status", campaign, "--watch", 86400, "--output", tmp_path)
    assert seen == [(campaign.parent / "out", None, print), (tmp_path, 86400, print)]
    for seconds in (0, 86401):
        assert command("status", campaign, "--watch", seconds).exit_code == 2


def test_status_that_is_ended_by_hand_ends_with_130(campaign, monkeypatch):
    def interrupted(*given, **named):
        raise KeyboardInterrupt

    monkeypatch.setattr("csstsim.campaign.running.status.show", interrupted)
    assert command("status", campaign, "--watch", 1).exit_code == 130


@pytest.mark.parametrize(("about", "line"), [(None, "(no docstring)"), ("Glints.\n\nOf any kind.", "Glints.")])
def test_a_layer_of_ones_own_keeps_the_case_of_its_path(monkeypatch, about, line):
    own = SimpleNamespace(
        __doc__=about, STAGE="render", UNITS=("electron", "DN"), Param=SimpleNamespace(model_fields={})
    )
    monkeypatch.setattr("csstsim.simulation.sim_steps.load_layer", lambda name: own)
    assert done("layers", "myLab.Glint", "GLINT") == "".join(
        f"{name}  [render, electron -> DN]\n    {line}\n" for name in ("myLab.Glint", "glint")
    )


def test_layers_are_listed_with_their_stage_units_and_parameters():
    said = done("layers", "Gain", "bias")
    assert "gain  [readout, electron -> DN]\n" in said and "bias  [readout, electron -> electron]\n" in said
    assert "      gain_16channel = True: " in said and "Keywords are those" not in said
    assert done("layers").startswith("Keywords are those of the paper")
    assert "nosuch" in refused("layers", "nosuch")


@pytest.mark.parametrize(("most", "verdict", "words"), [
    (1999, "ok", "a job of `render` takes up to 2 GB, 8 GB are free: enough for 4 at a time"),
    (2700, "warning", "snakemake --cores 2, not 4"), (8100, "problem", "end other programs"),
])  # fmt: skip
def test_memory_is_that_of_the_largest_job_on_each_core(monkeypatch, most, verdict, words):
    from csstsim.campaign.costs import Cost

    monkeypatch.setattr(of_campaign, "free_memory", lambda: 8e9)
    monkeypatch.setattr(of_campaign, "cores", lambda: 4)
    costs = {"select": {1: Cost(9.0, 300.0)}, "render": {1: Cost(1.0, 50.0), 2: Cost(1.0, float(most))},
             "chip": {1: Cost(1.0, 9e6)}}  # fmt: skip
    [found] = of_campaign.memory(costs)
    assert (found.verdict, found.what) == (verdict, "memory") and words in found.text


@pytest.mark.parametrize(("need", "made", "all_done", "verdict", "left"), [
    (9e9, 4e9, False, "ok", "5 GB"), (14e9, 4e9, False, "problem", "10 GB"), (9.5e9, 0.4e9, False, "warning", "9.1 GB"),
    (14e9, 4e9, True, "ok", "0 GB"), (1e9, 4e9, False, "ok", "0 GB"),
])  # fmt: skip
def test_disk_is_what_is_left_to_be_written(tmp_path, monkeypatch, need, made, all_done, verdict, left):
    monkeypatch.setattr(of_campaign, "free_disk", lambda folder: 9.9e9)
    [found] = of_campaign.output(tmp_path / "out", need, SimpleNamespace(done=all_done, disk=made))
    assert (found.verdict, found.what) == (verdict, "disk")
    assert found.text.startswith(f"{left} to be written to {tmp_path / 'out'}, 9.9 GB free")


@pytest.mark.parametrize(("value", "verdict"), [
    ("4", None), ("5", "warning"), ("0", "problem"), ("two", "problem"), ("2,8", None), ("8,2", "warning"),
    ("-1", "problem"),
])  # fmt: skip
def test_threads_beyond_the_cores_are_told(monkeypatch, value, verdict):
    for name in machine.THREADS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(machine, "cores", lambda: 4)
    monkeypatch.setenv("MKL_NUM_THREADS", value)
    *found, last = machine.threads()
    assert [one.verdict for one in found] == ([verdict] if verdict else [])
    assert last.text.startswith(f"4; MKL_NUM_THREADS={value.split(',')[0] if False else value}; ")
