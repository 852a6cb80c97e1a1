"""A record whose code changed stays current where the toy run gives what it gave."""

import copy
import dataclasses

import pytest
import yaml
from support.evidence_probe import command, digests, made, pages, probe_in, record, renewal, run


@pytest.fixture
def probe(tmp_path, monkeypatch):
    yield from probe_in(tmp_path, monkeypatch)


TABLE = "| S/N | bias | CPU-s |\n|---|---|---|\n| 10 | {bias} | {time} |\n| 20 | 0.125 | 0.1 |"


def toy(value=1.25, seconds=3.0, bias="-0.0310 ± 0.0011", time="0.7", **more):
    """What a toy run writes: a value, a time, a table with a column of times, and lines that a function prints."""
    return {
        "values": {"a": {"value": value, "what": "a"}, "t": {"value": seconds, "what": "t", "unit": "CPU-s/chip"}},
        "tables": {"by_snr": TABLE.format(bias=bias, time=time), "lines": f"worst 0.5 px in {time} seconds"},
    } | more


def test_what_differs_from_run_to_run_and_what_is_a_time_is_not_kept():
    kept = renewal.steady(toy(), toy(time="0.8"))
    assert kept["values"] == {"a": 1.25, "t": None} and kept["skipped"] == []
    assert kept["tables"]["by_snr"] == TABLE.format(bias="-0.0310 ± 0.0011", time="*").replace("| 0.1 |", "| * |")
    assert kept["tables"]["lines"] == "worst 0.5 px in * seconds"
    assert renewal.steady(toy(), toy(value=1.26))["values"]["a"] is None
    assert renewal.steady(toy(), toy(tables={"by_snr": "| S/N |\n|---|"}))["tables"] == {"by_snr": None, "lines": None}


