"""Angular correlation of the mock's galaxies compared with published measurements, and a seam test.

    pip install treecorr
    python benchmarks/galaxy_clustering.py                                                        (30 CPU-minutes)

w(theta) is by treecorr (Landy & Szalay). Values are means of three patches of 13.4 deg2, and errors are from their
scatter; the picture is of the first patch, with errors by leaving out one of 64 parts of the sky after the other. In
redshift slices w is compared with Limber's integral of halofit times the square of the bias that Nicola et al. (2020,
JCAP 03, 044) measured in HSC, b = (0.8346 - 0.0624 (i - 24)) D^-1.3. Without errors of w, the ratio would be that of
the galaxies' haloes: the square of their mean bias. The seam test counts pairs in the same brick and pairs across a
border, in the first 64 bricks. Galaxies of patches (clustered_sky.py) are kept in results/galaxy_clustering.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from evidence.record import Record

import clustered_sky
import matplotlib
import numpy as np

try:
    import treecorr
except ImportError:
    treecorr = None
matplotlib.use("Agg")
import matplotlib.pyplot as plt
from scipy.special import j0
from structure_lensing import kept_folder

from csstsim.base.healpix import NSIDE
from csstsim.catalog.truth_bricks import random_positions
from csstsim.universe.lensing.power_spectrum import MatterPower
from csstsim.universe.parameters import Universe, load_universe

Sky = dict[str, np.ndarray]
PATCHES, TOY_PATCHES = (409600, 51200, 640000), (409600,)  # first brick of each
BRICKS, TOY_BRICKS = 256, 4  # of a patch
TOY_DENSITY = 40.0  # galaxies per arcmin2
MAGNITUDES = ((18.0, 22.5), (22.5, 24.0), (24.0, 25.5), (18.0, 25.0))  # the last has the median 24 of COSMOS
SLICES = ((0.15, 0.5), (0.5, 0.75), (0.75, 1.0), (1.0, 1.5))  # of galaxies to i = 24.5, as Nicola et al.
MOST, TOY_MOST = 150_000, 5_000  # galaxies of a sample; more are thinned
BINS = {"min_sep": 0.1, "max_sep": 30.0, "nbins": 12, "sep_units": "arcmin", "bin_slop": 0.3, "num_threads": 1}
SHOWN = (1.0, 3.0)  # arcmin: the bins nearest to these are in the table
PARTS = 64  # of the sky, and bricks of the seam test
SEAM = {"min_sep": 0.1, "max_sep": 6.0, "nbins": 6, "sep_units": "arcmin", "bin_slop": 0.1, "num_threads": 1}
COSMOS = (1.0, 0.014)  # arcmin, w: at a median i of 24 (McCracken et al. 2007, ApJS 172, 314)


def catalogue(sky: Sky, chosen: np.ndarray, most: int, rng: np.random.Generator) -> "treecorr.Catalog":
    """Return the treecorr.Catalog of at most so many of some rows, with their column `patch`."""
    rows = np.flatnonzero(chosen)
    rows = np.sort(rng.choice(rows, min(len(rows), most), replace=False))
    return treecorr.Catalog(
        ra=sky["ra"][rows], dec=sky["dec"][rows], ra_units="deg", dec_units="deg", patch=sky["patch"][rows]
    )


def random_catalogue(bricks: np.ndarray, count: int, rng: np.random.Generator) -> "treecorr.Catalog":
    """Return a treecorr.Catalog of uniform positions on the bricks, in at most PARTS patches."""
    spots = [random_positions(pix, rng, count // len(bricks))[:2] for pix in bricks]
    ra, dec = (np.concatenate(v) for v in zip(*spots, strict=True))
    patch = np.repeat(np.arange(len(bricks)) // part(bricks), count // len(bricks))
    return treecorr.Catalog(ra=ra, dec=dec, ra_units="deg", dec_units="deg", patch=patch)


def part(bricks: np.ndarray) -> int:
    """Return how many bricks make one of PARTS."""
    return max(len(bricks) // PARTS, 1)


def pairs(bins: dict, first: "treecorr.Catalog", second: "treecorr.Catalog | None" = None) -> "treecorr.NNCorrelation":
    """Return the NNCorrelation of one or two catalogues."""
    found = treecorr.NNCorrelation(**bins, var_method="jackknife")
    found.process(first, second)
    return found


def correlation(
    data: "treecorr.Catalog", randoms: "treecorr.Catalog", rr: "treecorr.NNCorrelation"
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return theta [arcmin], w and its error; the integral constraint is added for a power law of slope -0.8."""
    dd, dr = pairs(BINS, data), pairs(BINS, data, randoms)
    w, variance = dd.calculateXi(rr=rr, dr=dr)
    shape = np.exp(dd.meanlogr) ** -0.8
    fraction = (rr.npairs * shape).sum() / (0.5 * randoms.ntot**2)  # of pairs within the largest separation
    good = (w > 0) & (variance > 0)
    amplitude = np.average(w[good] / shape[good], weights=(shape[good]) ** 2 / variance[good])
    return np.exp(dd.meanlogr), w + amplitude * fraction, np.sqrt(variance)


