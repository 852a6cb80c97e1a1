"""Galaxies of any Sersic index for the tests of the renderers: GalSim's image of one, and a Scene of one."""

import galsim
import numpy as np

from csstsim.catalog.profiles.sersic import sersic_b
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.render.imaging.reference import GSPARAMS, PSF_MAXK
from csstsim.render.scene import Scene

SCALE = 0.074  # arcsec per pixel


def scene_of(psf, x, y, electrons=1e5, index=1.0, size=0.3, matrix=None, bulge=0.0, bulge_size=0.3):
    """Return a Scene of n objects at x, y (n,); index 0 makes points. Other values: the same for all, or (n,)."""
    x, y = (np.array(v, float) for v in np.broadcast_arrays(np.atleast_1d(x), np.atleast_1d(y)))
    n = len(x)
    index, size, bulge = (np.broadcast_to(np.asarray(v, float), n) for v in (index, size, bulge))
    sersic = np.zeros((n, 2, 3))
    galaxy = index > 0
    sersic[galaxy, 0] = np.stack([index, sersic_b(np.maximum(index, 0.1)), size], axis=1)[galaxy]
    sersic[galaxy, 1] = 4.0, sersic_b(4.0), bulge_size
    matrix = np.eye(2) / SCALE if matrix is None else matrix
    node, weight, outside = psf.weights(x, y)
    return Scene(
        np.arange(n), x, y, np.broadcast_to(np.asarray(electrons, float)[..., None] / 4, (n, 4)).copy(),
        np.stack([1 - bulge, bulge], axis=1), sersic, np.broadcast_to(matrix, (n, 2, 2)).copy(), node.astype(np.int64),
        weight, outside,
    )  # fmt: skip


def shaped(q, angle):
    """Return the matrix (pixel per arcsec) of axis ratio q and equal area, its long axis at `angle` [rad]."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return turn @ np.diag([q**-0.5, q**0.5]) @ turn.T / SCALE


def galsim_image(psf, x, y, half, index, size, matrix, folding=5e-3):
    """Return GalSim's image of a galaxy of light 1 on (2 half + 1)^2 pixels round x, y, mean of the four sub-bands."""
    step = 1 / psf.oversampling
    response = pixel_response(psf.at(x, y).mean(axis=0), psf.oversampling)
    point = galsim.InterpolatedImage(
        galsim.ImageD(response), scale=step, normalization="sb", x_interpolant="quintic",
        gsparams=galsim.GSParams(**GSPARAMS), _force_maxk=PSF_MAXK,
        _force_stepk=2 * np.pi / (response.shape[0] * step),
    )  # fmt: skip
    gsparams = galsim.GSParams(**GSPARAMS, folding_threshold=folding)
    profile = galsim.Sersic(index, half_light_radius=size, gsparams=gsparams).transform(*np.ravel(matrix))
    both = galsim.Convolve(profile.withFlux(1.0), point, gsparams=gsparams, propagate_gsparams=False)
    image = galsim.ImageD(2 * half + 1, 2 * half + 1)
    offset = galsim.PositionD(x - round(x), y - round(y))
    both.drawImage(image, scale=1.0, method="no_pixel", center=image.true_center + offset)
    return image.array
