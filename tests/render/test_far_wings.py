"""Far wings on meshes against the same wings drawn pixel by pixel, and the account of each star against the image."""

import numpy as np
import pytest
from support.canvases import blank

from csstsim.catalog.profiles.log_table import first_of, nodes
from csstsim.instrument.chip import Window
from csstsim.optics.scatter.scattered_light import read_scattered
from csstsim.render.far_wings import FACTOR, MESH, OVER, FarWings, Side
from csstsim.render.wing_tables import Annulus
from csstsim.render.wings import NEAR, StampLight, Wings, wing_beyond

WINDOW = Window(1003, 2100, 507, 1411)
HALF = 32.0  # px
NEVER = 1e5  # px: the meshes take over nowhere


def drawn(psf, x, y, flux, reach, response, near=None, window=WINDOW):
    """Return (image, electrons of each star); near: px from which the meshes take over."""
    canvas, wing = blank(window, float, response=response), read_scattered(psf).wing
    wings, inside = Wings(canvas, wing, HALF), 4 * (1 - wing_beyond(wing, HALF).light.mean())  # no ring is missing
    light = [
        wings.add(star, np.full(4, f), StampLight(inside * f, inside * f), r, near=near)
        for *star, f, r in zip(x, y, flux, reach, strict=True)
    ]
    wings.add_to_canvas()
    return canvas.expected, light


STARS = {
    "middle": ([1500.3], [900.7], [1e8], [700.0]),
    "corner": ([1003.0], [507.0], [1e8], [900.0]),
    "off": ([400.0], [2000.0], [1e9], [2500.0]),
    "far off": ([-3000.0], [9000.0], [1e9], [2500.0]),
    "short": ([1500.3], [900.7], [1e5], [100.0]),
    "several": ([1200.0, 1900.2, 1777.7], [600.0, 1300.0, 1301.5], [1e6, 1e7, 1e8], [400.0, 900.0, 3000.0]),
}


@pytest.mark.parametrize("stars", STARS)
@pytest.mark.parametrize("lossy", [False, True])
def test_meshes_and_pixels_agree(psf_r, stars, lossy):
    """To 5e-4 of the wing, 3e-3 where the meshes take over at 48 px; the star's light and its account to 1e-6."""
    response = np.ones(WINDOW.shape, np.float32)
    if lossy:
        response *= np.random.default_rng(1).uniform(0.5, 1, WINDOW.shape).astype(np.float32)
    exact, light = drawn(psf_r, *STARS[stars], response, near=NEVER)
    meshed, account = drawn(psf_r, *STARS[stars], response)
    wing, full = read_scattered(psf_r).wing, np.zeros(WINDOW.shape)  # full: without the fade into the box
    for x, y, flux, _ in zip(*STARS[stars], strict=True):
        r = np.hypot(np.arange(WINDOW.x0, WINDOW.x1) - x, np.arange(WINDOW.y0, WINDOW.y1)[:, None] - y)
        full += flux * wing.profile(np.maximum(r, HALF)).sum(axis=0)
    assert (np.abs(meshed - exact) <= (3e-3 if stars == "short" else 5e-4) * full).all() and (meshed >= 0).all()
    assert account == pytest.approx(light, rel=1e-6)
    assert meshed.sum() == pytest.approx(sum(account), rel=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (MESH, MESH + 1), (17, 5)])
def test_windows_of_any_shape(psf_r, shape):
    ny, nx = shape
    window = Window(2000, 2000 + nx, 800, 800 + ny)
    response, star = np.ones(shape, np.float32), ([1500.0], [700.0], [1e8], [900.0])
    exact, _ = drawn(psf_r, *star, response, near=NEVER, window=window)
    meshed, _ = drawn(psf_r, *star, response, window=window)
    assert meshed == pytest.approx(exact, rel=5e-4)


def test_a_window_has_the_pixels_of_a_larger_one(psf_r):
    """The meshes stand elsewhere: 5e-4 of the wing."""
    star, part = ([1500.3], [900.7], [1e8], [700.0]), Window(1203, 1300, 701, 1011)
    whole, _ = drawn(psf_r, *star, np.ones(WINDOW.shape, np.float32))
    small, _ = drawn(psf_r, *star, np.ones(part.shape, np.float32), window=part)
    cut = slice(part.y0 - WINDOW.y0, part.y1 - WINDOW.y0), slice(part.x0 - WINDOW.x0, part.x1 - WINDOW.x0)
    assert small == pytest.approx(whole[cut], rel=5e-4)


@pytest.mark.parametrize("level", range(1 + len(OVER)))
def test_each_mesh_gives_a_plane_back(level):
    """A flat table is flat on the image, whatever mesh it is laid on; its account is the sum, over the response too."""
    window = Window(100, 400, 50, 231)
    response = np.random.default_rng(2).uniform(0.5, 1, window.shape).astype(np.float32)
    canvas = blank(window, float, response=response)
    far, image = FarWings(canvas), canvas.expected
    octaves = 40
    drawn = far.add(level, (250.3, 120.2), Annulus(np.full(len(nodes(0, octaves)), 2.5), first_of(0), 1e5))
    far.add_to_canvas()
    assert image == pytest.approx(2.5 * response, rel=1e-6)  # the spline's ends are felt a little
    assert drawn == pytest.approx(image.sum(), rel=1e-6)


def test_the_meshes_are_fine_where_they_take_over():
    """A mesh's step is at most a sixth of the radius from which it is used."""
    starts = NEAR[0], *OVER
    assert all(MESH * FACTOR**level <= start / 6 for level, start in enumerate(starts))


def test_edges_cut_each_side_of_a_wing_at_its_own_distance():
    """A flat table on the finest mesh, four limits softened over 16 px: 28 px off them all of it, or nothing."""
    window, at, side = Window(100, 400, 50, 231), (250.3, 120.2), Side(-90.0, 60.0, -40.0, 75.0)
    canvas = blank(window, float)
    far = FarWings(canvas)
    account = far.add(0, at, Annulus(np.full(len(nodes(0, 40)), 2.5), first_of(0), 1e5), side, 16.0)
    far.add_to_canvas()
    dx, dy = np.arange(100, 400) - at[0], (np.arange(50, 231) - at[1])[:, None]
    inner = (dx > side.x0 + 28) & (dx < side.x1 - 28) & (dy > side.y0 + 28) & (dy < side.y1 - 28)
    outer = (dx < side.x0 - 28) | (dx > side.x1 + 28) | (dy < side.y0 - 28) | (dy > side.y1 + 28)
    assert inner.sum() > 3000 and outer.sum() > 3000
    assert canvas.expected[inner] == pytest.approx(2.5, rel=0.02) and canvas.expected[outer].max() < 0.05
    assert canvas.expected.sum() == pytest.approx(2.5 * 150 * 115, rel=0.02)
    assert account == pytest.approx(canvas.expected.sum(), rel=0.01)
