"""The light of injected objects: its numbers, its noise, and that it is the simulator's."""

from types import SimpleNamespace

import numpy as np
import pytest
from astropy.table import Table
from inject.scene import CHIP, GEOMETRY, OBSID, empty, mixed, objects, simulation

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.inject import inject as inject_module
from csstsim.inject.level0 import convert
from csstsim.inject.light import Light, _as_list, catalogue_of, chip_index, light_of, shot_noise, table_of
from csstsim.inject.likely_charge import likely_charges
from csstsim.inject.request import Request, realisations_of, record
from csstsim.instrument.chip import Window
from csstsim.io.paths import ORDERS, TRUTH
from csstsim.stages.chip import light

SIGMAS = 5.0
LIGHT = 0.01  # sigma of a pixel
GRATING = 1


@pytest.fixture(scope="module")
def sim(tmp_path_factory):
    return simulation(tmp_path_factory.mktemp("light"))


@pytest.fixture(scope="module")
def bare(sim):
    return empty(sim)


@pytest.mark.parametrize("mean", [0.0, 1e-3, 0.7, 9.9, 10.1, 300.0, 1e6])
def test_shot_is_poisson(mean):
    count = 40_000
    drawn = shot_noise(np.full(count, mean, np.float32), np.arange(count, dtype=np.uint64), np.uint64(7))
    mean = float(np.float32(mean))
    assert drawn.min() >= 0 and abs(drawn.mean() - mean) <= SIGMAS * np.sqrt(mean / count)
    # The sample variance of n Poisson numbers has the variance (m + 2 m^2) / n
    assert abs(drawn.var() - mean) <= SIGMAS * np.sqrt((mean + 2 * mean**2) / count)


def test_random_numbers_belong_to_pixels_of_the_chip():
    whole, part = Window(0, 40, 0, 30), Window(10, 25, 5, 20)
    every = chip_index(np.arange(1200), whole, 40)
    assert np.array_equal(every, np.arange(1200))
    row, column = np.mgrid[5:20, 10:25].reshape(2, -1)
    inside = chip_index(np.arange(225), part, 40)
    assert np.array_equal(inside, row * 40 + column)
    mean = np.full(1200, 5.0, np.float32)
    drawn = shot_noise(mean, every, np.uint64(3))
    assert np.array_equal(shot_noise(mean[:225], inside, np.uint64(3)), drawn[row * 40 + column])
    assert not np.array_equal(shot_noise(mean, every, np.uint64(4)), drawn)
    by_row = drawn.reshape(30, 40) - 5.0
    assert abs((by_row[1:] * by_row[:-1]).mean()) < SIGMAS * 5.0 / np.sqrt(29 * 40)  # rows do not repeat


@pytest.mark.parametrize("added", [0.3, -0.8, 12.5, 1e-3])
def test_the_converter_rounds_to_the_sum_on_average(added):
    count, top = 40_000, 65535
    frame = np.full((200, 200), 500, np.uint16)
    changed, full = convert(frame, np.full(frame.shape, added, np.float32), np.uint64(5), top)
    off = frame.astype(float) - 500 - np.float32(added)
    assert np.abs(off).max() < 1 and abs(off.mean()) < SIGMAS * 0.5 / np.sqrt(count)
    assert changed == np.count_nonzero(frame != 500) and full == 0


def test_the_ends_of_the_converter():
    frame = np.array([[65535, 65530, 3, 500]], np.uint16)
    assert convert(frame, np.array([[-40.0, 1e6, -1e6, 0.0]], np.float32), np.uint64(5), 65535) == (2, 1)
    assert frame.tolist() == [[65535, 65535, 0, 500]]
    saturated = np.array(
        [[65535, 65535, 65534]], np.uint16
    )  # what was full before did not come to the end by this light
    assert convert(saturated, np.array([[90.0, 0.0, 90.0]], np.float32), np.uint64(5), 65535) == (1, 1)


def test_photons_are_those_of_a_simulation_to_the_bit(sim, bare):
    table = mixed(sim, 30, bright=23)
    run, job = sim.replace(catalog=table)._run, sim._run.job(OBSID, CHIP)
    state = light(run, job, lambda text: None)
    assert set(state.truth["method"]) == {"photons"}
    got = light_of(run, job, catalogue_of(run, job, table_of(table)), 0, lambda text: None)
    assert np.array_equal(got.plane(job.window.shape), state.counted)


