"""Builder of config/universe/star_spectra.fits, the compact model of stellar atmospheres (universe.stars.star_sed).

    python builders/build_star_spectra.py ../shared/data config/universe/star_spectra.fits Table_DA.txt [--check]

The file is written if it differs: two are the same if arrays are equal to 4e-5 of the largest value, a step of the 16
bits of coefficients. `--check` writes nothing, and ends with exit code 1 if it differs.

Steps, all in ln of photon density at the knots: (1) Castelli & Kurucz 2004 on (Teff, log g, [Fe/H]); (2) BT-Settl
CIFIST (Baraffe+ 2015) for cool stars, with the [Fe/H] dependence of BT-Settl at log g 4.5 (grizli's copy) and the
gravity dependence of ATLAS9 where BT-Settl has no giants; (3) a smooth transition between the two from 3600 to 4200 K;
(4) below 5200 K and above log g 3 to 4 a smooth factor that brings U-B, B-V, V-Rc, V-Ic and g-r of the dwarf sequence
to those of real stars (Pecaut & Mamajek 2013), as in Lejeune+ 1997, moved by what spectra of real dwarfs say of u-g and
g-r; the ultraviolet is that of such spectra (real_dwarfs.csv); (5) white dwarfs: ATLAS9 at log g 5, [Fe/H] -2.5 times a
smooth factor that gives the photometry of pure-hydrogen atmospheres (Holberg & Bergeron 2006), with unchanged lines;
(6) principal components. Needs the reference data and the Montreal table of pure-hydrogen atmospheres of
2021-01-13 (in the PyPI package WDPhotTools: wd_photometry/Table_DA_13012021.txt).
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import speclite.filters
from astropy.io import fits
from astropy.table import Table
from kept import Keeper, same_fits
from star_grids import GridSeds, read_packed

from csstsim.base.units import ab_photon_density
from csstsim.instrument.filter import GRID
from csstsim.universe.stars.star_sed import KNOTS, cubic, linear

COMPONENTS = 60
RELATIVE = 4e-5  # of coefficients in 16 bits
UV_FLOOR = 1e-6  # of the peak photon density: a cool star's light below it is not that of the photosphere
FEH = np.array([-2.5, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5])
LOGG = np.array([0.0, 1.0, 2.0, 3.0, 3.5, 4.0, 4.5, 5.0, 5.5])
WHITE = np.array([7.0, 8.0, 9.0])
TEFF = np.concatenate([
    np.arange(1900, 4300, 100), np.arange(4400, 5000, 200), np.arange(5000, 13001, 250),
    [14000, 15000, 16000, 18000, 20000, 22000, 25000, 28000, 31000, 35000, 40000, 45000, 50000],
]).astype(float)  # fmt: skip
FADE = (3600.0, 4200.0)  # K: BT-Settl below, ATLAS9 above
DWARFS = Path(__file__).with_name("dwarf_colours.csv")
REAL = Path(__file__).with_name("real_dwarfs.csv")
UV_ENDS, RED_STARTS = (3050.0, 3300.0), (8200.0, 8900.0)  # angstrom: where the corrections of NUV and z end and start
OLD = -1.5  # [Fe/H]: lines that the atmospheres lack in the ultraviolet of warm stars matter no more
DWARF_LOGG = ([2800, 3200, 3500, 3900, 4500, 5200], [5.15, 5.05, 4.9, 4.7, 4.62, 4.55])
BANDS = ["bessell-U", "bessell-B", "bessell-V", "bessell-R", "bessell-I", "sdss2010-g", "sdss2010-r"]
AB_OF_VEGA = np.array([0.79, -0.09, 0.02, 0.21, 0.45, 0.0, 0.0])  # Blanton & Roweis 2007, AJ 133, 734; SDSS is AB
COLOURS = np.array([  # V itself is unchanged
    [1, -1, 0, 0, 0, 0, 0], [0, 1, -1, 0, 0, 0, 0], [0, 0, 1, -1, 0, 0, 0], [0, 0, 1, 0, -1, 0, 0],
    [0, 0, 0, 0, 0, 1, -1], [0, 0, 1, 0, 0, 0, 0],
])  # fmt: skip
FULL, NONE = 4600.0, 5200.0  # K: the colour correction fades between
SOURCES = [  # lines of at most 72 characters
    "Coefficients fitted to the model atmospheres of Castelli & Kurucz 2004,",
    "IAU Symp. 210, A20 (ATLAS9, STScI ck04models); BT-Settl CIFIST2011_2015,",
    "Allard+ 2012, RSPTA 370, 2765; Baraffe+ 2015, A&A 577, A42 (copies in",
    "lephare-data and, for [Fe/H], gbrammer/grizli-config).",
    "Colours of cool dwarfs: Pecaut & Mamajek 2013, ApJS 208, 9; Covey+ 2007,",
    "AJ 134, 2398; spectra of dwarfs by STIS (CALSPEC; NGSL, Heap & Lindler)",
    "and of Pickles 1998, PASP 110, 863.",
    "White dwarfs: photometry of pure-hydrogen atmospheres of",
    "Holberg & Bergeron 2006, AJ 132, 1221; Tremblay+ 2011, ApJ 730, 128;",
    "Bedard+ 2020, ApJ 901, 93 (Montreal table of 2021-01-13).",
]
_G_CGS, _SUN_G, _PC_CM = 6.674e-8, 1.98841e33, 3.0857e18  # CODATA 2018, IAU 2015
DA_BANDS = ["galex-nuv", "sdss2010-u", "bessell-B", "sdss2010-g", "bessell-V", *(f"sdss2010-{b}" for b in "riz")]
DA_BANDS += ["panstarrs-y"]
DA_COLUMNS = [42, 25, 6, 26, 7, 27, 28, 29, 34]  # of the table; AB except B and V


def fade(x, low, high):
    """Return a smooth step: 0 below `low`, 1 above `high`."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def response(name):
    """Return a speclite filter at the knots."""
    return speclite.filters.load_filter(name).interpolator(KNOTS)


