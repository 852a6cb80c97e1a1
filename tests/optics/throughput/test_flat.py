"""Vignetting and internal flats: bounds, smoothness, reproducibility, wavelengths."""

from copy import deepcopy
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from csstsim.base.errors import InputError
from csstsim.base.rng import stream
from csstsim.detector.prnu import highest
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.optics.geometry.wcs import chip_plane
from csstsim.optics.throughput.coarse_grid import expand, grid_pixels
from csstsim.optics.throughput.flat import FlatField, _mosaic, check_flat
from csstsim.optics.throughput.led import load_leds
from csstsim.optics.throughput.response import Response, response_map, response_maximum
from csstsim.optics.throughput.shutter import exposed

EXPANSION = 1e-5  # relative: bilinear grid against the polynomials


def flats(camera, seed=3):
    return FlatField(camera.leds, partial(stream, seed, "camera"))


def test_vignetting_is_a_quadratic_polynomial_with_its_maximum_near_the_boresight(camera):
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-29758, 29758, 500), rng.uniform(-24876, 24876, 500)
    for seed in range(20):
        value = flats(camera, seed).vignetting(x, y)
        basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1) / np.array([1, 1e4, 1e4, 1e8, 1e8, 1e8])
        fit, *_ = np.linalg.lstsq(basis, value, rcond=None)
        np.testing.assert_allclose(basis @ fit, value, atol=1e-12)
        assert value.max() <= 1 and value.min() > 1 - 0.05 * 1.5
        assert flats(camera, seed).vignetting(0.0, 0.0) > 0.9995


def test_internal_flat_is_one_on_average_with_the_asked_spread(camera):
    values = []
    for seed in range(12):
        field = flats(camera, seed)
        for j in (0, 5, 11):
            chips = [field.internal(chip, *_mosaic(chip), np.eye(12)[j]).mean() for chip in camera.chips.values()]
            values.append([np.mean(chips) - 1, np.std(chips)])
    mean, spread = np.array(values).T
    assert abs(mean.mean()) < 5 * mean.std() / np.sqrt(len(mean)) and mean.std() < 0.02
    # chips average the pattern (0.02 rms, less inside a chip) and have levels of 0.01: 36 draws
    assert 0.012 < spread.mean() < 0.026


def test_wavelengths_near_each_other_look_alike(camera):
    chip = camera.chips[9]
    near, far = [], []
    for seed in range(30):
        a, b, c = (flats(camera, seed).internal(chip, *_mosaic(chip), np.eye(12)[j]).ravel() for j in (5, 6, 11))
        near.append(np.std(a - b))
        far.append(np.std(a - c))
    assert np.mean(near) < 0.4 * np.mean(far)  # 505 and 525 nm; 505 and 1050 nm


def test_maps_are_the_polynomials_and_windows_cuts_of_the_chip(camera):
    chip, filter_, field = camera.chips[30], camera.filters["GI"], flats(camera)
    whole = Window(0, 9216, 5000, 5040)
    grid = field.external_grid(chip, filter_)
    made = expand(grid, chip, whole)
    rotation, origin = chip_plane(chip)  # turned by 1 deg
    x, y = np.meshgrid(np.arange(0, 9216, 97), [5000, 5039])
    position = [r[0] * (x - origin[0]) + r[1] * (y - origin[1]) for r in rotation]
    weights = field.weights(filter_.wavelength, filter_.throughput)
    direct = field.vignetting(*position) * field.internal(chip, *position, weights)
    np.testing.assert_allclose(made[[0, 39]][:, ::97], direct, rtol=EXPANSION)
    cut = expand(grid, chip, Window(4000, 4100, 5010, 5020))
    np.testing.assert_array_equal(cut, made[10:20, 4000:4100])


def test_seeds_and_chips(camera):
    chip, filter_, window = camera.chips[9], camera.filters["r"], Window(0, 50, 0, 50)
    a, b, c = (expand(flats(camera, seed).external_grid(chip, filter_), chip, window) for seed in (3, 3, 4))
    np.testing.assert_array_equal(a, b)
    assert np.abs(a - c).max() > 1e-3


