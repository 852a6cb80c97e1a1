"""Quasars of the embedded universe against published numbers: counts, spectrum, colours; and the CPU time of a brick.

    python benchmarks/quasars.py [--composites FOLDER]

Counts per deg2 are those of both luminosity functions of quasars.yaml, in CSST g without Milky Way dust. With
--composites, only docs/figures/quasars.png is drawn: FOLDER has real composite spectra (sed/QSO of LePhare's data).
"""

import argparse
import time
from pathlib import Path

from evidence.record import Record

import numpy as np
from matplotlib.figure import Figure

from csstsim.base.rng import stream
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.light.photometry import rate_to_mag, subband_weights
from csstsim.instrument.camera import Camera, load_camera
from csstsim.instrument.filter import GRID
from csstsim.instrument.load import read_data
from csstsim.report.style import BLUE, GREEN, ORANGE, SKY, VERMILION
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.dust.extinction import odonnell
from csstsim.universe.lensing.cosmology import Cosmology
from csstsim.universe.quasars.quasar_sed import QuasarSeds
from csstsim.universe.quasars.quasars import draw_quasars

AREA, TOY_AREA = 16.0, 0.1  # deg2
BRICK = 4 * 180.0**2 / np.pi / (12 * 256**2)  # deg2
LIMITS = (19, 20, 21, 22, 23, 24, 25, 26)
SHOWN = (22, 23, 24)
EXPECTED = ("about 100", "-", "300-400")  # deg-2, after Ross et al. 2013 and Palanque-Delabrouille et al. 2016
NEAR = (34, 59, 98)  # deg-2 at z < 1 and r < SHOWN: Palanque-Delabrouille et al. 2016, A&A 587, A41, table 7
# Median SDSS colours by redshift: Richards et al. 2001, AJ 121, 2308; rounded, accurate to about 0.1 mag
TRACK = ((0.5, 0.15, 0.1), (1.0, 0.15, 0.2), (1.5, 0.05, 0.15), (2.0, 0.1, 0.1), (2.5, 0.6, 0.1), (3.0, 1.3, 0.2))
COMPOSITES = ("QSO_SDSS.sed", "QSO_VVDS.sed", "qso_template_norm.sed")  # angstrom, F_lambda
NOBODY = {"z": np.zeros(0), "bulgemass": np.zeros(0)}


