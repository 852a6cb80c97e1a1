"""Predicted error of an object's image by drawing method, in units of the object's own noise; used by render.policy.

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


def predicted(
    method: str, scene: Scene, reach: FloatArray, snr: FloatArray, numbers: Error, per_pixel: int
) -> FloatArray:
    """Return the bound (n,) of the error of `method` ("photons", "stamp"), in units of each object's noise.

    scene: render.scene.Scene; reach (n,): half the side of the stamp [px]; snr (n,): light over noise, by policy.noise;
    numbers: render.settings.Error; per_pixel: stored cells of the PSF to a pixel.
    """
    fraction = np.full(len(scene), numbers.psf[4 if per_pixel >= 4 else 2])
    if method == "stamp":
        fraction += terms(scene, reach, snr, numbers) @ [getattr(numbers.stamp, name) for name in TERMS]
    return snr * fraction


def terms(scene: Scene, reach: FloatArray, snr: FloatArray, numbers: Error) -> FloatArray:
    """Return the factors of the coefficients TERMS, (n, 3)."""
    index = scene.sersic[:, :, 0]
    radius = scene.sersic[:, :, 2]
    there = np.where(index > 0, scene.component_fractions, 0.0)
    r = radius * np.sqrt(np.abs(np.linalg.det(scene.matrix)))[:, None]  # px
    growth = np.minimum(r / numbers.size, 1.0) * np.sqrt(1 + np.asarray(snr) / numbers.bright)[:, None]
    split = there * np.minimum(growth, numbers.far)
    steep = np.maximum((index - 1) / 3, 0.0)
    cut = np.where(there.any(axis=1), 0.0, 1 / np.maximum(reach, 1))
    disk = (split * np.maximum(1 - steep, 0.0)).sum(axis=1)
    bulge = (split * steep).sum(axis=1)
    return np.stack([cut, disk, bulge], axis=1)
