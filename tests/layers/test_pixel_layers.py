"""PRNU_effect, cosmic_rays and detector_defects as layers: order, streams, masks, headers, windows, extremes."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from support.readout_state import OBSID, change_exposure, flat_state

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.detector import mask
from csstsim.detector.mask import BAD_COLUMN, COSMIC_RAY, DEAD, HOT
from csstsim.detector.prnu import CLIP, multiply
from csstsim.layers import cosmic_rays, detector_defects, led_calib_model, poisson_and_dark, prnu_effect, sky_background
from csstsim.optics.throughput.flat import FlatField
from csstsim.optics.throughput.response import response_map, response_maximum
from csstsim.simulation.exposure import Losses
from csstsim.simulation.sim_steps import SimSteps

END = [{"prescan_overscan": {}}, {"bias": {}}, {"readout_noise": {}}, {"gain": {}}, {"quantization_and_output": {}}]
LIGHT = [{"scie_obs": {}}, {"sky_background": {}}]
SEED = 11


def streams(name, obsid=OBSID, chip=9):
    return Streams(SEED, obsid, chip, name)


@pytest.fixture
def steps(tmp_path):
    def made(layers, kind=None):
        (tmp_path / "list.yaml").write_text(yaml.safe_dump({"layers": [*layers, *END]}))
        return SimSteps(tmp_path / "list.yaml", kind)

    return made


def masked(state):
    state.mask = np.zeros(state.image.shape, np.uint8)
    return state


# PRNU_effect


def test_the_list_decides_whether_light_meets_the_pixels(steps):
    prnu, poisson = {"PRNU_effect": {}}, {"poisson_and_dark": {}}
    assert steps([*LIGHT, prnu, poisson], "SCIE").losses == Losses(flat=True, shutter=True, prnu=True)
    assert not steps([*LIGHT, poisson], "SCIE").losses.prnu
    assert steps([{"led_calib_model": {}}, prnu, poisson], "FLAT").losses.prnu
    with pytest.raises(InputError, match="must come after sky_background"):
        steps([LIGHT[0], prnu, LIGHT[1], poisson])
    with pytest.raises(InputError, match="cannot follow"):
        steps([*LIGHT, poisson, prnu])
    with pytest.raises(InputError, match="kind of exposure"):
        steps([prnu, poisson], "DARK")


def test_sky_and_lamps_meet_the_same_pixels(camera):
    """The ratio with and without is the chip's map, in a window at odd columns; nothing else in the state changes."""
    key = streams("x").chip_key("prnu")
    for layer, name in ((sky_background, "sky_background"), (led_calib_model, "led_calib_model")):
        plain, state = (flat_state(camera, window=(1001, 1400, 801, 1000)) for _ in "ab")
        for here, on in ((plain, False), (state, True)):
            change_exposure(here, losses=Losses(prnu=on))
            layer.apply(here, layer.Param(), streams(name))
        share = np.ones(state.image.shape, np.float32)
        multiply(share, 1001, 801, camera.detector.prnu, key)
        np.testing.assert_allclose(state.image, plain.image * share, rtol=3e-7)
        assert abs(share.std() / camera.detector.prnu - 1) < 5 / np.sqrt(2 * share.size)
        assert state.header == plain.header


def test_the_maximum_is_the_same_with_it_and_without(camera):
    chip, window = camera.chips[9], camera.chips[9].full_window
    window = replace(window, y1=40)
    filter_, key = camera.filters["r"], streams("x").chip_key("prnu")
    for flat in (None, FlatField(camera.leds, streams("x").camera)):
        highest = response_maximum(chip, filter_, flat)
        share = response_map(chip, window, filter_, 150.0, flat=flat, shutter=flat is not None, prnu=key)
        assert share.max() <= highest
        assert highest >= 1 + CLIP * camera.detector.prnu


def test_its_layer_records_and_refuses(small):
    state = flat_state(small, 5.0)
    with pytest.raises(ValueError, match="rendered without PRNU"):
        prnu_effect.apply(state, prnu_effect.Param(), streams("prnu_effect"))
    change_exposure(state, losses=Losses(prnu=True))
    prnu_effect.apply(state, prnu_effect.Param(), streams("prnu_effect"))
    assert state.header == {"prnu_rms": small.detector.prnu} and (state.image == 5.0).all()
    wide = replace(small, detector=replace(small.detector, prnu=0.3))
    with pytest.raises(InputError, match="prnu"):
        prnu_effect.check(prnu_effect.Param(), wide, state.pointing)


