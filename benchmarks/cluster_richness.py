"""Satellites and richness against haloes' mass, with and without the galaxies in front of and behind clusters.

    python benchmarks/cluster_richness.py [--bricks 1024]                                         (ten CPU-minutes)

Satellites by halo mass at z = 0.1 are compared with Zehavi et al. (2011, ApJ 736, 59, table 3), at the same number
density; their masses are scaled to our larger density of matter.

Richness is the number of quiescent galaxies above 10^10.1 solar masses (0.2 L*) within R_lambda, as redMaPPer's. The
members of a halo are known. An observer has a cylinder: galaxies within R_lambda on the sky and within a part of
(1 + z) in redshift, less the mean number of such galaxies there. Each galaxy counts for the richest cluster alone, as
where redMaPPer percolates. `WIDTHS` are the half-widths; Sunayama et al. (2020, MNRAS 496, 4468) found 60 Mpc / h to be
that of SDSS, 0.018 (1 + z) at z = 0.25. Clusters are those of the mock, with their positions on the sky.

Its mean at given mass is compared with Murata et al. (2018, ApJ 854, 120), who fitted the richness of haloes of given
mass to SDSS. The mean mass at given richness is compared with McClintock et al. (2019, MNRAS 482, 1352). The two are
not each other's inverse, because richness scatters.
"""

import argparse
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path

from evidence.record import Record

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial import cKDTree

from csstsim.base.counter import object_keys
from csstsim.base.healpix import NSIDE
from csstsim.base.process.progress import progress
from csstsim.base.sphere import frames
from csstsim.catalog.truth_bricks import _clustered
from csstsim.instrument.camera import load_camera
from csstsim.instrument.load import read_data
from csstsim.universe.galaxies.clustered import ClusteredGalaxies
from csstsim.universe.galaxies.members import draw_members, redshift
from csstsim.universe.galaxies.occupation import Occupation
from csstsim.universe.parameters import load_universe

SEED, FIRST = 7, 6400 * 64
TOY_BRICKS = 16
H = 0.6766
FAINTEST = 10.1  # log10 solar masses in stars: 0.2 L*
LIGHTEST = 11.8  # log10 solar masses of haloes whose galaxies are counted: lighter ones have none so massive
CLUSTER = 13.2  # of haloes that are taken for clusters
NEAR, FAR = 0.2, 0.45  # redshifts of clusters; galaxies are from 0.1 nearer to 0.1 farther
WIDTHS = (0.018, 0.035, 0.05)  # half-widths of the slice over 1 + z
SDSS_Z, PIVOT_Z = 0.25, 0.35  # of Murata et al. (0.1 to 0.33), of McClintock et al.
RICHNESS = (20, 30, 45, 80)
MASSES = ((13.8, 14.05), (14.05, 14.35), (14.35, 14.7))  # log10 solar, of clusters with projection
PUBLISHED = read_data(Path(__file__).resolve().parents[1] / "tests" / "universe" / "published_galaxies.yaml")


def reach(richness: np.ndarray | float) -> np.ndarray:
    """Return R_lambda [physical Mpc]."""
    return (np.asarray(richness) / 100) ** 0.2 / H


def settled(count: Callable, rounds: int = 20) -> np.ndarray:
    """Return the richness of objects whose number within a radius [physical Mpc] is count(radius) (n,)."""
    found = count(reach(20.0))
    for _ in range(rounds):
        found = count(reach(np.maximum(found, 1.0)))
    return found


def of_members(clusters: ClusteredGalaxies, mass: np.ndarray, z: float) -> np.ndarray:
    """Return the richness of clusters drawn at log10 masses (n,), of their own members."""
    rng = np.random.default_rng(1)
    radius = clusters.matter.mass_function.virial_radius(10**mass)
    keys = object_keys(np.uint64(9), np.arange(len(mass)))
    spread = 10 ** (0.14 * rng.standard_normal(len(mass)))
    concentration = clusters.matter.haloes.mean_concentration(10**mass, z) * spread
    members = draw_members(clusters.occupation, np.full(len(mass), z), mass, concentration, radius, keys)
    red = (members.kind == 1) & (members.log_mass > FAINTEST)
    halo, apart = members.halo[red], np.hypot(*members.offset[red, :2].T) / (1 + z)
    return settled(lambda radius: np.bincount(halo[apart < np.broadcast_to(radius, len(mass))[halo]], None, len(mass)))


