"""Far wings on a mesh against the same wings drawn pixel by pixel, and the account of each star against the image."""

import numpy as np
import pytest

from csstsim.instrument.chip import Window
from csstsim.optics.beyond import Beyond, read_beyond
from csstsim.render.far_wings import MESH, FarWings
from csstsim.render.wings import add_beyond

WINDOW = Window(1003, 2100, 507, 1411)
HALF = 32.0  # px


def drawn(psf, x, y, flux, reach, response, far):
    image = np.zeros(WINDOW.shape)
    far = FarWings(WINDOW, response) if far else None
    beyond = Beyond(read_beyond(psf).wing)
    light = [
        add_beyond(image, response, WINDOW, None, *star, np.full(4, f), beyond, r, HALF, far)
        for *star, f, r in zip(x, y, flux, reach, strict=True)
    ]
    if far:
        far.lay(image)
    return image, [sum(electrons for electrons, _ in parts) for parts in light], light


STARS = {
    "middle": ([1500.3], [900.7], [1e8], [700.0]),
    "corner": ([1003.0], [507.0], [1e8], [900.0]),
    "off": ([400.0], [2000.0], [1e9], [2500.0]),
    "short": ([1500.3], [900.7], [1e5], [400.0]),
    "several": ([1200.0, 1900.2, 1777.7], [600.0, 1300.0, 1301.5], [1e6, 1e7, 1e8], [400.0, 900.0, 3000.0]),
}


@pytest.mark.parametrize("stars", STARS)
@pytest.mark.parametrize("lossy", [False, True])
def test_mesh_and_pixels_agree(psf_r, stars, lossy):
    """To 6e-4 of the wing as it would be without its taper; the star's light to 2e-5, the account of it to 1e-5."""
    response = np.ones(WINDOW.shape, np.float32)
    if lossy:
        response *= np.random.default_rng(1).uniform(0.5, 1, WINDOW.shape).astype(np.float32)
    exact, light, _ = drawn(psf_r, *STARS[stars], response, far=False)
    meshed, account, _ = drawn(psf_r, *STARS[stars], response, far=True)
    wing, untapered = read_beyond(psf_r).wing, np.zeros(WINDOW.shape)
    for x, y, flux, _ in zip(*STARS[stars], strict=True):
        r = np.hypot(np.arange(WINDOW.x0, WINDOW.x1) - x, np.arange(WINDOW.y0, WINDOW.y1)[:, None] - y)
        untapered += flux * wing.profile(np.maximum(r, HALF)).sum(axis=0)
    assert (np.abs(meshed - exact) < 6e-4 * untapered).all() and (meshed >= 0).all()
    assert account == pytest.approx(light, rel=2e-5)
    assert meshed.sum() == pytest.approx(sum(account), rel=1e-5)  # dips below zero, where wings end, are cut


def test_a_star_that_does_not_reach_the_window_gives_nothing(psf_r):
    image, account, light = drawn(psf_r, [-5000.0], [0.0], [1e9], [600.0], np.ones(WINDOW.shape, np.float32), far=True)
    assert not image.any() and account == [0] and light == [[]]


@pytest.mark.parametrize("shape", [(1, 1), (1, 300), (MESH, MESH + 1), (17, 5)])
def test_windows_of_any_shape(psf_r, shape):
    ny, nx = shape
    window = Window(2000, 2000 + nx, 800, 800 + ny)
    response, beyond = np.ones(shape, np.float32), Beyond(read_beyond(psf_r).wing)
    pair = []
    for far in (None, FarWings(window, response)):
        image = np.zeros(shape)
        add_beyond(image, response, window, None, 1500.0, 700.0, np.full(4, 1e8), beyond, 900.0, HALF, far)
        if far:
            far.lay(image)
        pair.append(image)
    assert pair[1] == pytest.approx(pair[0], rel=1e-4)