# cosmic_rays


def struck(state, obsid=OBSID, **param):
    return cosmic_rays.apply(state, cosmic_rays.Param(**param), streams("cosmic_rays", obsid))


@pytest.mark.parametrize(("kind", "exptime"), [("SCIE", 150.0), ("DARK", 1000.0), ("FLAT", 200.0), ("BIAS", 0.0)])
def test_rays_in_every_kind_of_exposure(camera, steps, kind, exptime):
    """Numbers go with the exposure and half of the readout: 5 sigma of the tracks' Poisson number."""
    window = (0, 9216, 0, 2000)
    state = masked(flat_state(camera, 0.0, window=window, type=kind, exptime=exptime))
    struck(state)
    # a track of length L is seen on the window's area and 2 L / pi beyond each side
    expected = camera.detector.cosmic_rays.rate * (exptime + 20) * (9216 * 2000 + 12.5 * (9216 + 2000) * 2 / np.pi)
    assert abs(state.header["cosmic_tracks"] - expected) < 5 * np.sqrt(expected)
    assert state.counted.dtype == np.int32 and not state.image.any()
    marked = state.mask == COSMIC_RAY
    np.testing.assert_array_equal(marked, state.counted >= camera.detector.cosmic_rays.marked_from)
    assert state.header["cosmic_pixels"] == marked.sum()
    assert state.header["cosmic_electrons"] == state.counted.sum(dtype=int)


@pytest.mark.parametrize(("exptime", "readout_time"), [(0.0, 40.0), (0.0, 90.0), (25.0, 40.0)])
def test_rays_strike_during_half_of_the_readout_on_average(small, exptime, readout_time):
    """Of a rate 3e4 times that of space, to 5 sigma of the tracks' Poisson number: 15 per cent at most."""
    rays = replace(small.detector.cosmic_rays, rate=3e4 * small.detector.cosmic_rays.rate)
    detector = replace(small.detector, cosmic_rays=rays, readout_time=readout_time)
    state = flat_state(small, exptime=exptime)
    ny, nx = state.image.shape
    change_exposure(state, chip=replace(state.chip, detector=detector))
    struck(state)
    expected = rays.rate * (exptime + readout_time / 2) * (nx * ny + 12.5 * (nx + ny) * 2 / np.pi)
    assert expected > 1200
    assert abs(state.header["cosmic_tracks"] - expected) < 5 * np.sqrt(expected)


def test_their_electrons_get_no_shot_noise(small, steps):
    """Without light and dark current what is read is what struck, and counted electrons stay under it."""
    counted = struck(flat_state(small, exptime=1e5)).counted.copy()
    state = flat_state(small, exptime=1e5)
    state.counted = np.full(state.image.shape, 3, np.int32)
    state = struck(state)
    change_exposure(state, pointing=replace(state.pointing, exptime=0.0))
    state = poisson_and_dark.apply(state, poisson_and_dark.Param(), streams("poisson_and_dark"))
    np.testing.assert_array_equal(state.image, counted + 3)
    assert counted.max() > 100
    with pytest.raises(InputError, match="must be followed by poisson_and_dark"):
        steps([{"poisson_and_dark": {}}, {"cosmic_rays": {}}])


def test_rays_are_saved_only_if_asked(small):
    assert struck(flat_state(small)).cosmic_rays is None
    state = struck(flat_state(small), exptime=1e5, save_cosmic_image=True)
    pixel, electrons = state.cosmic_rays
    np.testing.assert_array_equal(state.counted.reshape(-1)[pixel], electrons)
    assert electrons.sum() == state.counted.sum() and state.mask is None


def test_an_exposure_has_its_own_rays(small):
    one, same, other = (struck(flat_state(small), obsid, exptime=1e5).counted for obsid in ("1", "1", "2"))
    assert np.array_equal(one, same) and not np.array_equal(one, other)


# detector_defects


def spoiled(state, obsid=OBSID, **param):
    return detector_defects.apply(state, detector_defects.Param(**param), streams("detector_defects", obsid))


