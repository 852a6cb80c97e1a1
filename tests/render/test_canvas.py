"""The canvas: cuts and corners in the window's own pixels, boxes around boxes, planes made when needed."""

import numpy as np
import pytest

from csstsim.instrument.chip import Window
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.render.canvas import Canvas, around
from csstsim.render.drawing import Drawing

WINDOW = Window(100, 130, 40, 52)


def test_a_box_of_the_chip_is_cut_out_of_the_planes():
    canvas = Canvas(np.arange(12 * 30.0).reshape(12, 30), WINDOW)
    rows, columns = canvas.cut((103, 110, 41, 45))
    assert (rows, columns) == (slice(1, 5), slice(3, 10))
    assert canvas.expected[rows, columns].shape == (4, 7) and canvas.expected[rows, columns][0, 0] == 33
    assert canvas.corner.tolist() == [100, 100, 40, 40]
    assert (np.array([3, 10, 1, 5]) + canvas.corner).tolist() == [103, 110, 41, 45]


def test_planes_are_made_once_and_of_their_kind():
    canvas = Canvas(None, WINDOW)
    assert canvas.counted is None and canvas.maximum == 1.0
    plane = canvas.count()
    assert plane.dtype == np.int32 and plane.shape == (12, 30) and not plane.any()
    plane[3, 4] = 7
    assert canvas.count() is plane and canvas.counted[3, 4] == 7
    response = canvas.response_array
    assert response.dtype == np.float32 and response.shape == (12, 30) and (response == 1).all()
    response = np.full((12, 30), 0.5, np.float32)
    assert Canvas(None, WINDOW, response).response_array is response


def test_the_smallest_box_around_boxes():
    assert around([(5, 9, 30, 31), (2, 6, 33, 40), (4, 12, 20, 25)]) == (2, 12, 20, 40)
    assert around([(5, 9, 30, 31)]) == (5, 9, 30, 31)
    assert around([]) == (0, 0, 0, 0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_plane_of_expected_electrons_is_the_callers(dtype):
    plane = np.zeros(WINDOW.shape, dtype)
    assert Canvas(plane, WINDOW).expected is plane


def test_a_drawing_has_the_parts_of_its_scattered_light(mixer):
    bare, both = Drawing(None, None, 1.0, cached_mixer=mixer), Drawing(None, None, 1.0, Scattered("wing", "ghosts"))
    assert bare.wing is None and bare.ghosts is None and bare.mixer is mixer
    assert (both.wing, both.ghosts) == ("wing", "ghosts")
    assert (bare.fidelity, bare.variance, bare.key, bare.tables) == ("standard", 0.0, None, None)
    psf = mixer.psf
    assert Drawing(None, psf, 1.0).mixer.psf is psf
