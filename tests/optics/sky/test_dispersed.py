"""The sky through gratings: trapezoids in closed form, conservation, points dispersed one by one, edges, windows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import qmc
from support.readout_state import flat_state
from support.sky_geometry import camera, numbers

from csstsim.base.arrays.bounds import Bounds
from csstsim.base.errors import InputError
from csstsim.base.rng import Streams
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.instrument.grating import DiffractionOrder, Grating, Gratings
from csstsim.layers import sky_background
from csstsim.optics.sky.background_spectra import band, sunlight
from csstsim.optics.sky.dispersed import disperse, node_rows, nominal_spectrum, order_rows, sky_spectrum
from csstsim.optics.sky.zodiacal import spectrum

CAMERA, N = camera(), numbers()
SLITLESS = [chip.id for chip in CAMERA.slitless_chips]


def nominal(chip):
    return nominal_spectrum(CAMERA.filters[CAMERA.chips[chip].filter], N)


def even(gratings, window, spectrum, level=1.0):
    """Return a sky of `level` everywhere through the gratings, (ny, nx)."""
    image, full = np.zeros(window.shape, np.float32), np.full(window.shape, level, np.float32)
    disperse(image, lambda rows: full[rows], gratings, window, spectrum)
    return image


def straight(number, offset, per_px, blue, red, level=0.3, y_offset=0.0):
    """An order that is the same all over the field: x = offset + lambda / per_px, over a box of wavelengths."""
    table = np.zeros((6, 6))
    table[:, 0] = 0.0, y_offset, 0.0, 0.0, -offset * per_px, per_px
    return DiffractionOrder(number, (0, 0), table, np.where((blue <= GRID) & (red >= GRID), level, 0.0))


def trapezoid(x, low, high, first, last):
    """Mean over the pixels at x of the fraction of shifts first..last that bring them light from low..high."""

    def ramp(position):  # integral of the share lit by a half plane beyond 0, shifted by first..last
        inside = np.clip(position, first, last)
        return 0.5 * (inside - first) ** 2 / (last - first) + np.maximum(position - last, 0.0)

    def filled(edge):
        return ramp(x + 0.5 - edge) - ramp(x - 0.5 - edge)

    return filled(low) - filled(high)


@pytest.mark.parametrize("per_px", [7.1, -7.1])
@pytest.mark.parametrize("piece", [(300.25, 1200.6), (300.25, 420.0)])  # longer and shorter than the spectrum
def test_box_spectrum_gives_a_trapezoid(per_px, piece):
    blue, red = 4000.0, 6000.0
    order, window = straight(1, 5.0, per_px, blue, red), Window(-1500, 2500, 0, 3)
    found = order_rows(order, (*piece, -4000.0, 4000.0), np.array([0.0, 1.0]), window, np.full(len(GRID), 1e-3))
    shifts = sorted(5.0 + (wave / per_px) for wave in (blue - 0.25, red + 0.25))
    expected = 1e-3 * 0.3 * (red - blue + 0.5) * trapezoid(np.arange(-1500, 2500), *piece, *shifts)
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-4 * expected.max(), rtol=0)
    assert expected.max() > 0.1 and (np.abs(found[:, [0, -1]]) < 1e-15).all()


def test_a_first_order_without_end_is_the_nominal_sky():
    order = CAMERA.gratings[5].left.orders[1]
    plain = replace(order, coefficients=order.coefficients * [1, 0, 0, 0, 0, 0])
    window = Window(3000, 3100, 3000, 3010)
    found = order_rows(plain, (-1e4, 2e4, -1e4, 2e4), np.array([3000.0, 4096.0]), window, nominal(5))
    np.testing.assert_allclose(found, 1.0, rtol=1e-3)  # the sensitivities are the filter's curve, sampled


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("number", [-2, -1, 0, 1, 2])
def test_all_light_of_a_piece_lands_somewhere(side, number):
    gratings, spectrum, plane = CAMERA.gratings[5], nominal(5), Window(-4096, 14336, -4096, 14336)
    grating, piece = gratings.pieces[side]
    order, rows = grating.orders[number], node_rows(gratings, plane)
    lines = order_rows(order, piece, rows, plane, spectrum).sum(axis=1)
    found = np.interp(np.arange(plane.y0, plane.y1), rows, lines).sum()
    area = (piece[1] - piece[0]) * (piece[3] - piece[2])
    assert found == pytest.approx(area * 0.5 * (spectrum * order.throughput).sum(), rel=1e-5)


@pytest.mark.thorough
@pytest.mark.parametrize(("number", "bin_px", "wide"), [(0, 1, 24), (1, 40, 1280), (-1, 80, 2400), (2, 80, 2400)])
def test_points_dispersed_one_by_one(number, bin_px, wide):
    """Around the split of a real chip, forward through the traces only, both pieces: 0.3% of the level (sampling)."""
    gratings, spectrum, rows = CAMERA.gratings[29], nominal(29), np.arange(8500, 8516)
    start = int(gratings.split) - wide // 2
    window, found, direct = Window(start, start + wide, 8500, 8516), 0.0, 0.0
    bins = np.arange(start - 0.5, start + wide, bin_px), [rows[0] - 0.5, rows[-1] + 0.5]
    for grating, piece in gratings.pieces:
        order = grating.orders[number]
        far = wide / 2 + max(abs(order.lines(5000.0, 8500.0) @ [1.0, wave, 0.0, 0.0]) for wave in order.range) + 20
        x0, x1 = max(piece[0], gratings.split - far), min(piece[1], gratings.split + far)
        y0, y1 = rows[0] - 10.0, rows[-1] + 10.0
        u, v, w = qmc.Sobol(3, seed=4).random_base2(20).T
        x, y = x0 + (x1 - x0) * u, y0 + (y1 - y0) * v
        light = spectrum * order.throughput
        wave = np.interp(w, np.cumsum(light) / light.sum(), GRID + 0.25)  # drawn as the light has it
        p, q, r, s = order.lines(x, y).T
        seen = np.histogram2d(x + p + q * wave, y + r + s * wave, bins=bins)[0][:, 0]
        direct = direct + seen * 0.5 * light.sum() * (x1 - x0) * (y1 - y0) / len(u) / (bin_px * len(rows))
        found = found + order_rows(order, piece, rows.astype(float), window, spectrum).mean(axis=0)
    found = found.reshape(-1, bin_px).mean(axis=1)
    np.testing.assert_allclose(found, direct, atol=3e-3 * direct.max(), rtol=0)
    assert found.mean() == pytest.approx(direct.mean(), rel=5e-4)


def test_a_piece_ends_within_a_row():
    """The zeroth order is moved by 2 px in y: a frame up to row 5000.25 lights three quarters of row 5002."""
    shipped = CAMERA.gratings[5]
    zeroth = [Grating(grating.name, {0: grating.orders[0]}) for grating, _ in shipped.pieces]
    gratings = Gratings(*zeroth, shipped.split, Bounds(-300.0, 9600.0, 4000.75, 5000.25))
    sky = even(gratings, Window(500, 530, 3990, 5030), nominal(5))
    expected = np.interp(np.arange(3990, 5030), [4002, 4003, 4004, 5001, 5002, 5003], [0, 0.75, 1, 1, 0.75, 0])
    np.testing.assert_allclose(sky, np.broadcast_to(0.1 * expected[:, None], sky.shape), atol=1e-4)
    assert (sky[[0, 12, -1]] == 0).all()


def whole(chip, level=1.0):
    return even(CAMERA.gratings[chip], CAMERA.chips[chip].full_window, nominal(chip), level)


def test_what_is_added():
    """A sky that changes along y, the response, light that was there already, and the mean before losses."""
    window, gratings = Window(4000, 4100, 77, 177), CAMERA.gratings[5]
    slope, seen = np.linspace(1, 2, 100, dtype=np.float32)[:, None], np.full(window.shape, 0.25, np.float32)
    image = np.full(window.shape, 3.0, np.float32)
    mean = disperse(image, lambda rows: np.tile(slope[rows], 100), gratings, window, nominal(5), seen)
    expected = slope * even(gratings, window, nominal(5))
    np.testing.assert_allclose(image, 3.0 + 0.25 * expected, rtol=3e-7)
    assert mean == pytest.approx(expected.mean(dtype=float), rel=1e-7)


def test_a_window_has_the_pixels_of_the_chip():
    sky, gratings = whole(5), CAMERA.gratings[5]
    for x0, x1, y0, y1 in [(0, 300, 0, 40), (3600, 3800, 2040, 2060), (9100, 9216, 9200, 9232), (4000, 4001, 77, 78)]:
        part = even(gratings, Window(x0, x1, y0, y1), nominal(5))
        np.testing.assert_allclose(part, sky[y0:y1, x0:x1], rtol=3e-7)


@pytest.mark.parametrize("chip", SLITLESS)
def test_level_and_direction(chip):
    """A level by the shifts in the middle of the chip alone; at the split orders 1 and 2 double, and 0 on 16 px."""
    gratings, spectrum, nx = CAMERA.gratings[chip], nominal(chip), CAMERA.chips[chip].detector.nx
    middle = Window(0, nx, 4600, 4601)
    sky, expected = even(gratings, middle, spectrum), 0.0
    for grating, (x0, x1, _, _) in gratings.pieces:
        for order in grating.orders.values():
            light = 0.5 * spectrum * order.throughput
            p, q, _, _ = order.lines(nx / 2, 4600.0)
            shift = p + q * GRID
            inside = np.clip(x1 + shift, -0.5, nx - 0.5) - np.clip(x0 + shift, -0.5, nx - 0.5)
            expected += (light * inside).sum() / nx
            if order.number == 1:  # inwards: gratings.yaml
                assert np.sign(shift[10000]) == (1 if grating is gratings.left else -1)
    assert sky.mean() == pytest.approx(expected, rel=1e-3)
    split = int(gratings.split)
    assert sky[0, split - 100 : split + 100].mean() == pytest.approx(2 + 2 * 0.02 + 0.1 * 216 / 200, abs=2e-3)


def test_the_nominal_sky_is_one_sky():
    """Where two gratings overlap, their nominal rates and spectra mean the same light: 15%, as rates are rounded."""
    for one, other, wave in (("GU", "GV", 4000.0), ("GV", "GI", 6350.0)):
        levels = [CAMERA.filters[f].sky * nominal_spectrum(CAMERA.filters[f], N)[wave == GRID] for f in (one, other)]
        assert levels[0] == pytest.approx(levels[1], rel=0.15)


def test_the_spectrum_is_that_of_one_electron():
    filter_ = CAMERA.filters["GU"]
    for parts in ({"zodiacal": 0.1, "earth": 0.02, "moon": 0.3}, {"stars": 2.0}):
        assert band(filter_, sky_spectrum(filter_, parts, 60.0, N)) == pytest.approx(1.0)
    mixed = sky_spectrum(filter_, {"zodiacal": 3.0, "earth": 1.0}, 60.0, N)
    one, other = (sky_spectrum(filter_, {name: 1.0}, 60.0, N) for name in ("zodiacal", "earth"))
    np.testing.assert_allclose(mixed, 0.75 * one + 0.25 * other)
    assert (other / one)[GRID == 3000.0] < 0.4 * (other / one)[GRID == 4000.0]  # ozone


@pytest.mark.parametrize("model", [False, True])
def test_the_layer(model):
    """Twice the time, twice the sky; its rate in the header is the mean; components of the model sum to it."""
    frames = []
    for exptime in (100.0, 200.0):
        state = flat_state(
            CAMERA, chip=3, window=(3000, 4500, 50, 60), sat_position=(2596.0, 4496.0, -4357.0), exptime=exptime
        )
        param = sky_background.Param(enable_straylight_model=model)
        sky_background.apply(state, param, Streams(5, "1", 3, "sky_background"))
        assert state.header["sky_rate"] == pytest.approx(state.image.mean(dtype=float) / exptime, rel=1e-6)
        frames.append(state.image)
    np.testing.assert_allclose(frames[1], 2 * frames[0], rtol=3e-3)  # the spacecraft moves on
    components = (
        sum(value for name, value in state.header.items() if name.startswith("sky_")) - state.header["sky_rate"]
    )
    assert components == pytest.approx(state.header["sky_rate"] if model else 0.0)
    shape = frames[0] / even(state.exposure.gratings, state.window, nominal(3))
    if model:
        assert 1e-3 < np.ptp(shape) / shape.mean() < 0.2  # its colour is not the nominal one: ramps differ
    else:
        np.testing.assert_allclose(shape, 100 * 0.016, rtol=1e-6)


def test_the_colour_of_the_sky_is_needed():
    grey = replace(CAMERA, sky={})
    state = flat_state(grey, chip=3, window=(3000, 3010, 50, 60), sat_position=(2596.0, 4496.0, -4357.0))
    with pytest.raises(InputError, match="no sky parameters"):
        sky_background.apply(state, sky_background.Param(), Streams(5, "1", 3, "sky_background"))


def test_the_nominal_spectrum_is_zodiacal_light_with_earthshine():
    """In the V band one part of the first, of the colour far from the Sun, and `nominal` of the second."""
    filter_ = CAMERA.filters["GV"]
    wave = filter_.wavelength
    zodi = spectrum(wave, N)[1]
    sun, sun_v = sunlight(wave, N), sunlight(np.array([5500.0]), N)[0]
    earth = sun * np.interp(wave, *N.earth.spectrum.T)
    shape = zodi * sun_v / spectrum(np.array([5500.0]), N)[1, 0] + N.earth.nominal * earth
    found = nominal_spectrum(filter_, N)
    lit = shape > 0
    np.testing.assert_allclose(found[lit] * band(filter_, shape) / shape[lit], 1.0, rtol=1e-3)
    assert band(filter_, found) == pytest.approx(1.0)


def test_zodiacal_light_has_the_colour_of_its_angle_from_the_sun():
    filter_ = CAMERA.filters["GI"]
    near, far = spectrum(filter_.wavelength, N)
    for angle, fraction in ((20.0, 1.0), (60.0, 0.5), (120.0, 0.0)):
        shape = fraction * near + (1 - fraction) * far
        found = sky_spectrum(filter_, {"zodiacal": 0.3}, angle, N)
        np.testing.assert_allclose(found, shape / band(filter_, shape), rtol=1e-9)
    sun = sunlight(filter_.wavelength, N)
    for name in ("sun", "moon", "planets", "stars"):
        np.testing.assert_allclose(sky_spectrum(filter_, {name: 2.0}, 60.0, N), sun / band(filter_, sun), rtol=1e-12)
