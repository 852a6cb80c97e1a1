"""The independent truth against pixel integrals of the optics, closed forms and GalSim."""

from dataclasses import replace

import galsim
import numpy as np
import pytest

from csstsim.catalog.profiles.sersic import sersic_b
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.psf_set import centre_of, chip_optics
from csstsim.optics.psf.wavefront import load_wavefront
from csstsim.optics.scatter.scattered_light import Scattered
from csstsim.studies.bench.imaging.cases import FRACTIONS, make_cases
from csstsim.studies.bench.imaging.measures import errors
from csstsim.studies.bench.imaging.methods import standard
from csstsim.studies.bench.imaging.truth import Truth, sersic_transform
from csstsim.studies.bench.setting import make_setting

PEAK = 2e-5  # of the peak: numbers of the optics in single precision, on other lattices
K = np.geomspace(1e-3, 100, 40)  # radian per r_e; beyond, GalSim has an asymptotic form good to 5e-6


@pytest.fixture(scope="module")
def setting(bench_folder):
    return make_setting(bench_folder, "r")


@pytest.mark.parametrize("n", [1.0, 1.5, 2.5, 4.0])
def test_transform_is_galsims(n):
    profile = galsim.Sersic(n, half_light_radius=1.0, gsparams=galsim.GSParams(kvalue_accuracy=1e-9))
    theirs = np.array([profile.kValue(k, 0).real for k in K])
    assert sersic_transform(K, n, sersic_b(n)) == pytest.approx(theirs, abs=1e-6)


def test_a_star_is_the_optics_integrated_over_pixels(setting):
    """One cell a pixel, shifted to the star's position: no interpolation. The halo is left out of both."""
    wing = setting.scattered.wing
    bare = replace(setting, scattered=Scattered(replace(wing, share=np.zeros_like(wing.share)), None))
    case = make_cases(setting, 2)[0]
    got = Truth(bare)(case)
    camera, wavefront = setting.camera, load_wavefront(setting.camera.psf)
    (optics, kernel) = chip_optics(setting.chip, setting.filter, camera.psf, wavefront, 1, 64)
    x, y = case.scene.x[0], case.scene.y[0]
    coefficients = chip_coefficients(wavefront, camera.psf, setting.chip, x, y)
    transfers = [o.transfer(coefficients) for o in optics]
    centre = centre_of(optics, transfers, kernel, 1)
    shift = centre - 0.5 - np.array([x - round(x), y - round(y)])
    wanted = sum(s * o.image(t, kernel, shift) for s, o, t in zip(FRACTIONS, optics, transfers, strict=True))
    inner = slice(case.half - 30, case.half + 31)
    assert np.abs(got[inner, inner] - wanted[2:63, 2:63]).max() < PEAK * wanted.max()


def test_a_galaxy_is_the_references_where_a_node_is(setting):
    cases = make_cases(setting, 40, seed=2, largest=0.6)
    case = next(c for c in cases if not c.star and c.at_node and 0 < c.row["bulge_frac"][0] < 1)
    direct = Truth(setting)(case)
    (flux, x, y, e1, e2, size2, *_), _ = errors(standard(setting, case) / case.electrons, direct, 80.0, 1e4)
    assert abs(flux) < 5e-4
    assert max(abs(x), abs(y)) < 0.01  # mas
    assert max(abs(e1), abs(e2)) < 2e-5
    assert abs(size2) < 2e-5