SWITCHES = {"hot_pixels": HOT, "dead_pixels": DEAD, "bad_columns": BAD_COLUMN}


@pytest.fixture
def many(small):
    """The small camera with 5% of its pixels defective."""
    detector = replace(small.detector, defects=replace(small.detector.defects, defective=0.05))
    return replace(small, chips={9: replace(small.chips[9], detector=detector)}, detector=detector)


def test_a_chip(camera):
    """The real chip: as many defects as the paper says, and nothing but them changes."""
    state = masked(flat_state(camera, 40.0))
    spoiled(state)
    bits, header = state.mask, state.header
    assert header["hot_pixels"] == np.count_nonzero(bits & HOT)
    assert header["dead_pixels"] == np.count_nonzero(bits & DEAD)
    assert header["hot_pixels"] + header["dead_pixels"] == round(5e-5 * 9216 * 9232)
    assert 2 <= header["bad_columns"] == (bits & BAD_COLUMN).any(axis=0).sum() <= 10
    assert (state.image[bits == 0] == 40).all() and header["defects_level"] == 40
    assert (state.image[bits == HOT] > 40).mean() > 0.999
    assert state.image[bits == DEAD].mean() == pytest.approx(14.1, abs=5 * np.sqrt((28**2 / 12 + 25) / 2127))


def test_switching_one_off_leaves_the_others_pixels(many):
    every = spoiled(masked(flat_state(many, 300.0)))
    for off, bit in SWITCHES.items():
        state = spoiled(masked(flat_state(many, 300.0)), **{off: False})
        assert not (state.mask & bit).any() and state.header[off] == 0
        assert np.array_equal(state.mask, every.mask & ~np.uint8(bit))
        apart = every.mask & bit == 0
        assert np.array_equal(state.image[apart], every.image[apart])


def test_a_window_has_the_defects_of_the_chip(many):
    """Of a flat, where the background is the same; a window that cuts columns."""
    whole = spoiled(masked(flat_state(many, 300.0)))
    part = spoiled(masked(flat_state(many, 300.0, window=(31, 200, 11, 40))))
    assert np.array_equal(part.image, whole.image[11:40, 31:200])
    assert np.array_equal(part.mask, whole.mask[11:40, 31:200])
    assert part.header["hot_pixels"] == np.count_nonzero(part.mask & HOT) > 0


@pytest.mark.parametrize("rows", [(25, 45), (30, 36), (36, 64)])
def test_a_window_within_bad_columns_has_their_part(many, rows):
    """Columns reach from the seam at row 32 towards either amplifier: their noise is each row's own."""
    whole = spoiled(masked(flat_state(many, 300.0)))
    part = spoiled(masked(flat_state(many, 300.0, window=(0, 256, *rows))))
    assert np.array_equal(part.image, whole.image[slice(*rows)]) and (part.mask & BAD_COLUMN).any()


def test_places_last_and_noise_does_not(many):
    one, other = (spoiled(masked(flat_state(many, 300.0)), obsid) for obsid in ("1", "2"))
    assert np.array_equal(one.mask, other.mask)
    for bit in (HOT, DEAD, BAD_COLUMN):
        here = one.mask == bit
        assert (one.image[here] != other.image[here]).mean() > 0.5
        if bit == BAD_COLUMN:  # of one level
            change = (one.image - other.image)[here]
            assert abs(change.mean()) < 5 * 2 * np.sqrt(325) * np.sqrt(2 / change.size)
        else:
            assert np.corrcoef(one.image[here], other.image[here])[0, 1] > 0.9
    chip = replace(many.chips[9], id=8)
    another = spoiled_chip(replace(many, chips={9: chip}))
    assert not np.array_equal(one.mask, another.mask)


def spoiled_chip(camera):
    state = masked(flat_state(camera, 300.0))
    chip = state.chip.id
    return detector_defects.apply(state, detector_defects.Param(), streams("detector_defects", chip=chip))


