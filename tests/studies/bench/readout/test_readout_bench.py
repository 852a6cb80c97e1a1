"""`csstsim bench --readout`: every layer of the shipped exposure is timed, and each peer does a layer's work."""

import numpy as np
import pytest

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.simulation.sim_steps import SimSteps
from csstsim.studies.bench.readout import cti
from csstsim.studies.bench.readout import layers as readout

SHAPE = 64, 128  # of a peers' frame: enough to see that they run


def test_every_layer_is_timed_and_the_file_is_gone(tmp_path):
    camera = load_camera(SHIPPED / "instrument")
    took = readout._seconds(readout._state(camera, 4.0, readout._WARM_UP_WINDOW), readout._steps(), camera, tmp_path)
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


def test_peers_work_and_are_of_a_layer_of_csstsim(monkeypatch):
    monkeypatch.setattr(readout, "_CHANNEL", SHAPE)
    monkeypatch.setattr(readout, "_SENSOR", 8)
    others = readout._peer_costs(40.0, load_camera(SHIPPED / "instrument"))
    assert others.keys() <= {step.name for step in readout._steps().steps} | {readout.WRITE}
    assert all(np.isfinite([*peers.values()]).all() for peers in others.values())


def test_the_spot_of_a_column_stands_on_the_sky():
    column = cti.spot_column(500, 147)
    assert column.shape == (147 + 3 + 198,) and column.dtype == np.float32
    assert np.flatnonzero(column != 40).tolist() == [147, 148, 149] and set(column[147:150]) == {500.0}


def test_a_linear_model_moves_what_it_traps():
    """A spot loses LOSS a transfer and electron; all of it is released behind, exponentially by species."""
    image = np.zeros((4000, 2), np.float32)
    image[1000, 0], image[500, 1] = 1e6, 2e6
    cti.linear(image)
    assert 1e6 - image[1000, 0] == pytest.approx(1.2e-5 * 1001 * 1e6, rel=1e-3)
    assert 2e6 - image[500, 1] == pytest.approx(1.2e-5 * 501 * 2e6, rel=1e-3)
    tail = image[1001:, 0]
    fraction = cti.DENSITY / cti.DENSITY.sum()
    for after in (1, 5, 30):
        wanted = (fraction * (1 - np.exp(-1 / cti.TAU)) * np.exp(-(after - 1) / cti.TAU)).sum() * 1.2e-5 * 1001 * 1e6
        assert tail[after - 1] == pytest.approx(wanted, rel=2e-3)
    assert np.array_equal(cti.linear_column(np.array([0, 5, 0], np.float32), 9), _linear_of([0, 5, 0]))


def _linear_of(values):
    image = np.array(values, np.float32)[:, None]
    cti.linear(image)
    return image[:, 0]


def test_errors_of_charge_transfer_are_against_the_first_method():
    """One that moves a tenth more than the first; costs are of a chip's half-columns."""
    said = []

    def moved(gain):
        """A spot gains so many electrons a row, and the rows behind it one each."""

        def method(column, row):
            rows = np.arange(len(column))
            return column + gain * (rows * (column > 40) + (rows > row) * (column == 40) * (column.max() > 40))

        return method

    found = cti.accuracy(
        {"one": cti.TimedMethod(2e-3, moved(1.0)), "two": cti.TimedMethod(1e-3, moved(1.1))}, said.append
    )
    assert found["one"].error == 0 and found["two"].error == pytest.approx(0.1)
    assert (found["one"].cpu, found["two"].cpu) == pytest.approx((2e-3 * 18432, 1e-3 * 18432))
    assert found["one"].parts.shape == (6, 4) and found["one"].parts[0].tolist() == [3 * 148, 8, 40, 150]
    assert [part[0] for part in found["one"].parts] == [3 * 148] * 3 + [3 * 4001] * 3
    assert any("two: 18.4 CPU s per chip; error against the first: rms 10.00%, largest 10.0%" in line for line in said)
    assert ["500", "e-", "at", "147:", "444.00", "|", "8.00", "40.00", "150.00"] in [line.split() for line in said]


def test_the_minimum_of_three_times_is_the_cost(monkeypatch):
    times = iter([0.0, 5.0, 10.0, 12.0, 20.0, 29.0])
    monkeypatch.setattr(cti.time, "process_time", lambda: next(times))
    image = np.zeros(3)
    assert cti.cpu(lambda part: part.__setitem__(0, 1.0), image) == 2.0 and not image.any()


