"""Richness of clusters against their mass, with and without the galaxies in front of and behind them.

    python benchmarks/cluster_richness.py [--bricks 1024] [--figure results/richness.png]        (ten CPU-minutes)

Richness is the number of quiescent galaxies above 10^10.1 solar masses (0.2 L*) within R_lambda, as redMaPPer's. The
members of a halo are known. An observer has a cylinder: galaxies within R_lambda on the sky and within a part of
(1 + z) in redshift, less the mean number of such galaxies there. Each galaxy counts for the richest cluster alone, as
where redMaPPer percolates. `WIDTHS` are the half-widths; Sunayama et al. (2020, MNRAS 496, 4468) found 60 Mpc / h to be
that of SDSS, 0.018 (1 + z) at z = 0.25. Clusters are those of the mock, with their places on the sky.

Its mean at given mass is beside Murata et al. (2018, ApJ 854, 120), who fitted the richness of haloes of given mass to
SDSS. The mean mass at given richness is beside McClintock et al. (2019, MNRAS 482, 1352). The two are not each other's
inverse, because richness scatters.
"""

import argparse
from itertools import pairwise
from pathlib import Path

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
from csstsim.universe.galaxies.members import draw_members, redshift
from csstsim.universe.parameters import load_universe

SEED, FIRST = 7, 6400 * 64
H = 0.6766
FAINTEST = 10.1  # log10 solar masses in stars: 0.2 L*
LIGHTEST = 11.8  # log10 solar masses of haloes whose galaxies are counted: lighter ones have none so massive
CLUSTER = 13.2  # of haloes that are taken for clusters
NEAR, FAR = 0.2, 0.45  # redshifts of clusters; galaxies are from 0.1 nearer to 0.1 farther
WIDTHS = (0.018, 0.035, 0.05)  # half-widths of the slice over 1 + z
SDSS_Z, PIVOT_Z = 0.25, 0.35  # of Murata et al. (0.1 to 0.33), of McClintock et al.
RICHNESS = (20, 30, 45, 80)
PUBLISHED = read_data(Path(__file__).resolve().parents[1] / "tests" / "universe" / "published_galaxies.yaml")


def reach(richness):
    """R_lambda [physical Mpc]."""
    return (np.asarray(richness) / 100) ** 0.2 / H


def settled(count, rounds=20):
    """Return the richness of objects whose number within a radius [physical Mpc] is count(radius) (n,)."""
    found = count(reach(20.0))
    for _ in range(rounds):
        found = count(reach(np.maximum(found, 1.0)))
    return found


def of_members(clusters, mass, z):
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


def sky(clusters, bricks):
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


def inside(vectors, bricks, margin):
    """Return which places are farther than `margin` [rad] from the outline of the patch of bricks."""
    import healpy

    near = np.ones(len(vectors), bool)
    for angle in np.radians(np.arange(0, 360, 15)):
        _, east, north = frames(*_angles(vectors))
        moved = vectors + margin * (np.cos(angle) * east + np.sin(angle) * north)
        near &= np.isin(healpy.vec2pix(NSIDE, *moved.T, nest=True), bricks)
    return near


def _angles(vectors):
    return np.arctan2(vectors[:, 1], vectors[:, 0]), np.arcsin(np.clip(vectors[:, 2], -1, 1))


def projected(haloes, place, z, chosen, width, area):
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


def murata(log_mass):
    """Return the median and mean richness of haloes of these log10 masses by Murata et al. (2018)."""
    law = PUBLISHED["richness"]
    x = np.log(10**log_mass * H / law["pivot"])
    median = np.exp(law["a"] + law["b"] * x)
    return median, median * np.exp(0.5 * (law["sigma"] + law["q"] * x) ** 2)


def mcclintock(richness, z):
    """Return the mean mass within 200 times the mean density [solar] at a richness by McClintock et al. (2019)."""
    law = PUBLISHED["richness_mass"]
    return law["mass"] * (richness / law["pivot"]) ** law["slope"] * ((1 + z) / (1 + law["z"])) ** law["growth"]


def label(axes):
    """Name the axes of the two panels: richness at given mass, mean mass at given richness."""
    axes[0].set(
        xlabel="mass, 200 times the mean density [solar]", ylabel="richness", xlim=(1.5e13, 2e15), ylim=(1, 200)
    )
    axes[1].set(xlabel="richness", ylabel="mean mass [solar]", xlim=(15, 100))
    for axis in axes:
        axis.set(xscale="log", yscale="log")
        axis.legend(fontsize=8)


