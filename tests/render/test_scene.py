"""The matrix of a galaxy's shape against GalSim's shears and magnification, multiplied by hand."""

from dataclasses import replace

import galsim
import numpy as np
import pytest
from render.imaging.test_reference import objects
from scipy.special import gammaincinv

from csstsim.catalog.table import GALAXY, STAR
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.render.scene import make_scene, shape_matrix

SHAPES = [(0.0, 0.0), (0.3, 0.0), (0.0, -0.4), (0.2, 0.5)]
FIELDS = [(0.0, 0.0, 0.0), (0.1, 0.05, 0.0), (0.2, 0.0, -0.1), (-0.3, 0.1, 0.2), (0.0, -0.3, 0.4)]


@pytest.mark.parametrize("pa", [0.0, -113.4333])
def test_shape_lens_and_map_are_galsims(camera, make_pointing, pa):
    """Intrinsic shear, then the lens with its magnification, then pixels an arcsec; a star has the map alone."""
    wcs = ChipWCS(camera.chips[9], make_pointing(pa=pa))
    pairs = [(e, field) for e in SHAPES for field in FIELDS]
    e, fields = np.array([e for e, _ in pairs]), np.array([field for _, field in pairs])
    position = np.full(len(pairs), 4100.0), np.full(len(pairs), 4200.0)
    columns = {
        "e1": e[:, 0], "e2": e[:, 1], "kappa": fields[:, 0], "gamma1": fields[:, 1], "gamma2": fields[:, 2],
    }  # fmt: skip
    table = objects(wcs, *position, obj_type=GALAXY, **columns)
    pixels = wcs.jacobian(table["ra"][0], table["dec"][0])
    for row, ((e1, e2), (kappa, gamma1, gamma2)) in enumerate(pairs):
        g1, g2 = gamma1 / (1 - kappa), gamma2 / (1 - kappa)
        mu = 1 / ((1 - kappa) ** 2 - gamma1**2 - gamma2**2)
        lens = np.sqrt(mu) * galsim.Shear(g1=g1, g2=g2).getMatrix()
        wanted = pixels @ lens @ galsim.Shear(g1=e1, g2=e2).getMatrix()
        assert shape_matrix(table, wcs)[row] == pytest.approx(wanted, rel=1e-5, abs=1e-5)
    star = objects(wcs, *position, obj_type=STAR, **columns)
    assert shape_matrix(star, wcs) == pytest.approx(np.broadcast_to(pixels, (len(pairs), 2, 2)), rel=1e-9)


def test_a_scene_has_the_light_the_components_and_the_nodes_of_its_table(camera, make_pointing, psf_r):
    """A star, a quarter of the trail of a galaxy with a bulge, and a galaxy without one, whose bulge has no size."""
    wcs = ChipWCS(camera.chips[9], make_pointing())
    x, y = np.array([4100.0, 300.5, 8000.0]), np.array([4200.0, 7000.25, 100.0])
    columns = {
        "id": np.array([5, 2**60, 9]), "size_disk": np.array([0.0, 0.4, 0.6]), "size_bulge": np.array([0.0, 0.1, 0.3]),
        "bulge_frac": np.array([0.0, 0.25, 0.0]), "trail_share": np.array([1.0, 0.25, 1.0]),
    }  # fmt: skip
    columns |= {f"flux{i}": np.array([1.0, 10.0, 100.0]) * (i + 1) for i in range(4)}
    table = objects(wcs, x, y, obj_type=np.array([STAR, GALAXY, GALAXY]), reach=np.array([3, 5, 7]), **columns)
    scene = make_scene(table.with_columns(wing=np.array([0.0, 80.0, 90.0])), wcs, psf_r, 20.0)
    assert scene.ids.tolist() == [5, 2**60, 9] and scene.x.tolist() == x.tolist() and scene.y.tolist() == y.tolist()
    assert scene.electrons[1].tolist() == [200.0, 400.0, 600.0, 800.0]
    assert scene.total_electrons.tolist() == [200.0, 8000.0, 20000.0]
    assert scene.extended.tolist() == [False, True, True] and len(scene) == scene.objects == 3
    assert scene.component_fractions[1:] == pytest.approx(np.array([[0.75, 0.25], [1.0, 0.0]]), abs=1e-6)
    assert not scene.sersic[0].any() and scene.sersic[1:, :, 0].tolist() == [[1.0, 4.0], [1.0, 4.0]]
    assert scene.sersic[1:, :, 1] == pytest.approx(np.full((2, 2), gammaincinv([2.0, 8.0], 0.5)))
    assert scene.sersic[1:, :, 2] == pytest.approx(np.array([[0.4, 0.1], [0.6, 0.0]]), rel=1e-6)
    node, weight, outside = psf_r.weights(x, y)
    assert np.array_equal(scene.node, node) and np.array_equal(scene.weight, weight)
    assert np.array_equal(scene.outside, outside)
    assert scene.reach.tolist() == [3, 5, 7] and scene.wing.tolist() == [0.0, 80.0, 90.0]
    two = scene.take(np.array([2, 0]))
    assert two.ids.tolist() == [9, 5] and two.reach.tolist() == [7, 3] and two.spots is None and two.parent is None
    sized = scene.sized(11)
    assert sized.reach.tolist() == [11] * 3 and sized.wing.tolist() == [0.0] * 3 and scene.reach.tolist() == [3, 5, 7]


def test_what_is_extended_has_light_in_a_profile_or_in_spots(camera, make_pointing, psf_r):
    wcs = ChipWCS(camera.chips[9], make_pointing())
    scene = make_scene(objects(wcs, [100.0] * 3, [100.0] * 3), wcs, psf_r, 1.0)
    scene.sersic[1, 1], scene.sersic[2, 0] = (4.0, 7.67, 0.3), (1.0, 1.68, 0.3)
    scene.component_fractions[:] = [1.0, 0.0]
    assert scene.extended.tolist() == [False, False, True]
    spotted = replace(scene, spot=np.array([0, -1, -1]), parent=np.array([0, 1, 0]))
    assert spotted.extended.tolist() == [True, False, True] and spotted.objects == 2
