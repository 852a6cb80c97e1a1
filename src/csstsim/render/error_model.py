"""How wrong a method draws an object, in units of the object's own noise: what the policy weighs against cost.

An error that is a share of an object's light is seen with that share of its S/N, so for n objects

    bound = S/N (psf + cut / reach [points] + (disk or bulge) split [galaxies])
    split = min(min(r / size, 1) sqrt(1 + S/N / bright), far)

* psf: the density between the stored cells, common to photons and stamps; ten times larger with 2 cells to a pixel
  than with 4;
* cut: light beyond the stamp of a point, whose wing leaves a share of 1 / reach;
* disk, bulge: how a profile of Sersic index 1 or 4 is split and transformed (other indices linearly between and beyond,
  none below a disk's), r its half-light radius in pixels. In bright objects the far parts, where that is wrong, stand
  out of the sky and count for more, until all do (`far`).

It rises with S/N, hence with flux. The coefficients are such that at most 5% of objects exceed their bound against the
reference renderer: fitted on one sample and tested on another by benchmarks/error_model.py, for objects of S/N 0.1 to
3000, half-light radii to 2.5 arcsec and q down to 0.11. `far` is from galaxies of S/N to 14000, of which the bound is 1
to 4 times what the benchmark sees (--bright). It is of an ideal filter on the whole stamp: 1e-5 of the peak in
thousands of pixels is ten times the noise. Left out: the PSF's interpolation between nodes, wings, ghosts.
"""

import numpy as np

TERMS = ("cut", "disk", "bulge")  # of stamps


def predicted(method, scene, reach, snr, numbers, per_pixel):
    """Return the bound (n,) of the error of `method` ("photons", "stamp"), in units of each object's noise.

    scene: render.scene.Scene; reach (n,): half the side of the stamp [px]; snr (n,): light over noise, by policy.noise;
    numbers: render.settings.Error; per_pixel: stored cells of the PSF to a pixel.
    """
    share = np.full(len(scene), numbers.psf[4 if per_pixel >= 4 else 2])
    if method == "stamp":
        share += terms(scene, reach, snr, numbers) @ [getattr(numbers.stamp, name) for name in TERMS]
    return snr * share


def terms(scene, reach, snr, numbers):
    """Return what the coefficients TERMS are multiplied with, (n, 3)."""
    index, radius = scene.sersic[:, :, 0], scene.sersic[:, :, 2]
    there = np.where(index > 0, scene.light, 0.0)
    r = radius * np.sqrt(np.abs(np.linalg.det(scene.matrix)))[:, None]  # px
    growth = np.minimum(r / numbers.size, 1.0) * np.sqrt(1 + np.asarray(snr) / numbers.bright)[:, None]
    split = there * np.minimum(growth, numbers.far)
    steep = np.maximum((index - 1) / 3, 0.0)
    cut = np.where(there.any(axis=1), 0.0, 1 / np.maximum(reach, 1))
    disk, bulge = (split * np.maximum(1 - steep, 0.0)).sum(axis=1), (split * steep).sum(axis=1)
    return np.stack([cut, disk, bulge], axis=1)