@pytest.mark.parametrize("level", [0.0, -20.0, 9e4])
def test_extreme_frames(small, level):
    """All zero, all negative (whose background counts as 0), all saturated: values as stated, all finite."""
    state = spoiled(masked(flat_state(small, level)), hot_pixels=False)
    column = state.mask == BAD_COLUMN
    base = max(level, 0)
    sigma = 2 * np.sqrt(base + 25)
    assert (state.image[column] > 1.3 * base + 50 - 5 * sigma).all()
    assert (state.image[column] < 2 * base + 150 + 5 * sigma).all()
    assert (state.image[state.mask == 0] == np.float32(level)).all()
    one = spoiled(flat_state(small, level, window=(3, 4, 5, 6)))
    assert np.isfinite(one.image).all() and one.image.shape == (1, 1)


def test_what_defects_refuse(small):
    state = flat_state(small, 1.0)
    state.counted = np.zeros(state.image.shape, np.int32)
    with pytest.raises(ValueError, match="poisson_and_dark must come before"):
        spoiled(state)


@pytest.mark.parametrize("name", ["cosmic_rays", "defects"])
def test_missing_and_faulty_numbers(tmp_path, small, name):
    from support.mini import mini_camera

    from csstsim.instrument.camera import load_camera

    folder = mini_camera(tmp_path)
    layer = cosmic_rays if name == "cosmic_rays" else detector_defects
    data = yaml.safe_load((folder / f"{name}.yaml").read_text())
    first = next(iter(data["number" if name == "cosmic_rays" else "pixels"].values()))
    first["value"] = -1.0
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(InputError, match="should be greater than"):
        load_camera(folder)
    (folder / f"{name}.yaml").unlink()
    with pytest.raises(InputError, match=f"{name}.yaml"):
        layer.check(layer.Param(), load_camera(folder), None)


def test_bits_are_apart():
    assert sum(mask.BITS.values()) == sum({*mask.BITS.values()}) == 127


def test_bits_are_those_of_files_and_each_is_explained():
    assert mask.BITS == {
        "SATURATED": 1, "BLED": 2, "COSMIC_RAY": 4, "HOT": 8, "DEAD": 16, "BAD_COLUMN": 32, "CLIPPED": 64,
    }  # fmt: skip
    assert set(mask.ABOUT) == set(mask.BITS.values())
    words = {HOT: "hot", DEAD: "dead", BAD_COLUMN: "bad column", COSMIC_RAY: "cosmic ray", mask.BLED: "into it"}
    assert all(word in mask.ABOUT[bit] for bit, word in words.items())


def test_what_lists_leave_out():
    assert cosmic_rays.Param().model_dump() == {"exptime": None, "save_cosmic_image": False}
    assert detector_defects.Param().model_dump() == {"hot_pixels": True, "dead_pixels": True, "bad_columns": True}


def test_defects_electrons_are_what_the_image_gains(many):
    state = spoiled(flat_state(many, 300.0))
    assert state.header["defects_level"] == 300.0
    gained = state.image.sum(dtype=float) - 300.0 * state.image.size
    assert state.header["defects_electrons"] == pytest.approx(gained, rel=1e-6) and gained > 1e5


def test_hot_pixels_add_and_dead_ones_replace(many):
    """On a frame whose charge differs from pixel to pixel."""
    state = masked(flat_state(many, 300.0))
    state.image += np.arange(state.image.size, dtype=np.float32).reshape(state.image.shape) % 7
    before = state.image.copy()
    spoiled(state, bad_columns=False)
    hot, dead = state.mask == HOT, state.mask == DEAD
    plain = spoiled(masked(flat_state(many, 300.0)), bad_columns=False)
    shift = before[hot] - 300.0
    np.testing.assert_allclose(state.image[hot], plain.image[hot] + shift, rtol=1e-6)
    level = state.header["defects_level"]
    assert 302.5 < level < 303.5 and abs((state.image - plain.image)[dead]).max() < 0.8 * (level - 300.0)


def test_weakly_and_strongly_struck_pixels(small):
    """All electrons are counted, the weakest pixels are not marked; other marks stay."""
    state = masked(flat_state(small, exptime=1e5))
    state.mask[:] = 128
    struck(state)
    least = small.detector.cosmic_rays.marked_from
    assert np.array_equal(state.mask == 128 | COSMIC_RAY, state.counted >= least)
    assert ((state.mask == 128) == (state.counted < least)).all() and (state.counted == least).any()
