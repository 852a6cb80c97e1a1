"""What undersampled pixels do to m1 - m2: lone galaxies by GalSim, on pixels of the camera and half as wide.

Rings of four noiseless exponential galaxies, behind the shipped PSF of the middle of chip 9, are sheared by +-0.02 in
each component and drawn by GalSim on 0.074 arcsec pixels and on 0.037, in stamps of 3.6 and of 7.1 arcsec; `hsm` of
the budget measures them, smoothed by 0.074 arcsec in all. Recorded are m1, m2 and their difference, on the pixels'
axes, with errors from the rings. A minute.
"""

import argparse
from pathlib import Path

from evidence.record import Record

import galsim
import numpy as np
from astropy.table import Table

from csstsim.api import Simulation
from csstsim.stages.psf import open_psf
from csstsim.studies.budget.shear import estimators
from csstsim.studies.budget.shear.frames import DEC, RA
from csstsim.studies.budget.shear.sample import RING

SCALE, G, RINGS, TOY_RINGS = 0.074, 0.02, 40, 3
GRID, TOY_GRID = 6, 2  # nodes of the PSF set along a side
CASES = {"small": (48, 1), "small_half": (48, 2), "wide": (96, 1), "wide_half": (96, 2)}  # side of the stamp, factor


def psf_of(cache: Path, grid: int, chip: int = 9) -> galsim.InterpolatedImage:
    """Return the PSF of r on the middle of a chip, of the bands' mean; cache: folder of PSF sets."""
    nothing = Table({"ra": [RA], "dec": [DEC], "mag_r": [20.0], "type": ["star"]})
    simulation = Simulation(cache=cache).replace(psf={"grid": grid}, catalog=nothing).aim(RA, DEC, chip, size=200)
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


def measured(psf, side, factor, rings):
    """Return (rings, 2): the response of rings to each component, less 1."""
    rng, star = np.random.default_rng(1), drawn(psf, side, factor)
    shapes = []
    for _ in range(rings):
        size, e = np.exp(rng.uniform(*np.log((0.3, 0.6)))), 0.35 * np.sqrt(rng.random())
        turn, g2 = np.exp(2j * (rng.uniform(0, np.pi) + np.pi / 4 * np.arange(RING))), rng.choice([-1, 1])
        shift = rng.uniform(-0.5, 0.5, (RING, 2))
        arms = []
        for arm in (G, -G):
            stamps = []
            for one, place in zip(e * turn, shift, strict=True):
                galaxy = galsim.Exponential(half_light_radius=size, flux=1e5).shear(g1=one.real, g2=one.imag)
                stamps.append(drawn(galsim.Convolve(galaxy.shear(g1=arm, g2=g2 * arm), psf), side, factor, place))
            ring = estimators.Stamps(np.array(stamps), np.array([star] * RING), 0.0, SCALE)
            arms.append(estimators.hsm(ring, None).e.mean())
        half = (arms[0] - arms[1]) / (2 * G) - (1 + 1j * g2)
        shapes.append([half.real, g2 * half.imag])
    return np.array(shapes)


def main(record: Record) -> None:
    """Record m1, m2 and their difference for each stamp and pixel."""
    psf, smooth = psf_of(record.results / "cache", TOY_GRID if record.toy else GRID), estimators.SMOOTH
    rows = []
    for key, (side, factor) in CASES.items():
        estimators.SMOOTH = smooth * factor  # the same angle
        m = measured(psf, side, factor, TOY_RINGS if record.toy else RINGS)
        m = 1e4 * np.column_stack([m, m[:, 0] - m[:, 1]])
        mean, error = m.mean(axis=0), m.std(axis=0, ddof=1) / len(m) ** 0.5
        where = f"stamps of {side * SCALE:.1f} arcsec, pixels of {SCALE / factor:.3f}"
        rows.append([f"{side * SCALE:.1f}", f"{SCALE / factor:.3f}",
                     *(f"{v:+.1f} ± {s:.1f}" for v, s in zip(mean, error, strict=True))])  # fmt: skip
        record.value(key, mean[2], f"m1 - m2, {where}", unit="1e-4", error=error[2])
    record.table("bias", ["stamp [arcsec]", "pixel [arcsec]", "m1 [1e-4]", "m2", "m1 - m2"], rows)


if __name__ == "__main__":
    with Record(argparse.ArgumentParser(description=__doc__.splitlines()[0])) as record:
        main(record)
