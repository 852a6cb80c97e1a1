"""The register: each gate is a complete record, and one record is all that a new gate needs."""

import re
import textwrap
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import make_docs
import pytest
from measure.bricks.fabricated_frame import PIX, make_frame
from measure.bricks.gate_results import at_most
from support.csst import BANDS

from csstsim.campaign.thresholds import ValidateConfig
from csstsim.measure.bricks.merge import merge_brick
from csstsim.measure.bricks.validation.gates import register, star_photometry
from csstsim.measure.bricks.validation.gates.register import all_gates, gate_named, of_exposures
from csstsim.measure.bricks.validation.validate import validate_brick
from csstsim.measure.bricks.validation.verdict import sentence, verdict_of_results

NEW = Path(__file__).with_name("new_gate")  # what docs/extension_points.md shows
NAME = "flux of stars over true, less 1"
NO_THRESHOLDS = {"snr_min", "galaxy_snr_min"}  # keys of the campaign that choose objects


def test_each_threshold_of_a_campaign_is_that_of_a_gate_and_the_other_way_round():
    keys = {gate.threshold for gate in all_gates()}
    assert keys == ValidateConfig.model_fields.keys() - NO_THRESHOLDS


def test_each_record_is_complete():
    assert len({(gate.name, gate.scope) for gate in all_gates()}) == len(all_gates())
    for gate in all_gates():
        bracket = re.search(r" \[(\w+)\]$", gate.name)
        assert bracket is None or bracket[1] == gate.unit, gate.name
        assert gate.tests and not gate.tests.endswith(".") and callable(gate.measure)
        assert gate_named(gate.name).threshold == gate.threshold
    with pytest.raises(KeyError, match="no such gate"):
        gate_named("no such gate")


def validated(frame):
    sources, _ = merge_brick(PIX, [frame.measured], BANDS)
    return validate_brick(PIX, sources, [frame], BANDS, ValidateConfig())[0]


def test_a_new_gate_is_one_record(monkeypatch):
    """It is evaluated, sorted into the verdict, and listed in docs/validation.md."""
    frame = make_frame("g", 5, scatter=3.0)
    before = [gate["name"] for gate in validated(frame)["gates"]]
    source = Path(star_photometry.__file__).read_text()
    measure, record = ((NEW / f"{name}.txt").read_text() for name in ("measure", "record"))
    assert source.count("\nGATES = (\n") == 1
    source = source.replace("\nGATES = (\n", f"\n{measure}\n\nGATES = (\n").rpartition("\n)\n")[0] + "\n"
    family = ModuleType("star_photometry", star_photometry.__doc__)
    exec(source + textwrap.indent(record, "    ") + ")\n", family.__dict__)
    families = [family if one is star_photometry else one for one in register.FAMILIES]
    monkeypatch.setattr(register, "FAMILIES", families)
    assert gate_named(NAME).threshold == 0.02 and NAME in make_docs.gates(make_docs.GATES.read_text())

    after = [gate["name"] for gate in validated(frame)["gates"]]
    place = after.index(NAME)
    assert after[:place] + after[place + 1 :] == before and after[place - 1] == "zero point of an exposure [mag]"
    brighter = replace(frame, measured=frame.measured.with_columns(flux_psf=1.055 * frame.measured["flux_psf"]))
    failing = [gate for gate in verdict_of_results([validated(brighter)])["gates"] if gate["passed"] is False]
    assert any(sentence(gate).startswith(f"brick {PIX}, exposure 1, chip 10: {NAME} in g is 0.05") for gate in failing)


def test_gates_of_exposures_are_kept_by_name_and_band():
    gates = [
        at_most(name, band, value, 0.1, 50)
        for name, band, value in (("a", "r", 0.05), ("a", "g", 0.2), ("b", "r", 0.08), ("a", "r", 0.06), ("b", "r", 0))
    ]
    assert of_exposures(gates) == [gates[3], gates[1], gates[2]]
    few = [at_most("a", "r", 0.5, 0.1, n) for n in (3, 7, None, 5)]
    assert of_exposures(few[:2] + few[3:]) == [few[1]]


def test_of_exposures_keeps_what_fails_else_the_nearest():
    def at(value, n=50, **where):
        return at_most("a", "r", value, 0.1, n, **where)

    good, better, bad, worse, few = at(0.09, exposure="1"), at(0.01), at(0.2, exposure="2"), at(0.3), at(0.5, n=3)
    assert of_exposures([good, bad, better, worse, few]) == [bad, worse]
    assert of_exposures([better, good, few]) == [good]
    assert of_exposures([few, at(None, n=0)]) == [few]