CHANGES = {
    "nothing": ({}, 0),
    "times": ({"seconds": 9.0, "time": "11.2"}, 0),
    "the last bits": ({"value": 1.25000001}, 0),
    "a value by 0.1%": ({"value": 1.25125}, 1),
    "a value that is text": ({"value": "nan"}, 1),
    "a number of a table": ({"bias": "-0.0311 ± 0.0011"}, 1),
    "an error of a table": ({"bias": "-0.0310 ± 0.0012"}, 1),
    "a sign of a table": ({"bias": "0.0310 ± 0.0011"}, 1),
    "a word more": ({"bias": "-0.0310 ± 0.0011 mag"}, 1),
    "a part left out": ({"skipped": ["a peer"]}, 1),
    "a table that is gone": ({"tables": {"by_snr": TABLE.format(bias="-0.0310 ± 0.0011", time="2")}}, 1),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_moved_is_seen_and_times_are_not(change):
    changes, lines = CHANGES[change]
    kept = renewal.steady(toy(), toy(time="0.8"))
    found = renewal.moved(kept, renewal.steady(toy(**changes), toy(**changes)))
    assert len(found) == lines, found


def test_a_value_more_or_less_is_seen():
    kept = renewal.steady(toy(), toy())
    other = copy.deepcopy(kept)
    other["values"]["b"] = other["values"].pop("a")
    assert renewal.moved(kept, other) == ["a: no longer among its values", "b: not yet among its values"]


def changed_code(probe):
    """Put a change into the script; empty what is known of it."""
    path = probe / "probe.py"
    path.write_text(path.read_text() + "OTHER = 1\n")
    digests()
    for known in (pages.record, pages.is_stale, pages._is_renewed):
        known.cache_clear()


def recorded(probe, monkeypatch):
    made(probe, monkeypatch, a=(7.0, {}), t=(2.0, {"unit": "CPU-s"}))
    runs = iter([toy(), toy(time="0.8")])
    assert renewal.keep_toy(command(), lambda: next(runs)) == ""
    changed_code(probe)
    assert renewal.stale_parts(command(), record.read("probe")) == ["benchmarks/probe.py"]


def test_a_record_is_renewed_by_the_same_values_and_its_times_are_marked(probe, monkeypatch):
    recorded(probe, monkeypatch)
    assert renewal.renew(command(), toy(time="9"), pytest.fail) == []
    content = record.read("probe")
    assert set(content["renewed"]) == {"commit", "date", "digest"} and content["values"]["a"]["value"] == 7
    assert renewal.stale_parts(command(), content) == []
    pages.record.cache_clear()
    assert pages.for_site("[0](../benchmarks/records/probe.yaml#a)", "measure") == "[7](evidence.md#probe)"
    assert pages.for_site("[0](../benchmarks/records/probe.yaml#t)", "measure") == "[2†](evidence.md#probe)"
    changed_code(probe)
    assert renewal.stale_parts(command(), content) == ["benchmarks/probe.py"]


def test_other_values_leave_a_record_stale(probe, monkeypatch):
    recorded(probe, monkeypatch)
    before = record.read("probe")
    assert renewal.renew(command(), toy(value=1.3), lambda: toy(value=1.3)) == ["a: 1.25 then, 1.3 now"]
    assert record.read("probe") == before


def test_a_word_of_a_table_may_vary_and_a_value_may_not(probe, monkeypatch):
    recorded(probe, monkeypatch)
    before = record.read("probe")
    lines = renewal.renew(command(), toy(value=1.3), lambda: toy(value=1.4))
    assert lines == ["a: 1.25 then, another from run to run now"] and record.read("probe") == before
    kept = before["toy"]["tables"]["lines"]
    assert kept == "worst 0.5 px in * seconds"
    first, second = (toy() | {"tables": toy()["tables"] | {"lines": f"worst {n} px in 1 seconds"}} for n in (0.6, 0.7))
    assert renewal.renew(command(), first, lambda: second) == []
    assert "renewed" in record.read("probe")


def test_a_run_without_a_part_that_the_kept_one_has_is_not_compared(probe, monkeypatch):
    recorded(probe, monkeypatch)
    before = record.read("probe")
    assert renewal.renew(command(), toy(value=1.3, skipped={"a peer": "not installed"}), pytest.fail) is None
    assert record.read("probe") == before


def test_a_second_run_serves_all_records_that_share_it(probe, monkeypatch):
    recorded(probe, monkeypatch)
    twin = dataclasses.replace(command(), name="twin")
    record.store("twin", record.read("probe"))
    for name in ("probe", "twin"):
        path = record.path(name, toy=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.safe_dump(toy(value=1.3)))
    ran = []
    monkeypatch.setattr(run, "commands", lambda: {"probe": command(), "twin": twin})
    monkeypatch.setattr(run, "_toy", lambda one: ran.append(one.name) or toy(value=1.3))
    assert run._renewed(command()).count("a: 1.25 then, 1.3 now") == 2
    assert ran == ["probe"]


def test_a_record_of_code_that_did_not_change_is_not_written(probe, monkeypatch):
    made(probe, monkeypatch, a=(7.0, {}))
    assert renewal.renew(command(), toy(), pytest.fail) is None  # keeps no toy run yet
    assert renewal.keep_toy(command(), toy) == ""
    before = record.path("probe").stat().st_mtime_ns
    assert renewal.renew(command(), toy(), pytest.fail) == []
    assert record.path("probe").stat().st_mtime_ns == before


def test_times_alone_and_runs_that_failed_renew_nothing(probe, monkeypatch):
    made(probe, monkeypatch, a=(7.0, {}))
    times = {"values": {"t": {"value": 3.0, "what": "t", "unit": "s"}}, "tables": {"x": "worst of all"}}
    assert "times alone" in renewal.keep_toy(command(), lambda: times)
    assert "failed" in renewal.keep_toy(command(), lambda: None)
    assert "toy" not in record.read("probe")


@pytest.mark.parametrize("unit", ["CPU-s", "CPU-ns", "s", "us", "s/chip", "GB"])
def test_units_of_time_and_memory(unit):
    assert renewal.is_time(unit)


@pytest.mark.parametrize("unit", ["", "sigma", "mag", "mas", "uas", "e-/s/px", "million", "1e-4", "noise of the sky"])
def test_units_of_the_sky(unit):
    assert not renewal.is_time(unit)


@pytest.mark.parametrize("head", ["S/N", "sky [e-/s]", "s/n", "masses", "sigma"])
def test_a_column_that_is_none_of_times_is_kept(head):
    table = {"values": {}, "tables": {"x": f"| {head} |\n|---|\n| 1.5 |"}}
    assert renewal.steady(table, table)["tables"]["x"].endswith("| 1.5 |")


@pytest.mark.parametrize("head", ["CPU-s", "a chip [s]", "ms", "memory, GB", "seconds", "times faster", "cost"])
def test_a_column_of_times_is_not_kept(head):
    table = {"values": {}, "tables": {"x": f"| {head} |\n|---|\n| 1.5 |"}}
    assert renewal.steady(table, table)["tables"]["x"].endswith("| * |")


@pytest.mark.parametrize(("head", "wanted"), [("GB", "*"), ("CPU s with calibration", "*"), ("detections", "1.5")])
def test_a_row_of_times_or_memory_is_not_kept(head, wanted):
    table = {"values": {}, "tables": {"x": f"|  | one |\n|---|---|\n| {head} | 1.5 |"}}
    assert renewal.steady(table, table)["tables"]["x"].endswith(f"| {head} | {wanted} |")


CELLS = {
    "3.0 s": "* s", "11.4 ms": "* ms", "1.3e-03 (0.0058 s)": "1.3e-03 * s)", "2 min, 4 rows": "* min, 4 rows",
    "150 s/px": "150 s/px", "0.5 mag": "0.5 mag", "12 samples": "12 samples",
}  # fmt: skip


@pytest.mark.parametrize("cell", CELLS)
def test_the_number_of_a_time_in_a_cell_is_not_kept(cell):
    table = {"values": {}, "tables": {"x": f"| what |\n|---|\n| {cell} |"}}
    assert renewal.steady(table, table)["tables"]["x"].endswith(f"| {CELLS[cell]} |")