def ab_mags(ln_s, filters):
    """Return AB magnitudes (..., bands) of ln photon density (..., knots)."""
    zero = np.einsum("bw,w->b", filters, ab_photon_density(KNOTS))
    return -2.5 * np.log10(np.einsum("...w,bw->...b", np.exp(ln_s), filters) / zero)


def warp(ln_s, filters, target, basis, colours=None):
    """Return the combination of `basis` (m, knots) that, added to ln_s, gives the AB magnitudes `target` (m,).

    With `colours` (m, bands), the target is colours @ magnitudes. Newton's method with derivatives by differences.
    """
    colours = np.eye(len(target)) if colours is None else colours
    shift = np.zeros(len(target))
    for _ in range(6):
        every = ln_s + (shift + 1e-3 * np.vstack([np.zeros(len(shift)), np.eye(len(shift))])) @ basis
        value = ab_mags(every, filters) @ colours.T
        shift = shift - np.linalg.solve((value[1:] - value[0]).T / 1e-3, value[0] - target)
    return shift @ basis


def broken(knots):
    """Return (n, 1801) hat functions of ln lambda over `knots` [angstrom], constant outside."""
    x = np.log(knots)
    return np.stack([np.interp(np.log(KNOTS), x, row) for row in np.eye(len(x))])


def on_grid(seds, teff, logg, feh):
    """Return ln photon density (teff, logg, feh, knots), interpolated in a grid and constant outside it."""
    t, g, z = (axis.ravel() for axis in np.meshgrid(teff, logg, feh, indexing="ij"))
    out = np.log(seds.surface(t, g, z, KNOTS))
    return out.reshape(len(teff), len(logg), len(feh), -1)


def metallicity(path):
    """Return ln flux ratios to [Fe/H] = 0, (cool TEFF, FEH, knots), of BT-Settl at log g 4.5."""
    with fits.open(path) as file:
        head, table = file[1].header, file[1].data
        wave, flux = np.float64(table["wave"]), np.float64(table["flux"]).T
        node = np.array([[head[f"{k}{i:03d}"] for k in ("TEFF", "ZMET")] for i in range(len(flux))])
    ln_flux = np.log(np.maximum([np.interp(KNOTS, wave, f) for f in flux], 1e-30))

    def at(teff, feh):
        mine = np.flatnonzero(node[:, 1] == feh)
        mine = mine[np.argsort(node[mine, 0])]
        i, w = linear(node[mine, 0], np.array([teff]))
        return w[0] @ ln_flux[mine[i[0]]]

    def ratio(teff, feh):
        # Outside a metallicity's own range of Teff the ratio is that at its edge
        own = node[node[:, 1] == feh, 0]
        teff = np.clip(teff, max(own.min(), 1900), own.max())
        return at(teff, feh) - at(teff, 0.0)

    out = np.zeros((len(TEFF), len(FEH), len(KNOTS)))
    for i, teff in enumerate(TEFF):
        for j, feh in enumerate(FEH):
            # For [Fe/H] = -1.5 the copy has only 3000-5000 K: take the mean of its neighbours
            out[i, j] = 0.5 * (ratio(teff, -1.0) + ratio(teff, -2.0)) if feh == -1.5 else ratio(teff, feh)
    return out


