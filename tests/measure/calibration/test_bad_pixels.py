"""Defects and cosmic rays are found, filled and flagged by `measure`; stars are not taken for them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, maximum_filter
from scipy.special import erf
from support.readout_state import flat_state, run, small_camera

from csstsim.base.rng import Streams, stream
from csstsim.base.shipped import SHIPPED
from csstsim.detector import mask
from csstsim.measure import source_columns
from csstsim.measure.calibration import bad_pixels
from csstsim.measure.calibration.calibrate import Calibrated
from csstsim.measure.light.photometry import psf_model
from csstsim.simulation.sim_steps import SimSteps

N = 600


@pytest.fixture(scope="module")
def model(fabricate):
    return psf_model(fabricate.psf, (0, 0), (N, N))


def looked(fabricate, model, image):
    none = np.zeros(image.shape, bool)
    return bad_pixels.cosmic_rays(image, none, none, fabricate.READ_NOISE, model)


def test_smallest_pairs_are_those_of_the_gaussian(fabricate, model):
    """Star and pixel pair in one dimension have a closed form; it is least for a star on the middle of its pixel."""
    edges = 0.5 * (1 + erf(np.arange(-1.5, 2.0) / (fabricate.SIGMA * np.sqrt(2))))
    pair, middle = np.diff(edges)[:2]
    pair /= middle
    found = model.smallest_pairs(np.linspace(-0.5, 0.5, 5))
    assert found == pytest.approx([pair, pair, pair**2, pair**2], rel=0.01)  # of splines


def test_stars_are_no_cosmic_rays(fabricate, model):
    rng = stream(40, "stars")
    line = np.arange(20, N - 20, 20)
    x, y = (v.ravel() + rng.uniform(-0.5, 0.5, line.size**2) for v in np.meshgrid(line, line))
    flux = 10.0 ** rng.uniform(2.0, 5.5, x.size)
    image = np.zeros((N, N))
    fabricate.add_stars(image, x, y, flux)
    found = looked(fabricate, model, fabricate.add_noise(image, 41))
    hit = found[np.rint(y).astype(int), np.rint(x).astype(int)]
    assert x.size == 784
    assert hit.sum() <= 4  # half a per cent: faint ones with a noise peak of 5 sigma
    assert not hit[flux > 2000].any()


def test_rays_are_found_and_their_light_is_gone(fabricate, model):
    """Straight tracks of 500 to 5000 e-: 95% of the pixels above 5 sigma, and what is left is noise."""
    rng, noisy, rays = stream(42, "rays"), fabricate.add_noise(np.zeros((N, N)), 43), np.zeros((N, N))
    for _ in range(120):
        length, turn = rng.uniform(0, 15), rng.uniform(0, np.pi)
        position = rng.uniform(20, N - 20, 2)[:, None] + np.outer(
            (np.sin(turn), np.cos(turn)), np.arange(0, length + 0.1, 0.1)
        )
        where = np.rint(position + rng.normal(0, 0.2, position.shape)).astype(int)  # diffusion
        np.add.at(rays, tuple(where), 10 ** rng.uniform(2.7, 3.7) / position.shape[1])
    image = noisy + rays.astype(np.float32)
    found = looked(fabricate, model, image)
    strong = rays > 5 * np.sqrt(fabricate.VARIANCE)
    assert strong.sum() > 300
    assert found[strong].mean() > 0.95
    assert found.mean() < 9 * (rays > 0).mean()  # a pixel more on all sides
    bad_pixels.fill(image, found)
    assert abs(image[found].mean() - fabricate.SKY) < 5 * np.sqrt(fabricate.VARIANCE / 9) / np.sqrt(found.sum() / 20)
    table = fabricate.measure(noisy + rays.astype(np.float32))
    good = (table["flags"] & (source_columns.BAD_PIXELS | source_columns.SHARP | source_columns.NOT_CENTRED)) == 0
    clean = fabricate.measure(noisy.copy())
    assert (table["snr"][good] > 5).sum() <= (clean["snr"] > 5).sum() + 3  # of 120 rays


def test_a_star_next_to_a_ray_keeps_its_flux_and_says_so(fabricate):
    image = np.zeros((200, 200))
    fabricate.add_stars(image, [60.2, 140.1], [60.4, 139.8], [30000.0, 30000.0])
    noisy = fabricate.add_noise(image, 44)
    struck = noisy.copy()
    struck[50:71, 63] += 3000.0
    clean, table = fabricate.measure(noisy), fabricate.measure(struck)
    row = int(np.argmin(np.hypot(table["x"] - 60.2, table["y"] - 60.4)))
    assert table["flags"][row] & source_columns.BAD_PIXELS
    assert table["flux_psf"][row] == pytest.approx(30000.0, abs=5 * table["flux_psf_err"][row] + 600)  # 2% of centring
    assert (clean["flags"][clean["snr"] > 100] == 0).all()


@pytest.mark.parametrize("off", ["nothing", "hot_pixels", "dead_pixels", "bad_columns"])
def test_known_defects_are_those_of_the_layer(tmp_path, off):
    camera = small_camera(tmp_path)
    [step] = [step for step in SimSteps(SHIPPED / "observations" / "dark.yaml") if step.name == "detector_defects"]
    step = replace(step, param=step.param.model_copy(update={off: False}))
    rng = Streams(11, "any", 9, "measure")
    for window in (None, (30, 100, 20, 90)):
        state = flat_state(camera, 40.0, window=window)
        state.mask = np.zeros(state.image.shape, np.uint8)
        run(state, [step], seed=11)
        known = bad_pixels.known_defects(state.chip, state.window, step.param, rng)
        assert known.any() or window or off == "bad_columns"
        assert np.array_equal(known, state.mask & (mask.HOT | mask.DEAD | mask.BAD_COLUMN) > 0)


def test_fill():
    image = np.arange(25, dtype=np.float32).reshape(5, 5)
    bad = np.zeros((5, 5), bool)
    bad[2, 2] = bad[0, 0] = True
    filled = image.copy()
    bad_pixels.fill(filled, bad)
    assert filled[2, 2] == 12.0 and filled[0, 0] == pytest.approx((1 + 5 + 6) / 3)
    assert np.array_equal(filled[~bad], image[~bad])
    bad[:] = True
    bad_pixels.fill(image, bad)  # nothing to fill it from
    assert image[4, 4] == 24.0
    wide = np.full((60, 60), 7.0, np.float32)
    wide[:, :30] = 3.0
    bad = np.ones((60, 60), bool)
    bad[:, 59] = False
    bad_pixels.fill(wide, bad)  # beyond its neighbours' reach: the median
    assert (wide == 7.0).all()


@pytest.mark.parametrize("shape", [(1, 1), (2, 5), (3, 3)])
def test_small_frames_have_no_rays(fabricate, model, shape):
    assert not looked(fabricate, model, np.full(shape, 50.0, np.float32)).any()


def plain_rays(image, left_out, sky, read_variance, pairs):
    """The rule of the module's docstring, pixel by pixel in plain Python; pairs by (dy, dx)."""
    found, ny, nx = np.zeros(image.shape, bool), *image.shape

    def struck(y, x, least, doubt):
        noise = max(image[y, x], 0) + read_variance
        value = float(image[y, x]) - sky
        if value < least * noise**0.5 or found[y, x] or left_out[y, x]:
            return False
        for (dy, dx), ratio in pairs.items():
            sides = [p for p in ((y - dy, x - dx), (y + dy, x + dx)) if not (found[p] or left_out[p])]
            if sides:
                light = sum(float(image[p]) - sky for p in sides)
                light += doubt * sum(max(image[p], 0) + read_variance for p in sides) ** 0.5
                if value - doubt * noise**0.5 > light / len(sides) / ratio:
                    return True
        return False

    positions = [(y, x) for y in range(1, ny - 1) for x in range(1, nx - 1)]
    for position in positions:
        found[position] = struck(*position, bad_pixels.SIGMA, bad_pixels.NOISE)
    queue = [position for position in positions if found[position]]
    while queue:
        y, x = queue.pop()
        for position in positions:
            if (
                abs(position[0] - y) < 2
                and abs(position[1] - x) < 2
                and struck(*position, bad_pixels.NEIGHBOUR_SIGMA, 0.0)
            ):
                found[position] = True
                queue.append(position)
    return maximum_filter(found, 3)


