"""The compact star spectra against the grids they represent and the colours of real stars.

    python benchmarks/star_spectra.py [--grids FOLDER]

Residuals in mmag of the camera's colours: of the dwarf sequence against Pecaut & Mamajek 2013, and against spectra of
real dwarfs in the camera's bands (builders/real_colours.csv) at their g-i; then the CPU seconds of a chip's stars.
With --grids, against ATLAS9 and BT-Settl instead, at their nodes and between. FOLDER has the grids as files of
builders/star_grids.py, which `GridSeds` reads. Below 5200 K the model follows real colours and departs from the grids
by their errors.
"""

import argparse
import time
from itertools import pairwise
from pathlib import Path

from evidence.record import Record

import numpy as np
import speclite.filters
from astropy.table import Table
from matplotlib.figure import Figure
from star_grids import GridSeds, read_packed

from csstsim.base.shipped import SHIPPED
from csstsim.base.units import ab_photon_density
from csstsim.catalog.light.photometry import subband_weights
from csstsim.instrument.camera import Camera, load_camera
from csstsim.instrument.filter import GRID
from csstsim.report.style import BLUE, GREEN, VERMILION
from csstsim.universe.stars.star_sed import StarSeds

BUILDERS = Path(__file__).resolve().parents[1] / "builders"
BANDS = ("NUV", "u", "g", "r", "i", "z", "y")
CURVE = (5500.0 / GRID) ** 1.3
VEGA = {"U": 0.79, "B": -0.09, "V": 0.02, "R": 0.21, "I": 0.45, "BP": 0.029, "RP": 0.354, "g": 0.0, "r": 0.0}
FILTERS = [*(f"bessell-{b}" for b in "UBVRI"), "gaiadr2-BP", "gaiadr2-RP", "sdss2010-g", "sdss2010-r"]
LOGG = ([2800, 3200, 3500, 3900, 4500, 5200, 6500, 9700], [5.15, 5.05, 4.9, 4.7, 4.62, 4.55, 4.25, 4.1])
GRIDS = {
    "ATLAS9 4500-5000 K": ("ck04/ck04_packed_1500_12000A.fits", (4500, 5000), (4.0, 5.0), (-2.0, 0.5)),
    "ATLAS9 giants 4500-5000 K": ("ck04/ck04_packed_1500_12000A.fits", (4500, 5000), (1.0, 2.5), (-2.0, 0.5)),
    "ATLAS9 5250-10000 K": ("ck04/ck04_packed_1500_12000A.fits", (5250, 10000), (2.0, 5.0), (-2.5, 0.5)),
    "ATLAS9 10-30 kK": ("ck04/ck04_packed_1500_12000A.fits", (10000, 30000), (4.0, 5.0), (-2.5, 0.5)),
    "BT-Settl 2500-3500 K": ("btsettl/btsettl_cifist_solar_lephare.fits", (2500, 3500), (4.5, 5.5), (0.0, 0.0)),
}
MARKS = [(3646, "Balmer jump"), (4000, "4000 A"), (4340, "H$\\gamma$"), (4861, "H$\\beta$"), (5175, "Mg b"),
         (5893, "Na D"), (6563, "H$\\alpha$"), (7090, "TiO"), (7600, "TiO"), (8540, "Ca II")]  # fmt: skip


def camera_colours(seds, weights, *star):
    zero = np.einsum("bw,w->b", weights, ab_photon_density(GRID))
    return np.diff(2.5 * np.log10(seds.rates(*star, 0.0, weights) / zero), axis=1)