def test_weights_are_of_the_throughput(camera):
    field = flats(camera)
    for name in ("NUV", "r", "y"):
        weights = field.weights(camera.filters[name].wavelength, camera.filters[name].throughput)
        mean = np.average(camera.filters[name].wavelength / 10, weights=camera.filters[name].throughput)
        assert weights.sum() == pytest.approx(1) and (weights >= 0).all()
        inside = np.clip(mean, 275, 1050)
        assert weights @ field.wavelengths == pytest.approx(inside, abs=4.0)  # nm; NUV reaches below 275
    at_880 = field.weights(GRID, load_leds(camera.leds)["880"].line)
    assert set(np.flatnonzero(at_880 > 1e-6)) <= {9, 10, 11}  # 760, 940 and, by its width, 1050


def test_a_lamp_gives_its_photons_through_the_filter(camera):
    led, filter_ = load_leds(camera.leds)["670"], camera.filters["r"]
    assert np.trapezoid(led.line, GRID) == pytest.approx(1, rel=1e-6)
    assert np.trapezoid(led.line * filter_.at(GRID), GRID) == pytest.approx(filter_.at(6700.0), rel=0.02)
    assert not (led.line * camera.filters["NUV"].at(GRID)).any()


def test_bilinear_expansion_is_exact_for_planes(camera):
    chip = camera.chips[9]
    x, y = grid_pixels(chip, 5)
    out = expand(1 + 1e-5 * x - 2e-5 * y, chip, Window(9000, 9216, 9000, 9232))
    row, column = np.mgrid[9000:9232, 9000:9216]
    np.testing.assert_allclose(out, 1 + 1e-5 * column - 2e-5 * row, rtol=3e-7)


def test_nothing_asked_is_no_map(camera):
    chip, window = camera.chips[9], Window(0, 10, 0, 10)
    ask, field = partial(response_map, chip, window, camera.filters["r"], 150.0), flats(camera, 1)
    assert ask(flat=None, shutter=False) is None
    both, flat, shutter = ask(flat=field, shutter=True), ask(flat=field, shutter=False), ask(flat=None, shutter=True)
    np.testing.assert_allclose(both, flat * shutter, rtol=1e-6)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("flat", "wavelengths"), [500, 400]), (("flat", "order"), 0), (("flat", "correlation"), 0.0),
        (("vignetting", "corner"), [0.05, 0.03]), (("half_mosaic",), [0, 1]), (("flat", "pattern_rms"), "x"),
    ],
)  # fmt: skip
def test_bad_numbers_are_refused(camera, path, value):
    numbers = deepcopy(camera.leds)
    inner = numbers
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    with pytest.raises(InputError, match=rf"leds.yaml: {'.'.join(path)}: .*\(got .*; allowed: "):
        check_flat(numbers)
    del inner[path[-1]]
    with pytest.raises(InputError, match=rf"leds.yaml: {'.'.join(path)}: missing"):
        check_flat(numbers)


@pytest.mark.parametrize("row", [["x", 10, 1], ["500", 0, 1], ["500", 10, -1], ["500", 10], ["99", 10, 1]])
def test_bad_lamps_are_refused(row):
    with pytest.raises(InputError, match="bad row"):
        load_leds({"leds": [row]})


def test_each_detector_has_a_level_of_its_own_and_they_are_one_on_average(camera):
    """Without the pattern an internal flat is one number a chip, thirty of them, of mean 1 at each wavelength."""
    numbers = deepcopy(camera.leds)
    numbers["flat"]["pattern_rms"] = 0.0
    field = FlatField(numbers, partial(stream, 4, "camera"))
    for wave in np.eye(len(field.wavelengths))[[0, 7]]:
        levels = [field.internal(chip, *_mosaic(chip), wave) for chip in camera.chips.values()]
        assert max(np.ptp(level) for level in levels) == 0
        values = np.array([level.flat[0] for level in levels])
        assert len(np.unique(values)) == 30 and values.mean() == pytest.approx(1.0, rel=1e-12)


def test_the_scatter_of_detectors_levels_is_what_is_asked(camera):
    """Without a pattern; of 24 seeds, 30 detectors: 5 sigma of a standard deviation are 13%."""
    numbers = deepcopy(camera.leds)
    numbers["flat"] |= {"pattern_rms": 0.0, "detector_rms": 0.02}
    found = []
    for seed in range(24):
        field = FlatField(numbers, partial(stream, seed, "camera"))
        found += [field.internal(chip, *_mosaic(chip), np.eye(12)[3]).mean() for chip in camera.chips.values()]
    assert np.std(found) == pytest.approx(0.02 * np.sqrt(29 / 30), rel=0.13)