def test_the_scene_of_charge_transfer_has_a_chips_density():
    """The sky to five sigma, whole electrons, an end at 90000 e-; other columns with another seed."""
    image = cti.scene(np.random.default_rng(3), 24, 40)
    assert image.shape == (4616, 24) and image.dtype == np.float32 and image.max() <= 90000
    assert np.median(image) == pytest.approx(40, abs=1) and (image == np.rint(image)).all()
    expected = (76638 + 5801) / (9216 * 9232) * image.size
    assert 0.5 * expected < np.count_nonzero(image > 40 + 8 * np.sqrt(40)) < 100 * expected


def test_peers_work_is_scaled_to_a_chip(monkeypatch):
    """The pixels of a call times the number of calls are those of a chip; a cost is that of a call as often."""
    traps = load_camera(SHIPPED / "instrument").detector.traps
    frame = np.full(readout._CHANNEL, 40.0, np.float32)
    calls = {(peer.layer, peer.name): peer.calls for peer in readout._peers(frame, np.random.default_rng(1), traps)}
    for (_, name), count in calls.items():
        part = readout._SENSOR**2 if "Silicon" in name else frame[:, : readout._COLUMNS].size
        pixels = part if "Silicon" in name or "arctic" in name else frame.size
        assert count * pixels == pytest.approx(readout.PIXELS), name
    now = [0.0]

    def work(seconds):
        now[0] += seconds

    some = [
        readout._Peer("bias", "a", lambda: work(0.5), 16), readout._Peer("bias", "b", lambda: work(2.0), 1.5),
        readout._Peer("gain", "a", lambda: work(1.0), 4),
    ]  # fmt: skip
    monkeypatch.setattr(readout, "_CHANNEL", SHAPE)
    monkeypatch.setattr(readout, "_peers", lambda *given: some)
    monkeypatch.setattr(readout.time, "process_time", lambda: now[0])
    found = readout._peer_costs(40.0, load_camera(SHIPPED / "instrument"))
    assert found == {"bias": {"a": 8.0, "b": 3.0}, "gain": {"a": 4.0}}


def test_the_frame_has_the_stars_and_the_sky_of_a_chip():
    """5000 stars of 1e2 to 1e6 electrons a chip, even in the logarithm; faint ones are counted."""
    camera = load_camera(SHIPPED / "instrument")
    window = readout._WARM_UP_WINDOW
    state = readout._state(camera, 4.0, window)
    number = 5000 * window.nx * window.ny // (9216 * 9232)
    light = 10 ** stream(1, "bench", "readout").uniform(2, 6, number)
    bright = light >= 1e4
    assert number > 50 and bright.any() and state.image.shape == window.shape
    assert state.image.sum(dtype=float) == pytest.approx(light[bright].sum(), rel=1e-4)
    faint = light[~bright].sum()
    assert state.counted.sum() == pytest.approx(faint, abs=5 * np.sqrt(faint))
    assert state.exposure.filter.sky * 150.0 == pytest.approx(4.0)


def test_the_cost_of_columns_is_that_of_one(monkeypatch):
    """Of a clock on which a column takes 2 ms, whatever a method works on."""
    monkeypatch.setattr(cti, "cpu", lambda work, image, repeats=3: 2e-3 * image.shape[1])
    assert cti.half_column(24, 40) == pytest.approx(2e-3)
    methods = cti.timed_methods(5e-3)
    assert methods.pop("exact, event by event").seconds == 5e-3
    assert {name: method.seconds for name, method in methods.items()} == pytest.approx(dict.fromkeys(methods, 2e-3))
    assert {"mean field", "linear"} <= set(methods)


@pytest.mark.parametrize("flux", [500, 5000])
def test_more_and_smaller_electrons_are_the_same_process_in_the_mean(flux):
    """Thirty times as many electrons and traps, each a thirtieth: the same loss and trails of a spot, to 10%.

    Nearly all charge is still in the column. The scatter of the means is 2%.
    """
    many, few = (cti.stochastic(columns, scale) for columns, scale in ((60, 1), (6, 30)))
    changes = []
    for method in (many, few):
        column = cti.spot_column(flux, 147)
        assert method(column, 147).sum() == pytest.approx(column.sum(), rel=2e-3)
        changes.append(cti.spot_change(method, flux, 147))
    assert changes[0][0] < -2 and changes[1] == pytest.approx(changes[0], rel=0.1, abs=0.5)