@pytest.mark.thorough
def test_the_noise_is_poisson(sim, bare):
    """Variance of the injected electrons over realisations equals their mean, for stamps and photons."""
    run, job = bare._run, bare._run.job(OBSID, CHIP)
    table = table_of(objects(sim, [60.0, 180.0], [60.0, 180.0], [18.0, 21.5]))
    catalogue = catalogue_of(run, job, table)
    drawn = [light_of(run, job, catalogue, k, lambda text: None) for k in range(1, 61)]
    assert set(drawn[0].truth["method"]) == {"photons", "stamp"}
    for part in (np.s_[:128, :128], np.s_[128:, 128:]):
        planes = np.array([light.plane(job.window.shape)[part] for light in drawn])
        ratio = planes.var(axis=0, ddof=1).sum() / planes.mean(axis=0).sum()
        # A pixel's sample variance of n draws has the relative error sqrt(2 / (n - 1)); pixels are independent
        weight = planes.mean(axis=0).ravel()
        error = np.sqrt(2 / 59) * np.sqrt((weight**2).sum()) / weight.sum()
        assert ratio == pytest.approx(1.0, abs=SIGMAS * error)


def test_a_stamp_and_photons_on_the_same_pixels_add_up(bare):
    run, job = bare._run, bare._run.job(OBSID, CHIP)
    table = objects(bare, [128.0, 129.0], [128.0, 128.0], [18.0, 21.5])
    both, bright = (
        light_of(run, job, catalogue_of(run, job, table_of(some)), 1, lambda text: None) for some in (table, table[:1])
    )
    assert set(both.truth["method"]) == {"photons", "stamp"}
    assert both.nominal.sum(dtype=float) == pytest.approx(both.truth["drawn"].sum(), rel=1e-6)
    more = both.plane(job.window.shape) - bright.plane(job.window.shape)
    assert more.min() >= 0 and more.sum(dtype=float) == pytest.approx(both.truth["drawn"][1], rel=1e-4)
    assert (np.diff(both.pixel) > 0).all()


def test_through_gratings_it_is_what_a_simulation_draws(tmp_path):
    """Chip 1, GI: the same photons, the same expected light, a truth of orders; and into the frame as read."""
    sim = simulation(tmp_path, GEOMETRY | {"ny": 128, "channel_ny": 64}, select={"types": ["SCIE"], "chips": [GRATING]})
    table = objects(sim, [100.0, 180.0], [60.0, 64.0], [20.5, 21.0], ["star", "galaxy"], chip=GRATING)
    nothing = objects(sim, 128.0, 64.0, 60.0, id=[10**9], chip=GRATING)
    dark = sim.replace(catalog=nothing, layers={"detector_defects": None})  # a dead pixel would take a line's light
    wanted, sky = sim.replace(catalog=table).light(OBSID, GRATING), dark.light(OBSID, GRATING)
    made = dark.inject(sky, table, realisation=0)
    light = made.image - sky.image
    assert (light > 0).sum() > 500 and len(made.orders) > 2
    noise = np.sqrt(sky.image + dark._run.camera.detector.read_noise**2)
    assert (np.abs(made.image - wanted.image) / noise).max() < LIGHT
    frame = dark.chip(OBSID, GRATING)
    added = (dark.inject(frame, table).electrons - frame.electrons).sum(dtype=float)
    drawn = made.orders["drawn"].sum()
    assert added == pytest.approx(
        drawn, abs=SIGMAS * np.sqrt(drawn) + 0.01 * drawn
    )  # the header's gains have few digits


def test_light_curves_dim_the_objects(sim, tmp_path):
    job = sim._run.job(OBSID, CHIP)
    table = table_of(objects(sim, 64, 64, 20.0))
    count = len(table["ra"])
    curves = tmp_path / "curves.csv"
    curves.write_text("curve,mjd,dmag\nfade,50000,1.25\n")
    steady = light_of(sim._run, job, catalogue_of(sim._run, job, table))
    faded = light_of(sim._run, job, catalogue_of(sim._run, job, table | {"light_curve": ["fade"] * count}, curves))
    assert np.allclose(faded.truth["electrons"], steady.truth["electrons"] * 10**-0.5, rtol=1e-5)
    assert np.allclose(faded.truth["dmag"], 1.25)
    frame = sim.light(OBSID, CHIP)
    changed = sim.inject(frame, table | {"light_curve": ["fade"] * count}, light_curves=curves)
    assert np.allclose(changed.truth["dmag"], 1.25)
    with pytest.raises(InputError, match="light curves"):
        catalogue_of(sim._run, job, table | {"light_curve": ["fade"] * count})


