"""Laboratory maps in the layers: light meets them, defects and bias have them, and windows read their part alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from support.lab_maps import map_path, name_maps, response, write_map
from support.mini_campaign import write_scene
from support.readout_state import change_exposure, flat_state, small_camera

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.campaign.opened import OpenCampaign
from csstsim.detector import mapped_defects
from csstsim.detector.channels import ReadoutFrame
from csstsim.detector.mask import BAD_COLUMN, DEAD, HOT
from csstsim.instrument.camera import load_camera
from csstsim.instrument.chip import Window
from csstsim.instrument.maps.chip_maps import NO_MAPS
from csstsim.instrument.maps.lab_map import frame_of
from csstsim.io.truth import electron_budget
from csstsim.layers import (
    bias,
    detector_defects,
    led_calib_model,
    poisson_and_dark,
    prnu_effect,
    scie_obs,
    sky_background,
)
from csstsim.measure.calibration.bad_pixels import known_defects
from csstsim.measure.calibration.calibrate import Corrections, Electronics, calibrate
from csstsim.optics.throughput.coarse_grid import expand
from csstsim.optics.throughput.flat import FlatField
from csstsim.optics.throughput.response import Response, response_map, response_maximum
from csstsim.render.psf_table import read_tables
from csstsim.simulation.exposure import Losses
from csstsim.simulation.state import State
from csstsim.stages import psf as psf_stage
from csstsim.stages import select as select_stage

CHIP, SEED, OBSID = 9, 11, "10100000001"
SHAPE = 64, 256
LEDS = 525, 590, 670, 760  # of r


def streams(name, obsid=OBSID):
    return Streams(SEED, obsid, CHIP, name)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """(camera of small chips whose chip 9 has every map, {name: its values})."""
    folder = tmp_path_factory.mktemp("lab")
    small_camera(folder)
    instrument, rng = folder / "instrument", np.random.default_rng(4)
    name_maps(instrument, "prnu", "led_flats", "bad_pixels", "bias")
    detector = small_camera(folder).detector
    bits = rng.choice([0, HOT, DEAD, HOT | BAD_COLUMN], SHAPE, p=[0.985, 0.007, 0.007, 0.001]).astype(np.uint8)
    bits[4:30, 77] |= BAD_COLUMN
    bits[20:50, 200] |= BAD_COLUMN
    shape = ReadoutFrame.of(detector, None).stored_shape("channels")
    structure = rng.normal(0, 4, shape).astype(np.float32)
    values = {"prnu": response(SHAPE, 2, 0.05), "bad_pixels": bits, "bias": structure - structure.mean()}
    for kind, value in values.items():
        write_map(map_path(instrument, kind, CHIP), value)
    for led in LEDS:
        values[led] = response(SHAPE, led, 0.08) * np.float32(1 + (led - 640) / 1000)
        write_map(map_path(instrument, "led_flats", CHIP, led), values[led])
    made = load_camera(instrument)
    return replace(made, chips={CHIP: made.chips[CHIP]}), values


def mean_flat(values, wave, light):
    """Return the flat of light at `wave` [A]: the maps interpolated to each sample, then averaged. Independent sum."""
    total, weight = np.zeros(SHAPE), 0.0
    for wavelength, share in zip(wave[::20] / 10, light[::20], strict=True):
        if share > 0:
            right = int(np.clip(np.searchsorted(LEDS, wavelength), 1, len(LEDS) - 1))
            t = np.clip((wavelength - LEDS[right - 1]) / (LEDS[right] - LEDS[right - 1]), 0, 1)
            total += share * ((1 - t) * values[LEDS[right - 1]] + t * values[LEDS[right]])
            weight += share
    return total / weight


def test_the_flat_of_a_band_is_the_mean_of_the_leds_maps(lab):
    """To 1e-4: the sum here has samples of 10 A."""
    camera, values = lab
    chip, filter_ = camera.chips[CHIP], camera.filters["r"]
    field = FlatField(camera.leds, streams("x").camera)
    internal = field.laboratory(chip, filter_.wavelength, filter_.throughput).part(*chip.full_window.slices)
    made = expand(field.external_grid(chip, filter_), chip, chip.full_window) * internal
    drawn = expand(field.external_grid(replace(chip, maps=NO_MAPS), filter_), chip, chip.full_window)
    x, y = np.meshgrid(np.arange(256) - 127.5, np.arange(64) - 31.5)
    vignetting = field.vignetting(chip.xc + x, chip.yc + y)
    wanted = vignetting * mean_flat(values, filter_.wavelength, filter_.throughput)
    np.testing.assert_allclose(made, wanted, rtol=1e-4)
    assert made.std() > 5 * drawn.std()


def test_a_lamp_has_the_map_of_its_wavelength(lab):
    """670 nm: a line of 20 nm FWHM, so mostly its own map; PRNU is multiplied if the list has it."""
    camera, values = lab
    state, plain = (flat_state(camera, type="FLAT", losses=Losses(prnu=on)) for on in (True, False))
    for here in (state, plain):
        led_calib_model.apply(here, led_calib_model.Param(), streams("led_calib_model"))
    np.testing.assert_allclose(state.image, plain.image * values["prnu"], rtol=1e-6)
    flat = plain.image / plain.image.mean()
    assert np.corrcoef(flat.ravel(), values[670].ravel())[0, 1] > 0.98


def test_sky_meets_the_pixels_of_the_map(lab):
    camera, values = lab
    plain, state = (flat_state(camera, window=(31, 200, 11, 40), losses=Losses(prnu=on)) for on in (False, True))
    for here in (plain, state):
        sky_background.apply(here, sky_background.Param(), streams("sky_background"))
    part = values["prnu"][11:40, 31:200]
    np.testing.assert_allclose(state.image, plain.image * part, rtol=3e-7)
    prnu_effect.apply(state, prnu_effect.Param(), streams("prnu_effect"))
    assert state.header["prnu_rms"] == pytest.approx(part.std(), rel=1e-5)


def test_every_way_to_ask_for_the_response_has_the_same_numbers(lab):
    camera, _ = lab
    chip, window = camera.chips[CHIP], Window(31, 200, 11, 40)
    ask, flat = (camera.filters["r"], 150.0), FlatField(camera.leds, streams("x").camera)
    how = {"flat": flat, "shutter": True, "prnu": streams("x").chip_key("prnu")}
    whole = response_map(chip, chip.full_window, *ask, **how)
    part = Response(chip, window, *ask, **how)
    np.testing.assert_array_equal(part.rows(0, window.ny), whole[window.slices])
    row, column = np.array([0, 5, 28]), np.array([168, 3, 0])
    np.testing.assert_array_equal(part.at(row, column), whole[window.slices][row, column])
    assert whole.max() <= response_maximum(chip, camera.filters["r"], flat)


def test_a_window_reads_its_part_alone(tmp_path):
    """A map whose lower half is not a number serves a window in the upper half, and no other."""
    camera = small_camera(tmp_path)
    name_maps(tmp_path / "instrument", "prnu")
    values = response(SHAPE)
    values[:32] = np.nan
    write_map(map_path(tmp_path / "instrument", "prnu", CHIP), values)
    camera = load_camera(tmp_path / "instrument")
    ask = camera.filters["r"], 150.0
    how = {"flat": None, "shutter": False, "prnu": streams("x").chip_key("prnu")}
    upper = response_map(camera.chips[CHIP], Window(5, 90, 32, 64), *ask, **how)
    assert np.array_equal(upper, values[32:, 5:90])
    with pytest.raises(InputError, match=r"prnu_09.fits: 85 pixel"):
        response_map(camera.chips[CHIP], Window(5, 90, 31, 64), *ask, **how)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """(a job of 128 x 128 pixels, its star and three galaxies, their PSF set and its tables): response 0.4 to 1.6."""
    folder = tmp_path_factory.mktemp("scene")
    places = [40.3, 90.1, 20.0, 64.0], [50.2, 70.6, 110.0, 30.0]
    path = write_scene(folder, "Pair", *places, mag=22.0)
    name_maps(folder / "instrument", "prnu", "led_flats", prnu={"chips": [CHIP]}, led_flats={"chips": [CHIP]})
    steps = np.random.default_rng(3).choice([0.4, 1.0, 1.6], (128, 128)).astype(np.float32)
    write_map(map_path(folder / "instrument", "prnu", CHIP), steps)
    for led in LEDS:
        write_map(map_path(folder / "instrument", "led_flats", CHIP, led), response((128, 128), led, 0.1))
    run = OpenCampaign(path)
    job = run.job(OBSID, CHIP)
    psf_stage.psf(run, CHIP)
    psf = psf_stage.open_psf(run, job.chip)
    return job, select_stage.selected(run, job.exposure), psf, read_tables(run.paths.psf_tables(CHIP), psf)


def drawn(scene, obsid, fidelity):
    job, objects, psf, tables = scene
    losses = Losses(flat=True, shutter=True, prnu=True)
    state = State.blank(replace(job.exposure, losses=losses, fidelity=fidelity), objects)
    state.psf, state.tables = psf, tables
    return scie_obs.apply(state, scie_obs.Param(), streams("scie_obs", obsid))


def test_mean_is_variance_under_a_map_with_responses_above_one(scene):
    """120 exposures: sum of variances over sum of means is 1, and light is that of the map, within 5 sigma."""
    expected, frames = drawn(scene, "0", "noise_free").image.astype(float), []
    for number in range(120):
        state = drawn(scene, str(number), "standard")
        assert state.counted.any(), "photons, which are lost one by one"
        poisson_and_dark.apply(change_time(state), poisson_and_dark.Param(), streams("poisson_and_dark", str(number)))
        frames.append(state.image)
    mean, variance = np.mean(frames, axis=0, dtype=float), np.var(frames, axis=0, dtype=float, ddof=1)
    light = expected.sum()
    assert abs(mean.sum() - light) < 5 * np.sqrt(light / 120)
    # each pixel's variance of n frames has an error of mean sqrt(2 / n), plus that of a Poisson's fourth moment
    sigma = np.sqrt((2 * expected**2 + expected).sum() / 120)
    assert abs(variance.sum() - light) < 5 * sigma
    steps = scene[0].chip.maps.prnu.part(slice(None), slice(None))
    for step in np.unique(steps):
        here = steps == step
        assert abs(mean[here].sum() - expected[here].sum()) < 5 * np.sqrt(expected[here].sum() / 120), step


def change_time(state):
    """Return the state with an exposure of 0 s, so that dark current adds nothing to the light."""
    change_exposure(state, pointing=replace(state.pointing, exptime=0.0))
    return state


# detector_defects


def spoiled(camera, obsid=OBSID, window=None, level=300.0, **param):
    state = flat_state(camera, level, window=window)
    state.mask = np.zeros(state.image.shape, np.uint8)
    return detector_defects.apply(state, detector_defects.Param(**param), streams("detector_defects", obsid))


def test_defects_are_where_the_map_says(lab):
    camera, values = lab
    state, bits = spoiled(camera), values["bad_pixels"]
    assert np.array_equal(state.mask, bits)
    assert (state.image[bits == 0] == 300).all() and (state.image[bits == HOT] > 300).mean() > 0.99
    assert state.header["hot_pixels"] == np.count_nonzero(bits & HOT)
    assert state.header["dead_pixels"] == np.count_nonzero(bits & DEAD)
    alone = len(np.unique(np.nonzero(bits[:32] & BAD_COLUMN)[1])) + len(
        np.unique(np.nonzero(bits[32:] & BAD_COLUMN)[1])
    )
    assert state.header["bad_columns"] == alone
    for off, bit in {"hot_pixels": HOT, "dead_pixels": DEAD, "bad_columns": BAD_COLUMN}.items():
        other = spoiled(camera, **{off: False})
        apart = bits & bit == 0
        assert np.array_equal(other.mask, bits & ~np.uint8(bit)) and other.header[off] == 0
        assert np.array_equal(other.image[apart], state.image[apart])


def test_a_window_has_the_defects_of_the_chip_and_measure_knows_them(lab):
    camera, values = lab
    whole, part = spoiled(camera), spoiled(camera, window=(31, 220, 11, 40))
    assert np.array_equal(part.image, whole.image[11:40, 31:220])
    param = detector_defects.Param(dead_pixels=False)
    known = known_defects(part.chip, part.window, param, streams("measure"))
    assert np.array_equal(known, values["bad_pixels"][11:40, 31:220] & (HOT | BAD_COLUMN) > 0)


def test_charges_follow_the_laws_of_drawn_defects(tmp_path):
    """Kolmogorov and Smirnov on 1600 pixels of each kind, 40 exposures; p above 6e-7, five sigma."""
    small_camera(tmp_path)
    instrument = tmp_path / "instrument"
    name_maps(instrument, "bad_pixels")
    bits = np.zeros(SHAPE, np.uint8)
    bits.reshape(-1)[:1600:1] = np.resize([HOT, DEAD], 1600)
    bits[:, 101::40] = BAD_COLUMN
    write_map(map_path(instrument, "bad_pixels", CHIP), bits)
    camera = load_camera(instrument)
    frames = np.array([spoiled(camera, str(n)).image for n in range(40)], dtype=float)
    numbers, level = camera.detector.defects, 300.0
    rate = (frames.mean(axis=0) - level)[bits == HOT] / 150.0
    law = stats.gamma(numbers.hot_shape, scale=numbers.hot_scale / numbers.hot_time)
    assert stats.kstest(rate, law.cdf).pvalue > 6e-7
    hot = frames[:, bits == HOT]
    spread = hot.var(axis=0, ddof=1).sum() / (hot.mean(axis=0) - level).sum()
    assert abs(spread - 1) < 5 * np.sqrt(2 / 39 / 800) * 1.3  # Gamma rates weigh unequally
    dead = frames[:, bits == DEAD]
    share = dead.mean(axis=0) / level
    clear = share > 0.1  # lower ones are cut at 0
    assert stats.kstest(share[clear], stats.uniform(0.1, numbers.dead_max - 0.1).cdf).pvalue > 6e-7
    assert dead[:, clear].std(axis=0, ddof=1).mean() == pytest.approx(numbers.dead_noise, rel=0.03)
    column = frames[:, :, 101::40]
    low, high = 1.3 * level + 50, 2 * level + 150
    levels = column.reshape(40, 2, 32, -1).mean(axis=(0, 2))
    assert ((levels > low - 3) & (levels < high + 3)).all() and np.ptp(levels) > 20
    noise = column.reshape(40, 2, 32, -1).std(axis=(0, 2), ddof=1)
    assert noise == pytest.approx(np.sqrt(4 * (level + 25) - 25), rel=0.1)  # 1280 draws: 2% each


# bias


def biased(camera, window=None):
    state = flat_state(camera, 0.0, window=window)
    frame = ReadoutFrame.of(state.chip.detector, state.window)
    state.image = np.full(frame.shape, 7.0, np.float32)
    return bias.apply(state, bias.Param(), streams("bias")), frame


@pytest.mark.parametrize("window", [None, (31, 200, 11, 40), (0, 256, 40, 41)])
def test_structure_is_added_to_the_levels(lab, window):
    camera, values = lab
    state, frame = biased(camera, window)
    plain = replace(
        camera, chips={CHIP: replace(camera.chips[CHIP], maps=type(camera.chips[CHIP].maps)({}, None, 0, None))}
    )
    without, _ = biased(plain, window)
    added = state.image - without.image
    assert np.abs(added - frame.from_stored(values["bias"], "channels")).max() < 1e-4  # rounding of 500 e-
    assert state.header["bias"] == without.header["bias"]


def test_both_arrangements_of_the_map_are_one(lab, tmp_path):
    """The same structure as the chip lies and as Level-0 stores it."""
    _, values = lab
    small_camera(tmp_path)
    name_maps(tmp_path / "instrument", "bias")
    frame, images = ReadoutFrame.of(lab[0].detector, None), []
    pixels = frame.from_stored(values["bias"], "channels")
    for layout in ("channels", "mosaic"):
        write_map(map_path(tmp_path / "instrument", "bias", CHIP), frame.to_stored(pixels, layout))
        images.append(biased(load_camera(tmp_path / "instrument"), (31, 200, 11, 40))[0].image)
    assert np.array_equal(*images)


def test_measure_takes_the_structure_off(lab):
    """A flat of 1000 e- in DN of gain 1.1 e-/DN comes back within rounding, 0.32 DN rms; without, it has 4 e- more."""
    camera, _ = lab
    state, frame = biased(camera)
    structure, gain = frame_of(camera.chips[CHIP].maps.bias, frame), dict.fromkeys(range(1, 17), 1.1)
    for block in frame.blocks:
        state.image[block.active] += 1000.0
    dn = np.rint(state.image / 1.1).astype(np.uint16)
    with_it = calibrate(dn, frame, Electronics(gain), Corrections(structure=structure)).electrons
    assert abs(with_it.mean() - 1000) < 0.1 and with_it.std() < 0.45
    assert calibrate(dn, frame, Electronics(gain)).electrons.std() > 3.5


def test_a_level_of_the_overscan_alone_shifts_no_light(lab):
    """Structure of 6 e- in the serial overscan: subtracted in DN of gain 1.1 before the level is taken, to 0.1 e-."""
    camera, _ = lab
    frame = ReadoutFrame.of(camera.chips[CHIP].detector, None)
    image, structure = np.full(frame.shape, 500.0, np.float32), np.zeros(frame.shape, np.float32)
    for block in frame.blocks:
        image[block.active] += 1000.0
        structure[block.serial_overscan] = 6.0
    dither = np.random.default_rng(5).uniform(-0.5, 0.5, frame.shape)  # of a DN: the rounding's mean is 0
    dn, gain = np.rint((image + structure) / 1.1 + dither).astype(np.uint16), dict.fromkeys(range(1, 17), 1.1)
    assert calibrate(dn, frame, Electronics(gain), Corrections(structure=structure)).electrons.mean() == pytest.approx(
        1000.0, abs=0.1
    )
    assert calibrate(dn, frame, Electronics(gain)).electrons.mean() == pytest.approx(994.0, abs=0.1)


def test_the_light_check_knows_what_a_bias_map_can_add(lab):
    """A map that is 3 e- higher on the active pixels than on the overscans: at most 3 e- of each pixel."""
    camera, _ = lab
    state, frame = biased(camera)
    structure = frame_of(camera.chips[CHIP].maps.bias, frame)
    levels = [np.median(structure[block.serial_overscan]) for block in frame.blocks]
    parts = [structure[block.whole].astype(float) - level for block, level in zip(frame.blocks, levels, strict=True)]
    assert state.header["bias_structure"] >= sum(abs(part.sum()) for part in parts) * (1 - 1e-6)
    assert electron_budget(state.header, 1)["bias_structure"] == state.header["bias_structure"]
    assert "bias_structure" not in electron_budget({}, 1)


def test_mapped_charges_have_the_least_that_drawn_ones_have(lab):
    """Rates of hot pixels are at least hot_min; no charge is below 0; Poisson mean to 5 sigma."""
    numbers, n = lab[0].chips[CHIP].detector.defects, 4000
    x, y, keys = np.arange(n) % 256, np.arange(n) // 256, (np.uint64(3), np.uint64(4))
    cool = replace(numbers, hot_scale=1e-6)
    charge = mapped_defects.hot_charge(x, y, 150.0, cool, *keys)
    mean = 150.0 * numbers.hot_min
    assert numbers.hot_min == 0.1 and abs(charge.mean() - mean) < 5 * np.sqrt(mean / n)
    assert not mapped_defects.hot_charge(x, y, 0.0, numbers, *keys).any()
    dead = mapped_defects.dead_charge(x, y, 0.0, numbers, *keys)
    dark = replace(numbers, **dict.fromkeys(("low_factor", "low_offset", "high_factor", "high_offset"), 0.0))
    column = mapped_defects.column_charge(x, y, 8, 100.0, 5.0, dark, *keys)
    for values in (dead, column):  # noise about 0 alone
        assert values.min() == 0 and abs((values == 0).mean() - 0.5) < 5 * np.sqrt(0.25 / n)


def test_columns_of_a_window_are_counted_by_halves_of_the_chip(lab):
    """Column 77 is bad below, 200 in both halves: rows 11 to 40 have three, 35 to 45 the upper part of one."""
    camera, values = lab
    bits = values["bad_pixels"] & BAD_COLUMN
    for window in ((70, 210, 11, 40), (190, 210, 35, 45), (70, 80, 5, 20)):
        x0, x1, y0, y1 = window
        state = spoiled(camera, window=window, hot_pixels=False, dead_pixels=False)
        part = bits[y0:y1, x0:x1] > 0
        low, high = part[: max(32 - y0, 0)], part[max(32 - y0, 0) :]
        assert state.header["bad_columns"] == low.any(axis=0).sum() + high.any(axis=0).sum() > 0
        assert (state.header["hot_pixels"], state.header["dead_pixels"]) == (0, 0)
