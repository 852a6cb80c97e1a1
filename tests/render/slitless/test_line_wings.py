"""Wings of a spectrum against those of many points, each drawn by itself (render.wings)."""

import numpy as np
import pytest
from support.canvases import blank

from csstsim.instrument.chip import Window
from csstsim.optics.scatter.scattered_light import Scattered, scattered_light
from csstsim.render.far_wings import Side
from csstsim.render.slitless.line_wings import LINE_STEP, _box, add_line, order_wing, points_of
from csstsim.render.wings import StampLight, Wings, wing_beyond

WINDOW = Window(2800, 4200, 4300, 5400)
HALF = 32.0  # px, of the PSF's box
LIGHT = 1e8


@pytest.fixture(scope="module")
def scattered(camera):
    return Scattered(scattered_light(camera, camera.filters["GV"]).wing)


@pytest.fixture(scope="module")
def spectrum():
    """A trace of 400 px, 0.2 px a bin, brighter to the red, in a PSF whose mixture changes along it."""
    x = 3300.3 + 0.2 * np.arange(2000)
    light = LIGHT * np.linspace(0.5, 1.5, 2000) / 2000
    fraction = np.linspace(0, 3, 2000)
    mixture = np.clip(1 - np.abs(fraction - np.arange(4)[:, None]), 0, 1)
    return x, 4850.4 + 0.005 * (x - 3300), light * mixture


def inside(scattered, shows):
    """Share of the light in the box and in stamps: of wings that are what the box leaves out, and of no ring."""
    shown, far = wing_beyond(scattered.wing, HALF).light, wing_beyond(scattered.wing, HALF, shows).light
    return 1 - shown, 1 - far


def draw(spectrum, scattered, wing, window=WINDOW, response=None, **how):
    canvas = blank(window, float, response=response)
    wings = Wings(canvas, scattered.wing, HALF)
    drawn, box = add_line(wings, points_of(*spectrum), StampLight(*inside(scattered, wing > 0)), wing, **how)
    wings.add_to_canvas()
    return canvas.expected, drawn, box


def one_by_one(spectrum, scattered, step=10):
    """Points 2 px apart, pixel by pixel."""
    canvas, (x, y, light) = blank(WINDOW, float), spectrum
    for k in range(0, len(x), step):
        some = light[:, k : k + step]
        at = (some.sum(axis=0) * (x[k : k + step], y[k : k + step])).sum(axis=1) / some.sum()
        flux = some.sum(axis=1)
        held = flux @ inside(scattered, True)[0]
        Wings(canvas, scattered.wing, HALF).add(at, flux, StampLight(held, held), 900.0, near=1e5)
    return canvas.expected


def test_points_hold_all_light_and_its_centroid(spectrum):
    x, y, light = spectrum
    positions, flux = points_of(x, y, light)
    assert len(positions) == np.ceil((x[-1] - x[0]) / LINE_STEP)
    assert flux.sum(axis=0) == pytest.approx(light.sum(axis=1))
    for at, values in zip(positions.T, (x, y), strict=True):
        assert at @ flux.sum(axis=1) == pytest.approx(values @ light.sum(axis=0))
    dark, none = points_of(x, y, 0 * light)
    assert len(dark) == 0 and none.shape == (0, 4)


