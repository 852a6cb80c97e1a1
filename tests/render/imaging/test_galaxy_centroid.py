"""A galaxy's light is centred on its position, in the transformed part as in the other."""

import numpy as np
import pytest
from render.galaxies import scene_of, shaped
from support.canvases import blank
from support.grating_scene import gaussian_psf

from csstsim.instrument.chip import Window
from csstsim.render.imaging.galaxy_stamp import plan_galaxies
from csstsim.render.imaging.stamps import draw_scene

WINDOW = Window(3500, 4501, 4500, 5501)
REACH, BOX_PX = 480, 16.0
CENTROID_PX = 2e-3


@pytest.mark.parametrize(("index", "size"), [(1.0, 2.0), (4.0, 1.0), (1.0, 0.6)])
@pytest.mark.parametrize("position", [(4000.0, 5000.0), (4000.3, 4999.6)])
def test_all_parts_of_a_galaxy_have_one_centre(tmp_path, index, size, position):
    """First moments within circles of 20 to 400 px about its position, behind a round PSF: none moves."""
    psf = gaussian_psf(tmp_path / "g.h5")
    scene = scene_of(psf, *position, 1e7, index=index, size=size, matrix=shaped(0.7, 0.5))
    cut = plan_galaxies(scene, np.array([REACH]), BOX_PX, np.ones(1, bool)).cut[0, 0]
    assert np.isfinite(cut) or size < 1  # a large one has both parts
    canvas = blank(WINDOW, float)
    draw_scene(canvas, scene.sized(REACH), psf)
    image = canvas.expected
    dx = np.arange(WINDOW.x0, WINDOW.x1) - position[0]
    dy = (np.arange(WINDOW.y0, WINDOW.y1) - position[1])[:, None]
    radius = np.hypot(dx, dy)
    for reach in (20.0, 60.0, 150.0, 400.0):
        window = np.exp(-0.5 * (radius / reach) ** 2 * 9)  # 3 sigma at that radius: no hard edge on the pixels
        light = (image * window).sum()
        assert abs((image * window * dx).sum() / light) < CENTROID_PX * max(reach / 60, 1)
        assert abs((image * window * dy).sum() / light) < CENTROID_PX * max(reach / 60, 1)
