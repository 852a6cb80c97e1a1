"""Objects on the line between a chip's two gratings: one entry for their light, but electrons drawn separately."""

import numpy as np
import pytest
from support.dispersed_sky import Sky
from support.grating_scene import SPLIT, gaussian_psf

from csstsim.instrument.chip import Window
from csstsim.render.psf_table import make_table
from csstsim.render.slitless.draw_dispersed import _visit_keys

WINDOW = Window(4000, 7000, 4780, 4920)
ONE_GRATING = 0.02  # the two gratings' throughputs differ by less


@pytest.mark.parametrize("fidelity", ["noise_free", "standard"])
def test_the_nominal_light_of_a_star_on_the_line_is_that_of_one_star(
    tmp_path, camera, make_pointing, observe, fidelity
):
    psf = gaussian_psf(tmp_path / "g.h5")
    positions = (SPLIT - 400.0, SPLIT - 0.2, SPLIT + 0.2, SPLIT + 400.0)
    objects = [(x, 4850.0, {"id": k, "ab": 18.0}) for k, x in enumerate(positions)]
    sky = Sky(camera, make_pointing(), observe(make_pointing()), psf, objects)
    _, drawn, _, _ = sky.draw(sky.select(WINDOW), WINDOW, fidelity, make_table(psf))
    order = np.argsort(drawn["id"])
    electrons, light = drawn["electrons"][order], drawn["drawn"][order]
    assert electrons[1:3] == pytest.approx(np.full(2, max(electrons[0], electrons[3])), rel=ONE_GRATING)
    assert light[1:3] == pytest.approx(np.full(2, electrons[0]), rel=0.05)  # first orders end on the window


def test_each_visit_has_a_key_of_its_own():
    keys = np.arange(1, 2001, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    visits = np.stack([np.repeat(np.arange(2000), 2), np.tile([0, 1], 2000), np.zeros(4000, int)], axis=1)
    assert len(np.unique(_visit_keys(keys, visits))) == len(visits)
    # A visit's key is its object's and piece's, whatever else is visited
    assert np.array_equal(_visit_keys(keys, visits[7:8]), _visit_keys(keys, visits)[7:8])