def sample(numbers: dict, cosmology: Cosmology, area: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (z, coefficients, scale) of the quasars of an area [deg2]."""
    drawn = draw_quasars(lambda name: stream(1, "benchmark", name), area, NOBODY, numbers, cosmology)
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


def report_counts(record: Record, numbers: dict, seds: QuasarSeds, camera: Camera, cosmology: Cosmology) -> None:
    """Record counts per deg2 of both luminosity functions."""
    found, area = {}, TOY_AREA if record.toy else AREA
    for chosen in ("published", "simqso"):
        quasars = sample(numbers | {"luminosity_function": chosen}, cosmology, area)
        found[chosen] = (*magnitudes(seds, quasars, camera, camera.filters), quasars[0])
    names = list(camera.filters)
    g, r = names.index("g"), names.index("r")
    rows = [[f"{limit}", *(f"{(mag[:, g] < limit).sum() / area:.1f}" for mag, _, _ in found.values())]
            for limit in LIMITS]  # fmt: skip
    record.table("functions", ["quasars per deg², g <", *found], rows)
    mag, cpu, z = found[numbers["luminosity_function"]]

    def per_deg2(keep: np.ndarray) -> str:
        return f"{keep.sum() / area:.0f} ± {np.sqrt(keep.sum()) / area:.0f}"

    rows = [
        ["quasars per deg², g", *(per_deg2(mag[:, g] < limit) for limit in SHOWN)],
        ["expected", *EXPECTED],
        ["quasars per deg² at z < 1, r", *(per_deg2((mag[:, r] < limit) & (z < 1)) for limit in SHOWN)],
        ["Palanque-Delabrouille et al. 2016, table 7", *NEAR],
    ]
    record.table("counts", ["", *(f"< {limit}" for limit in SHOWN)], rows)
    count = len(z) / area * BRICK
    record.value("brick", count, "quasars of a brick", error=np.sqrt(len(z)) / area * BRICK)
    record.value("brick_cpu", cpu / len(z) * count, f"their rates in {mag.shape[1]} bands", unit="CPU-s")


def mean_quasar(m1450=-26.0):
    own = np.zeros((1, COEFFICIENTS))
    own[:, 0] = m1450
    return own


def report_colours(record: Record, seds: QuasarSeds, camera: Camera) -> None:
    """Record u-g and g-r of the mean quasar, and SDSS's; the bands differ a little."""
    rows = []
    for z, u_g, g_r in TRACK:
        ((u, g, r),), _ = magnitudes(seds, (np.array([z]), mean_quasar(), np.ones(1)), camera, ("u", "g", "r"))
        rows.append([z, f"{u - g:.2f}", f"{u_g:.2f}", f"{g - r:.2f}", f"{g_r:.2f}"])
    record.table("colours", ["z", "u - g", "SDSS", "g - r", "SDSS"], rows)


def figure(record: Record, seds: QuasarSeds, camera: Camera, z: np.ndarray, mag: np.ndarray) -> None:
    page = Figure((12, 8), layout="constrained")
    top, left, right = (page.add_subplot(2, 2, k) for k in ((1, 2), 3, 4))
    rest = np.arange(1000.0, 7300.0, 1.0)  # seen at z = 1, where the forest absorbs little
    flux = seds.spectra([1.0], mean_quasar(), [1.0], [0.0], 2 * rest)[0] / rest
    top.plot(rest, flux / np.interp(1450, rest, flux), color="k", lw=1, label="mean quasar, M1450 = -26")
    for name, colour in zip(COMPOSITES, (BLUE, ORANGE, GREEN), strict=True):
        path = record.options.composites / name
        if not path.exists():
            record.skip(name, f"{path} is missing")
            continue
        x, y = np.loadtxt(path, usecols=(0, 1)).T
        part = (x > 1000) & (x < 7300)
        norm = np.median(y[(x > 1430) & (x < 1480)])
        top.plot(x[part], y[part] / norm, color=colour, lw=0.7, label=path.stem)
    top.set(xscale="log", yscale="log", ylim=(0.05, 5), xlabel="rest wavelength [A]", ylabel="F_lambda / F(1450 A)")
    top.legend()
    names = list(camera.filters)
    u, g, r = (mag[:, names.index(band)] for band in "ugr")
    some = g < 24
    for axes, blue, red, column, label in ((left, u, g, 1, "u - g"), (right, g, r, 2, "g - r")):
        axes.plot(z[some], (blue - red)[some], ".", ms=3, color=SKY, label="simulated, g < 24 (CSST bands)")
        known = [(t[0], t[column]) for t in TRACK]
        axes.plot(*zip(*known, strict=True), "D", color=VERMILION, label="SDSS median (Richards et al. 2001)")
        axes.set(xlim=(0, 5), ylim=(-1, 3), xlabel="z", ylabel=label)
    left.legend(loc="upper left")
    page.savefig(record.figure("quasars.png"), dpi=90)


def main(record: Record) -> None:
    subjects = ("quasars", "galaxies", "cosmology")
    numbers, galaxies, cosmology = (read_data(SHIPPED / "universe" / f"{name}.yaml") for name in subjects)
    camera, seds = load_camera(), QuasarSeds(numbers, galaxies["igm"], odonnell(GRID))
    if record.options.composites:
        quasars = sample(numbers, Cosmology(cosmology), TOY_AREA if record.toy else AREA)
        figure(record, seds, camera, quasars[0], magnitudes(seds, quasars, camera, camera.filters)[0])
        return
    report_counts(record, numbers, seds, camera, Cosmology(cosmology))
    report_colours(record, seds, camera)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--composites", type=Path, help="folder of real composite spectra; only the picture is drawn")
    with Record(parser) as record:
        main(record)