def test_rays_are_those_of_the_rule_in_plain_python(fabricate, model):
    rng = stream(46, "rays")
    image = rng.normal(fabricate.SKY, np.sqrt(fabricate.VARIANCE), (40, 44)).astype(np.float32)
    image[rng.random(image.shape) < 0.02] += 400.0
    image[20, 5:30] += 300.0
    image[10:13, 30:33] = 8e4
    image[14, 33] = 900.0  # 3 px from it by steps along the axes: left out
    saturated, known = image > 5e4, rng.random(image.shape) < 0.01
    looked = bad_pixels.cosmic_rays(image, saturated, known, fabricate.READ_NOISE, model)
    y, x = np.mgrid[-3:4, -3:4]
    left_out = known | binary_dilation(saturated, abs(y) + abs(x) <= 3)
    ratios = bad_pixels.RATIO_FRACTION * model.smallest_pairs(np.linspace(-0.5, 0.5, 5))
    pairs = dict(zip([(0, 1), (1, 0), (1, 1), (1, -1)], ratios, strict=True))
    wanted = plain_rays(image, left_out, np.median(image[::8, ::8]), fabricate.READ_NOISE**2, pairs)
    assert wanted.sum() > 100
    assert np.array_equal(looked, wanted)


@pytest.mark.parametrize("shape", [(1, 30), (30, 1), (30, 40)])
def test_a_frame_without_a_pixel_to_use(fabricate, model, shape):
    """All saturated, all bad, or no numbers: nothing is found, and what can be filled from nothing stays."""
    full = np.ones(shape, bool)
    for saturated, bad, value in ((full, ~full, 9e4), (~full, full, 9e4), (~full, ~full, np.nan)):
        image = np.full(shape, value, np.float32)
        marks = bad_pixels.fill_bad_pixels(
            Calibrated(image, bad_pixels.FULL * saturated | bad_pixels.BAD * bad, {}, {1: 5.0}, None), model
        )
        assert np.array_equal(marks, bad_pixels.FULL * saturated | bad_pixels.BAD * bad)
        np.testing.assert_array_equal(image, np.float32(value))
