"""An object's own noise, and the predicted error of its image in units of this noise, from which methods are chosen.

An error equal to a fraction of an object's light has the same fraction of its S/N, so the bound for an object is

    bound = S/N (psf + cut / reach [points] + (disk or bulge) split [galaxies])
    split = min(min(r / size, 1) sqrt(1 + S/N / bright), far)

* psf: error of the density between the stored cells, common to photons and stamps; ten times larger with 2 cells to a
  pixel than with 4;
* cut: light beyond the stamp of a point; the wing leaves a fraction 1 / reach there;
* disk, bulge: error of the split and transform of a profile of Sersic index 1 or 4 (linear in the index in between and
  above, no less than a disk's below 1); r is the half-light radius in pixels. The error lies in the outer parts. The
  brighter the object, the more of them exceed the sky noise and count, up to the limit `far`.

The bound rises with S/N, hence with flux. The coefficients are chosen so that at most 5% of objects exceed their bound,
measured against the reference renderer: benchmarks/error_model.py fits them on one sample and tests them on another,
with S/N 0.1 to 3000, half-light radii up to 2.5 arcsec and q down to 0.11. `far` comes from galaxies of S/N up to
14000; for these the bound is 1 to 4 times the measured error (--bright). The error is that of an ideal filter on the
whole stamp: 1e-5 of the peak in thousands of pixels is ten times the noise. Left out: interpolation of the PSF between
nodes, wings, ghosts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray
    from csstsim.render.scene import Scene
    from csstsim.render.settings import Error

TERMS = ("cut", "disk", "bulge")  # of stamps
_PSF_HALF_LIGHT = 1.2  # pixel
_GAUSSIAN = 4 * np.pi / (2 * np.log(2))  # effective number of pixels / half-light radius^2 of a Gaussian


def noise(scene: Scene, electrons: FloatArray, variance: float, length: float = 0.0) -> FloatArray:
    """Return the noise (n,) of each object's electrons and of the pixels that it covers [electron].

    electrons: (n,); variance: of a pixel without objects [electron^2]; length: of a trace [px].
    """
    size2 = _PSF_HALF_LIGHT**2 + half_light_px2(scene)
    return np.sqrt(electrons + (_GAUSSIAN * size2 + length * np.sqrt(_GAUSSIAN * size2)) * variance)


def half_light_px2(scene: Scene) -> FloatArray:
    """Return (n,) squared circular half-light radii [px^2]: of each object the flux-weighted mean of its components."""
    stretch2 = np.abs(np.linalg.det(scene.matrix))
    return (scene.component_fractions * scene.sersic[:, :, 2] ** 2).sum(axis=1) * stretch2


def allowed_error(snr: FloatArray, numbers: Error, per_pixel: int, eps: float) -> FloatArray:
    """Return the allowed error (n,) as a fraction of S/N: eps of the noise, or twice the error of the PSF."""
    return np.maximum(eps / np.maximum(snr, 1e-9), 2 * _psf_fraction(numbers, per_pixel))


def psf_error(snr: FloatArray, numbers: Error, per_pixel: int) -> FloatArray:
    """Return the bound (n,) of the error of an image that is exact but for the PSF, in units of each object's noise.

    snr: (n,), electrons over `noise`; numbers: render.settings.Error; per_pixel: stored cells of the PSF to a pixel.
    """
    return snr * _psf_fraction(numbers, per_pixel)


def stamp_error(scene: Scene, reach: FloatArray, snr: FloatArray, numbers: Error, per_pixel: int) -> FloatArray:
    """Return the bound (n,) of the error of a stamp in units of each object's noise.

    reach: (n,), half the side of the stamp [px]; snr, numbers, per_pixel: as in `psf_error`.
    """
    coefficients = [getattr(numbers.stamp, name) for name in TERMS]
    return snr * (_psf_fraction(numbers, per_pixel) + terms(scene, reach, snr, numbers) @ coefficients)


def _psf_fraction(numbers: Error, per_pixel: int) -> float:
    return numbers.psf[4 if per_pixel >= 4 else 2]


def terms(scene: Scene, reach: FloatArray, snr: FloatArray, numbers: Error) -> FloatArray:
    """Return the factors of the coefficients TERMS, (n, 3)."""
    index = scene.sersic[:, :, 0]
    radius = scene.sersic[:, :, 2]
    extended = np.where(index > 0, scene.component_fractions, 0.0)
    r = radius * np.sqrt(np.abs(np.linalg.det(scene.matrix)))[:, None]  # px
    growth = np.minimum(r / numbers.size, 1.0) * np.sqrt(1 + np.asarray(snr) / numbers.bright)[:, None]
    split = extended * np.minimum(growth, numbers.far)
    steep = np.maximum((index - 1) / 3, 0.0)
    cut = np.where(extended.any(axis=1), 0.0, 1 / np.maximum(reach, 1))
    disk = (split * np.maximum(1 - steep, 0.0)).sum(axis=1)
    bulge = (split * steep).sum(axis=1)
    return np.stack([cut, disk, bulge], axis=1)