def atmospheres(data):
    """Return ln photon density (TEFF, LOGG, FEH, knots) of steps 1 to 3."""
    none = np.zeros_like(GRID)
    hot = GridSeds(read_packed(data / "ck04/ck04_packed_1500_12000A.fits"), none)
    cool = GridSeds(read_packed(data / "btsettl/btsettl_cifist_solar_lephare.fits"), none)
    kurucz = on_grid(hot, np.maximum(TEFF, 3500), LOGG, FEH)
    settl = on_grid(cool, np.minimum(TEFF, 7000), np.maximum(LOGG, 4), [0.0])
    settl = settl + metallicity(data / "btsettl/grizli_bt-settl_t400-7000_g4.5.fits")[:, None]
    four = list(LOGG).index(4.0)
    settl[:, :four] += kurucz[:, :four] - kurucz[:, four : four + 1]
    share = fade(TEFF, *FADE)[:, None, None, None]
    return share * kurucz + (1 - share) * settl, hot


def calibrate(ln_s):
    """Step 4: add to ln_s (TEFF, LOGG, FEH, knots), in place, the corrections to the colours of real dwarfs."""
    filters = np.array([response(name) for name in BANDS])
    basis = broken([3600, 4300, 4850, 5450, 6500, 7900])
    table = Table.read(DWARFS, format="ascii.csv", comment="#")
    table = table[table["teff"] < NONE + 100][::-1]  # cool first
    rows = []
    move = Table.read(REAL, format="ascii.csv", comment="#")
    for name, column in (("U-B", "u-g"), ("g-r", "g-r")):
        table[name] += np.interp(table["teff"], move["teff"], move[column])
    for teff, *colours in table[["teff", "U-B", "B-V", "V-R", "V-I", "g-r"]].iterrows():
        (i, a), (j, b) = cubic(5040 / TEFF[::-1], np.array([5040 / teff])), linear(LOGG, [np.interp(teff, *DWARF_LOGG)])
        model = np.einsum("p,q,pqw->w", a[0], b[0], ln_s[::-1][i[0]][:, j[0], list(FEH).index(0.0)])
        target = np.append(colours, 0.0) + COLOURS @ AB_OF_VEGA
        target[-1] = ab_mags(model, filters)[2]
        rows.append(warp(model, filters, target, basis, COLOURS))
    for k, teff in enumerate(TEFF):
        correction = np.array([np.interp(teff, table["teff"], column) for column in np.array(rows).T])
        correction *= 1 - fade(teff, FULL, NONE)
        ln_s[k] += fade(LOGG, 3.0, 4.0)[:, None, None] * correction
        dim = np.interp(teff, move["teff"], move["NUV"]) * (1 - fade(KNOTS, *UV_ENDS)) * np.log(10) / 2.5
        # Missing lines depend on metals; where real stars are brighter, it is a chromosphere, which giants have less
        share = np.clip(1 - FEH / OLD, 0, 1)[None, :] if dim[0] > 0 else fade(LOGG, 3.0, 4.0)[:, None]
        red = np.interp(teff, move["teff"], move["z"]) * fade(KNOTS, *RED_STARTS) * np.log(10) / 2.5
        ln_s[k] += fade(LOGG, 3.0, 4.0)[:, None, None] * red
        ln_s[k] -= np.broadcast_to(share, (len(LOGG), len(FEH)))[:, :, None] * dim


def white_dwarfs(hot, path):
    """Step 5: return ln photon density (TEFF, WHITE, knots)."""
    table = np.loadtxt(path, skiprows=2)
    filters = np.array([response(name) for name in DA_BANDS])
    basis = broken([2300, 3680, 3880, 4700, 5500, 6200, 7500, 8900, 9650])  # 3680 to 3880: the Balmer jump
    zero = np.array([dict(zip(BANDS, AB_OF_VEGA, strict=True)).get(band, 0.0) for band in DA_BANDS])
    out = np.zeros((len(TEFF), len(WHITE), len(KNOTS)))
    for q, logg in enumerate(WHITE):
        mine = table[table[:, 1] == logg]
        ln_t = np.log(mine[:, 0])
        for k, teff in enumerate(np.maximum(TEFF, 3000)):
            row = np.array([np.interp(np.log(teff), ln_t, column) for column in mine.T])
            radius2 = _G_CGS * row[2] * _SUN_G / 10**logg
            target = row[DA_COLUMNS] + zero + 2.5 * np.log10(radius2 / (10 * _PC_CM) ** 2)
            start = np.log(hot.surface([max(teff, 3500)], [5.0], [-2.5], KNOTS)[0])
            out[k, q] = start + warp(start, filters, target, basis)
    return out


def importance():
    """Return (TEFF, LOGG + WHITE, FEH): the nodes' weights for the components; least where there are no stars."""
    t, g, z = np.meshgrid(TEFF, [*LOGG, *WHITE], FEH, indexing="ij")
    out = np.where((t < 5000) & (g < 6), 1.7, 1.0)
    out[(g > 6) & (t < 4000)] = 0.05
    out[(g > 6) & (z != 0)] = 0.0  # copies
    out[(g < 3.9) & (t < 3300)] *= 0.1
    out[(g < 3.9) & (t > 15000)] *= 0.3
    out[(z != 0) & (t < 2500)] *= 0.3
    return out.ravel()


