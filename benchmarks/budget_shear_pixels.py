"""What undersampled pixels do to m1 - m2: lone galaxies by GalSim, on pixels of the camera and half as wide.

Rings of four noiseless exponential galaxies, behind the shipped PSF of the middle of chip 9, are sheared by +-0.02 in
each component and drawn by GalSim on 0.074 arcsec pixels and on 0.037, in stamps of 3.6 and of 7.1 arcsec; `hsm` of
the budget measures them, smoothed by 0.074 arcsec in all. Printed are m1, m2 and their difference, on the pixels' axes,
with errors from the rings. A minute.
"""

import galsim
import numpy as np

from csstsim.api import Simulation
from csstsim.budget.shear import estimators
from csstsim.budget.shear.frames import DEC, RA
from csstsim.budget.shear.sample import RING
from csstsim.stages.psf import open_psf

SCALE, G, RINGS = 0.074, 0.02, 40


def psf_of(chip=9):
    """Return the PSF of r on the middle of a chip, of the bands' mean, as a galsim.InterpolatedImage."""
    simulation = Simulation().replace(psf={"grid": 6}).aim(RA, DEC, chip, size=200)
    run = simulation._run
    simulation.light("10100000001", chip)  # makes the PSF set, if there is none
    detector = run.camera.detector
    found = open_psf(run, run.camera.chips[chip])
    cells = found.at(detector.nx / 2, detector.ny / 2).mean(axis=0)
    return galsim.InterpolatedImage(galsim.ImageD(cells), scale=SCALE / found.oversampling, flux=1.0)


def drawn(profile, side, factor, shift=(0.0, 0.0)):
    """Return the stamp of a profile, of `side` SCALE, on pixels of SCALE / factor; its place is on the middle pixel."""
    scale, side = SCALE / factor, side * factor
    centre = galsim.PositionD(*(scale / 2 + SCALE * v for v in shift))
    return profile.shift(centre).drawImage(nx=side, ny=side, scale=scale).array.astype(float)


def measured(psf, side, factor):
    """Return (rings, 2): the response of rings to each component, less 1."""
    rng, star = np.random.default_rng(1), drawn(psf, side, factor)
    shapes = []
    for _ in range(RINGS):
        size, e = np.exp(rng.uniform(*np.log((0.3, 0.6)))), 0.35 * np.sqrt(rng.random())
        turn, g2 = np.exp(2j * (rng.uniform(0, np.pi) + np.pi / 4 * np.arange(RING))), rng.choice([-1, 1])
        shift = rng.uniform(-0.5, 0.5, (RING, 2))
        arms = []
        for arm in (G, -G):
            stamps = []
            for one, place in zip(e * turn, shift, strict=True):
                galaxy = galsim.Exponential(half_light_radius=size, flux=1e5).shear(g1=one.real, g2=one.imag)
                stamps.append(drawn(galsim.Convolve(galaxy.shear(g1=arm, g2=g2 * arm), psf), side, factor, place))
            arms.append(estimators.hsm(np.array(stamps), np.array([star] * RING), 0.0, SCALE, None).e.mean())
        half = (arms[0] - arms[1]) / (2 * G) - (1 + 1j * g2)
        shapes.append([half.real, g2 * half.imag])
    return np.array(shapes)


def main():
    """Run as the module says."""
    psf, smooth = psf_of(), estimators.SMOOTH
    for side, factor in ((48, 1), (48, 2), (96, 1), (96, 2)):
        estimators.SMOOTH = smooth * factor  # the same angle
        m = measured(psf, side, factor)
        m = 1e4 * np.column_stack([m, m[:, 0] - m[:, 1]])
        pairs = [
            f"{v:+.1f} ± {s:.1f}" for v, s in zip(m.mean(axis=0), m.std(axis=0, ddof=1) / len(m) ** 0.5, strict=True)
        ]
        print(f"stamps of {side * SCALE:.1f} arcsec, pixels of {SCALE / factor:.3f}: m1, m2, m1 - m2 [1e-4]:", *pairs)


if __name__ == "__main__":
    main()
