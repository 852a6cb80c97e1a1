"""Layers of charge in the pixel: inputs of their kernels, headers, masks, order and refusals."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.ndimage import convolve
from support.readout_state import change_exposure, flat_state, run

from csstsim.base.errors import InputError
from csstsim.base.rng import Streams, stream
from csstsim.detector import bfe_kernel
from csstsim.detector.blooming import bloom
from csstsim.detector.brighter_fatter import move_charge
from csstsim.detector.mask import BLED, SATURATED
from csstsim.layers import blooming, brighter_fatter, nonlinearity, prescan_overscan
from csstsim.simulation.sim_steps import SimSteps

RNG = Streams(3, "1", 9, "layer")
LAYERS = {layer.__name__.rpartition(".")[2]: layer for layer in (brighter_fatter, blooming, nonlinearity)}
END = ["bias", "readout_noise", "gain", "quantization_and_output"]
ORDERS = {
    "default": ["poisson_and_dark", "brighter_fatter", "blooming", "prescan_overscan", "nonlinearity", *END],
    "paper": ["poisson_and_dark", "brighter_fatter", "nonlinearity", "blooming", "prescan_overscan", *END],
}


def scene(camera, window=None, **detector):
    """A state with counted sky and a few saturated pixels; `detector` replaces its numbers."""
    state = flat_state(camera, window=window)
    change_exposure(state, chip=replace(state.chip, detector=replace(state.chip.detector, **detector)))
    x, y = np.meshgrid(np.arange(256), np.arange(64))
    whole = stream(2, "scene").poisson(40.0, (64, 256)) + 400_000.0 * ((x % 37 == 5) & (y % 23 == 9))
    window = state.window
    state.image = whole[window.y0 : window.y1, window.x0 : window.x1].astype(np.float32)
    return state


def camera_with(camera, **detector):
    return replace(camera, detector=replace(camera.detector, **detector))


def order(tmp_path, names):
    path = tmp_path / "order.yaml"
    path.write_text(yaml.safe_dump({"layers": [{name: {}} for name in names]}), encoding="utf-8")
    return SimSteps(path, "DARK")


@pytest.mark.parametrize("name", ORDERS)
def test_both_orders_run(small, tmp_path, name):
    steps = order(tmp_path, ORDERS[name])
    steps.check(small, flat_state(small).pointing)
    state = run(scene(small), steps)
    assert state.image.dtype == np.uint16 and state.image.max() > 60_000
    assert {"bfe_area", "saturated", "bloom_lost", "nonlinearity_cubic"} <= state.header.keys()


@pytest.mark.parametrize("window", [None, (30, 200, 3, 50)])
def test_brighter_fatter_moves_with_the_cameras_numbers(small, window):
    state = scene(small, window)
    wanted = state.image.copy()
    numbers = small.detector.brighter_fatter
    kernel, skew = bfe_kernel.kernel(numbers["scale"] * np.array(numbers["areas"]))
    move_charge(wanted, kernel, skew, small.detector.full_well)
    before = state.image.copy()
    state = brighter_fatter.apply(state, brighter_fatter.Param(), RNG)
    assert np.array_equal(state.image, wanted) and not np.array_equal(before, wanted)
    assert state.header["bfe_area"] == pytest.approx(-1.56e-6)


def test_spots_widen_by_a_per_cent_or_two(camera):
    """A star of 1.7 px FWHM filling its middle pixel: width^2 grows with flux; 1 to 2% in FWHM is what papers find."""
    y, x = np.mgrid[-10:11, -10:11]
    profile = np.exp(-(x**2 + y**2) / (2 * 0.75**2))
    growth = []
    for peak in (9000.0, 45_000.0, 90_000.0):
        state = flat_state(camera, window=(0, 21, 0, 21))
        state.image = (peak * profile).astype(np.float32)
        after = brighter_fatter.apply(state, brighter_fatter.Param(), RNG).image.astype(float)
        for axis in (x, y):
            width = [np.sqrt((image * axis**2).sum() / image.sum()) for image in (peak * profile, after)]
            growth.append(width[1] / width[0] - 1)
    growth = np.array(growth).reshape(3, 2)
    assert np.allclose(growth[1:] / growth[0], [[5, 5], [10, 10]], rtol=0.05)  # in proportion to the flux
    assert (growth[2] > 0.01).all() and (growth[2] < 0.03).all()


def test_blooming_spills_and_marks(small):
    state = scene(small)
    wanted, state.mask = state.image.copy(), np.full(state.image.shape, 128, np.uint8)
    mask = state.mask.copy()
    number, lost = bloom(wanted, small.detector.full_well, small.detector.bloom_row_share, mask)
    before = state.image.copy()
    state = blooming.apply(state, blooming.Param(), RNG)
    assert np.array_equal(state.image, wanted) and np.array_equal(state.mask, mask)
    assert (state.header["saturated"], state.header["bloom_lost"]) == (number, lost)
    assert number == (before > 90_000).sum() > 0
    assert ((state.mask & SATURATED > 0) == (before > 90_000)).all()
    assert ((state.mask & BLED > 0) == ((state.image > before) & (before <= 90_000))).all()
    assert (state.mask & 128).all()
    unmasked = blooming.apply(scene(small), blooming.Param(), RNG)
    assert unmasked.mask is None and np.array_equal(unmasked.image, wanted)
    straight = blooming.apply(scene(small), blooming.Param(row_share=0), RNG)
    assert np.array_equal(straight.image[:, :5], scene(small).image[:, :5])
    assert not np.array_equal(wanted[:, :5], scene(small).image[:, :5])


@pytest.mark.parametrize("many", [True, False])
@pytest.mark.parametrize("window", [None, (30, 200, 3, 50)])
def test_nonlinearity_in_either_frame(small, window, many):
    param = nonlinearity.Param(nonlinearity_16channel=many)
    before = nonlinearity.apply(scene(small, window), param, RNG)
    after = nonlinearity.apply(prescan_overscan.apply(scene(small, window), prescan_overscan.Param(), RNG), param, RNG)
    assert before.header == after.header
    before = prescan_overscan.apply(before, prescan_overscan.Param(), RNG)
    assert np.array_equal(before.image, after.image)
    pairs = np.transpose([before.header[f"nonlinearity_{name}"] for name in ("quadratic", "cubic")])
    assert pairs.shape == (16, 2) and len(np.unique(pairs[:, 0])) == (16 if many else 1)
    assert (np.abs(pairs[:, 0] / -5e-7 - 1) <= 0.1).all()


def test_one_polynomial_a_channel(small):
    state = flat_state(small, 50_000.0)
    state = nonlinearity.apply(state, nonlinearity.Param(nonlinearity_16channel=True), RNG)
    lower = state.image[:32].reshape(32, 8, 32)
    for i, quadratic in enumerate(state.header["nonlinearity_quadratic"][:8]):
        assert (lower[:, i] == np.float32(50_000 + quadratic * 2.5e9)).all()


def test_curves_that_fall_are_refused_in_check(small, tmp_path):
    steps, pointing = order(tmp_path, ORDERS["default"]), flat_state(small).pointing
    bad = camera_with(small, nonlinearity_quadratic=-6e-6)
    with pytest.raises(InputError, match=r"falls with charge within 0\.\.90000 e-") as error:
        steps.check(bad, pointing)
    assert "layers.nonlinearity" in str(error.value)
    edge = camera_with(small, nonlinearity_quadratic=-5.3e-6)
    nonlinearity.check(nonlinearity.Param(), edge, pointing)
    with pytest.raises(InputError, match="falls"):
        nonlinearity.check(nonlinearity.Param(nonlinearity_16channel=True), edge, pointing)


AREAS = [[-2e-6, 0, 0], [0, 0, 0], [0, 0, 0]]


@pytest.mark.parametrize("numbers", [
    {}, {"areas": AREAS}, {"areas": AREAS[:2], "scale": 1.0}, {"areas": AREAS, "scale": "strong"},
    {"areas": [["a", 0, 0], *AREAS[1:]], "scale": 1.0}, {"areas": AREAS, "scale": 10.0},
])  # fmt: skip
def test_unusable_areas_are_refused_in_check(small, numbers):
    with pytest.raises(InputError, match=r"brighter_fatter\.yaml"):
        brighter_fatter.check(brighter_fatter.Param(), camera_with(small, brighter_fatter=numbers), None)


def test_a_share_beyond_one_is_refused():
    for share in (-0.1, 1.1):
        with pytest.raises(ValueError, match="row_share"):
            blooming.Param(row_share=share)


@pytest.mark.parametrize("name", ["brighter_fatter", "blooming"])
def test_forgotten_counted_electrons_are_refused(small, name):
    state = flat_state(small)
    state.counted = np.ones(state.image.shape, np.int32)
    with pytest.raises(ValueError, match="poisson_and_dark must come before"):
        LAYERS[name].apply(state, LAYERS[name].Param(), RNG)


@pytest.mark.parametrize("name", LAYERS)
@pytest.mark.parametrize("window", [None, (31, 32, 40, 41)])
@pytest.mark.parametrize("level", [0.0, 2e5])
def test_empty_and_full_images(small, name, window, level):
    """All zero stays so; all saturated: uniform, at the full well after blooming, on the tangent after nonlinearity."""
    state = LAYERS[name].apply(flat_state(small, level, window=window), LAYERS[name].Param(), RNG)
    wanted = {"brighter_fatter": level, "blooming": min(level, 9e4), "nonlinearity": level and 85_950 + 0.91 * 1.1e5}
    assert np.abs(state.image - wanted[name]).max() < 0.02


@pytest.mark.parametrize("name", [name for name in LAYERS if name != "brighter_fatter"])
def test_negative_charge_stays_as_it_is(small, name):
    """What layers refuse, and what they make of all other images: test_edge_images."""
    state = flat_state(small, -3.0)
    assert (LAYERS[name].apply(state, LAYERS[name].Param(), RNG).image == -3).all()


def test_the_kernel_of_areas_made_of_a_kernel():
    """Areas as twice the Laplacian of a K, alike beside the middle, by scipy, and of a skew: both come back."""
    quadrant = np.array([[5.0, 2.5, 0.8], [2.5, 1.5, 0.4], [0.8, 0.5, 0.2]]) * 1e-6
    for skew in (3e-7, -2e-7):
        whole = np.zeros((9, 9))
        whole[2:7, 2:7] = bfe_kernel.unfold(quadrant)
        areas = 2 * convolve(whole, [[0, 1, 0], [1, -4, 1], [0, 1, 0]], mode="constant")
        areas[[3, 5], 4] += 2 * skew  # of the second difference along y
        areas[4, [3, 5]] -= 2 * skew
        potential, found = bfe_kernel.kernel(areas[4:7, 4:7])
        assert found == pytest.approx(skew, rel=1e-9)
        np.testing.assert_allclose(potential, quadrant, rtol=1e-9)


def test_boundaries_may_move_by_less_than_a_quarter_pixel_at_full_well(small):
    """The sum of all 25 numbers of K and the skew, times the full well, which is set just below and above."""
    numbers = small.detector.brighter_fatter
    potential, skew = bfe_kernel.kernel(numbers["scale"] * np.array(numbers["areas"]))
    edge, middle = potential[1:, 0].sum() + potential[0, 1:].sum(), potential[0, 0]
    whole = middle + 2 * edge + 4 * potential[1:, 1:].sum() + abs(skew)
    assert (potential > 0).all()
    bfe_kernel.detector_kernel(replace(small.detector, full_well=0.249 / whole))
    with pytest.raises(InputError, match="boundaries move too far") as error:
        bfe_kernel.detector_kernel(replace(small.detector, full_well=0.251 / whole))
    assert "0.251" in str(error.value) and "0.25 pixels" in str(error.value)


def test_one_polynomial_for_the_chip_unless_asked(small):
    assert nonlinearity.Param().nonlinearity_16channel is False and blooming.Param().row_share is None
    state = nonlinearity.apply(flat_state(small, 50_000.0), nonlinearity.Param(), RNG)
    quadratic, cubic = small.detector.nonlinearity_quadratic, small.detector.nonlinearity_cubic
    assert state.header == {"nonlinearity_quadratic": [quadratic] * 16, "nonlinearity_cubic": [cubic] * 16}


@pytest.mark.parametrize("half", [0, 1])
def test_channels_of_the_upper_half_are_bent_by_their_own_polynomial(small, half):
    """Channels 9 to 16 run from right to left."""
    state = nonlinearity.apply(flat_state(small, 50_000.0), nonlinearity.Param(nonlinearity_16channel=True), RNG)
    quadratic = np.reshape(state.header["nonlinearity_quadratic"], (2, 8))[half]
    found = state.image[48 if half else 16].reshape(8, 32)[:, 7]
    assert found == pytest.approx(50_000 + (quadratic[::-1] if half else quadratic) * 2.5e9, abs=0.01)
