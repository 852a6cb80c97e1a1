"""`csstsim bench --readout`: every layer of the shipped exposure is timed, and each peer does a layer's work."""

import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.bench.readout import cti
from csstsim.bench.readout import layers as readout
from csstsim.instrument.camera import load_camera
from csstsim.simulation.sim_steps import SimSteps

SHAPE = 64, 128  # of a peers' frame: enough to see that they run


def test_every_layer_is_timed_and_the_file_is_gone(tmp_path):
    camera = load_camera(SHIPPED / "instrument")
    took = readout._seconds(readout._state(camera, 4.0, readout._WARM), readout._steps(), camera, tmp_path)
    layers = [step.name for step in SimSteps(SHIPPED / "observations" / "science.yaml", "SCIE")]
    assert [*took] == [*layers[1:], readout.WRITE]
    assert took["cte_effect"] > 0
    assert not list(tmp_path.iterdir())


def test_the_change_of_a_spot_is_without_that_of_the_sky():
    """A method that loses a tenth of all charge and puts a fifth of it behind by five pixels."""

    def method(column, row):
        behind = np.concatenate([np.zeros(5), column[:-5]])
        return 0.9 * column + 0.02 * behind

    spot = cti.spot_change(method, 1040.0, 300)
    assert np.allclose(spot, [-0.1 * 3 * (1040 - cti.SKY), 0.02 * 3 * (1040 - cti.SKY), 0, 0], atol=0.01)


def test_traps_are_the_papers():
    [cte] = [step.param for step in readout._steps().steps if step.name == "cte_effect"]
    assert cte.density_scale == 1.0


def test_peers_work_and_stand_beside_a_layer_of_ours(monkeypatch):
    monkeypatch.setattr(readout, "_CHANNEL", SHAPE)
    monkeypatch.setattr(readout, "_SENSOR", 8)
    others = readout._others(40.0, load_camera(SHIPPED / "instrument"))
    assert others.keys() <= {step.name for step in readout._steps().steps} | {readout.WRITE}
    assert all(np.isfinite([*peers.values()]).all() for peers in others.values())