@pytest.mark.parametrize("skew", [0.0, 0.3])
def test_the_four_corners_lose_on_average_what_is_asked(camera, skew):
    """About the middle, whatever the skew, which takes from one axis what it gives to the other."""
    numbers = deepcopy(camera.leds)
    numbers["vignetting"] |= {"corner": [0.2, 0.2], "skew": skew, "offset": 0.0}
    half_x, half_y = numbers["half_mosaic"]
    seen = []
    for seed in range(5):
        field = FlatField(numbers, partial(stream, seed, "camera"))
        corners = field.vignetting(np.array([1, 1, -1, -1]) * half_x, np.array([1, -1, 1, -1]) * half_y)
        assert corners.mean() == pytest.approx(0.8, rel=1e-12)
        seen.append(np.ptp(corners))
    assert (max(seen) > 0.01) == (skew > 0)


def test_each_shape_has_an_equal_part_of_the_patterns_variance(camera):
    """One shape of the first LED at a time: the mean square over the mosaic is rms^2 / 14, of one axis or of both."""
    rms, (half_x, half_y) = camera.leds["flat"]["pattern_rms"], camera.leds["half_mosaic"]
    step = (np.arange(40) + 0.5) / 20 - 1  # middles of cells: means of cosines are exact
    x, y = np.meshgrid(half_x * step, half_y * step)
    for shape in range(14):  # i + j = 1 to 4

        def draw(size, shape=shape):
            values = np.zeros(size)
            if len(size) == 2:
                values[0, shape] = 1.0
            return values

        field = FlatField(camera.leds, lambda name, draw=draw: SimpleNamespace(standard_normal=draw))
        flat = field.internal(camera.chips[9], x, y, np.eye(12)[0])
        assert flat.mean() == pytest.approx(1.0) and np.mean((flat - 1) ** 2) == pytest.approx(rms**2 / 14, rel=1e-6)


EDGES = {  # key: (values that are taken, values that are not)
    "half_mosaic": ([[1, 2]], [[1, 0], [1], [1, 2, 3]]),
    "flat.wavelengths": ([[400, 500]], [[400], [400, 400], [500, 400]]),
    "flat.order": ([1, 8], [0, 9]),
    "flat.correlation": ([1e-3], [0, -1]),
    "flat.pattern_rms": ([0, 0.1], [-0.01, 0.11]),
    "flat.detector_rms": ([0, 0.1], [-0.01, 0.11]),
    "vignetting.corner": ([[0, 0.5], [0.1, 0.1]], [[-0.1, 0.1], [0.1, 0.6], [0.2, 0.1], [0.1]]),
    "vignetting.skew": ([0, 0.5], [-0.1, 0.6]),
    "vignetting.offset": ([0, 0.5], [-0.1, 0.6]),
}


@pytest.mark.parametrize("name", EDGES)
def test_each_number_of_the_lamps_has_its_bounds(camera, name):
    fine, wrong = EDGES[name]
    *above, last = name.split(".")
    for value in (*fine, *wrong):
        numbers = deepcopy(camera.leds)
        (numbers[above[0]] if above else numbers)[last] = value
        if value in fine:
            check_flat(numbers)
        else:
            with pytest.raises(InputError, match=rf"leds.yaml: {name}: missing or out of range"):
                check_flat(numbers)


def test_a_lamps_line_has_the_width_and_place_of_its_row():
    """Half its top at half the full width [nm] on either side; rows give name, width, rate in that order."""
    leds = load_leds({"leds": [["500", 20, 3.5], [670, 8.0, 0]]})
    assert list(leds) == ["500", "670"] and (leds["500"].fwhm, leds["500"].rate) == (20.0, 3.5)
    line = leds["500"].line
    assert GRID[line.argmax()] == 5000.0
    for off in (-100.0, 100.0):
        assert line[np.searchsorted(GRID, 5000.0 + off)] == pytest.approx(line.max() / 2, rel=1e-9)
    assert load_leds({}) == {} and leds["670"].rate == 0
    for row in (["500", 10, 1, 2], ["1100", 10, 1], ["200", 10, 1], ["500", 10, np.inf]):
        with pytest.raises(InputError, match="bad row"):
            load_leds({"leds": [row]})


