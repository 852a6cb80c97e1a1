"""The matrix of a galaxy's shape against GalSim's shears and magnification, multiplied by hand."""

import galsim
import numpy as np
import pytest
from test_reference import objects

from csstsim.catalog.table import GALAXY, STAR
from csstsim.optics.geometry.wcs import ChipWCS
from csstsim.render.scene import shape_matrix

SHAPES = [(0.0, 0.0), (0.3, 0.0), (0.0, -0.4), (0.2, 0.5)]
FIELDS = [(0.0, 0.0, 0.0), (0.1, 0.05, 0.0), (0.2, 0.0, -0.1), (-0.3, 0.1, 0.2), (0.0, -0.3, 0.4)]


@pytest.mark.parametrize("pa", [0.0, -113.4333])
def test_shape_lens_and_map_are_galsims(camera, make_pointing, pa):
    """Intrinsic shear, then the lens with its magnification, then pixels an arcsec; a star has the map alone."""
    wcs = ChipWCS(camera.chips[9], make_pointing(pa=pa))
    pairs = [(e, field) for e in SHAPES for field in FIELDS]
    e, fields = np.array([e for e, _ in pairs]), np.array([field for _, field in pairs])
    place = np.full(len(pairs), 4100.0), np.full(len(pairs), 4200.0)
    columns = {
        "e1": e[:, 0], "e2": e[:, 1], "kappa": fields[:, 0], "gamma1": fields[:, 1], "gamma2": fields[:, 2],
    }  # fmt: skip
    table = objects(wcs, *place, obj_type=GALAXY, **columns)
    pixels = wcs.jacobian(table["ra"][0], table["dec"][0])
    for row, ((e1, e2), (kappa, gamma1, gamma2)) in enumerate(pairs):
        g1, g2 = gamma1 / (1 - kappa), gamma2 / (1 - kappa)
        mu = 1 / ((1 - kappa) ** 2 - gamma1**2 - gamma2**2)
        lens = np.sqrt(mu) * galsim.Shear(g1=g1, g2=g2).getMatrix()
        wanted = pixels @ lens @ galsim.Shear(g1=e1, g2=e2).getMatrix()
        assert shape_matrix(table, wcs)[row] == pytest.approx(wanted, rel=1e-5, abs=1e-5)
    star = objects(wcs, *place, obj_type=STAR, **columns)
    assert shape_matrix(star, wcs) == pytest.approx(np.broadcast_to(pixels, (len(pairs), 2, 2)), rel=1e-9)