def sky(clusters: ClusteredGalaxies, bricks: Iterable[int]) -> tuple[dict, np.ndarray, np.ndarray, np.ndarray]:
    """Return haloes of the bricks (columns with `vector`), and their red galaxies: vector, z, row of the halo."""
    parts = []
    for pix in progress(bricks, "bricks"):
        found = clusters.matter.haloes.near(int(pix), lambda z, _: np.zeros(np.shape(z)), lowest=LIGHTEST)
        here = (found["z"] > NEAR - 0.1) & (found["z"] < FAR + 0.1)
        parts.append({name: values[here] for name, values in found.items()})
    haloes = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    radius = clusters.matter.mass_function.virial_radius(10 ** haloes["log_mass"])
    members = draw_members(
        clusters.occupation, haloes["z"], haloes["log_mass"], haloes["concentration"], radius, haloes["key"]
    )
    red = (members.kind == 1) & (members.log_mass > FAINTEST)
    halo = members.halo[red]
    centre, east, north = frames(np.radians(haloes["ra"]), np.radians(haloes["dec"]))
    chi = clusters.population.cosmology.comoving_distance(haloes["z"])
    x, y = (members.offset[red, k, None] / chi[halo, None] for k in (0, 1))
    place = centre[halo] + east[halo] * x + north[halo] * y
    place /= np.linalg.norm(place, axis=1, keepdims=True)
    return haloes | {"vector": centre, "chi": chi}, place, redshift(haloes["z"][halo], members.speed[red]), halo


def inside(vectors: np.ndarray, bricks: np.ndarray, margin: float) -> np.ndarray:
    """Return which positions are farther than `margin` [rad] from the outline of the patch of bricks."""
    import healpy

    near = np.ones(len(vectors), bool)
    for angle in np.radians(np.arange(0, 360, 15)):
        _, east, north = frames(*_angles(vectors))
        moved = vectors + margin * (np.cos(angle) * east + np.sin(angle) * north)
        near &= np.isin(healpy.vec2pix(NSIDE, *moved.T, nest=True), bricks)
    return near