def test_the_response_is_the_product_of_its_losses_for_any_pixels(camera):
    """A window off the corner: parts, rows and single pixels are cuts of the whole; each loss can be left out."""
    chip, window, filter_ = camera.chips[9], Window(3001, 3060, 7002, 7042), camera.filters["r"]
    master = np.random.default_rng(4).uniform(0.9, 1.1, window.shape).astype(np.float32)
    ask, field = partial(Response, chip, window, filter_, 20.0), flats(camera, 1)
    whole = ask(flat=field, shutter=True, prnu=np.uint64(9), master=master)
    image = whole.rows(0, window.ny)
    assert image.shape == window.shape and image.dtype == np.float32
    assert np.array_equal(whole.rows(5, 9), image[5:9])
    assert np.array_equal(whole.part(slice(3, 20), slice(11, 50)), image[3:20, 11:50])
    row, column = np.array([0, 39, 7, 20]), np.array([58, 0, 3, 31])
    assert whole.at(row, column) == pytest.approx(image[row, column], rel=1e-6)
    off = {"flat": None, "shutter": False}
    alone = [
        ask(**off | {"flat": field}).rows(0, 40), ask(**off | {"shutter": True}).rows(0, 40),
        ask(**off, prnu=np.uint64(9)).rows(0, 40), ask(**off, master=master).rows(0, 40),
    ]  # fmt: skip
    assert image == pytest.approx(np.prod(alone, axis=0), rel=1e-6)
    assert np.array_equal(alone[0], expand(field.external_grid(chip, filter_), chip, window))
    assert alone[1][0] == pytest.approx(exposed(chip, window, 20.0), rel=1e-6) and (alone[1] == alone[1][0]).all()
    assert alone[2].std() == pytest.approx(chip.detector.prnu, rel=0.1) and np.array_equal(alone[3], master)
    without = response_maximum(chip, filter_, None)
    assert without == pytest.approx(highest(chip.detector.prnu), rel=1e-5)
    assert response_maximum(chip, filter_, field) == pytest.approx(without * field.external_grid(chip, filter_).max())


def test_vignetting_is_centred_anywhere_within_its_offset(camera):
    """The vertex of the quadratic, where nothing is lost: up to 0.4 of half a mosaic off along x and along y."""
    numbers = deepcopy(camera.leds)
    numbers["vignetting"] |= {"corner": [0.2, 0.2], "skew": 0.0, "offset": 0.4}
    half = np.array(numbers["half_mosaic"])
    centres = []
    for seed in range(40):
        field = FlatField(numbers, partial(stream, seed, "camera"))
        low, middle, high = (
            np.array([field.vignetting(at * half[0], 0.0), field.vignetting(0.0, at * half[1])]) for at in (-1, 0, 1)
        )
        centre = (high - low) / (2 * (2 * middle - low - high))
        assert field.vignetting(*(centre * half)) == pytest.approx(1.0, abs=1e-12)
        centres.append(centre)
    assert (np.abs(centres).max(axis=0) <= 0.4).all() and (np.abs(centres).max(axis=0) > 0.3).all()


def test_flats_are_alike_by_the_ratio_of_their_wavelengths(camera):
    """One random number of the pattern at a time: the covariance is exp(-0.5 (ln ratio / correlation)^2)."""
    count, (half_x, half_y) = len(camera.leds["flat"]["wavelengths"]), camera.leds["half_mosaic"]
    made = []
    for i in range(count):

        def draw(size, i=i):
            values = np.zeros(size)
            if len(size) == 2:
                values[i, 0] = 1.0
            return values

        field = FlatField(camera.leds, lambda name, draw=draw: SimpleNamespace(standard_normal=draw))
        at = camera.chips[9], 0.3 * half_x, 0.2 * half_y
        made.append([float(field.internal(*at, weights)) - 1 for weights in np.eye(count)])
    covariance = np.einsum("ij,ik->jk", made, made)
    ratio = np.log(np.divide.outer(field.wavelengths, field.wavelengths)) / camera.leds["flat"]["correlation"]
    assert covariance / covariance[0, 0] == pytest.approx(np.exp(-0.5 * ratio**2), abs=1e-6)
