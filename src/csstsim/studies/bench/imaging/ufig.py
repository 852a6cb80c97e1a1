"""UFig (Berge et al. 2013; Fischbacher et al. 2024), if it is installed: electrons shot through a round Moffat PSF.

UFig has Moffat PSFs; here a least-squares fit to the cells of the object's PSF. UFig's compiled loops are called as by
its plugins, with csstsim's matrix for a galaxy's shape.
"""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from csstsim.base.rng import stream
from csstsim.base.types import FloatArray

if TYPE_CHECKING:
    from csstsim.render.scene import Scene
    from csstsim.studies.bench.imaging.cases import Case
    from csstsim.studies.bench.setting import Setting
    from csstsim.studies.bench.sweep import Draw

INSTALLED = all(importlib.util.find_spec(name) for name in ("ufig", "ivy", "cosmic_toolbox"))
_SUPPRESSION = -7.5  # UFig's value without flexion


class _Moffat(NamedTuple):
    """A Moffat profile: FWHM [px], beta, and its flux in a PSF's box."""

    fwhm: float
    beta: float
    flux: float


def prepare(setting: Setting, case: Case) -> Draw:
    """Return draw(copies) by UFig's photons through a Moffat PSF: an image [e-] of the window's shape."""
    from ufig import rendering_util
    from ufig.config import common
    from ufig.plugins.gamma_interpolation_table import load_intrinsicTable
    from ufig.plugins.render_galaxies_flexion import integrate_image
    from ufig.plugins.render_stars_photon import integrate_image_phot

    scene = case.scene
    window = case.window
    gamma = common.gammaprecision, common.gammaprecisionhigh
    precision = *gamma, common.sersicprecision
    fractions = np.array([1.0]) if case.star else scene.component_fractions[0]
    moffat = _moffat(setting, scene)
    rng = stream(1, "bench", "ufig", case.id)
    table = load_intrinsicTable(common.sersicprecision, *gamma)

    def draw(copies: int) -> FloatArray:
        image = np.zeros(window.shape)
        number = rng.poisson(case.electrons * moffat.flux * fractions, (copies, fractions.size)).reshape(-1, 1)
        n = len(number)
        buffer = rng.integers(0, 1 << 32, 44497).astype(np.uint32)
        # UFig's pixel n begins at coordinate n
        x = np.full(n, scene.x[0] - window.x0 + 0.5)
        y = np.full(n, scene.y[0] - window.y0 + 0.5)
        zeros = np.zeros((n, 1))
        psf = (
            np.full((n, 1), moffat.beta),
            rendering_util.compute_ellip_matrices(np.full(n, moffat.fwhm), np.zeros(n), np.zeros(n)),
            np.zeros((n, 2, 2, 2)),
            zeros,
            zeros,
            zeros,
            _SUPPRESSION,
            False,
        )
        if case.star:
            integrate_image_phot(buffer, image, x, y, number, *psf)
        else:
            index = np.tile(scene.sersic[0, :, 0], copies)
            shape = np.tile(scene.matrix[0] * scene.sersic[0, :, 2, None, None], (copies, 1, 1))
            integrate_image(buffer, *precision, table, image, x, y, number, index, shape, *psf)
        return image

    return draw


def _moffat(setting: Setting, scene: Scene) -> _Moffat:
    """Return the Moffat profile fitted to the PSF, with all the flux of the PSF's box."""
    electrons = scene.electrons[0] / scene.electrons[0].sum()
    cells = sum(
        w * np.tensordot(electrons, setting.psf.node(n).astype(float), axes=1)
        for n, w in zip(scene.node[0], scene.weight[0], strict=True)
    )
    total = cells.sum()
    axis = (np.arange(len(cells)) - (len(cells) - 1) / 2) / setting.psf.oversampling
    r2 = axis**2 + axis[:, None] ** 2

    def residual(parameters: FloatArray) -> FloatArray:
        fwhm, beta = parameters
        alpha2 = fwhm**2 / (4 * (2 ** (1 / beta) - 1))
        density = total * (beta - 1) / (np.pi * alpha2) * (1 + r2 / alpha2) ** -beta
        return (density / setting.psf.oversampling**2 - cells).ravel()

    fwhm, beta = least_squares(residual, (1.8, 3.0), bounds=((0.3, 1.05), (10, 20))).x
    return _Moffat(fwhm, beta, total)