@pytest.mark.thorough
@pytest.mark.parametrize("wing", [100.0, 400.0, 1500.0])
def test_the_line_is_the_sum_of_its_points(spectrum, scattered, wing):
    """All light of the wing to 3e-3, and its level from 40 px off the trace on to 1.5%; where boxes fade (22 to 30 px)
    5% of its top, 10% at the ends of the trace. There the wing is under 1e-3 of the trace's own light."""
    image, drawn, _ = draw(spectrum, scattered, wing)
    expected = one_by_one(spectrum, scattered)
    assert image.sum() == pytest.approx(expected.sum(), rel=3e-3)
    assert drawn == pytest.approx(image.sum(), rel=1e-5)
    rows, columns = np.arange(WINDOW.y0, WINDOW.y1) - 4851.4, np.arange(WINDOW.x0, WINDOW.x1) - 3500
    for off in (40, 60, 80, 150, 300):
        row = np.abs(rows - off).argmin()
        lit = np.abs(columns) < 250
        assert np.abs(image[row, lit] / expected[row, lit] - 1).max() < 1.5e-2
    error, top = np.abs(image - expected), expected.max()
    assert error[:, np.abs(columns) < 150].max() < 0.05 * top
    assert error.max() < 0.1 * top
    assert top < 1e-3 * LIGHT / 400


def test_faint_haze_is_the_wing_beyond_the_box(spectrum, scattered):
    """wing_px 0: the level of a wing that shows, 60 px off the trace and further, to 4%; what is said is drawn."""
    hazy, drawn, box = draw(spectrum, scattered, 0.0)
    assert box is None and drawn == pytest.approx(hazy.sum(), rel=1e-5) and hazy.min() >= 0
    shown, *_ = draw(spectrum, scattered, 512.0)
    rows, lit = np.arange(WINDOW.y0, WINDOW.y1) - 4851.4, slice(500, 900)
    for off in (-300, -100, 60, 80, 200):
        row = np.abs(rows - off).argmin()
        assert hazy[row, lit] == pytest.approx(shown[row, lit], rel=0.04)


@pytest.mark.parametrize("wing", [0.0, 150.0, 900.0])
def test_two_sides_of_an_edge_are_the_whole(spectrum, scattered, wing):
    """Cut at an edge 7.3 px right of the object: both sides add up pixel by pixel, and each is dark far beyond."""
    whole, *_ = draw(spectrum, scattered, wing)
    left, light, _ = draw(spectrum, scattered, wing, side=Side(-np.inf, 7.3, -np.inf, np.inf))
    right, rest, _ = draw(spectrum, scattered, wing, side=Side(7.3, np.inf, -np.inf, np.inf))
    # Near the trace, where cubics of one side dip below zero and are cut off, 2% of the wing's top
    assert np.abs(left + right - whole).max() < 0.02 * whole.max()
    assert light + rest == pytest.approx(whole.sum(), rel=1e-3)
    assert light > rest > 0
    beyond_edge = np.arange(WINDOW.x0, WINDOW.x1) > 3700 + 7.3 + 80
    assert left[:, beyond_edge].max() < 1e-3 * whole[:, beyond_edge].max()


def test_a_window_and_the_response(spectrum, scattered):
    image, *_ = draw(spectrum, scattered, 900.0)
    part = Window(3201, 3333, 4801, 4899)
    small, _, box = draw(spectrum, scattered, 900.0, window=part)
    cut = slice(part.y0 - WINDOW.y0, part.y1 - WINDOW.y0), slice(part.x0 - WINDOW.x0, part.x1 - WINDOW.x0)
    assert np.abs(small - image[cut]).max() < 0.05 * image[cut].max()  # the mesh begins elsewhere
    assert box == (part.x0, part.x1, part.y0, part.y1)
    response = np.random.default_rng(1).uniform(0.5, 1, WINDOW.shape).astype(np.float32)
    seen, drawn, _ = draw(spectrum, scattered, 900.0, response=response)
    assert np.abs(seen - image * response).max() < 1e-5 * image.max()
    assert drawn == pytest.approx(seen.sum(), rel=1e-5)
    away, drawn, box = draw(spectrum, scattered, 150.0, window=Window(0, 100, 0, 100))
    level = spectrum[2].sum(axis=1) @ scattered.wing.profile(np.hypot(3500 - 49.5, 4850 - 49.5))
    assert away.mean() == pytest.approx(level, rel=0.02) and drawn == pytest.approx(away.sum()) and box is None