def against_grids(record: Record, seds: StarSeds, weights: np.ndarray, folder: Path) -> None:
    rng, rows = np.random.default_rng(1), []
    for name, (path, teff, logg, feh) in GRIDS.items():
        if not (folder / path).exists():
            record.skip(name, f"{folder / path} is missing")
            continue
        grid = read_packed(folder / path)
        axes = (grid.teff, teff), (grid.logg, logg), (grid.feh, feh)
        inside = np.logical_and.reduce([(low <= v) & (v <= high) for v, (low, high) in axes])
        other = GridSeds(grid, CURVE)
        nodes = grid.teff[inside], grid.logg[inside], grid.feh[inside]
        between = [rng.uniform(*limits, 500) for limits in (teff, logg, feh)]
        for where, stars in (("nodes", nodes), ("between", between)):
            gap = 1e3 * (camera_colours(seds, weights, *stars) - camera_colours(other, weights, *stars))
            cells = [f"{np.sqrt((g**2).mean()):.1f} / {np.abs(g).max():.0f}" for g in gap.T]
            rows.append([f"{name}, {where}", *cells])
    record.table("grids", ["mmag: rms / largest", *(f"{a}-{b}" for a, b in pairwise(BANDS))], rows)


def against_stars(record: Record, seds: StarSeds) -> None:
    real = Table.read(BUILDERS / "dwarf_colours.csv", format="ascii.csv", comment="#")
    surface = seds.surface(real["teff"], np.interp(real["teff"], *LOGG), 0.0)
    m = {}
    for name in FILTERS:
        response, band = speclite.filters.load_filter(name).interpolator(GRID), name.split("-")[1]
        m[band] = -2.5 * np.log10(surface @ response / (ab_photon_density(GRID) @ response)) - VEGA[band]
    print("\nmodel - real dwarfs (Pecaut & Mamajek 2013) [mmag]")
    print("type  Teff", *(f"{name:>6s}" for name in real.colnames[2:]))
    error = {name: m[name.split("-")[0]] - m[name.split("-")[1]] - real[name] for name in real.colnames[2:]}
    for k, row in enumerate(real):
        print(f"{row['type']:5s} {row['teff']:4d}", *(f"{1e3 * e[k]:6.0f}" for e in error.values()))
    used = (real["teff"] >= 3500) & (real["teff"] <= 10000)
    rms = {name: 1e3 * np.sqrt((e[used] ** 2).mean()) for name, e in error.items()}
    record.table("dwarfs", list(rms), [[f"{value:.0f}" for value in rms.values()]])
    some = (real["teff"] >= 7020) & (real["teff"] <= 8100)
    record.value("ub_largest", 1e3 * np.abs(error["U-B"][some]).max(), "largest error of U-B, A5 to F1", unit="mmag")


def against_spectra(record: Record, seds: StarSeds, weights: np.ndarray) -> None:
    """Record model - real colours at given g-i, and draw the colours along the dwarf sequence."""
    real = Table.read(BUILDERS / "real_colours.csv", format="ascii.csv")
    teff = np.geomspace(9900, 2700, 200)
    ours, names = camera_colours(seds, weights, teff, np.interp(teff, *LOGG), 0.0 * teff), real.colnames[2:]
    g_i, ours_g_i = real["g-r"] + real["r-i"], ours[:, 2] + ours[:, 3]
    error = np.stack([np.interp(g_i, ours_g_i, ours[:, k]) - real[name] for k, name in enumerate(names)], axis=1)
    print("\nmodel - spectra of real dwarfs at the same g-i [mmag]")
    print("star             g-i  " + " ".join(f"{n:>6s}" for n in names))
    for row, colour, e in zip(real, g_i, error, strict=True):
        print(f"{row['star']:15s} {colour:5.2f}", *(f"{1e3 * v:6.0f}" for v in e))
    pickles = real["source"] == "Pickles"
    rows = {
        "largest of ten STIS spectra, F1 to M2 (i to y: the Sun's)": np.nanmax(np.abs(error[~pickles]), axis=0),
        "mean of 27 spectra of Pickles (1998), A0 to M5": np.nanmean(error[pickles], axis=0),
        "largest of these": np.nanmax(np.abs(error[pickles]), axis=0),
    }
    record.table("spectra", ["", *names], [[name, *(f"{1e3 * v:.0f}" for v in each)] for name, each in rows.items()])
    page = Figure((11, 6), layout="constrained")
    for k, (axes, name) in enumerate(zip(page.subplots(2, 3, sharex=True).flat, names, strict=True)):
        axes.plot(ours_g_i, ours[:, k], color=BLUE)
        for pick, mark, label in (
            (real["source"] != "Pickles", "o", "STIS"),
            (real["source"] == "Pickles", "x", "Pickles"),
        ):
            axes.plot(
                g_i[pick], real[name][pick], mark, color=VERMILION if mark == "o" else GREEN, mfc="none", label=label
            )
        axes.set(ylabel=f"{name} [mag]", xlim=(-0.6, 3.5))
    axes.legend()
    page.supxlabel("g - i [mag, AB, the camera's bands]")
    page.savefig(record.figure("star_colours.png"), dpi=80)


