"""Make the files of the example: python make_lens.py [FOLDER]      needs lenstronomy (pip install "csstsim[lens]").

A quasar in a disk galaxy at z = 0.6 behind an elliptical galaxy at z = 0.3. lenstronomy gives the arcs of the disk, and
places, magnifications and delays of the quasar's images. Written: objects.csv, arcs.fits, curves.csv, three spectra.
All numbers are made up, but of the size of known lenses.
"""

import sys
from pathlib import Path

import numpy as np
from astropy.cosmology import FlatLambdaCDM
from astropy.io import fits
from lenstronomy.LensModel.lens_model import LensModel
from lenstronomy.LensModel.Solver.lens_equation_solver import LensEquationSolver
from lenstronomy.LightModel.light_model import LightModel

PLACE = 150.1, 2.2  # deg
Z_LENS, Z_SOURCE = 0.3, 0.6
LENS = [{"theta_E": 1.1, "e1": 0.10, "e2": 0.06, "center_x": 0.0, "center_y": 0.0}, {"gamma1": 0.04, "gamma2": -0.03}]
SOURCE = {"R_sersic": 0.20, "n_sersic": 1.0, "e1": 0.15, "e2": 0.1, "center_x": 0.07, "center_y": 0.05}
MAG_LENS, MAG_DISK, MAG_QUASAR = 18.3, 21.7, 22.8  # r, AB; disk and quasar before lensing
SCALE, SIDE, FINER = 0.03, 151, 5  # arcsec, pixels, and points along the side of each
START, DAYS, STEP = 61600.0, 700.0, 5.0  # MJD, of the light curves
WALK, DAMPING = 0.25, 200.0  # mag, days: the quasar's damped random walk
WAVE = np.arange(2000.0, 11001.0, 10.0)  # angstrom, observed


def model():
    """Return the LensModel: an isothermal ellipsoid in an external shear; x is to the east, y to the north."""
    cosmology = FlatLambdaCDM(H0=70, Om0=0.3)
    return LensModel(["SIE", "SHEAR"], z_lens=Z_LENS, z_source=Z_SOURCE, cosmo=cosmology)


def arcs(lens):
    """Return the light of the lensed disk in each pixel, north up and east left, and its magnification."""
    step = SCALE / FINER
    at = (np.arange(SIDE * FINER) - (SIDE * FINER - 1) / 2) * step
    east, north = np.meshgrid(-at, at)
    disk = LightModel(["SERSIC_ELLIPSE"])
    place = lens.ray_shooting(east.ravel(), north.ravel(), LENS)
    seen = disk.surface_brightness(*place, [SOURCE | {"amp": 1.0}]).reshape(east.shape)
    whole = disk.total_flux([SOURCE | {"amp": 1.0}])[0]
    pixels = seen.reshape(SIDE, FINER, SIDE, FINER).sum(axis=(1, 3)) * step**2
    return pixels, pixels.sum() / whole


def quasar_images(lens):
    """Return (east, north [arcsec], magnification, delay [day]) of the images, the first to vary first."""
    solver = LensEquationSolver(lens)
    middle = SOURCE["center_x"], SOURCE["center_y"]
    east, north = solver.image_position_from_source(*middle, LENS, min_distance=0.01, search_window=5.0)
    delay = lens.arrival_time(east, north, LENS, x_source=middle[0], y_source=middle[1])
    first = np.argsort(delay)
    magnification = np.abs(lens.magnification(east, north, LENS))
    return east[first], north[first], magnification[first], (delay - delay.min())[first]


def walk():
    """Return a function of MJD: the quasar's change [mag], a damped random walk with a step a day."""
    rng, days = np.random.default_rng(1), np.arange(START - 100, START + DAYS + 1)
    keep = np.exp(-1 / DAMPING)
    value, values = WALK * rng.standard_normal(), []
    for _ in days:
        values.append(value)
        value = keep * value + WALK * np.sqrt(1 - keep**2) * rng.standard_normal()
    return lambda mjd: np.interp(mjd, days, values)


def spectra():
    """Return {file: photon density}: of an old galaxy, a disk with [O II] and H beta, and a quasar with Mg II."""

    def line(rest, width, z):
        return np.exp(-0.5 * ((WAVE - rest * (1 + z)) / width) ** 2)

    step = 1 / (1 + np.exp(-(WAVE - 4000 * (1 + Z_LENS)) / 60))
    old = (0.25 + 0.75 * step) * (WAVE / 7000) ** np.where(WAVE < 7000, 1.5, 0.3)
    disk = (WAVE / 7000) ** -0.7 + 10 * line(3727.5, 6, Z_SOURCE) + 2 * line(4861.3, 6, Z_SOURCE)
    quasar = (WAVE / 7000) ** -0.6 * (1 + 1.2 * line(2798, 45, Z_SOURCE))
    return {"old.csv": old, "disk.csv": disk, "quasar.csv": quasar}


def main(folder):
    """Write the files into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    lens, change = model(), walk()
    pixels, magnification = arcs(lens)
    fits.writeto(folder / "arcs.fits", (pixels / pixels.sum()).astype(np.float32), overwrite=True)
    for name, flux in spectra().items():
        np.savetxt(folder / name, np.stack([WAVE, flux], 1), "%.4g", ",", header="WAVELENGTH,FLUX", comments="")
    head = "id,ra,dec,z,type,mag_r,size,n,e1,e2,part_of,offset_ra,offset_dec,image_file,image_scale,spectrum_file"
    head += ",light_curve"
    ra, dec = PLACE
    rows = [
        f"1,{ra},{dec},{Z_LENS},galaxy,{MAG_LENS},0.9,4,0.1,0.06,,,,,,old.csv,",
        f"2,,,{Z_SOURCE},galaxy,{MAG_DISK - 2.5 * np.log10(magnification):.4f},,1,0,0,1,,,arcs.fits,{SCALE},disk.csv,",
    ]
    curves, days = ["curve,mjd,dmag"], np.arange(START, START + DAYS + 1, STEP)
    for k, (east, north, mu, delay) in enumerate(zip(*quasar_images(lens), strict=True)):
        name, mag = "ABCD"[k], MAG_QUASAR - 2.5 * np.log10(mu)
        rows.append(f"{k + 3},,,{Z_SOURCE},quasar,{mag:.4f},,1,0,0,1,{east:.5f},{north:.5f},,,quasar.csv,{name}")
        curves += [f"{name},{mjd:.0f},{dmag:.4f}" for mjd, dmag in zip(days, change(days - delay), strict=True)]
        print(f"{name}: {east:+.3f}, {north:+.3f} arcsec, magnified {mu:.2f} times, {delay:.2f} days late")
    print(f"arcs: magnified {magnification:.2f} times")
    (folder / "objects.csv").write_text("\n".join([head, *rows]) + "\n")
    (folder / "curves.csv").write_text("\n".join(curves) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