def test_no_order_loses_light_by_its_brightness(spectrum, scattered):
    """From hidden to long wings: all that a stamp does not hold, to 3e-3 of it; to 5e-3 if it holds 5% less.

    If it holds half, the light is far away, as of a galaxy larger than its stamp: none is put near.
    """
    reaches = [order_wing(300.0, fraction, HALF) for fraction in (1e-5, 1e-3, 5e-3, 0.03, 0.3, 1.0)] + [1500.0]
    assert reaches[0] == 0 and reaches[-2] > 3 * HALF
    far = []
    box, _ = inside(scattered, True)
    for reach in reaches:
        for held in (box, 0.95 * box, 0.5 * box):
            wings = Wings(blank(WINDOW, float), scattered.wing, HALF)
            far.append(add_line(wings, points_of(*spectrum), StampLight(box, held), reach)[0])
    full, small, half = far[::3], far[1::3], far[2::3]
    total = (spectrum[2].sum(axis=1) * box).sum()
    assert full == pytest.approx([full[-1]] * len(full), rel=3e-3)
    assert np.subtract(small, full) == pytest.approx([0.05 * total] * len(full), rel=5e-3)
    assert half == full


@pytest.mark.parametrize("sign", [1, -1])
def test_points_are_steps_of_eight_pixels_weighted_by_light(sign):
    """Five bins to two points, of which the second is empty; numbers by hand, whichever way the spectrum runs."""
    x, y = np.array([10.0, 12.0, 17.5, 20.0, 30.0]), np.array([1.0, 3.0, 5.0, 7.0, 9.0])
    light = np.zeros((4, 5))
    light[0], light[2] = [1.0, 3.0, 0.0, 0.0, 2.0], [0.0, 4.0, 0.0, 0.0, 0.0]
    positions, flux = points_of(x[::sign], y[::sign], light[:, ::sign])
    assert positions.tolist() == [[11.75, 2.75], [30.0, 9.0]]
    assert flux.tolist() == [[4.0, 0.0, 4.0, 0.0], [2.0, 0.0, 0.0, 0.0]]


def test_the_box_of_a_wing_along_a_trace():
    window = Window(100, 200, 40, 60)
    positions = np.array([[120.4, 50.0], [150.0, 45.2]])
    assert _box(window, positions, 4.0) == (117, 155, 42, 55)
    assert _box(window, positions, 300.0) == (100, 200, 40, 60)
    for shift in ((-60.0, 0.0), (90.0, 0.0), (0.0, -20.0), (0.0, 20.0)):
        assert _box(window, positions + shift, 4.0) is None


@pytest.mark.parametrize("wing", [0.0, 150.0, 900.0])
def test_an_edge_across_the_trace_cuts_rows(spectrum, scattered, wing):
    """Light up to 20.3 px above the object and from 11 px below: 80 px off the edges all of the wing, or nothing."""
    whole, *_ = draw(spectrum, scattered, wing)
    rows = np.arange(WINDOW.y0, WINDOW.y1) - 4851.4  # the trace rises by 2 px
    for low, high in ((-np.inf, 20.3), (-11.0, np.inf)):
        part, light, _ = draw(spectrum, scattered, wing, side=Side(-np.inf, np.inf, low, high))
        kept, dark = (rows > low + 80) & (rows < high - 80), (rows < low - 80) | (rows > high + 80)
        assert kept.sum() > 100 and dark.sum() > 100
        assert np.abs(part[kept] - whole[kept]).max() < 2e-3 * whole[kept].max()
        assert part[dark].max() < 1e-2 * whole[dark].max()  # far out many points are merged, and their edge is soft
        assert light == pytest.approx(part.sum(), rel=1e-4)
        if wing > 0 and high < 99:  # near the trace its wing is cut by the pixel, with an edge of 8 px
            beside = (rows > high + 20) & (rows < high + 35)
            assert part[beside].max() < 0.3 * whole[beside].max()
