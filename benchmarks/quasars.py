"""Quasars of the embedded universe against published numbers: counts, spectrum, colours; and the CPU time of a brick.

    python benchmarks/quasars.py [--figure docs/figures/quasars.png] [--composites FILE ...]

Counts per deg2 are those of both luminosity functions of quasars.yaml, in CSST g without Milky Way dust. With
--composites, real composite spectra (two columns: angstrom, F_lambda) are drawn with the mean quasar's.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from csstsim.base.rng import stream
from csstsim.catalog.light.photometry import rate_to_mag, subband_weights
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID
from csstsim.instrument.load import read_data
from csstsim.report.style import BLUE, GREEN, ORANGE, SKY, VERMILION
from csstsim.universe.dust.extinction import odonnell
from csstsim.universe.lensing.cosmology import Cosmology
from csstsim.universe.quasars.quasar_sed import COEFFICIENTS, QuasarSeds
from csstsim.universe.quasars.quasars import draw_quasars

SHIPPED = Path(__file__).resolve().parents[1] / "config"
AREA = 4.0  # deg2
BRICK = 4 * 180.0**2 / np.pi / (12 * 256**2)  # deg2
LIMITS = (19, 20, 21, 22, 23, 24, 25, 26)
PUBLISHED = {22: "~100", 24: "300-400"}  # deg-2, after Ross et al. 2013 and Palanque-Delabrouille et al. 2016
# Median SDSS colours by redshift: Richards et al. 2001, AJ 121, 2308; rounded, accurate to about 0.1 mag
TRACK = ((0.5, 0.15, 0.1), (1.0, 0.15, 0.2), (1.5, 0.05, 0.15), (2.0, 0.1, 0.1), (2.5, 0.6, 0.1), (3.0, 1.3, 0.2))
NOBODY = {"z": np.zeros(0), "bulgemass": np.zeros(0)}


def sample(numbers, cosmology):
    """Return (z, coefficients, scale) of AREA deg2."""
    drawn = draw_quasars(lambda name: stream(1, "benchmark", name), AREA, NOBODY, numbers, cosmology)
    return drawn["z"], np.column_stack([drawn[f"coeff{k}"] for k in range(COEFFICIENTS)]), drawn["sed_scale"]


def magnitudes(seds, quasars, camera, names):
    """Return (n, names) AB magnitudes and the CPU seconds they cost."""
    filters = [camera.filters[name] for name in names]
    weights = np.stack([subband_weights(f, camera.telescope).sum(axis=0) for f in filters])
    z, own, scale = quasars
    start = time.process_time()
    rates = seds.rates(z, own, np.zeros(len(z)), weights) * scale[:, None]
    cpu = time.process_time() - start
    return np.column_stack([rate_to_mag(rates[:, k], f, camera.telescope) for k, f in enumerate(filters)]), cpu


def report_counts(numbers, seds, camera, cosmology):
    """Print counts per deg2 at g < limit; return the magnitudes for the shipped luminosity function."""
    found = {}
    for chosen in ("published", "simqso"):
        quasars = sample(numbers | {"luminosity_function": chosen}, cosmology)
        found[chosen] = (*magnitudes(seds, quasars, camera, camera.filters), quasars[0])
    print(f"quasars / deg2 at g <   {'published':>10s} {'simqso':>10s} {'observed':>10s}")
    g = list(camera.filters).index("g")
    for limit in LIMITS:
        row = [(mag[:, g] < limit).sum() / AREA for mag, _, _ in found.values()]
        print(f"{limit:21d}   {row[0]:10.1f} {row[1]:10.1f} {PUBLISHED.get(limit, ''):>10s}")
    mag, cpu, z = found[numbers["luminosity_function"]]
    count = len(z) / AREA * BRICK
    print(f"{count:.0f} quasars per brick, {cpu / len(z) * count:.3f} CPU s for their rates in {mag.shape[1]} filters")
    return z, mag


def mean_quasar(m1450=-26.0):
    own = np.zeros((1, COEFFICIENTS))
    own[:, 0] = m1450
    return own


def report_colours(seds, camera):
    """Print u-g and g-r of the mean quasar, and SDSS's; the bands differ a little."""
    print("\n   z    u-g  SDSS    g-r  SDSS")
    for z, u_g, g_r in TRACK:
        mag, _ = magnitudes(seds, (np.array([z]), mean_quasar(), np.ones(1)), camera, ("u", "g", "r"))
        print(f"{z:4.1f} {mag[0, 0] - mag[0, 1]:6.2f} {u_g:5.2f} {mag[0, 1] - mag[0, 2]:6.2f} {g_r:5.2f}")


def figure(path, seds, camera, z, mag, composites):
    from matplotlib.figure import Figure

    page = Figure((12, 8), layout="constrained")
    top, left, right = (page.add_subplot(2, 2, k) for k in ((1, 2), 3, 4))
    rest = np.arange(1000.0, 7300.0, 1.0)  # seen at z = 1, where the forest absorbs little
    flux = seds.spectra([1.0], mean_quasar(), [1.0], [0.0], 2 * rest)[0] / rest
    top.plot(rest, flux / np.interp(1450, rest, flux), color="k", lw=1, label="mean quasar, M1450 = -26")
    for name, colour in zip(composites, (BLUE, ORANGE, GREEN), strict=False):
        x, y = np.loadtxt(name, usecols=(0, 1)).T
        part = (x > 1000) & (x < 7300)
        norm = np.median(y[(x > 1430) & (x < 1480)])
        top.plot(x[part], y[part] / norm, color=colour, lw=0.7, label=name.stem)
    top.set(xscale="log", yscale="log", ylim=(0.05, 5), xlabel="rest wavelength [A]", ylabel="F_lambda / F(1450 A)")
    top.legend()
    names = list(camera.filters)
    u, g, r = (mag[:, names.index(band)] for band in "ugr")
    some = g < 24
    for axes, blue, red, column, label in ((left, u, g, 1, "u - g"), (right, g, r, 2, "g - r")):
        axes.plot(z[some], (blue - red)[some], ".", ms=3, color=SKY, label="drawn, g < 24 (CSST bands)")
        known = [(t[0], t[column]) for t in TRACK]
        axes.plot(*zip(*known, strict=True), "D", color=VERMILION, label="SDSS median (Richards et al. 2001)")
        axes.set(xlim=(0, 5), ylim=(-1, 3), xlabel="z", ylabel=label)
    left.legend(loc="upper left")
    page.savefig(path, dpi=90)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--figure", type=Path, help="write the figure here")
    parser.add_argument("--composites", type=Path, nargs="*", default=[], help="files of real composite spectra")
    args = parser.parse_args()
    subjects = ("quasars", "galaxies", "cosmology")
    numbers, galaxies, cosmology = (read_data(SHIPPED / "universe" / f"{name}.yaml") for name in subjects)
    camera, seds = load_camera(SHIPPED / "instrument"), QuasarSeds(numbers, galaxies["igm"], odonnell(GRID))
    z, mag = report_counts(numbers, seds, camera, Cosmology(cosmology))
    report_colours(seds, camera)
    if args.figure:
        figure(args.figure, seds, camera, z, mag, args.composites)


if __name__ == "__main__":
    main()