def seam(
    data: "treecorr.Catalog", randoms: "treecorr.Catalog"
) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """Return theta and w with its error of pairs within bricks, then across borders: jackknife over bricks."""
    dd, dr, rr = pairs(SEAM, data), pairs(SEAM, data, randoms), pairs(SEAM, randoms)
    patches = data.npatch
    ratio = randoms.ntot / data.ntot

    def estimate(same, left_out):
        sums = []
        for found in (dd, dr, rr):
            total = np.zeros(len(found.npairs))
            for (i, j), part in found.results.items():
                if (i == j) == same and left_out not in (i, j):
                    total += part.npairs
            sums.append(total)
        return (sums[0] * ratio**2 - sums[1] * ratio + sums[2]) / sums[2]

    out = []
    for same in (True, False):
        whole = estimate(same, -1)
        parts = np.stack([estimate(same, k) for k in range(patches)])
        out.append((whole, np.sqrt((patches - 1) / patches * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0))))
    return np.exp(dd.meanlogr), out


def predicted(theta: np.ndarray, z: np.ndarray, universe: Universe) -> np.ndarray:
    """Return w(theta [arcmin]) of Limber's integral for redshifts z of galaxies to i = 24.5 with the bias of HSC."""
    cosmology = universe.cosmology
    power = MatterPower(cosmology, universe.numbers["cosmology"])
    number, edges = np.histogram(z, 40, density=True)
    middle = 0.5 * (edges[1:] + edges[:-1])
    chi, width = cosmology.comoving_distance(middle), np.diff(cosmology.comoving_distance(edges))
    kernel = number * np.diff(edges) / width * hsc_bias(middle, universe)
    ell = np.geomspace(1.0, 3e5, 6000)
    spectrum = sum(
        w * (k / c) ** 2 * power.nonlinear(ell / c, zz) for w, k, c, zz in zip(width, kernel, chi, middle, strict=True)
    ) * np.exp(-((ell / 1e5) ** 2))
    return np.array(
        [np.trapezoid(ell**2 * spectrum * j0(ell * np.radians(t / 60)) / (2 * np.pi), np.log(ell)) for t in theta]
    )


def hsc_bias(z: np.ndarray, universe: Universe) -> np.ndarray:
    """Return the bias of HSC's galaxies to i = 24.5 (Nicola et al. 2020)."""
    return (0.8346 - 0.0624 * 0.5) * universe.cosmology.growth(z) ** -1.30


def halo_bias(sky: Sky, chosen: np.ndarray, universe: Universe) -> float:
    """Return the square of the mean bias of the haloes of galaxies, over that of HSC's."""
    chosen = chosen & np.isfinite(sky["halomass"])
    matter = universe.matter_field(clustered_sky.SEED, haloes=True)
    ours = matter.mass_function.bias(sky["halomass"][chosen], sky["z"][chosen])
    return float((ours.mean() / hsc_bias(sky["z"][chosen], universe).mean()) ** 2)


