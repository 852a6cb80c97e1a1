"""Builder of `stars.spectrum` in config/universe/: model atmospheres against Planck, as broken lines.

For each Teff the ratio of the model's flux to the Planck function, in magnitudes, is fitted by least squares with
a line broken at WAVELENGTH (in ln lambda), then set to 0 at 5500 A. Metallicity: slope per dex between
[M/H] = -1.5 and 0. Models: Castelli & Kurucz 2004 from 4200 K, logg 4.5; BT-Settl (Allard et al. 2012) below, solar.
Below 3500 K the metallicity slope of 3500 K is kept. Needs the reference data (CSSTSIM_DATA); prints YAML.

    python tests/universe/build_star_spectrum.py ../shared/data
"""

import sys
from pathlib import Path

import numpy as np
from astropy.io import fits

from csstsim.units import C_A_S, H_J_S, K_J_K

WAVELENGTH = [2000, 2300, 2600, 2800, 3000, 3300, 3620, 3720, 3950, 4150, 4500, 5000, 5500, 6200, 6700, 7100, 7500,
              8200, 8700, 9600, 11000]  # fmt: skip
TEFF = [2600, 3000, 3400, 3800, 4200, 4800, 5400, 6000, 6800, 8000, 9600, 12000]


def hats(wave):
    """Return (n, knots): the broken-line basis at `wave`."""
    knots = np.log(WAVELENGTH)
    return np.stack([np.interp(np.log(wave), knots, row) for row in np.eye(len(knots))], axis=1)


def broken_line(wave, flux, teff):
    """Return the knots' magnitudes of a model relative to Planck, 0 at 5500 A."""
    use = (wave >= 2000) & (wave <= 11000) & (flux > 0)
    x = H_J_S * C_A_S / (wave[use] * K_J_K * teff)
    ratio = -2.5 * np.log10(flux[use] * wave[use] ** 5 * np.expm1(x))
    weight = np.sqrt(np.gradient(np.log(wave[use])))[:, None]
    knots = np.linalg.lstsq(hats(wave[use]) * weight, ratio * weight[:, 0], rcond=None)[0]
    return knots - knots[WAVELENGTH.index(5500)]


def main(data):
    """Print the two tables."""
    with (
        fits.open(data / "ck04/ck04_packed_1500_12000A.fits") as ck,
        fits.open(data / "btsettl/btsettl_cifist_solar_lephare.fits") as bt,
    ):
        ck_wave, ck = np.float64(ck[1].data), ck[2].data
        bt_wave, bt = np.float64(bt[1].data), bt[2].data

    def kurucz(teff, feh):
        def at(t):
            row = (ck["teff"] == t) & (ck["logg"] == 4.5) & (ck["feh"] == feh)
            return np.log(np.maximum(np.float64(ck["flux"][row][0]), 1e-300))

        grid = np.unique(ck["teff"])
        low = grid[grid <= teff][-1]
        high = grid[grid >= teff][0]
        share = (teff - low) / (high - low) if high > low else 0.0
        return np.exp((1 - share) * at(low) + share * at(high))

    solar, slope = [], []
    for teff in TEFF:
        if teff < 4200:
            logg = 5.0
            row = (bt["teff"] == teff) & (bt["logg"] == logg)
            solar.append(broken_line(bt_wave, np.float64(bt["flux"][row][0]), teff))
        else:
            solar.append(broken_line(ck_wave, kurucz(teff, 0.0), teff))
        warm = max(teff, 3500)
        poor, rich = (broken_line(ck_wave, kurucz(warm, feh), warm) for feh in (-1.5, 0.0))
        slope.append((rich - poor) / 1.5)
    for name, rows in (("solar", solar), ("per_dex", slope)):
        print(f"    {name}:")
        for row in rows:
            print("      - [" + ", ".join(f"{v:.2f}" for v in row) + "]")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