def beside_published(axes, clusters):
    """Draw and print the mean richness of members at given mass, and the mean mass at given richness."""
    mass = np.repeat(np.arange(13.3, 15.21, 0.1), 60)
    found = of_members(clusters, mass, SDSS_Z)
    each = np.unique(mass)
    axes[0].plot(10**each, [found[mass == m].mean() for m in each], "C0", label="mean, members alone")
    axes[0].plot(10**each, murata(each)[1], "k", label="mean, Murata et al. 2018")
    for m in (13.9, 14.2, 14.5, 14.8):
        here = np.abs(mass - m) < 0.01
        scatter = np.log(np.maximum(found[here], 1)).std()
        print(
            f"z = {SDSS_Z}, members at 10^{m:.1f}: {found[here].mean():.1f}, scatter {scatter:.2f} in ln; "
            f"published {murata(m)[1]:.1f}"
        )
    found = of_members(clusters, mass, PIVOT_Z)
    weight = clusters.matter.mass_function.dn_dlnm(10**mass, PIVOT_Z)
    for low, high in pairwise(RICHNESS):
        here = (found >= low) & (found < high)
        mean, lam = (np.average(v[here], weights=weight[here]) for v in (10**mass, found))
        print(f"z = {PIVOT_Z}, mass at {lam:.0f} members: {mean:.2e}, published {mcclintock(lam, PIVOT_Z):.2e}")
        axes[1].plot(lam, mean, "C0s", mfc="none", label="members alone" if low == RICHNESS[0] else None)
    grid = np.array([15, 100])
    axes[1].plot(grid, mcclintock(grid, PIVOT_Z), "k", label="McClintock et al. 2019")


def with_projection(axes, clusters, bricks):
    """Print and draw the same for the mock's own clusters with all galaxies in front of and behind them."""
    haloes, place, z, _ = sky(clusters, bricks)
    area = len(bricks) * 4 * np.pi / (12 * NSIDE**2)
    cosmology = clusters.population.cosmology
    margin = reach(100.0) * (1 + NEAR) / float(cosmology.comoving_distance(NEAR))
    candidates = (haloes["log_mass"] > CLUSTER) & (haloes["z"] > NEAR) & (haloes["z"] < FAR)
    rows = np.flatnonzero(candidates)
    kept = inside(haloes["vector"][rows], bricks, margin)
    mass, far = haloes["log_mass"][rows][kept], haloes["z"][rows][kept]
    print(f"{area * (180 / np.pi) ** 2:.0f} deg2, {len(z)} red galaxies, {len(mass)} haloes above 10^{CLUSTER}")
    for width in WIDTHS:
        found = projected(haloes, place, z, candidates, width, area)[kept]
        words = []
        for low, high in ((13.8, 14.05), (14.05, 14.35), (14.35, 14.7)):
            here = (mass > low) & (mass < high)
            scatter = 0.5 * np.diff(np.log(np.maximum(np.percentile(found[here], [16, 84]), 1)))[0]
            expected = murata(mass[here])[1].mean()
            words.append(f"{mass[here].mean():.2f}: {found[here].mean():.1f} ({expected:.1f}), {scatter:.2f}")
        print(
            f"slice {width} (1 + z), richness at log mass (Murata et al.), half of the 68% range in ln: "
            + "; ".join(words)
        )
        words = []
        for low, high in pairwise(RICHNESS):
            here = (found >= low) & (found < high)
            mean, error = (10 ** mass[here]).mean(), (10 ** mass[here]).std() / np.sqrt(here.sum())
            lam, expected = found[here].mean(), mcclintock(found[here], far[here]).mean()
            words.append(f"{lam:.0f}: {mean:.2e} +- {error:.1e} of {here.sum()}, {mean / expected:.2f}")
            if width == WIDTHS[0]:
                told = "with projection" if low == RICHNESS[0] else None
                axes[1].errorbar(lam, mean, error, fmt="rs", label=told)
        print("    mass at richness, over McClintock et al.: " + "; ".join(words))
        if width == WIDTHS[0]:
            axes[0].plot(10**mass, found, "r.", ms=2, alpha=0.4, label="each, with projection")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bricks", type=int, default=1024, choices=(64, 256, 1024))
    parser.add_argument("--figure", type=Path, default=Path("results/richness.png"))
    args = parser.parse_args()
    clusters = _clustered(SEED, load_universe(), load_camera(), "haloes")
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
    beside_published(axes, clusters)
    with_projection(axes, clusters, np.arange(FIRST, FIRST + args.bricks))
    label(axes)
    args.figure.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.figure, dpi=90)


if __name__ == "__main__":
    main()
