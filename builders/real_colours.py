"""Builder of real_colours.csv: colours of real dwarfs in the camera's bands, from their spectra.

    python builders/real_colours.py FOLDER builders/real_colours.csv

FOLDER has sun_reference_stis_002.fits (CALSPEC), h_stis_ngsl_*_v2.txt (STIS Next Generation Spectral Library),
HD020630.txt and HR8086.txt (Pal et al. 2023, ApJS 266, 41): public copies are in github.com/Askaniy/TrueColorTools,
folder spectra/files; and the dwarfs of Pickles 1998, PASP 110, 863, as g2v.sed.ext and so on
(github.com/lephare-photoz/lephare-data, folder sed/STAR/PICKLES). A band that a spectrum does not cover has no colour.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import Table

from csstsim.base.shipped import SHIPPED
from csstsim.base.units import ab_photon_density
from csstsim.catalog.light.photometry import subband_weights
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID

BANDS = ("NUV", "u", "g", "r", "i", "z", "y")
STIS = {
    "h_stis_ngsl_hd105452_v2": "F1V", "h_stis_ngsl_hd114710_v2": "G0V", "HD020630": "G5V",
    "h_stis_ngsl_hd115617_v2": "G7V", "h_stis_ngsl_hd185144_v2": "K0V", "h_stis_ngsl_hd022049_v2": "K2V",
    "h_stis_ngsl_hd201091_v2": "K5V", "HR8086": "K7V", "h_stis_ngsl_hd095735_v2": "M2V",
}  # fmt: skip
PICKLES = (
    "a0v a2v a3v a5v a7v f0v f2v f5v f6v f8v g0v g2v g5v g8v k0v k2v k3v k4v k5v k7v m0v m1v m2v m2p5v m3v m4v m5v"
)


def colours(wave, flux, weights):
    """Return the colours (bands - 1,) of a spectrum, per angstrom, at wave [angstrom]; NaN where it has no light."""
    light = np.interp(GRID, wave, flux, left=np.nan, right=np.nan) * GRID
    zero = ab_photon_density(GRID)
    rates = [np.sum((light * w)[w > 0]) / np.sum((zero * w)[w > 0]) for w in weights]
    return np.diff(2.5 * np.log10(rates))


def main(folder, out):
    """Write the table."""
    camera = load_camera(SHIPPED / "instrument")
    weights = np.stack([subband_weights(camera.filters[b], camera.telescope).sum(axis=0) for b in BANDS])
    sun = fits.getdata(Path(folder) / "sun_reference_stis_002.fits")
    spectra = [("Sun", "CALSPEC", sun["WAVELENGTH"], sun["FLUX"])]
    for names, source, ending in ((STIS, "STIS", ".txt"), (PICKLES.split(), "Pickles", ".sed.ext")):
        for name in names:
            wave, flux = np.loadtxt(Path(folder) / (name + ending))[:, :2].T
            label = f"{name.split('_')[-2] if '_' in name else name}-{STIS[name]}" if source == "STIS" else name
            spectra.append((label, source, wave, flux))
    rows = [(name, source, *np.round(colours(wave, flux, weights), 3)) for name, source, wave, flux in spectra]
    heads = [f"{a}-{b}" for a, b in pairwise(BANDS)]
    Table(rows=rows, names=["star", "source", *heads]).write(out, format="ascii.csv", overwrite=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
