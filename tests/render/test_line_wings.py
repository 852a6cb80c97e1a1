"""Wings of a spectrum against those of many points, each drawn by itself (render.wings)."""

import numpy as np
import pytest

from csstsim.instrument.chip import Window
from csstsim.optics.beyond import Beyond, beyond_box
from csstsim.render.far_wings import FarWings
from csstsim.render.line_wings import LINE_STEP, add_line, order_wing, points_of
from csstsim.render.wings import add_beyond

WINDOW = Window(2800, 4200, 4300, 5400)
HALF = 32.0  # px, of the PSF's box
LIGHT = 1e8


@pytest.fixture(scope="module")
def beyond(camera):
    return Beyond(beyond_box(camera, camera.filters["GV"]).wing)


@pytest.fixture(scope="module")
def spectrum():
    """A trace of 400 px, 0.2 px a bin, brighter to the red, in a PSF whose mixture changes along it."""
    x = 3300.3 + 0.2 * np.arange(2000)
    light = LIGHT * np.linspace(0.5, 1.5, 2000) / 2000
    share = np.linspace(0, 3, 2000)
    mixture = np.clip(1 - np.abs(share - np.arange(4)[:, None]), 0, 1)
    return x, 4850.4 + 0.005 * (x - 3300), light * mixture


def draw(spectrum, beyond, wing, window=WINDOW, response=None, **how):
    image, response = np.zeros(window.shape), np.ones(window.shape, np.float32) if response is None else response
    far = FarWings(window, response)
    points = points_of(*spectrum)
    drawn, box = add_line(image, response, window, *points, beyond.wing, wing, HALF, far, **how)
    far.lay(image)
    return image, drawn, box


def one_by_one(spectrum, beyond, wing, step=10):
    """Points 2 px apart."""
    image, one = np.zeros(WINDOW.shape), np.ones(WINDOW.shape, np.float32)
    x, y, light = spectrum
    for k in range(0, len(x), step):
        some = light[:, k : k + step]
        at = (some.sum(axis=0) * (x[k : k + step], y[k : k + step])).sum(axis=1) / some.sum()
        add_beyond(image, one, WINDOW, None, *at, some.sum(axis=1), beyond, wing, HALF)
    return image


def test_points_hold_all_light_and_its_centroid(spectrum):
    x, y, light = spectrum
    places, flux = points_of(x, y, light)
    assert len(places) == np.ceil((x[-1] - x[0]) / LINE_STEP)
    assert flux.sum(axis=0) == pytest.approx(light.sum(axis=1))
    for at, values in zip(places.T, (x, y), strict=True):
        assert at @ flux.sum(axis=1) == pytest.approx(values @ light.sum(axis=0))
    dark, none = points_of(x, y, 0 * light)
    assert len(dark) == 0 and none.shape == (0, 4)


@pytest.mark.parametrize("wing, light, far", [(100.0, 5e-3, 1e-2), (400.0, 3e-3, 1.5e-2), (1500.0, 3e-3, 1.5e-2)])
def test_the_line_is_the_sum_of_its_points(spectrum, beyond, wing, light, far):
    """All light of the wing, and its level from 40 px off the trace on; where boxes fade (22 to 30 px) 5% of its
    top, 10% at the ends of the trace. There the wing is under 1e-3 of the trace's own light."""
    image, drawn, _ = draw(spectrum, beyond, wing)
    expected = one_by_one(spectrum, beyond, wing)
    assert image.sum() == pytest.approx(expected.sum(), rel=light)
    assert drawn == pytest.approx(image.sum(), rel=1e-5)
    rows, columns = np.arange(WINDOW.y0, WINDOW.y1) - 4851.4, np.arange(WINDOW.x0, WINDOW.x1) - 3500
    for off in (40, 60, 80, 150, 300):
        if off < 0.7 * wing:
            row = np.abs(rows - off).argmin()
            lit = np.abs(columns) < 250
            assert np.abs(image[row, lit] / expected[row, lit] - 1).max() < far
    error, top = np.abs(image - expected), expected.max()
    assert error[:, np.abs(columns) < 150].max() < 0.05 * top
    assert error.max() < 0.1 * top
    assert top < 1e-3 * LIGHT / 400


def test_faint_haze_has_the_light_of_the_wing(spectrum, beyond):
    """wing_px 0: as much as a wing of 512 px adds, within 1%, spread smoothly."""
    hazy, drawn, box = draw(spectrum, beyond, 0.0)
    assert box is None and drawn == pytest.approx(hazy.sum(), rel=1e-5)
    assert hazy.sum() == pytest.approx(draw(spectrum, beyond, 512.0)[0].sum(), rel=0.01)
    assert hazy.min() >= 0


@pytest.mark.parametrize("wing", [0.0, 150.0, 900.0])
def test_two_sides_of_an_edge_are_the_whole(spectrum, beyond, wing):
    """Cut at an edge 7.3 px right of the object: both sides add up pixel by pixel, and each is dark far beyond."""
    whole, *_ = draw(spectrum, beyond, wing)
    left, light, _ = draw(spectrum, beyond, wing, side=(-np.inf, 7.3, -np.inf, np.inf))
    right, rest, _ = draw(spectrum, beyond, wing, side=(7.3, np.inf, -np.inf, np.inf))
    # Near the trace, where cubics of one side dip below zero and are cut off, 2% of the wing's top
    assert np.abs(left + right - whole).max() < 0.02 * whole.max()
    assert light + rest == pytest.approx(whole.sum(), rel=1e-3)
    assert light > rest > 0
    beyond_edge = np.arange(WINDOW.x0, WINDOW.x1) > 3700 + 7.3 + 80
    assert left[:, beyond_edge].max() < 1e-3 * whole[:, beyond_edge].max()


def test_a_window_and_the_response(spectrum, beyond):
    image, *_ = draw(spectrum, beyond, 900.0)
    part = Window(3201, 3333, 4801, 4899)
    small, _, box = draw(spectrum, beyond, 900.0, window=part)
    cut = slice(part.y0 - WINDOW.y0, part.y1 - WINDOW.y0), slice(part.x0 - WINDOW.x0, part.x1 - WINDOW.x0)
    assert np.abs(small - image[cut]).max() < 0.05 * image[cut].max()  # the mesh begins elsewhere
    assert box == (part.x0, part.x1, part.y0, part.y1)
    response = np.random.default_rng(1).uniform(0.5, 1, WINDOW.shape).astype(np.float32)
    seen, drawn, _ = draw(spectrum, beyond, 900.0, response=response)
    assert np.abs(seen - image * response).max() < 1e-5 * image.max()
    assert drawn == pytest.approx(seen.sum(), rel=1e-5)
    nothing, drawn, box = draw(spectrum, beyond, 150.0, window=Window(0, 100, 0, 100))
    assert not nothing.any() and drawn == 0 and box is None


def test_a_brighter_order_loses_no_light(spectrum, beyond):
    """From hidden to long wings light beyond the box grows: at most a tenth of a wing is lost from one to the next."""
    reaches = [order_wing(300.0, share, HALF) for share in (1e-5, 1e-3, 5e-3, 0.03, 0.3, 1.0)] + [1500.0]
    assert reaches[0] == 0 and reaches[-2] > 3 * HALF
    light = [draw(spectrum, beyond, reach)[1] for reach in reaches]
    assert (np.diff(light) > -0.1 * light[0]).all()
