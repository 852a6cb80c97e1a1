"""Fixtures of several tests of the renderers: the GV grating, PSFs of known width behind it, and a mixer of psf_r."""

import pytest
from support.grating_scene import GV, disperser_of, gaussian_psf

from csstsim.render.psf_mixture import Mixer
from csstsim.render.psf_table import make_table


@pytest.fixture(scope="session")
def psf(tmp_path_factory):
    return gaussian_psf(tmp_path_factory.mktemp("psf") / "g.h5")


@pytest.fixture(scope="session")
def tables(psf):
    return make_table(psf)


@pytest.fixture(scope="session")
def disperser(camera):
    return disperser_of(camera, GV)


@pytest.fixture(scope="session")
def mixer(psf_r):
    return Mixer(psf_r)
