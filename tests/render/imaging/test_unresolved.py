"""Light spread smoothly is conserved and stays in place; each object's account equals what was added."""

import numpy as np
import pytest
from support.canvases import blank
from test_draw import scene_of

from csstsim.instrument.chip import Window
from csstsim.render.imaging.unresolved import MESH, add_unresolved

WINDOW = Window(1000, 1700, 500, 1111)
ALL = np.ones(WINDOW.shape, np.float32)


def spread(x, y, electrons, response=ALL):
    canvas = blank(WINDOW, float, response=response)
    return canvas.expected, *add_unresolved(canvas, scene_of(x, y, electrons))


@pytest.mark.parametrize("x, y", [(1350.0, 800.0), (1313.37, 777.77), (1320.0, 820.0), (1128.0, 628.0)])
def test_light_and_first_moments_stay(x, y):
    image, drawn, box = spread([x], [y], [1e4])
    assert image.sum() == pytest.approx(1e4, rel=1e-12) and drawn == pytest.approx([1e4], rel=1e-12)
    rows, columns = np.indices(image.shape)
    assert (image * columns).sum() / 1e4 + WINDOW.x0 == pytest.approx(x, abs=1e-6)
    assert (image * rows).sum() / 1e4 + WINDOW.y0 == pytest.approx(y, abs=1e-6)
    inside = np.zeros(image.shape, bool)
    inside[box[0, 2] - WINDOW.y0 : box[0, 3] - WINDOW.y0, box[0, 0] - WINDOW.x0 : box[0, 1] - WINDOW.x0] = True
    assert not image[~inside].any()


def test_what_each_gives_adds_up_at_the_edges_and_under_losses():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(WINDOW.x0 - 300, WINDOW.x1 + 300, 500), rng.uniform(WINDOW.y0 - 300, WINDOW.y1 + 300, 500)
    response = rng.uniform(0.5, 1.0, WINDOW.shape).astype(np.float32)
    image, drawn, _ = spread(x, y, rng.uniform(0, 100, 500), response)
    assert image.sum() == pytest.approx(drawn.sum(), rel=1e-10)
    far = (x < WINDOW.x0 - 2 * MESH) | (y > WINDOW.y1 + 2 * MESH)
    assert far.any() and not drawn[far].any() and (drawn[WINDOW.contains(x, y)] > 0).all()


def test_no_object_no_light():
    image, drawn, box = spread([], [], [])
    assert not image.any() and drawn.shape == (0,) and box.shape == (0, 4)


def test_a_field_of_objects_is_as_flat_as_their_number_allows():
    """One object a pixel on a grid is a level sky away from the window's edge, to rounding."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(900.0, 1800.0, 16), np.arange(400.0, 1200.0, 16)))
    image, *_ = spread(x, y, np.full(x.size, 256.0))
    inner = image[2 * MESH : -2 * MESH, 2 * MESH : -2 * MESH]
    assert np.ptp(inner) < 1e-9 and inner.mean() == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(("column", "row"), [(128, 192), (320, 64)])
def test_an_object_on_a_mesh_point_is_a_pyramid_around_it(column, row):
    """Half a mesh away it has half of its height, along either axis; under a response the pixel's fraction."""
    response = np.random.default_rng(2).uniform(0.5, 1.0, WINDOW.shape).astype(np.float32)
    image, drawn, box = spread([WINDOW.x0 + column], [WINDOW.y0 + row], [4096.0], response)
    y, x = np.indices(WINDOW.shape)
    wanted = np.maximum(1 - abs(x - column) / MESH, 0) * np.maximum(1 - abs(y - row) / MESH, 0) * response
    np.testing.assert_allclose(image, wanted, atol=1e-12)
    assert drawn[0] == pytest.approx(wanted.sum())
    x0, x1, y0, y1 = (box[0] - np.repeat([WINDOW.x0, WINDOW.y0], 2)).tolist()
    assert (x0, y0) == (column - MESH, row - MESH) and x1 >= column + MESH and y1 >= row + MESH


def test_boxes_end_with_the_window():
    _, _, box = spread([WINDOW.x0 - 20.0, WINDOW.x1 + 10.0], [WINDOW.y1 + 5.0, WINDOW.y0 - 3.0], [1.0, 1.0])
    assert (box[:, 0] >= WINDOW.x0).all() and (box[:, 1] <= WINDOW.x1).all()
    assert (box[:, 2] >= WINDOW.y0).all() and (box[:, 3] <= WINDOW.y1).all()
    assert box[0, 0] == WINDOW.x0 and box[0, 3] == WINDOW.y1 and box[1, 1] == WINDOW.x1 and box[1, 2] == WINDOW.y0
