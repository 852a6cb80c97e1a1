"""The list of layers: what is refused, what it asks of an exposure, and how a stage is run."""

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from pydantic import Field
from support.readout_state import POINTING

from csstsim.base.errors import BlockedError, InputError
from csstsim.instrument.pointing import Pointing
from csstsim.layers.param import LayerParam
from csstsim.simulation.exposure import Losses
from csstsim.simulation.sim_steps import SimSteps, Step, known_layers, load_layer

END = [{name: {}} for name in ("poisson_and_dark", "prescan_overscan", "gain", "quantization_and_output")]


class Options(LayerParam):
    """Options that any layer may have."""

    exptime: float | None = Field(None, description="s")
    field_dist: bool = Field(False, description="on")
    flat_fielding: bool = Field(False, description="on")
    shutter_effect: bool = Field(False, description="on")
    mask: bool = Field(False, description="on")
    amount: float = Field(1.0, description="electrons")


@pytest.fixture
def layer(monkeypatch, tmp_path):
    """Put a layer of one's own where a dotted path finds it."""
    monkeypatch.setitem(sys.modules, "lab", ModuleType("lab"))

    def put(name, stage="render", units=("electron", "electron"), **parts):
        module = ModuleType(f"lab.{name}")
        module.__file__ = str(tmp_path / f"{name}.py")
        (tmp_path / f"{name}.py").write_text("# a layer\n")
        for key, value in ({"STAGE": stage, "UNITS": units, "Param": Options, "apply": _add} | parts).items():
            setattr(module, key, value)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        return module.__name__

    return put


def _add(state, param, rng):
    state.seen.append((rng, param.amount))
    return state


def steps(*entries, kind=None):
    return SimSteps("list.yaml", kind, [*entries, *END])


def test_a_list_keeps_its_order_names_and_parameters(layer):
    name = layer("glint")
    found = steps({name: {"amount": 2.0}}, {name: None}, {name: {"amount": 3.0}})
    assert [step.name for step in found][:4] == ["lab.glint", "lab.glint#2", "lab.glint#3", "poisson_and_dark"]
    assert [step.param.amount for step in found.stage("render")] == [2.0, 1.0, 3.0]
    assert found.step("gain").keyword == "gain" and found.step("bias") is None and found.file == "list.yaml"
    assert found.describe()[0] == {"lab.glint": Options(amount=2.0).model_dump(mode="json")}
    stages = [[step.name for step in found.stage(stage)] for stage in ("render", "readout", "level0")]
    assert stages == [["lab.glint", "lab.glint#2", "lab.glint#3"], ["poisson_and_dark", "prescan_overscan", "gain"],
                      ["quantization_and_output"]]  # fmt: skip
    assert not found.shipped and steps().shipped


@pytest.mark.parametrize(("entries", "words"), [
    (["scie_obs", "Scie_OBS", *END], "layers.Scie_OBS: given twice"),
    (["bias_of_mine", *END], r"layers: unknown layer \(got 'bias_of_mine'\); allowed: bias, blooming"),
    (["led_calib_model", *END], r"layers.led_calib_model: does not belong .*\(got 'SCIE'\); allowed: FLAT"),
    (["poisson_and_dark", "sky_background", *END[1:]], "a layer of stage 'render' cannot follow one of "
     "stage 'readout'; allowed: render then readout then level0"),
    ([END[0], "gain", END[3]],
     r"layers.gain: works on the readout pixels, but the layers before it leave the active ones"),
    ([*END[:3], "bias", END[3]], r"layers.bias: takes electron, but the layers before it leave DN \(got 'bias'\)"),
    ([*END[:2], "blooming", *END[2:]], "works on the active pixels, but the layers before it leave the readout ones"),
    (["prnu_effect", "scie_obs", *END], "layers.prnu_effect: must come after scie_obs"),
    (["blooming", *END], "layers.blooming: must come after poisson_and_dark"),
    ([END[0], "cosmic_rays", *END[1:]], "layers.cosmic_rays: must be followed by poisson_and_dark"),
    (END[:1], "layers.prescan_overscan: a layer is missing"), (END[:2], "layers.gain: a layer is missing"),
    (END[:3], "layers.quantization_and_output: a layer is missing"),
    ([{"scie_obs": {"exptime": 30.0}}, {"sky_background": {"exptime": 31.0}}, *END],
     r"layers.sky_background: layers request different exposure times \(got 31.0\); allowed: one for all, or null"),
    ([{"scie_obs": {"flat_fielding": True}}, {"sky_background": {"flat_fielding": False}}, *END],
     r"layers.sky_background.flat_fielding: layers differ in flat_fielding \(got False\)"),
    ([{"scie_obs": {"shutter_effect": False}}, {"sky_background": {"shutter_effect": True}}, *END],
     r"layers.sky_background.shutter_effect: layers differ in shutter_effect \(got True\)"),
    ([END[0], {"bias": {"nosuch": 1}}, *END[1:]], r"list\.yaml: layers\.1\.bias\.nosuch"),
])  # fmt: skip
def test_a_list_that_cannot_be_run_is_refused_by_its_layer(entries, words):
    with pytest.raises(InputError, match=words):
        SimSteps("list.yaml", "SCIE", [{one: {}} if isinstance(one, str) else one for one in entries])


