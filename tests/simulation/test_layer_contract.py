"""The contract test of a layer finds each fault: one small layer, damaged in one way at a time."""

import sys
from types import ModuleType

import pytest

from csstsim.base.errors import InputError
from csstsim.detector.channels import ReadoutFrame
from csstsim.simulation.layer_contract import check_layer

SOUND = '''"""A gradient (a paper, 2020)."""
import numpy as np
import random
from pydantic import Field
from csstsim.layers.param import LayerParam
STAGE, UNITS, FRAME = "readout", ("electron", "electron"), ("active", "active")
KEPT = []
class Param(LayerParam):
    """Of the gradient."""
    slope: float = Field(0.5, ge=0, description="electrons per row")
def apply(state, param, rng):
    """Add it, in place."""
    state.image += np.float32(param.slope) * np.arange(state.image.shape[0], dtype=np.float32)[:, None]
    state.image += rng.exposure("noise").normal(size=state.image.shape).astype(np.float32)
    state.header["slope"] = param.slope
    return state
'''
NOISE = 'rng.exposure("noise").normal'
FAULTS = {
    "the module has no docstring": ('"""A gradient (a paper, 2020)."""', ""),
    "Param has no docstring": ('    """Of the gradient."""\n', ""),
    "apply has no docstring": ('    """Add it, in place."""\n', ""),
    "UNITS is": ('("electron", "electron")', '("electron", "volt")'),
    "FRAME is": ('("active", "active")', '"active"'),
    "AFTER is 'bias'": ("KEPT = []", 'AFTER = "bias"'),
    "BEFORE names 'poison_and_dark'": ("KEPT = []", 'BEFORE = ("mylab.glint", "poison_and_dark")'),
    "EXPOSURES names 'SCI'": ("KEPT = []", 'EXPOSURES = ("SCI",)'),
    "it must take (state, param, rng)": ("apply(state, param, rng)", "apply(state, param, seed)"),
    "not a class of": ("class Param(LayerParam)", "class Param"),
    "slope has no default": ("0.5, ge=0", "ge=0"),
    "slope has no description": (', description="electrons per row"', ""),
    "slope is a number without a unit": ("electrons per row", "the gradient's"),
    "apply raised ValueError": ("[:, None]", "[None]"),  # a window that is not square
    "returned NoneType": ("    return state\n", ""),
    "global random numbers": (NOISE, "np.random.normal"),
    "the same seed gives another image": (NOISE, "np.random.default_rng().normal"),
    "returns an image of shape (63, 64)": ("    return", "    state.image = state.image[1:]\n    return"),
    "returns an image of float64": ("    return", "    state.image = state.image.astype(float)\n    return"),
    "not finite": ("    return", "    state.image *= np.float32(1e5) / (state.image.max() > 1e3)\n    return"),
    "returns counted electrons of float64": ("    return", "    state.counted = np.zeros((64, 64))\n    return"),
    "a plain array in C order": ("    return", "    state.image = np.asfortranarray(state.image)\n    return"),
    "apply raised AttributeError: property 'wcs'": ("    return", "    state.wcs = None\n    return"),
    "changes state.exposure": ("    return", "    state.exposure = None\n    return"),
    "keeps a reference": ("    return", "    KEPT.append(state.image[:2])\n    return"),
    "header 'slope' is float32": ("= param.slope\n", "= np.float32(param.slope)\n"),
    "header 'slope' is float nan": ("= param.slope\n", "= float('nan')\n"),
    "gives another image or header": ("= param.slope\n", "= float(np.random.default_rng().random())\n"),
    "slope is a number without a unit: \"the": ("float = Field(0.5, ge=0, description=\"electrons per row",
                                               "float | None = Field(0.5, ge=0, description=\"the gradient's"),
}  # fmt: skip


def layer(old="", new=""):
    assert old in SOUND
    module = ModuleType("spoilt")
    exec(SOUND.replace(old, new), module.__dict__)
    return module


def test_a_sound_layer_has_no_faults():
    assert check_layer(layer()) == ()


@pytest.mark.filterwarnings("ignore:divide by zero")
@pytest.mark.parametrize("words", FAULTS)
def test_fault_is_found(words):
    faults = check_layer(layer(*FAULTS[words]))
    assert any(words in fault for fault in faults), faults
    assert len(faults) == len(set(faults)) <= 2, faults


def test_what_is_applied_is_a_function():
    spoilt = layer()
    spoilt.apply = type("Applied", (), {"__doc__": "Not a function."})
    assert any("apply is type" in fault for fault in check_layer(spoilt))


def test_python_random_numbers_are_global_too():
    spoilt = layer("    return", "    state.image += np.float32(random.random())\n    return")
    assert any("global random numbers" in fault for fault in check_layer(spoilt))


def test_what_cannot_be_loaded_or_given_is_an_error(monkeypatch):
    with pytest.raises(InputError, match=r"cannot import the layer.*nowhere"):
        check_layer("nowhere.glint")
    monkeypatch.setitem(sys.modules, "mylab.half", ModuleType("half"))
    monkeypatch.setitem(sys.modules, "mylab", ModuleType("mylab"))
    with pytest.raises(InputError, match="lacks Param, apply, STAGE, UNITS"):
        check_layer("mylab.half")
    with pytest.raises(InputError, match="parameters refused"):
        check_layer(layer(), {"slope": -1.0})
    assert check_layer(layer(), {"slope": 2.0}) == ()


def test_a_layer_that_may_work_on_either_frame_is_run_on_both():
    """Without FRAME; a layer that counts on the window's shape fails on prescan and overscan."""
    spoilt = layer(
        ', FRAME = "readout", ("electron", "electron"), ("active", "active")', ' = "readout", ("electron", "electron")'
    )
    assert check_layer(spoilt) == ()
    apply = spoilt.apply

    def narrow(state, param, rng):
        """Add it where the shape is the window's."""
        if state.image.shape != state.window.shape:
            raise ValueError("prescan")
        return apply(state, param, rng)

    spoilt.apply = narrow
    assert check_layer(spoilt) == ("apply raised ValueError: prescan",)


def test_a_layer_of_the_readout_frame_is_run_on_prescan_and_overscan():
    sound = layer('("active", "active")', '("readout", "readout")')
    apply, shapes = sound.apply, set()

    def noted(state, param, rng):
        """Add it, and note the shape."""
        shapes.add(state.image.shape == ReadoutFrame.of(state.chip.detector, state.window).shape)
        return apply(state, param, rng)

    sound.apply = noted
    assert check_layer(sound) == () and shapes == {True}