def speed(record: Record, seds: StarSeds, camera: Camera, weights: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    star = [rng.uniform(low, high, 30000) for low, high in ((2500, 9000), (0, 5), (-2, 0.3), (0, 1))]
    four = subband_weights(camera.filters["g"], camera.telescope)
    for name, n, w, what in (("", 5, four, ""), ("chip", 5000, four, "5,000 stars, 4 sub-bands"),
                             ("seven", 30000, weights, "30,000 stars, 7 bands")):  # fmt: skip
        start = time.process_time()
        seds.rates(*(v[:n] for v in star), w)
        if name:
            record.value(name, time.process_time() - start, f"spectra to electrons, {what}", unit="CPU-s")


def figure(seds: StarSeds, path: Path) -> None:
    hot = [(40000, 4.0), (20000, 4.0), (9700, 4.1), (12000, 8.0), (7200, 4.2), (5770, 4.44), (4800, 2.5)]
    cool = [(4600, 4.6), (4200, 1.5), (3850, 4.7), (3200, 5.05), (2600, 5.2)]
    fig = Figure(figsize=(15, 9), layout="constrained")
    for ax, stars, step, low in zip(fig.subplots(1, 2), (hot, cool), (0.55, 1.0), (1e-5, 1e-8), strict=True):
        for k, (teff, logg) in enumerate(stars):
            f_lambda = seds.surface([teff], [logg], [0.0])[0] / GRID
            f_lambda *= 10.0 ** (-step * k) / f_lambda[(GRID > 7400) & (GRID < 7500)].mean()
            ax.plot(GRID, f_lambda, lw=0.8, color=f"C{k}")
            ax.text(11050, f_lambda[-1], f"{teff} K\nlog g {logg}", va="center", fontsize=8, color=f"C{k}")
        for wave, name in MARKS:
            ax.axvline(wave, color="0.8", lw=0.6, zorder=0)
            ax.text(wave, 1.01, name, rotation=90, fontsize=8, ha="center", transform=ax.get_xaxis_transform())
        ax.set(yscale="log", xlim=(2000, 12200), xlabel="wavelength [A]")
        ax.set(ylim=(low, None), ylabel=f"$f_\\lambda$ relative to 7450 A, each curve {step} dex below the last")
    fig.savefig(path, dpi=110)


def main(record: Record) -> None:
    seds, camera = StarSeds(SHIPPED / "universe" / "star_spectra.fits", CURVE), load_camera()
    weights = np.stack([subband_weights(camera.filters[b], camera.telescope).sum(axis=0) for b in BANDS])
    if record.options.grids:
        against_grids(record, seds, weights, record.options.grids)
        return
    against_stars(record, seds)
    against_spectra(record, seds, weights)
    speed(record, seds, camera, weights)
    figure(seds, record.figure("star_spectra.png"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grids", type=Path, help="folder of the packed grids; only these are compared")
    with Record(parser) as record:
        main(record)