def test_a_layer_after_or_before_which_another_may_stand_asks_for_no_other():
    """Only layers of the list count, and one of those named behind is enough."""
    steps({"prnu_effect": {}}, kind="SCIE")
    steps({"scie_obs": {}}, {"sky_background": {}}, {"prnu_effect": {}}, {"cosmic_rays": {}}, kind="SCIE")
    steps({"led_calib_model": {}}, kind="FLAT")
    steps({"led_calib_model": {}}, {"prnu_effect": {}})


def test_layers_of_ones_own_state_what_stands_before_and_after_them(layer):
    first, behind = layer("first", BEFORE=("lab.behind", "bias")), layer("behind", AFTER=("lab.third", "lab.first"))
    assert len(list(steps({first: {}}, {behind: {}}))) == 6
    with pytest.raises(InputError, match=r"lab\.first: must be followed by lab\.behind or bias"):
        steps({first: {}})
    with pytest.raises(InputError, match=r"lab\.behind: must come after lab\.first"):
        steps({behind: {}}, {first: {}}, {behind: {}})


@pytest.mark.parametrize(("options", "losses", "mask", "distorted", "exptime"), [
    ([{}, {}], (False, False, False), False, False, None),
    ([{"flat_fielding": True}] * 2, (True, False, False), False, False, None),
    ([{"shutter_effect": True}] * 2, (False, True, False), False, False, None),
    ([{}, {"mask": True}], (False, False, False), True, False, None),
    ([{"field_dist": True}, {}], (False, False, False), False, True, None),
    ([{}, {"exptime": 0.0}], (False, False, False), False, False, 0.0),
    ([{"exptime": 7.5}, {"exptime": 7.5}], (False, False, False), False, False, 7.5),
])  # fmt: skip
def test_what_a_list_asks_of_an_exposure(layer, options, losses, mask, distorted, exptime):
    one, other = layer("one"), layer("other")
    found = steps({one: options[0]}, {other: options[1]})
    assert found.losses == Losses(*losses) and (found.mask, found.field_dist) == (mask, distorted)
    assert found.timed(Pointing(**POINTING)).exptime == (150.0 if exptime is None else exptime)


def test_an_exposure_of_no_time_is_a_bias(layer):
    name = layer("one")
    assert steps({name: {"exptime": 0.0}}, kind="BIAS").timed(Pointing(**POINTING)).exptime == 0.0
    with pytest.raises(InputError, match="exptime: zero exposure time"):
        steps({name: {"exptime": 0.0}}, kind="DARK")


def test_the_pixels_own_response_is_a_loss_of_its_layer():
    assert steps({"prnu_effect": {}}).losses == Losses(prnu=True)


def test_a_check_names_the_list_and_the_layer(layer):
    def check(param, camera, pointing):
        seen.append((param.amount, camera, pointing))
        if pointing in faults:
            raise faults[pointing]

    seen, faults = [], {"long": InputError("too long", key="amount"), "down": BlockedError("looks at the Earth")}
    found = steps({layer("checked", check=check): {"amount": 4.0}})
    found.check("a camera", "good")
    assert seen == [(4.0, "a camera", "good")]
    with pytest.raises(InputError, match=r"^list\.yaml: layers\.lab\.checked: amount: too long$") as refused:
        found.check("a camera", "long")
    assert refused.value.page == "config/README.md"
    with pytest.raises(BlockedError, match=r"^looks at the Earth$"):
        found.check("a camera", "down")


def test_a_digest_has_what_decides_the_pixels_up_to_its_stage(layer):
    """Which stages see a change: of a layer those from its own on; of the mask those after render."""
    own, late = layer("own"), layer("late", stage="level0", units=("DN", "DN"), Param=LayerParam)
    stages = "select", "render", "readout", "level0", "measure"

    def changed(one, other):
        return [stage for stage in stages if one.digest(stage) != other.digest(stage)]

    def listed(*render, end=(), **quantization):
        return SimSteps("a.yaml", None, [*render, *END[:3], *end, {"quantization_and_output": quantization}])

    sky, plain = {"sky_background": {"shutter_effect": False}}, {"sky_background": {}}
    assert changed(listed(plain), listed(plain)) == []
    assert changed(listed(plain), listed(sky)) == [*stages[1:]]
    assert changed(listed(plain), listed(plain, mask=True)) == [*stages[2:]]  # no layer that draws sees it
    assert changed(listed({own: {}}), listed({own: {}}, mask=True)) == [*stages[1:]]
    assert changed(listed(plain), listed(plain, layout="chip")) == ["level0", "measure"]
    assert changed(listed(plain), listed(plain, end=[{late: {}}])) == ["level0", "measure"]
    assert changed(listed({own: {}}), listed({own: {"field_dist": True}})) == [*stages]
    assert [listed(plain, end=[{late: {}}]).has_own(stage) for stage in stages] == [False, False, False, True, True]
    assert [listed({own: {}}).has_own(stage) for stage in stages] == [False, True, True, True, True]
    assert len(listed(plain).digest("render")) == 16