def components(ln_s, weight):
    """Return mean (knots,), components (k, knots) and coefficients (n, k) in -1 ... 1 of ln_s (n, knots).

    Least squares in a metric that weights residuals smooth over 150 A, which change broad bands, eleven times.
    """
    mean = np.average(ln_s, axis=0, weights=weight)
    seen = np.interp(KNOTS, [2000, 2500, 3000], [0.1, 0.5, 1.0])
    smooth = np.exp(-0.5 * ((KNOTS[:, None] - KNOTS) / 150.0) ** 2)
    metric = seen[:, None] * (np.eye(len(KNOTS)) + 10 * smooth / smooth.sum(axis=1).max()) * seen
    value, vector = np.linalg.eigh(metric)
    root, inverse = ((vector * np.sqrt(np.maximum(value, 1e-9)) ** power) @ vector.T for power in (1, -1))
    part = (ln_s - mean) @ root
    axes = np.linalg.eigh((part * weight[:, None] ** 2).T @ part)[1][:, ::-1][:, :COMPONENTS]
    coefficients, basis = part @ axes, axes.T @ inverse
    scale = np.abs(coefficients).max(axis=0) * np.sign(basis[np.arange(COMPONENTS), np.abs(basis).argmax(axis=1)])
    return mean, basis * scale[:, None], coefficients / scale


def write(out, nodes, mean, basis, coefficients):
    """Write the FITS file that StarSeds reads."""
    image = fits.ImageHDU(coefficients.astype(np.float32), name="COEFF")
    image.scale("int16", bscale=1 / 32767)
    hdus = [fits.PrimaryHDU(), image, fits.ImageHDU(np.vstack([mean, basis]).astype(np.float32), name="BASIS")]
    hdus += [fits.ImageHDU(axis, name=name) for name, axis in zip(("THETA", "LOGG", "FEH"), nodes, strict=True)]
    head = hdus[0].header
    head["BUILDER"] = "builders/build_star_spectra.py"
    head["BUNIT"] = ("photon/s/m2/Angstrom", "exp(BASIS[0] + COEFF @ BASIS[1:])")
    head["CRVAL1"], head["CDELT1"] = (KNOTS[0], "Angstrom, first knot"), (KNOTS[1] - KNOTS[0], "Angstrom")
    for line in SOURCES:
        head["HISTORY"] = line
    fits.HDUList(hdus).writeto(out)  # no checksum, whose comment has the date


def report(loss, used):
    """Print the components' errors in boxes of 1000 A, rms and largest over the nodes in use [mmag]."""
    boxes = 1085.7 * loss[..., :-1].reshape(*loss.shape[:3], -1, 200).mean(axis=-1)
    for low, high in ((1900, 2500), (2500, 3500), (3500, 5000), (5000, 10000), (10000, 50001)):
        rows = ((low <= TEFF) & (high > TEFF))[::-1]
        part = boxes[rows][used[rows]]
        cells = [f"{np.sqrt((box**2).mean()):.1f}/{np.abs(box).max():.0f}" for box in part.T]
        print(f"{low}-{high} K, from 2000 A:", *cells)


def main() -> int:
    """Make the file; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the reference data")
    parser.add_argument("out", type=Path, help="the file")
    parser.add_argument("table_da", type=Path, help="Montreal table of pure-hydrogen atmospheres")
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if the file differs")
    options = parser.parse_args()
    ln_s, hot = atmospheres(options.data)
    calibrate(ln_s)
    white = white_dwarfs(hot, options.table_da)[:, :, None]
    ln_s = np.concatenate([ln_s, np.repeat(white, len(FEH), axis=2)], axis=1)
    ln_s = np.logaddexp(ln_s, ln_s.max(axis=-1, keepdims=True) + np.log(UV_FLOOR))[::-1]  # theta rises
    weight = importance().reshape(ln_s.shape[:3])[::-1].ravel()
    mean, basis, coefficients = components(ln_s.reshape(-1, len(KNOTS)), weight)
    loss = (mean + coefficients @ basis - ln_s.reshape(-1, len(KNOTS))).reshape(*ln_s.shape[:3], -1)
    report(loss, weight.reshape(ln_s.shape[:3]) >= 0.3)
    nodes = 5040.0 / TEFF[::-1], np.append(LOGG, WHITE), FEH
    keeper = Keeper(options.check)
    with keeper.file(options.out, same_fits(RELATIVE)) as new:
        write(new, nodes, mean, basis, coefficients.reshape(*ln_s.shape[:3], COMPONENTS))
    return keeper.code()


if __name__ == "__main__":
    sys.exit(main())
