"""Light rendered only where it is needed: there it is the same as in a complete image."""

import numpy as np
import pytest
from measure.slitless import EDGES, PHOTONS, GaussianPsf, binned, orders_of

from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.measure.spectra import spectral_model
from csstsim.measure.spectra.line_profile import OFFSETS, Shapes
from csstsim.measure.spectra.near_orders import TILE, OrderExtents, near_orders
from csstsim.measure.spectra.spectral_model import make_model

WINDOW = Window(1000, 3300, 3800, 4500)


@pytest.fixture(scope="module")
def scene(camera):
    """Forty objects of all sizes and brightnesses: (model, orders, shapes, spectra)."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(1100, 3200, 40), rng.uniform(3780, 4520, 40)
    model = make_model(camera.gratings[2], PHOTONS, GaussianPsf().at(0, 0), 2, camera.filters["GV"].psf_wavelength)
    fraction, radius = rng.uniform(0, 1, 40), rng.choice([0.0, 0.5, 3.0, 15.0], (40, 2, 2))
    shapes = Shapes(np.stack([fraction, 1 - fraction], axis=1), radius, np.zeros(40), np.zeros(40, bool))
    level = 10 ** rng.uniform(-3, 1, 40)
    even = binned(6000.0 / GRID, EDGES)
    orders = orders_of(camera.gratings[2], x, y, WINDOW)
    pairs = model.pairs(orders)
    through = np.array([PHOTONS * np.diff(np.interp(EDGES, GRID, sums)) @ even for sums in model.cumulative])
    orders = orders.with_columns(electrons=level[orders["row"]] * through[pairs])
    return model, orders, shapes, lambda rows, edges: level[rows, None] * even


@pytest.mark.parametrize("boxes", [[(1500, 1700, 4000, 4020)], [(1000, 1010, 3800, 3810), (3250, 3290, 4300, 4500)],
                                   [(900, 3400, 3700, 4600)], [(3400, 3500, 3800, 3900)]])  # fmt: skip
@pytest.mark.parametrize("faintest", [0.5, 20.0])
def test_an_image_in_boxes_is_the_whole_one_there(scene, monkeypatch, boxes, faintest):
    model, orders, shapes, spectra = scene
    rendered = []
    render = spectral_model._render

    def counted(image, corner, traced, *rest):
        rendered.append(len(traced.pair))
        render(image, corner, traced, *rest)

    monkeypatch.setattr(spectral_model, "_render", counted)
    asked = orders, shapes, spectra, EDGES, WINDOW, faintest
    whole, some = model.image(*asked), model.image(*asked, boxes=np.array(boxes, float))
    for x0, x1, y0, y1 in boxes:
        part = np.s_[max(y0 - WINDOW.y0, 0) : max(y1 - WINDOW.y0, 0), max(x0 - WINDOW.x0, 0) : max(x1 - WINDOW.x0, 0)]
        assert np.array_equal(some[part], whole[part])
    assert whole.max() > 10 * faintest
    if boxes[0][0] in (1500, 3400):
        assert sum(rendered[1:]) < 0.6 * rendered[0]  # the orders that are far away are not rendered


def test_traces_may_fall_by_many_rows(scene):
    """Steeper than those of the gratings, by 80 rows and more: boxes at their ends have all of the light."""
    slope = -0.04  # rows per angstrom
    model, orders, shapes, spectra = scene
    steep = orders.with_columns(s=orders["s"] + slope, r=orders["r"] - slope * 5000.0)
    asked = steep, shapes, spectra, EDGES, WINDOW, 0.5
    whole, lit = model.image(*asked), 0
    for x in (1200, 2400):
        for y in (3850, 4100, 4350):
            part = np.s_[y - WINDOW.y0 : y - WINDOW.y0 + 8, x - WINDOW.x0 : x - WINDOW.x0 + 8]
            some = model.image(*asked, boxes=np.array([[x, x + 8, y, y + 8]], float))
            assert np.array_equal(some[part], whole[part]), (x, y)
            lit += whole[part].any()
    assert lit > 1


def test_an_order_is_near_where_its_tiles_are_those_of_a_box():
    """A box of two tiles in x and one in y; orders of a pixel's reach that end next to it, and within."""
    x0, y0 = WINDOW.x0 + 10 * TILE, WINDOW.y0 + 12 * TILE
    x1, y1 = x0 + 2 * TILE, y0 + TILE
    middle = y0 + 8.0
    cases = [
        (x0 - 40, x0 - 1, middle, False), (x0 - 40, x0, middle, True), (x1 - 1, x1 + 40, middle, True),
        (x1, x1 + 40, middle, False), (x0 - 40, x1 + 40, middle, True), (x0, x1, y0 - 1.1, False),
        (x0, x1, y0 - 1.0, True), (x0, x1, y1 + 0.9, True), (x0, x1, y1 + 1.0, False),
    ]  # fmt: skip
    first, last, height, near = (np.array(values) for values in zip(*cases, strict=True))
    ends, heights, n = np.stack([first, last], axis=1), np.stack([height, height], axis=1), len(cases)
    nothing = np.zeros((1, 2, 1, len(OFFSETS)))
    boxes = np.array([[x0, x1, y0, y1]], float)
    size = np.zeros((n, 2), int)
    extents = OrderExtents(ends, heights, np.ones(n), np.full((n, 2), 0.5), size)
    found = near_orders(extents, nothing, WINDOW, boxes, 1.0)
    assert found.tolist() == near.tolist()
