"""Builder of config/universe/galaxy_spectra.fits: 20 components that span galaxies' rest-frame spectra.

Templates: the five of kcorrect (Blanton & Roweis 2007, AJ 133, 734; BSD-3, from skypy), with stars and emission lines
separate, stars without dust, per solar mass of stars formed. Their lines are reddened and too strong: `lines` of
galaxies.yaml takes their dust out and gives them the strength observed. Dust: Calzetti et al. (2000, ApJ 533, 682),
made steeper as Salim et al. (2018, ApJ 859, 11) found, the same for stars and lines. The components are singular
vectors (no mean subtracted, so an SED is a plain sum) of random mixtures of templates, dust and line strengths. Each
wavelength is weighted by the inverse of the mixtures' geometric mean, so that faint ultraviolet counts as much as
bright red light.
The file also has the projections of each template with each dust column, so a galaxy's coefficients are linear in its
masses.

    python builders/build_galaxy_spectra.py ../shared/data             # writes galaxy_spectra.fits if it differs
    python builders/build_galaxy_spectra.py --check ../shared/data     # writes nothing; exit code 1 if it differs

Two files are the same if their arrays are equal to 1e-5 of the largest value.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from astropy.io import fits
from kept import Keeper, same_fits

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.base.units import C_A_S, H_J_S
from csstsim.instrument.load import read_data

REST = 600.0 + 2.9 * np.arange(3587)  # angstrom (paper, section 3.2.2)
DUST = np.linspace(0.0, 3.0, 31)  # A(V), mag
COMPONENTS = 20
MIXTURES = 2500
LYMAN_LIMIT, ESCAPE = 912.0, 0.03  # A; share of starlight below it that leaves the galaxy: a few per cent (E)


def calzetti(wavelength):
    """Return A(lambda)/A(V) of Calzetti et al. (2000), equation 4, R_V = 4.05; linear in 1 / lambda below 1200 A."""
    x = 1e4 / np.maximum(wavelength, 1200.0)
    blue = 2.659 * (-2.156 + 1.509 * x - 0.198 * x**2 + 0.011 * x**3) + 4.05
    red = 2.659 * (-1.857 + 1.040 * x) + 4.05
    k = np.where(wavelength < 6300.0, blue, red) / 4.05
    slope = (2.659 * (1.509 - 0.396 / 0.12 + 0.033 / 0.12**2)) / 4.05  # of k in x at 1200 A
    return k + np.where(wavelength < 1200.0, slope * (1e4 / wavelength - 1e4 / 1200.0), 0.0)


def attenuation(wavelength):
    """Return A(lambda)/A(V): Calzetti's times (lambda / 5500 A)^slope, `dust.slope` of galaxies.yaml."""
    return calzetti(wavelength) * (wavelength / 5500.0) ** numbers()["dust"]["slope"]


def numbers():
    return read_data(SHIPPED / "universe" / "galaxies.yaml")


def templates(path):
    """Return stars, lines (5, 3587): photon / s / m2 / A per solar mass formed at 10 pc; and the templates' table."""
    with fits.open(path) as file:
        wave = file[11].data.astype(float)
        stars, lines = (rebin(wave, file[hdu].data.astype(float)) for hdu in (4, 9))
        info = {name: file[hdu].data for name, hdu in (("surviving", 17), ("metals", 18), ("m300", 19), ("m1000", 20))}
    own = numbers()["lines"]
    lines *= own["strength"] * 10 ** (0.4 * own["dust"] * attenuation(REST))
    photons = 1e-3 * REST / (H_J_S * C_A_S)  # erg / s / cm2 / A to photon / s / m2 / A
    return stars * photons * np.where(REST < LYMAN_LIMIT, ESCAPE, 1.0), lines * photons, info


def rebin(wave, flux):
    """Return `flux` (n, len(wave)) averaged over the cells of the rest grid, which keeps the light of lines."""
    edges = np.append(REST - 1.45, REST[-1] + 1.45)
    total = np.concatenate(
        [np.zeros((len(flux), 1)), np.cumsum(0.5 * (flux[:, 1:] + flux[:, :-1]) * np.diff(wave), axis=1)], axis=1
    )
    at = np.array([np.interp(edges, wave, row) for row in total])
    return np.diff(at, axis=1) / 2.9