def test_tables_of_every_form(tmp_path):
    """A path, an astropy Table or a mapping: the same columns; what is none of them is named."""
    table = Table({"id": [3, 4], "ra": [1.0, 2.0], "dec": [3.0, 4.0]})
    table.write(tmp_path / "a.ecsv")
    given = {name: np.array(table[name]) for name in table.colnames}
    for form in (table, given, tmp_path / "a.ecsv", str(tmp_path / "a.ecsv")):
        found = table_of(form)
        assert list(found) == ["id", "ra", "dec"] and all(np.array_equal(found[name], given[name]) for name in given)
    assert table_of(given) is not given
    with pytest.raises(InputError, match="mag: must have a value for each row"):
        table_of(given | {"mag": 20.0})
    with pytest.raises(InputError, match=r"table: not a table of objects .*got 'list'"):
        table_of([1.0, 2.0])


def test_files_that_a_table_names_are_next_to_it(tmp_path):
    """The names in a file are from its own folder."""
    Table({"id": [1], "ra": [1.0], "dec": [2.0], "image_file": ["a.fits"]}).write(tmp_path / "t.csv")
    assert table_of(tmp_path / "t.csv")["image_file"][0] == str(tmp_path / "a.fits")


def test_light_without_noise_and_a_frame_without_objects(sim, bare):
    """A frame without photon noise has the expected light; layers that draw no objects are refused."""
    table = table_of(objects(sim, [60.0], [70.0], [18.0]))
    quiet = bare.replace(layers={"poisson_and_dark": None, "cosmic_rays": None}, fidelity="noise_free")._run
    job = quiet.job(OBSID, CHIP)
    made = light_of(quiet, job, catalogue_of(quiet, job, table), 1, lambda text: None)
    assert np.array_equal(made.electrons, made.nominal) and made.electrons.sum() == pytest.approx(
        made.truth["drawn"].sum(), rel=1e-5
    )
    assert not np.array_equal(made.nominal, np.rint(made.nominal))
    none = SimpleNamespace(
        steps={"SCIE": SimpleNamespace(step=lambda name: None)}, file="a.yaml", region=lambda exposure: None
    )
    with pytest.raises(InputError, match="scie_obs is not among them"):
        light_of(none, job, None)


def test_numbers_of_counted_electrons_dense_and_sparse():
    """The same pixels either way; and the plane of a Light has each where it belongs."""
    plane = np.zeros((3, 5), np.int32)
    plane[0, 4], plane[2, 1] = 7, 9
    at, electrons = _as_list(plane)
    assert at.tolist() == [4, 11] and electrons.tolist() == [7, 9]
    sparse = SimpleNamespace(pixel=np.array([4, 11], np.uint32), electrons=np.array([7, 9]))
    assert _as_list(sparse)[0].dtype == np.int64 and [v.tolist() for v in _as_list(sparse)] == [[4, 11], [7, 9]]
    assert [len(v) for v in _as_list(None)] == [0, 0]
    half = np.array([0.5, 1.5], np.float32)
    assert Light(at, half, 2 * half, None, None, None).plane((3, 5)).ravel()[[4, 11, 0]].tolist() == [0.5, 1.5, 0.0]


def test_orders_are_written_next_to_the_frame(monkeypatch, tmp_path):
    """With the truth, whose meta data say of which frame, table and realisation they are."""
    written = []
    monkeypatch.setattr(inject_module, "rewrite", lambda *given: written.append(given))
    monkeypatch.setattr(
        inject_module, "truth_table",
        lambda truth, chip: SimpleNamespace(write=lambda path, about: written.append((path, about))),
    )  # fmt: skip
    monkeypatch.setattr("csstsim.io.orders.write_orders", lambda path, orders, about: written.append((path, orders)))
    request = inject_module.Request({"ra": [1.0]}, "x/new.csv", 7)
    light = SimpleNamespace(orders="orders")
    target = tmp_path / "deep" / "b.fits"
    inject_module._write(tmp_path / "a.fits", target, {"IMAGE": 1}, request, light, [0, 0], SimpleNamespace(chip=None))
    about = {"level0": "b.fits", "injected": "new.csv", "realisation": "7"}
    assert written[0] == (target.with_suffix(TRUTH), about) and written[1] == (target.with_suffix(ORDERS), "orders")
    source, to, planes, said = written[2]
    assert (source, to, planes) == (tmp_path / "a.fits", target, {"IMAGE": 1}) and target.parent.is_dir()
    assert said["cards"][0][:2] == ("INJCOUNT", 2)
    truth = {"drawn": np.array([3.0, 0.0, 1234.5])}
    assert inject_module._summary(truth) == "2 objects injected, 1237.5 electrons"


