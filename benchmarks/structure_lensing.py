"""Convergence and shear of the structured sky: spectra, B modes, skewness and peaks, beside halofit.

    PYTHONPATH=benchmarks python benchmarks/structure_lensing.py [--patches 2] [--seeds 1] [--structure haloes]

Patches of 4 deg take two CPU-minutes each, `--patches` of them for each seed. They are kept in
results/structure_lensing, so a run goes on where it stopped. The smooth field is summed on a patch's own grid; the
first lines are the largest differences from the maps of bricks, which galaxies see. Then, per l-bin and redshift of
sources:

- E over halofit: C_l of the shear's E mode over Limber's integral, with the error of the mean from the scatter of the
  patches, and the same with the power of the drawn haloes, each for itself, replaced by its mean. Most of the scatter
  is theirs: few clusters have most of the power.
- the spectrum from which maps are drawn over halofit's, and B over E.

Samples of 0.3 arcmin fold power of high multipoles back into E and B; the expected part is taken from E. Then come the
deviation and skewness of kappa in Gaussian windows, and the number of high peaks; then B over E of a small patch by its
sampling.
docs/figures/structure_lensing.png: the middle of a map with its haloes.
"""

import argparse
from itertools import pairwise
from pathlib import Path

import healpy
import numpy as np
from lensing_spectra import FINE, SOURCES, WIDE, patch, spectra
from scipy.ndimage import gaussian_filter, maximum_filter

from csstsim.universe.lensing.tangent_grid import TangentGrid, prolong
from csstsim.universe.parameters import load_universe
from csstsim.universe.structure.halo_lensing import halo_lenses, halo_shear
from csstsim.universe.structure.halo_profile import disc_transform, halo_transform
from csstsim.universe.structure.kernels import add_lensing

ROOT = Path(__file__).resolve().parents[1]
KEPT, TARGET = ROOT / "results" / "structure_lensing", ROOT / "docs" / "figures" / "structure_lensing.png"
DEGREES, SIZE = 4.0, 800
STEP = np.radians(DEGREES) / SIZE
EDGES = np.array([700, 1000, 1500, 2200, 3300, 5000, 7500, 11000])  # the window of a patch adds power below
WINDOWS = (1.0, 2.0, 4.0)  # Gaussian sigma, arcmin
WIDEST_GRID = 24  # half the points along a side of the coarsest grid
PICTURE = 0.6  # deg, side of the figure
POINTS = 200_000  # kernels summed at once


def centres(count):
    """Return ra, dec [deg] of patches all over the sky; the first are those of lensing_spectra."""
    golden = 137.5 * np.arange(count) % 360, np.degrees(np.arcsin(2 * (0.618034 * np.arange(count) % 1) - 1))
    return [*FINE, *WIDE, *zip(*golden, strict=True)][:count]