def mixtures(stars, lines, rng):
    """Return (MIXTURES, 3587) random galaxies, each of unit mean light at 4000-8000 A."""
    optical = (REST > 4000) & (REST < 8000)
    mix = rng.dirichlet(np.full(5, 0.35), MIXTURES) / stars[:, optical].mean(axis=1)  # shares of optical light
    dust = np.minimum(rng.exponential(0.35, MIXTURES), DUST[-1])[:, None]
    strength = rng.lognormal(0.0, 0.7, MIXTURES)[:, None]
    seds = (mix @ stars + strength * (mix @ lines)) * 10 ** (-0.4 * dust * attenuation(REST))
    return seds / seds[:, optical].mean(axis=1, keepdims=True)


def main() -> int:
    """Make the file, and print how well the components span galaxies; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the reference data")
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 if the file differs")
    options = parser.parse_args()
    stars, lines, info = templates(options.data / "galsed" / "k_nmf_derived.default.fits")
    train = mixtures(stars, lines, stream(1, "galaxy spectra"))
    weight = 1.0 / np.exp(np.log(train).mean(axis=0))
    rows = train * weight
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    basis = np.linalg.svd(rows, full_matrices=False)[2][:COMPONENTS]
    dimmed = 10 ** (-0.4 * DUST[:, None] * attenuation(REST))  # (dust, wavelength)
    projections = [
        np.einsum("tw,aw,kw->tak", part * weight, dimmed, basis) for part in (stars, lines)
    ]  # orthonormal rows: the projection is a product
    basis = basis / weight
    held = mixtures(stars, lines, stream(2, "galaxy spectra"))
    found = np.einsum("nw,kw->nk", held * weight, basis * weight)
    error = np.einsum("nk,kw->nw", found, basis) / held - 1
    for low, high in ((912, 2000), (2000, 4000), (4000, 11000)):
        part = (low < REST) & (high > REST)
        broad = (found @ basis)[:, part].sum(axis=1) / held[:, part].sum(axis=1) - 1
        mags = held[:, part].sum(axis=1)
        for name, rows in (("all", mags > 0), ("brighter half", mags > np.median(mags))):
            rms, worst = error[rows][:, part].std(), np.quantile(np.abs(broad[rows]), 0.99)
            print(f"{low}-{high} A, {name}: rms per sample {rms:.5f}; 99% of |broad-band error| below {worst:.5f}")
    keeper = Keeper(options.check)
    with keeper.file(SHIPPED / "universe" / "galaxy_spectra.fits", same_fits(1e-5)) as new:
        write(new, basis, projections, info)
    return keeper.code()


def write(path, basis, projections, info):
    head = fits.Header()
    head["SOURCE"] = "kcorrect NMF templates, Blanton & Roweis 2007, AJ 133, 734 (BSD-3)"
    head["DUST"] = "Calzetti et al. 2000, ApJ 533, 682, times (lambda/5500 A)^dust.slope"
    head["BUILDER"] = "builders/build_galaxy_spectra.py"
    head["WAVE0"], head["DWAVE"] = (REST[0], "angstrom, rest frame"), (2.9, "angstrom")
    head["LINEDUST"] = (numbers()["lines"]["dust"], "mag of A(V) taken out of the templates' lines")
    head["LINES"] = (numbers()["lines"]["strength"], "factor on these lines")
    head["ESCAPE"] = (ESCAPE, "of starlight below 912 A (estimate)")
    columns = [fits.Column(name, "E", array=values) for name, values in info.items()]
    fits.HDUList([
        fits.PrimaryHDU(header=head),
        fits.ImageHDU(basis.astype(np.float32), name="BASIS"),
        fits.ImageHDU(projections[0].astype(np.float32), name="STARS"),
        fits.ImageHDU(projections[1].astype(np.float32), name="LINES"),
        fits.ImageHDU(DUST.astype(np.float32), name="DUST"),
        fits.BinTableHDU.from_columns(columns, name="TEMPLATES"),
    ]).writeto(path)  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