WINDOW = 30, 170, 70, 246  # x0, x1, y0, y1: neither its corner nor its sides are alike


def test_injected_light_in_a_window_is_that_of_the_whole_chip(bare):
    """The noise of a pixel of expected light does not depend on the window in which it is rendered."""
    table = table_of(objects(bare, [90.0, 140.0], [150.0, 110.0], [18.0, 17.5]))
    planes = []
    for sim in (bare, bare.replace(window=WINDOW)):
        run, job = sim._run, sim._run.job(OBSID, CHIP)
        light = light_of(run, job, catalogue_of(run, job, table), 1, lambda text: None)
        assert set(light.truth["method"]) == {"stamp"}
        planes.append(light.plane(job.window.shape))
    whole, part = planes
    x0, x1, y0, y1 = WINDOW
    cut = whole[y0:y1, x0:x1]
    lit = cut > 5
    assert lit.sum() > 200 and (part == cut)[lit].mean() > 0.98


def test_likely_charges_of_a_window_are_those_of_the_whole_chip(bare):
    """With few traps the charge drawn for a pixel is set by its own random number, whatever the window."""
    sim = bare.replace(layers={"CTE_effect": {"density_scale": 0.1}})
    shown = np.random.default_rng(7).poisson(60.0, (bare._run.job(OBSID, CHIP).window.shape)).astype(np.float32)
    x0, x1, y0, y1 = WINDOW
    drawn = []
    for one, charge in ((sim, shown), (sim.replace(window=WINDOW), shown[y0:y1, x0:x1].copy())):
        run, job = one._run, one._run.job(OBSID, CHIP)
        streams = Streams(run.config.seed, job.obsid, job.chip.id, "inject 1")
        drawn.append(next(iter(likely_charges(run, job, charge, streams))))
    whole, part = drawn
    assert np.std(whole - shown) > 4.0  # electrons; the transfer of so few traps moves less than one
    assert np.std(part - whole[y0:y1, x0:x1]) < 1.0


def test_a_frame_in_memory_stays_and_its_copy_states_what_was_injected(bare, tmp_path):
    """Digest and realisation as in a file; the header that was given has neither."""
    curves = tmp_path / "curves.csv"
    curves.write_text("curve,mjd,dmag\nfade,50000,1.25\n")
    table = table_of(objects(bare, 64, 64, 20.0)) | {"light_curve": ["fade"]}
    frame = bare.chip(OBSID, CHIP)
    header, raw = frame.header.tostring(), frame.raw.copy()
    made = bare.inject(frame, table, realisation=3, light_curves=curves)
    assert frame.header.tostring() == header and np.array_equal(frame.raw, raw)
    stated = record(Request(table, "a table", 3, light_curves=curves), 1)
    assert {key: made.header[key] for key, *_ in stated["cards"]} == {key: value for key, value, _ in stated["cards"]}
    said = "".join("".join(made.header["HISTORY"]).split())  # lines end anywhere
    assert "".join(stated["history"][0].split()) in said


def test_noise_is_used_once_in_a_frame_in_memory(bare):
    """As in a file: the same realisation again is refused, another is added, and the header states both."""
    frame, table = bare.chip(OBSID, CHIP), objects(bare, 64, 64, 20.0)
    once = bare.inject(frame, table)
    with pytest.raises(InputError, match="realisation: the frame has injected objects with this noise"):
        bare.inject(once, table)
    twice = bare.inject(once, table, realisation=12)
    assert realisations_of("".join(twice.header["HISTORY"])) == {1, 12}
    first, second = (one.raw.sum(dtype=float) - frame.raw.sum(dtype=float) for one in (once, twice))
    assert second == pytest.approx(2 * first, rel=0.05)