def _angles(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.arctan2(vectors[:, 1], vectors[:, 0]), np.arcsin(np.clip(vectors[:, 2], -1, 1))


def projected(
    haloes: dict, place: np.ndarray, z: np.ndarray, chosen: np.ndarray, width: float, area: float
) -> np.ndarray:
    """Return the richness of the `chosen` haloes in a slice of half-width `width` (1 + z), richest first served."""
    clusters = np.flatnonzero(chosen)
    tree = cKDTree(place)
    scale = (1 + haloes["z"][clusters]) / haloes["chi"][clusters]  # rad per physical Mpc
    widest = reach(300.0) * scale
    lists = tree.query_ball_point(haloes["vector"][clusters], widest)
    owner = np.repeat(np.arange(len(clusters)), [len(v) for v in lists])
    galaxy = np.concatenate([np.asarray(v, int) for v in lists])
    apart = np.linalg.norm(place[galaxy] - haloes["vector"][clusters][owner], axis=1) / scale[owner]
    zc = haloes["z"][clusters]
    slab = np.abs(z[galaxy] - zc[owner]) < width * (1 + zc[owner])
    owner, galaxy, apart = owner[slab], galaxy[slab], apart[slab]
    ordered = np.sort(z)
    number = np.searchsorted(ordered, zc + width * (1 + zc)) - np.searchsorted(ordered, zc - width * (1 + zc))
    background = number / area * np.pi * scale**2  # per square physical Mpc

    def count(radius, free):
        radius = np.broadcast_to(radius, len(clusters))
        within = free & (apart < radius[owner])
        return np.bincount(owner[within], minlength=len(clusters)) - background * radius**2

    first = settled(lambda radius: count(radius, np.ones(len(owner), bool)))
    best = np.full(len(z), -np.inf)
    mine = apart < reach(np.maximum(first, 1.0))[owner]
    np.maximum.at(best, galaxy[mine], first[owner[mine]])
    return settled(lambda radius: count(radius, first[owner] >= best[galaxy]))


def murata(log_mass: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Return the median and mean richness of haloes of these log10 masses by Murata et al. (2018)."""
    law = PUBLISHED["richness"]
    x = np.log(10**log_mass * H / law["pivot"])
    median = np.exp(law["a"] + law["b"] * x)
    return median, median * np.exp(0.5 * (law["sigma"] + law["q"] * x) ** 2)


def mcclintock(richness: np.ndarray | float, z: np.ndarray | float) -> np.ndarray:
    """Return the mean mass within 200 times the mean density [solar] at a richness by McClintock et al. (2019)."""
    law = PUBLISHED["richness_mass"]
    return law["mass"] * (richness / law["pivot"]) ** law["slope"] * ((1 + z) / (1 + law["z"])) ** law["growth"]


def label(axes: Sequence[plt.Axes]) -> None:
    """Name the axes of the two panels: richness at given mass, mean mass at given richness."""
    axes[0].set(
        xlabel="mass, 200 times the mean density [solar]", ylabel="richness", xlim=(1.5e13, 2e15), ylim=(1, 200)
    )
    axes[1].set(xlabel="richness", ylabel="mean mass [solar]", xlim=(15, 100))
    for axis in axes:
        axis.set(xscale="log", yscale="log")
        axis.legend(fontsize=8)


def report_satellites(record: Record, occupation: Occupation) -> None:
    """Record mean satellites by halo mass compared with Zehavi et al. (2011), at the same number densities."""
    published, masses, z = PUBLISHED["satellites"], (13.0, 13.5, 14.0, 14.5), 0.1
    matter = np.log10(occupation.grid.cosmology.omega_m / published["omega_m"])  # dex of halo mass
    row = np.searchsorted(occupation.grid.z, z) - 1
    density = occupation._density[row] / occupation.grid.volume[row]
    mean = occupation.surviving[row][:, None] * occupation.satellite  # of a halo, above each proxy
    every, rows = density @ (occupation.central + mean), []
    for magnitude, m0, m1, alpha, number, fraction in published["rows"]:
        least = np.interp(-number * H**3, -every, occupation.proxies)
        found = np.interp(least, occupation.proxies, density @ mean / every)
        cells = []
        for m in masses:
            ours = np.interp(least, occupation.proxies, mean[np.argmin(np.abs(occupation.mass - m))])
            theirs = ((10 ** (m - matter) * H - 10**m0) / 10**m1) ** alpha
            cells.append(f"{ours:.2g} ({theirs:.2g})")
        rows.append([f"{magnitude:g}", *cells, f"{found:.2f} ({fraction:.2f})"])
    header = ["M_r below", *(f"log mass {m:g}" for m in masses), "fraction of satellites"]
    record.table("satellites", header, rows)
    column = np.argmin(np.abs(occupation.grid.log_mass - 10.0))
    for z in (0.1, 0.6, 1.0, 2.0):
        found = occupation.satellite_fraction[np.searchsorted(occupation.grid.z, z) - 1, column]
        record.value(f"satellites_{z:g}", found, f"fraction of satellites at 10^10 solar masses in stars, z = {z:g}")


def report_members(record: Record, axes: Sequence[plt.Axes], clusters: ClusteredGalaxies) -> None:
    """Draw and record the mean richness of members at given mass, and the mean mass at given richness."""
    mass, rows = np.repeat(np.arange(13.3, 15.21, 0.1), 60), []
    found = of_members(clusters, mass, SDSS_Z)
    each = np.unique(mass)
    axes[0].plot(10**each, [found[mass == m].mean() for m in each], "C0", label="mean, members alone")
    axes[0].plot(10**each, murata(each)[1], "k", label="mean, Murata et al. 2018")
    for m in (13.9, 14.2, 14.5, 14.8):
        here = np.abs(mass - m) < 0.01
        scatter = np.log(np.maximum(found[here], 1)).std()
        rows.append([f"{m:g}", f"{found[here].mean():.1f}", f"{scatter:.2f}", f"{murata(m)[1]:.1f}"])
    record.table("members", ["log mass", "richness of members", "scatter in ln", "SDSS: Murata et al. 2018"], rows)
    found = of_members(clusters, mass, PIVOT_Z)
    weight = clusters.matter.mass_function.dn_dlnm(10**mass, PIVOT_Z)
    ratios = []
    for low, high in pairwise(RICHNESS):
        here = (found >= low) & (found < high)
        mean, lam = (np.average(v[here], weights=weight[here]) for v in (10**mass, found))
        ratios.append(mean / mcclintock(lam, PIVOT_Z))
        axes[1].plot(lam, mean, "C0s", mfc="none", label="members alone" if low == RICHNESS[0] else None)
    what = "mean mass at a number of members, over McClintock et al. (2019)"
    record.value("members_ratio_min", min(ratios), f"smallest {what}")
    record.value("members_ratio_max", max(ratios), f"largest {what}")
    grid = np.array([15, 100])
    axes[1].plot(grid, mcclintock(grid, PIVOT_Z), "k", label="McClintock et al. 2019")


def report_projection(
    record: Record, axes: Sequence[plt.Axes], clusters: ClusteredGalaxies, bricks: np.ndarray
) -> None:
    """Draw and record the same for the mock's own clusters with all galaxies in front of and behind them."""
    haloes, place, z, _ = sky(clusters, bricks)
    area = len(bricks) * 4 * np.pi / (12 * NSIDE**2)
    cosmology = clusters.population.cosmology
    margin = reach(100.0) * (1 + NEAR) / float(cosmology.comoving_distance(NEAR))
    candidates = (haloes["log_mass"] > CLUSTER) & (haloes["z"] > NEAR) & (haloes["z"] < FAR)
    rows = np.flatnonzero(candidates)
    kept = inside(haloes["vector"][rows], bricks, margin)
    mass, far = haloes["log_mass"][rows][kept], haloes["z"][rows][kept]
    record.value("area", area * (180 / np.pi) ** 2, "sky in which clusters are counted", unit="deg2")
    record.value("clusters", len(mass), f"haloes above 10^{CLUSTER} solar masses in it, z = {NEAR:g} to {FAR:g}")
    at_mass, at_richness, ratios = [], [], []
    for width in WIDTHS:
        found = projected(haloes, place, z, candidates, width, area)[kept]
        for low, high in MASSES:
            here = (mass > low) & (mass < high)
            if not here.any():
                continue  # few bricks
            scatter = 0.5 * np.diff(np.log(np.maximum(np.percentile(found[here], [16, 84]), 1)))[0]
            cells = [f"{mass[here].mean():.2f}", f"{found[here].mean():.1f}", f"{scatter:.2f}"]
            at_mass.append([f"{width:g}", *cells, f"{murata(mass[here])[1].mean():.1f}"])
        for low, high in pairwise(RICHNESS):
            here = (found >= low) & (found < high)
            if not here.any():
                continue
            mean, error = (10 ** mass[here]).mean(), (10 ** mass[here]).std() / np.sqrt(here.sum())
            lam, expected = found[here].mean(), mcclintock(found[here], far[here]).mean()
            ratios.append((mean / expected, error / expected))
            cells = [f"{mean / 1e14:.2f} ± {error / 1e14:.2f}", here.sum(), f"{mean / expected:.2f}"]
            at_richness.append([f"{width:g}", f"{lam:.0f}", *cells])
            if width == WIDTHS[0]:
                told = "with projection" if low == RICHNESS[0] else None
                axes[1].errorbar(lam, mean, error, fmt="rs", label=told)
        if width == WIDTHS[0]:
            axes[0].plot(10**mass, found, "r.", ms=2, alpha=0.4, label="each, with projection")
    header = [
        "half-width over 1 + z",
        "mean log mass",
        "richness",
        "half of the 68% range of ln",
        "SDSS: Murata et al. 2018",
    ]
    record.table("richness", header, at_mass)
    header = ["half-width over 1 + z", "richness", "mean mass [10¹⁴ solar]", "clusters", "over McClintock et al. 2019"]
    record.table("mass", header, at_richness)
    ratio, error = np.array(ratios or [(np.nan, np.nan)]).T
    what = "mean mass at a richness with projection, over McClintock et al. (2019)"
    record.value("ratio_min", ratio.min(), f"smallest {what}")
    record.value("ratio_max", ratio.max(), f"largest {what}")
    record.value("ratio_error_min", (error / ratio).min(), "smallest relative error of these")
    record.value("ratio_error_max", (error / ratio).max(), "largest error of these, of the value")


def main(record: Record) -> None:
    clusters = _clustered(SEED, load_universe(), load_camera(), "haloes")
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    report_satellites(record, clusters.occupation)
    report_members(record, axes, clusters)
    report_projection(record, axes, clusters, np.arange(FIRST, FIRST + record.options.bricks))
    label(axes)
    figure.savefig(record.figure("cluster_richness.png"), dpi=90)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bricks", type=int, default=1024, choices=(TOY_BRICKS, 64, 256, 1024))
    with Record(parser) as record:
        record.options.bricks = TOY_BRICKS if record.toy else record.options.bricks
        main(record)
