"""Rules for every layer, whoever writes it: its form, its seed, no change of other layers' random numbers."""

import importlib
import re

import numpy as np
import pytest
import yaml
from support.readout_state import OBSID, dark_layers, flat_state, run

from csstsim.base.errors import InputError
from csstsim.simulation.layer_contract import check_layer, form_faults
from csstsim.simulation.sim_steps import SimSteps, known_layers

READOUT = [step.name for step in dark_layers()]


@pytest.mark.parametrize("name", known_layers())
def test_form(name):
    layer = importlib.import_module(f"csstsim.layers.{name}")
    assert not form_faults(layer)  # a source among other things: the paper, or any reference
    assert "mitted" in layer.__doc__


def test_every_item_of_the_paper_has_its_layer():
    about = [importlib.import_module(f"csstsim.layers.{name}").__doc__ for name in known_layers()]
    items = re.findall(r"paper, Appendix B item (\d+)", " ".join(" ".join(about).split()))
    assert sorted(map(int, items)) == list(range(1, 17))


@pytest.mark.parametrize("name", sorted(set(known_layers()) - {"scie_obs"}))  # it needs a PSF set: end_to_end
def test_contract(name):
    assert not check_layer(name)


@pytest.mark.parametrize("name", known_layers())
def test_unknown_parameters_are_refused(name):
    layer = importlib.import_module(f"csstsim.layers.{name}")
    with pytest.raises(ValueError, match="no_such_key"):
        layer.Param.model_validate({"no_such_key": 1})


def before(small, name, obsid=OBSID):
    """The state as the layer called `name` finds it."""
    return run(flat_state(small, 80.0), dark_layers(off=READOUT[READOUT.index(name) :]), obsid=obsid)


def step_of(name):
    return [step for step in dark_layers() if step.name == name]


@pytest.mark.parametrize("name", READOUT)
def test_contract_in_its_place(small, name):
    """... as the layers before it leave a dark exposure."""
    assert not check_layer(name, state=lambda: before(small, name))


@pytest.mark.parametrize("name", ["poisson_and_dark", "readout_noise"])
def test_noise_is_new_in_each_exposure_chip_and_seed(small, name):
    images = [run(before(small, name, obsid), step_of(name), obsid=obsid).image for obsid in ("1", "2")]
    images.append(run(before(small, name, "1"), step_of(name), seed=12, obsid="1").image)
    state = run(flat_state(small, 80.0, chip=8), dark_layers(off=READOUT[READOUT.index(name) :]), obsid="1")
    images.append(run(state, step_of(name), obsid="1").image)
    for i, one in enumerate(images):
        for other in images[i + 1 :]:
            z = one.ravel() - one.mean(), other.ravel() - other.mean()
            correlation = np.mean(z[0] * z[1]) / (z[0].std() * z[1].std())
            if name == "poisson_and_dark":  # beyond it, the shot noise of `before` is common to some pairs
                assert abs(correlation) < 5 / np.sqrt(one.size)
            assert not np.array_equal(one, other)


PAIRS = [(name, off) for name in READOUT for off in ("poisson_and_dark", "bias", "readout_noise") if name != off]


@pytest.mark.parametrize(("name", "off"), PAIRS)
def test_another_layer_switched_off_changes_nothing_here(small, name, off):
    """What a layer makes of the same input is the same bits, whatever ran before it."""
    upto = READOUT[READOUT.index(name) :]
    added = []
    # Rays leave counted electrons, which poisson_and_dark alone merges
    for missing in ((), (off, "cosmic_rays") if off == "poisson_and_dark" else (off,)):
        state = run(flat_state(small, 80.0), dark_layers(off=[*upto, *missing]))
        state.image[...] = 100.0
        state.header.clear()
        added.append(run(state, step_of(name)))
    assert np.array_equal(added[0].image, added[1].image)
    assert added[0].header == added[1].header


CHARGE = ("brighter_fatter", "detector_defects", "blooming", "CTE_effect", "nonlinearity")


@pytest.mark.parametrize("moved", CHARGE)
@pytest.mark.parametrize("before", ["poisson_and_dark", "cosmic_rays"])
def test_charge_is_counted_before_it_moves(tmp_path, moved, before):
    """Else noise would be drawn twice, or never meet the layer; with rays and without them."""
    for rays in (True, False):
        names = ["cosmic_rays"] * rays + ["poisson_and_dark", "prescan_overscan", "gain", "quantization_and_output"]
        if before not in names:
            continue
        names.insert(names.index(before), moved)
        (tmp_path / "list.yaml").write_text(yaml.safe_dump({"layers": [{name: {}} for name in names]}))
        with pytest.raises(InputError, match=f"{moved}: must come after poisson_and_dark"):
            SimSteps(tmp_path / "list.yaml", "DARK")


def test_bias_is_added_to_the_voltage(tmp_path):
    names = ["poisson_and_dark", "prescan_overscan", "bias", "nonlinearity", "gain", "quantization_and_output"]
    (tmp_path / "list.yaml").write_text(yaml.safe_dump({"layers": [{name: {}} for name in names]}))
    with pytest.raises(InputError, match="bias: must come after nonlinearity"):
        SimSteps(tmp_path / "list.yaml", "DARK")
