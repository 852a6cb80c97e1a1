"""Angular correlation of the mock's galaxies beside published measurements, a seam test, richness of clusters.

    pip install treecorr
    python benchmarks/clustered_sky.py && python benchmarks/galaxy_clustering.py [--sky results/clustered_sky]

w(theta) is by treecorr (Landy & Szalay), with errors by leaving out one of 64 parts of the sky after the other. In
redshift slices it is compared with Limber's integral of halofit times the square of the bias that Nicola et al. (2020,
JCAP 03, 044) measured in HSC, b = (0.8346 - 0.0624 (i - 24)) D^-1.3. The seam test counts pairs in the same brick and
pairs across a border, in the first 64 bricks.

Richness against mass is that of benchmarks/cluster_richness.py. Satellites by halo mass at z = 0.1 are beside Zehavi et
al. (2011, ApJ 736, 59, table 3), at the same number density; their masses are scaled to our larger density of matter.
Writes docs/figures/galaxy_clustering.png; exit code 1 if the seam test fails.
"""

import argparse
import sys
from pathlib import Path

import cluster_richness
import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import treecorr
from cluster_richness import FIRST
from scipy.special import j0

from csstsim.base.healpix import NSIDE
from csstsim.catalog.truth_bricks import _clustered, place
from csstsim.instrument.camera import load_camera
from csstsim.instrument.load import read_data
from csstsim.universe.lensing.power_spectrum import MatterPower
from csstsim.universe.parameters import load_universe

MAGNITUDES = ((18.0, 22.5), (22.5, 24.0), (24.0, 25.5), (18.0, 25.0))  # the last has the median 24 of COSMOS
SLICES = ((0.15, 0.5), (0.5, 0.75), (0.75, 1.0), (1.0, 1.5))  # of galaxies to i = 24.5, as Nicola et al.
MOST = 150_000  # galaxies of a sample; more are thinned
BINS = {"min_sep": 0.1, "max_sep": 30.0, "nbins": 12, "sep_units": "arcmin", "bin_slop": 0.3, "num_threads": 1}
PARTS = 64  # of the sky, and bricks of the seam test
SEAM = {"min_sep": 0.1, "max_sep": 6.0, "nbins": 6, "sep_units": "arcmin", "bin_slop": 0.1, "num_threads": 1}
COSMOS = (1.0, 0.014)  # arcmin, w: at a median i of 24 (McCracken et al. 2007, ApJS 172, 314)
H = 0.6766
PUBLISHED = read_data(Path(__file__).resolve().parents[1] / "tests" / "universe" / "published_galaxies.yaml")


def catalogue(sky, chosen, rng):
    """Return the treecorr.Catalog of some rows, with their column `patch`."""
    rows = np.flatnonzero(chosen)
    rows = np.sort(rng.choice(rows, min(len(rows), MOST), replace=False))
    return treecorr.Catalog(
        ra=sky["ra"][rows], dec=sky["dec"][rows], ra_units="deg", dec_units="deg", patch=sky["patch"][rows]
    )