def test_another_text_of_ones_own_layer_is_another_digest(layer, tmp_path):
    own = layer("own")
    before = steps({own: {}})
    known = before.digest("render"), before.digest("select")
    (tmp_path / "own.py").write_text("# the same layer, otherwise\n")
    after = steps({own: {}})
    assert after.digest("render") != known[0] and after.digest("select") == known[1]


def test_a_stage_runs_its_layers_one_after_the_other(layer):
    """What each gets, what it leaves in the header, and its unit."""

    def state_more(state, param, rng):
        state.header |= {"width": 2, "angle": 1, "old": 7}
        return state

    one, other = layer("one"), layer("other", apply=state_more, units=("electron", "DN"))
    end = layer("end", stage="readout", units=("DN", "DN"))
    list_ = SimpleNamespace(seen=[], header={"old": 3, "own": ["before"]}, unit="electron")
    found = SimSteps("list.yaml", None, [{one: {"amount": 2.0}}, {one: {"amount": 5.0}}, *END])
    found.steps[1:1] = [step for step in unchecked(other, end)]
    state = found.run(list_, "render", SimpleNamespace(layer=lambda name: f"stream of {name}"))
    assert state.seen == [("stream of lab.one", 2.0), ("stream of lab.one#2", 5.0)] and state.unit == "electron"
    assert state.header["own"] == ["before", "angle", "width"] and state.header["old"] == 7
    assert [name for name, *_ in state.header["timing"]] == ["lab.one", "lab.other", "lab.one#2"]
    assert all(wall >= 0 and cpu >= 0 for _, wall, cpu in state.header["timing"])


def test_the_time_of_a_layer_is_wall_and_then_cpu_seconds(layer, monkeypatch):
    wall, cpu = iter([10.0, 13.0]), iter([2.0, 2.5])
    clocks = SimpleNamespace(perf_counter=lambda: next(wall), process_time=lambda: next(cpu))
    found = steps({layer("one"): {}})
    monkeypatch.setattr("csstsim.simulation.sim_steps.time", clocks)
    state = SimpleNamespace(seen=[], header={}, unit="electron")
    assert found.run(state, "render", SimpleNamespace(layer=str)).header["timing"] == [["lab.one", 3.0, 0.5]]


def unchecked(*names):
    """Steps that no list has checked."""
    return [Step(name, name, load_layer(name), Options()) for name in names]


def test_the_unit_is_what_the_last_layer_leaves(layer):
    found = steps()
    found.steps[:] = unchecked(layer("turns", units=("electron", "DN")))
    state = SimpleNamespace(seen=[], header={}, unit="electron")
    assert found.run(state, "render", SimpleNamespace(layer=str)).unit == "DN"
    assert state.header["own"] == []


@pytest.mark.parametrize(("fault", "notes"), [(ValueError("no"), ["in layer lab.bad"]), (InputError("no"), None)])
def test_a_fault_in_a_layer_names_it(layer, fault, notes):
    def fail(state, param, rng):
        raise fault

    found = steps({layer("bad", apply=fail): {}})
    with pytest.raises(type(fault)) as raised:
        found.run(SimpleNamespace(header={}), "render", SimpleNamespace(layer=str))
    assert getattr(raised.value, "__notes__", None) == notes


@pytest.mark.parametrize(("parts", "words"), [
    ({"stage": "draw"}, r"layers\.lab\.odd\.STAGE: unknown stage \(got 'draw'\); allowed: render, readout, level0"),
    ({"units": ("electron",)}, r"layers\.lab\.odd\.UNITS: must be a pair \(got \('electron',\)\)"),
    ({"units": "DN"}, r"lab\.odd\.UNITS: must be a pair"), ({"units": ("DN", 1)}, "UNITS: must be a pair"),
    ({"FRAME": ("active", "active", "readout")}, r"lab\.odd\.FRAME: must be a pair"),
])  # fmt: skip
def test_a_module_that_is_no_layer_is_refused(layer, parts, words):
    with pytest.raises(InputError, match=words):
        load_layer(layer("odd", **parts), "list.yaml")


def test_a_module_without_a_part_is_refused_by_it(layer):
    name = layer("part")
    for part, missing in (("UNITS", "UNITS"), ("apply", "apply, UNITS"), ("Param", "Param, apply, UNITS")):
        delattr(sys.modules[name], part)
        with pytest.raises(InputError, match=rf"list\.yaml: layers: the layer's module lacks {missing} "):
            load_layer(name, "list.yaml")


def test_keywords_are_known_in_any_case():
    names = known_layers()
    assert names == sorted(names) and "param" not in names and {"bias", "cte_effect", "scie_obs"} <= set(names)
    assert load_layer("CTE_Effect").__name__ == "csstsim.layers.cte_effect"
    assert np.all([load_layer(name).STAGE in ("render", "readout", "level0") for name in names])