def read_sky(folder: Path, structure: str, first: int, toy: bool) -> Sky:
    """Return the galaxies of a patch with a column `patch`, the number of one of PARTS."""
    bricks = range(first, first + (TOY_BRICKS if toy else BRICKS))
    density = TOY_DENSITY if toy else clustered_sky.DENSITY
    sky = clustered_sky.patch(structure, bricks, folder / f"{structure}_{first}.npz", density)
    return sky | {"patch": (sky["brick"] - first) // part(np.array(bricks))}


def patch_rows(sky: Sky, universe: Universe, most: int, axes: Sequence[plt.Axes] | None) -> np.ndarray:
    """Return what the table shows of a patch, a row for each of MAGNITUDES and SLICES; draw it into `axes`.

    Columns: galaxies, theta and w of each of SHOWN, w over HSC's at the first of them, the same beyond 2 arcmin, and
    `halo_bias`; for magnitudes NaN, but for the last: w of halofit with HSC's bias.
    """
    rng, bricks = np.random.default_rng(3), np.unique(sky["brick"])
    randoms = random_catalogue(bricks, 2 * most, rng)
    rr, rows = pairs(BINS, randoms), []
    samples = [("i", sky["i"] < 99, limits) for limits in MAGNITUDES] + [("z", sky["i"] < 24.5, z) for z in SLICES]
    for k, (column, kept, (low, high)) in enumerate(samples):
        chosen = kept & (sky[column] >= low) & (sky[column] < high)
        theta, w, error = correlation(catalogue(sky, chosen, most, rng), randoms, rr)
        at = [np.argmin(np.abs(np.log(theta / t))) for t in SHOWN]
        row = [chosen.sum(), *theta[at], *w[at]]
        model = predicted(theta, sky["z"][chosen], universe)
        if column == "i":
            row += [np.nan, np.nan, model[at[0]]]
        else:
            far = theta > 2
            weight = 1 / error[far] ** 2
            ratio = np.sum(weight * w[far] * model[far]) / np.sum(weight * model[far] ** 2)
            row += [w[at[0]] / model[at[0]], ratio, halo_bias(sky, chosen, universe)]
        rows.append(row)
        if axes is not None:
            name = f"{low:g} < {column} < {high:g}"
            axis, marks = axes[int(column == "z")], "o-" if column == "i" else "o"
            axis.errorbar(theta, w, error, fmt=marks, ms=3, color=f"C{k % 4}", label=name)
            if column == "z":
                axis.plot(theta, model, color=f"C{k % 4}", lw=1)
    return np.array(rows)


def report_table(record: Record, found: np.ndarray) -> None:
    """Record the means of `patch_rows` (patches, rows, columns), with errors from the scatter of the patches."""
    mean = found.mean(axis=0)
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found)) if len(found) > 1 else np.full_like(mean, np.nan)
    names = [f"{low:g} < i < {high:g}" for low, high in MAGNITUDES]
    names += [f"{low:g} < z < {high:g}" for low, high in SLICES]
    rows = []
    for k, name in enumerate(names):
        row = [name, *(f"{mean[k, c]:.3f} ± {error[k, c]:.3f}" for c in (3, 4))]
        some = () if k < len(MAGNITUDES) else (5, 6)
        row += [f"{mean[k, c]:.2f} ± {error[k, c]:.2f}" for c in some] + [f"{mean[k, 7]:.2f}" for _ in some[:1]]
        rows.append(row + [""] * (6 - len(row)))
    near, far = (f"{np.exp(np.log(mean[:, c]).mean()):.1f}'" for c in (1, 2))
    header = ["", f"w at {near}", f"w at {far}", f"w over HSC's, {near}", "beyond 2'", "haloes' bias², over HSC's"]
    record.table("correlation", header, rows)
    cosmos = len(MAGNITUDES) - 1
    record.value("w_cosmos", mean[cosmos, 3], f"w at {near}, of a median i of 24", error=error[cosmos, 3])
    record.value("w_hsc", mean[cosmos, 7], "the same of halofit with HSC's bias")
    slices = range(len(MAGNITUDES), len(names))
    for k, (low, high) in zip(slices, SLICES, strict=True):
        record.value(
            f"over_hsc_{low:g}", mean[k, 5], f"w over HSC's at {near}, z = {low:g} to {high:g}", error=error[k, 5]
        )
    off = max(abs(mean[k, 6] - mean[k, 7]) / error[k, 6] for k in slices)
    record.value("from_haloes", off, "largest departure of w over HSC's beyond 2' from haloes' bias", unit="sigma")


def report_seam(record: Record, sky: Sky, most: int) -> None:
    """Record the correlation of bright galaxies within bricks and across borders."""
    rng, bricks = np.random.default_rng(4), np.unique(sky["brick"])[:PARTS]
    some = {name: values[np.isin(sky["brick"], bricks)] for name, values in sky.items()}
    some["patch"] = np.searchsorted(bricks, some["brick"])
    data = catalogue(some, some["i"] < 23.0, most, rng)
    theta, (within, across) = seam(data, random_catalogue(bricks, 2 * most, rng))
    off = (within[0] - across[0]) / np.hypot(within[1], across[1])
    cells = zip(theta, within[0], across[0], off, strict=True)
    rows = [[f"{t:.2f}", f"{a:.4f}", f"{b:.4f}", f"{sigma:+.1f}"] for t, a, b, sigma in cells]
    record.table("seam", ["arcmin", "w within bricks", "across", "sigma"], rows)
    record.value("seam_worst", np.abs(off).max(), "largest difference of w across borders", unit="sigma", below=3)
    record.value("seam_rms", np.sqrt((off**2).mean()), "rms of these differences", unit="sigma", below=2)


def main(record: Record) -> None:
    structure, toy = record.options.structure, record.toy
    patches, most = (TOY_PATCHES, TOY_MOST) if toy else (PATCHES, MOST)
    folder, universe, found = kept_folder(record, "galaxy_clustering"), load_universe(), []
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    area = (TOY_BRICKS if toy else BRICKS) * 41252.96 / (12 * NSIDE**2)
    record.value("area", area, f"each of {len(patches)} patches", unit="deg2")
    for first in patches:
        sky = read_sky(folder, structure, first, toy)
        if treecorr is None:
            record.skip("correlations", "treecorr is not installed")
            return
        found.append(patch_rows(sky, universe, most, None if found else axes))
        if len(found) == 1:
            report_seam(record, sky, most)
    report_table(record, np.array(found))
    axes[0].plot(*COSMOS, "k*", ms=12, label="COSMOS, median i = 24", zorder=5)
    for axis, title in zip(axes, ("magnitudes", "i < 24.5; lines: halofit with HSC's bias"), strict=True):
        axis.set(xscale="log", yscale="log", xlabel="theta [arcmin]", ylabel="w")
        axis.set_title(title, fontsize=9)
        axis.legend(fontsize=8)
    figure.savefig(record.figure("galaxy_clustering.png"), dpi=90)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--structure", default="haloes", choices=("haloes", "field", "none"))
    with Record(parser) as record:
        main(record)