def smooth_maps(field, grid, sources):
    """Return kappa, gamma1, gamma2 (3, sources, rows, columns) of the smooth field on a TangentGrid, in its frame.

    sources: their redshifts.
    """
    grids = [grid]
    while grids[0].rows > WIDEST_GRID:
        half = (grids[0].rows + 1) // 2 + 4
        grids.insert(0, TangentGrid(grid.axes, 2 * grids[0].step, half, half))
    weights = (field.shells.weights(np.array(sources))[:, : field.lenses]).T
    values, done = np.zeros((*grids[0].shape, 3, len(sources)), np.float32), 0
    for coarse, fine in zip([None, *grids], grids, strict=False):
        values = values if coarse is None else prolong(values, coarse, fine)
        while done < len(field.widths) and (fine is grid or field.widths[done][1] > field.samples * fine.step):
            order, sigma = field.widths[done]
            reach = min(field.reach * sigma, np.pi)
            pixels, points = field.pixels(fine, order, reach)
            for rows in np.array_split(np.arange(len(pixels)), len(pixels) // POINTS + 1):
                summed = (field.deviates(done, pixels[rows])[:, : field.lenses]
                          * field.amplitude[: field.lenses, done]) @ weights  # fmt: skip
                boxes = fine.boxes(points[rows], reach)
                add_lensing(values, *fine.frames, points[rows], boxes, summed.astype(np.float32), sigma**-2, reach)
            done += 1
    return np.moveaxis(values, (2, 3), (0, 1))


def haloes_about(matter, grid):
    """Return the columns of the haloes that lens sources on a TangentGrid."""
    haloes, numbers, centre = matter.haloes, matter.numbers["haloes"], grid.centre
    parts = []
    for tier, depths in enumerate(haloes._depths):
        if np.exp(haloes.edges[tier]) < 0.999 * numbers["lens_mass"]:
            continue
        for order, (_, nearest, _) in depths.items():
            nside = 2 ** haloes._cell_order(tier, order)
            widest = float(matter.disc_angle(nearest, haloes.edges[tier + 1] / np.log(10)))
            cells = healpy.query_disc(nside, centre, min(grid.radius + widest, np.pi), inclusive=True, nest=True)
            for cell in cells.tolist():
                some = haloes._draw(tier, order, cell)
                apart = 2 * np.arcsin(0.5 * np.linalg.norm(some["vector"] - centre, axis=1))
                keep = apart < grid.radius + matter.disc_angle(some["z"], some["log_mass"])
                parts.append({name: v[keep] for name, v in some.items()})
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def power_of_haloes(matter, haloes, lenses, grid):
    """Return C_l (sources, bins) of the haloes in the window of a patch, each for itself: its mean is C_1h."""
    points = SIZE + 1 - 16  # the window of `spectra` has along a side
    place = (lenses[:, :3] @ grid.axes[:2].T) / (lenses[:, :3] @ grid.centre)[:, None] / ((points + 1) * STEP)
    inside = (np.abs(place) < 0.5).all(axis=1)
    chi, strength, disc = lenses[inside, 3:6].T
    radius, c = matter.mass_function.virial_radius(10 ** haloes["log_mass"][inside]), haloes["concentration"][inside]
    chance = (np.cos(np.pi * place[inside]) ** 4).prod(axis=1)  # the window squared
    far = matter.shells.source_distance(np.array(SOURCES))[:, None]
    flux = np.pi * strength * np.maximum(1 - chi / far, 0.0)  # kappa integrated over the halo
    power = chance * flux**2 / (((np.hanning(points + 2) ** 2).sum() * STEP) ** 2)
    found = np.zeros((len(SOURCES), len(EDGES) - 1))
    for b, (low, high) in enumerate(pairwise(EDGES)):
        ells = low + (high - low) * (np.arange(3) + 0.5) / 3
        for ell in ells:
            k = (ell + 0.5) / chi
            profile = halo_transform(k, radius, c, matter.numbers["haloes"]["cuts"]) - disc_transform(k, disc * chi)
            found[:, b] += ell / ells.sum() * (power @ profile**2)
    return found


def patch_grid(ra0, dec0, degrees, size):
    """Return the TangentGrid of a patch of `degrees` with `size` + 1 points along a side; its axes are east, north."""
    centre, a = healpy.ang2vec(ra0, dec0, lonlat=True), np.radians(ra0)
    east = np.array([-np.sin(a), np.cos(a), 0.0])
    axes = np.stack([east, np.cross(centre, east), centre])
    return TangentGrid(axes, np.radians(degrees) / size, size // 2, size // 2)


def add_haloes(maps, field, grid, sources):
    """Add the haloes' part to `maps` of `smooth_maps`; return the haloes' columns and their `halo_lenses`."""
    haloes = haloes_about(field, grid)
    lenses = halo_lenses(haloes, field.mass_function, field.numbers["haloes"])
    n, t1, t2 = (v.reshape(-1, 3) for v in grid.frames)
    ra, dec = healpy.vec2ang(n, lonlat=True)
    local = np.stack([-np.sin(np.radians(ra)), np.cos(np.radians(ra)), 0 * ra], axis=1)
    turn = (np.einsum("nk,nk->n", local, t1) + 1j * np.einsum("nk,nk->n", local, t2)) ** 2
    for k, chi in enumerate(field.shells.source_distance(np.array(sources))):
        kappa, gamma1, gamma2 = halo_shear(lenses, ra, dec, np.full(len(ra), chi))
        gamma = (gamma1 + 1j * gamma2) * turn
        maps[:, k] += np.stack([kappa, gamma.real, gamma.imag]).reshape(3, *grid.shape).astype(np.float32)
    return haloes, lenses


def make_patch(field, ra0, dec0):
    """Return the maps (3, sources, SIZE + 1, SIZE + 1) of a patch and `power_of_haloes`."""
    grid = patch_grid(ra0, dec0, DEGREES, SIZE)
    maps = smooth_maps(field, grid, SOURCES)
    if field.haloes is None:
        return maps, np.zeros((len(SOURCES), len(EDGES) - 1))
    return maps, power_of_haloes(field, *add_haloes(maps, field, grid, SOURCES), grid)


def kept_patch(field, name, centre):
    """Return `make_patch` of a patch of the field of that name, made or as kept."""
    path = KEPT / f"wide_{name}_{centre[0]:.2f}_{centre[1]:.2f}.npz"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        maps, drawn = make_patch(field, *centre)
        np.savez(path, maps=maps, drawn=drawn)
        print(path.name, flush=True)
    with np.load(path) as kept:
        return kept["maps"].astype(float), kept["drawn"]


def folded(spectrum, ell):
    """Return the part of E that samples fold back to multipoles `ell` from higher ones, mean over directions.

    A mode keeps the direction of its shear, so that cos^2 of twice the angle between both modes is E, and the rest B.
    """
    angle, shift = np.pi / 4 * (np.arange(5) + 0.5) / 5, 2 * np.pi / STEP * np.array([-1, 0, 1])
    first, second = (f(angle)[:, None, None] for f in (np.cos, np.sin))
    x, y = (ell[:, None, None, None] * f + at for f, at in ((first, shift), (second, shift[:, None])))
    turned = 2 * (x * first + y * second) ** 2 / (x**2 + y**2) - 1
    powers = spectrum(np.hypot(x, y).ravel()).reshape((*x.shape[:2], 3, 3)) * turned**2
    return powers.sum(axis=(2, 3)).mean(axis=1) - spectrum(ell)


def tell_spectra(found, drawn, field):
    """Print E over halofit, model over halofit and B over E of each source and bin.

    found: (patches, sources, 3, bins) of `spectra`; drawn: (patches, sources, bins) of `power_of_haloes`.
    """
    root = np.sqrt(len(found))
    print(f"{len(found)} patches of {DEGREES:g} deg: E over halofit (error), with the mean power of haloes (error),")
    print("model over halofit, B over E")
    for b, (low, high) in enumerate(pairwise(EDGES)):
        ell = np.linspace(low, high, 8)
        print(f"l {np.sqrt(low * high):5.0f}", end="")
        for k, z in enumerate(SOURCES):
            halofit, model = field.shells.limber(ell, z), field.spectrum(ell, z)
            back = folded(lambda at, z=z: field.spectrum(at, z), ell)
            haloes = np.zeros(len(ell))
            if field.haloes is not None:
                haloes = field.shells.weights(np.array([z]))[0] ** 2 @ field.spectra.one_halo(ell)
            wanted, model, back, haloes = (np.average(v, weights=ell) for v in (halofit, model, back, haloes))
            each = (found[:, k, 1, b] - back) / wanted
            print("  ", end="")
            for values in (each, each - (drawn[:, k, b] - haloes) / wanted):
                print(f" {values.mean():5.3f} ({values.std(ddof=1) / root:.3f})", end="")
            print(f" {model / wanted:5.3f} {found[:, k, 2, b].mean() / found[:, k, 1, b].mean():7.1e}", end="")
        print()


def moments(kappa, sigma):
    """Return the variance and third moment of one map in a Gaussian window of `sigma` points."""
    edge = int(3 * sigma)
    smooth = gaussian_filter(kappa, sigma)[edge:-edge, edge:-edge] - kappa.mean()
    return (smooth**2).mean(), (smooth**3).mean()


def peaks(kappa, sigma):
    """Return the heights of the local maxima of one map in a Gaussian window of `sigma` points."""
    edge = int(3 * sigma)
    smooth = gaussian_filter(kappa, sigma)
    top = (smooth == maximum_filter(smooth, 3))[edge:-edge, edge:-edge]
    return smooth[edge:-edge, edge:-edge][top]


def tell_moments(kappas):
    """Print deviation, skewness <k^3> / <k^2>^2 and peaks of kappa (patches, sources, rows, columns)."""
    print("\nGaussian window [arcmin]: sigma of kappa x 1000, S3 = <k^3> / <k^2>^2, peaks above 3 sigma per deg2")
    for window in WINDOWS:
        sigma = np.radians(window / 60) / STEP
        area = (DEGREES * (1 - 2 * int(3 * sigma) / SIZE)) ** 2
        print(f"{window:g}", end="")
        for k, z in enumerate(SOURCES):
            second, third = np.array([moments(kappa[k], sigma) for kappa in kappas]).T
            each = third / second.mean() ** 2
            high = [(peaks(kappa[k], sigma) > 3 * np.sqrt(second.mean())).sum() / area for kappa in kappas]
            deviation = 1e3 * np.sqrt(second.mean())
            print(f"   z {z:g}: {deviation:.2f}", end="")
            for values, digits in ((each, 0), (high, 1)):
                error = np.std(values, ddof=1) / np.sqrt(len(values))
                print(f", {np.mean(values):.{digits}f} +- {error:.{digits}f}", end="")
        print()


def tell_sampling(field):
    """Print B over E of one patch of 0.3 deg, sampled more and more finely: what is left of B is the field's own."""
    edges, side = np.array([2000, 7000, 11000, 14000]), np.radians(0.3)
    for size in (100, 200, 400):
        maps = patch(field, *FINE[0], side, size)
        for k, z in enumerate(SOURCES):
            _, e, b = spectra(maps[:, k], side / size, edges)[0]
            ratios = " ".join(f"{ratio:.1e}" for ratio in b / e)
            print(f"{np.degrees(side / size) * 3600:4.1f} arcsec, z {z:g}: B over E {ratios} between l {edges}")


def tell_bricks(maps, bricks):
    """Print how much the middle of a patch differs from maps sampled brick by brick on a grid twice as fine."""
    half = bricks.shape[-1] // 4
    middle = slice(SIZE // 2 - half, SIZE // 2 + half + 1)
    apart = np.abs(bricks[..., ::2, ::2] - maps[..., middle, middle]).max()
    print(f"from maps of bricks these differ by {apart:.1e} at most, of {np.abs(bricks).max():.3f}\n")


def draw(matter, kappa, centre):
    """Write the figure: convergence at z = 1 of the middle of a patch, with the haloes above 1e13 in front of it."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    (ra, dec), half = centre, PICTURE / 2
    v = healpy.ang2vec(ra, dec, lonlat=True)
    a = np.radians(ra)
    east = np.array([-np.sin(a), np.cos(a), 0.0])
    bricks = healpy.query_disc(256, v, np.radians(1.6 * half), nest=True)
    found = [matter.haloes.near(int(pix), lambda z, log_mass: 0 * (z + log_mass), 13.0) for pix in bricks]
    columns = {name: np.concatenate([one[name] for one in found]) for name in ("ra", "dec", "z", "log_mass")}
    n = healpy.ang2vec(columns["ra"], columns["dec"], lonlat=True)
    x, y = (np.degrees(n @ axis / (n @ v)) for axis in (east, np.cross(v, east)))
    shown = (columns["z"] < 0.9) & (np.abs(x) < half) & (np.abs(y) < half)
    figure, axes = plt.subplots(figsize=(6.6, 5.6), layout="constrained")
    image = axes.imshow(kappa, origin="lower", extent=(-half, half, -half, half), cmap="magma", vmin=-0.03, vmax=0.1)
    size = 10 ** ((columns["log_mass"][shown] - 13) / 3)
    axes.scatter(x[shown], y[shown], s=60 * size**2, facecolors="none", edgecolors="w", linewidths=0.7)
    figure.colorbar(image, label=r"$\kappa$ ($z_s = 1$)", shrink=0.9)
    axes.set(xlabel="east [deg]", ylabel="north [deg]", title="circles: haloes above 1e13 solar masses, z < 0.9")
    figure.savefig(TARGET, dpi=90)
    print(TARGET)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--patches", type=int, default=2, help="at least 2")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--structure", choices=("haloes", "field"), default="haloes")
    asked = parser.parse_args()
    fields = [load_universe().matter_field(seed, asked.structure == "haloes") for seed in asked.seeds]
    found, drawn, kappas, field = [], [], [], fields[0]
    bricks = patch(field, *centres(1)[0], np.radians(PICTURE), int(2 * PICTURE / DEGREES * SIZE))
    for seed, one in zip(asked.seeds, fields, strict=True):
        for centre in centres(asked.patches):
            maps, power = kept_patch(one, f"{asked.structure}_{seed}", centre)
            if not found:
                tell_bricks(maps, bricks)
            found.append([spectra(maps[:, k], STEP, EDGES)[0] for k in range(len(SOURCES))])
            drawn.append(power)
            kappas.append(maps[0])
    tell_spectra(np.array(found), np.array(drawn), field)
    tell_moments(kappas)
    tell_sampling(field)
    if field.haloes is not None:
        draw(field, bricks[0, 0], centres(1)[0])


if __name__ == "__main__":
    main()