def random_catalogue(bricks, count, rng):
    """Return a treecorr.Catalog of uniform places on the bricks, in at most PARTS patches."""
    spots = [place(pix, rng, count // len(bricks))[:2] for pix in bricks]
    ra, dec = (np.concatenate(v) for v in zip(*spots, strict=True))
    patch = np.repeat(np.arange(len(bricks)) // part(bricks), count // len(bricks))
    return treecorr.Catalog(ra=ra, dec=dec, ra_units="deg", dec_units="deg", patch=patch)


def part(bricks):
    """Return how many bricks make one of PARTS."""
    return max(len(bricks) // PARTS, 1)


def pairs(bins, first, second=None):
    """Return the NNCorrelation of one or two catalogues."""
    found = treecorr.NNCorrelation(**bins, var_method="jackknife")
    found.process(first, second)
    return found


def correlation(data, randoms, rr, bins=BINS):
    """Return theta [arcmin], w and its error; the integral constraint is added for a power law of slope -0.8."""
    dd, dr = pairs(bins, data), pairs(bins, data, randoms)
    w, variance = dd.calculateXi(rr=rr, dr=dr)
    shape = np.exp(dd.meanlogr) ** -0.8
    share = (rr.npairs * shape).sum() / (0.5 * randoms.ntot**2)  # of pairs within the largest separation
    good = (w > 0) & (variance > 0)
    amplitude = np.average(w[good] / shape[good], weights=(shape[good]) ** 2 / variance[good])
    return np.exp(dd.meanlogr), w + amplitude * share, np.sqrt(variance)


def seam(data, randoms):
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


def predicted(theta, z, universe):
    """Return w(theta [arcmin]) of Limber's integral for redshifts z of galaxies to i = 24.5 with the bias of HSC."""
    cosmology = universe.cosmology
    power = MatterPower(cosmology, universe.numbers["cosmology"])
    number, edges = np.histogram(z, 40, density=True)
    middle = 0.5 * (edges[1:] + edges[:-1])
    chi, width = cosmology.comoving_distance(middle), np.diff(cosmology.comoving_distance(edges))
    bias = (0.8346 - 0.0624 * 0.5) * cosmology.growth(middle) ** -1.30
    kernel = number * np.diff(edges) / width * bias
    ell = np.geomspace(1.0, 3e5, 6000)
    spectrum = sum(
        w * (k / c) ** 2 * power.nonlinear(ell / c, zz) for w, k, c, zz in zip(width, kernel, chi, middle, strict=True)
    ) * np.exp(-((ell / 1e5) ** 2))
    return np.array(
        [np.trapezoid(ell**2 * spectrum * j0(ell * np.radians(t / 60)) / (2 * np.pi), np.log(ell)) for t in theta]
    )


def satellites(occupation, z=0.1):
    """Print mean satellites by halo mass beside Zehavi et al. (2011), at the same number densities."""
    published = PUBLISHED["satellites"]
    matter = np.log10(occupation.grid.cosmology.omega_m / published["omega_m"])  # dex of halo mass
    row = np.searchsorted(occupation.grid.z, z) - 1
    density = occupation._density[row] / occupation.grid.volume[row]
    mean = occupation.surviving[row][:, None] * occupation.satellite  # of a halo, above each proxy
    every = density @ (occupation.central + mean)
    for magnitude, m0, m1, alpha, number, fraction in published["rows"]:
        least = np.interp(-number * H**3, -every, occupation.proxies)
        share = np.interp(least, occupation.proxies, density @ mean / every)
        words = []
        for m in (13.0, 13.5, 14.0, 14.5):
            ours = np.interp(least, occupation.proxies, mean[np.argmin(np.abs(occupation.mass - m))])
            theirs = ((10 ** (m - matter) * H - 10**m0) / 10**m1) ** alpha
            words.append(f"{m:g}: {ours:.2f} ({theirs:.2f})")
        print(f"M_r < {magnitude}: satellite fraction {share:.2f} ({fraction}); satellites at " + ", ".join(words))
    rows = [np.searchsorted(occupation.grid.z, z) - 1 for z in (0.1, 0.6, 1.0, 2.0)]
    column = np.argmin(np.abs(occupation.grid.log_mass - 10.0))
    print("satellite share at 10^10, z = 0.1, 0.6, 1, 2:", np.round(occupation.satellite_share[rows, column], 2))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sky", type=Path, default=Path("results/clustered_sky"))
    parser.add_argument("--structure", default="haloes")
    parser.add_argument("--clusters", type=int, default=1024, help="bricks with haloes alone, for the richness")
    args = parser.parse_args()
    with np.load(args.sky / f"{args.structure}.npz") as file:
        sky = dict(file)
    bricks = np.unique(sky["brick"])
    brick = np.searchsorted(bricks, sky["brick"])
    sky["patch"] = brick // part(bricks)
    rng = np.random.default_rng(3)
    universe = load_universe()
    randoms = random_catalogue(bricks, 2 * MOST, rng)
    rr = pairs(BINS, randoms)
    figure, axes = plt.subplots(2, 2, figsize=(11, 9))
    axes = axes.ravel()
    print(f"{len(bricks)} bricks, {len(bricks) * 41252.96 / (12 * NSIDE**2):.2f} deg2; w at arcmin")
    for low, high in MAGNITUDES:
        chosen = (sky["i"] >= low) & (sky["i"] < high)
        theta, w, error = correlation(catalogue(sky, chosen, rng), randoms, rr)
        axes[0].errorbar(theta, w, error, fmt="o-", ms=3, label=f"{low:g} < i < {high:g}")
        print(f"i {low:g} to {high:g}: {chosen.sum()} galaxies;", _line(theta, w, error))
    axes[0].plot(*COSMOS, "k*", ms=12, label="COSMOS, median i = 24", zorder=5)
    shallow = (sky["i"] < 24.5) & (sky["z"] > 0)
    for k, (low, high) in enumerate(SLICES):
        chosen = shallow & (sky["z"] >= low) & (sky["z"] < high)
        theta, w, error = correlation(catalogue(sky, chosen, rng), randoms, rr)
        model = predicted(theta, sky["z"][chosen], universe)
        axes[1].errorbar(theta, w, error, fmt="o", ms=3, color=f"C{k}", label=f"{low:g} < z < {high:g}")
        axes[1].plot(theta, model, color=f"C{k}", lw=1)
        far = theta > 2
        weight = 1 / error[far] ** 2
        ratio = np.sum(weight * w[far] * model[far]) / np.sum(weight * model[far] ** 2)
        near = np.argmin(np.abs(np.log(theta)))
        print(f"z {low:g} to {high:g}: {chosen.sum()} galaxies;", _line(theta, w, error))
        print(f"    over HSC's: {w[near] / model[near]:.2f} at {theta[near]:.2g}, {ratio:.2f} beyond 2 arcmin")
    some = {name: values[brick < PARTS] for name, values in (sky | {"patch": brick}).items()}
    data, randoms = catalogue(some, some["i"] < 23.0, rng), random_catalogue(bricks[:PARTS], 2 * MOST, rng)
    theta, (within, across) = seam(data, randoms)
    off = (within[0] - across[0]) / np.hypot(within[1], across[1])
    for t, a, b, sigma in zip(theta, within[0], across[0], off, strict=True):
        print(f"seam, i < 23, {t:.2f} arcmin: within bricks {a:.4f}, across {b:.4f}, {sigma:+.1f} sigma")
    clusters = _clustered(7, universe, load_camera(), "haloes")
    satellites(clusters.occupation)
    cluster_richness.beside_published(axes[2:], clusters)
    cluster_richness.with_projection(axes[2:], clusters, np.arange(FIRST, FIRST + args.clusters))
    cluster_richness.label(axes[2:])
    for axis, title in zip(axes, ("magnitudes", "i < 24.5; lines: halofit with HSC's bias"), strict=False):
        axis.set(xscale="log", yscale="log", xlabel="theta [arcmin]", ylabel="w")
        axis.set_title(title, fontsize=9)
        axis.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig("docs/figures/galaxy_clustering.png", dpi=90)
    sys.exit(int(np.abs(off).max() > 3 or np.sqrt((off**2).mean()) > 2))


def _line(theta, w, error):
    at = [np.argmin(np.abs(np.log(theta / t))) for t in (0.3, 1, 3, 10)]
    return ", ".join(f"{theta[k]:.2g}: {w[k]:.4f} +- {error[k]:.4f}" for k in at)


if __name__ == "__main__":
    main()
