"""Convergence and shear of the structured sky: spectra, B modes, skewness and peaks, beside halofit.

    PYTHONPATH=benchmarks python benchmarks/structure_lensing.py [--patches 2] [--seed 1] [--structure haloes]

Patches of 1.2 deg are sampled brick by brick, as galaxies are (three CPU-minutes each; they are kept in
results/structure_lensing, so a run goes on where it stopped). Prints, per l-bin and source redshift, C_l of the
shear's E mode over halofit's Limber integral with the error of the mean from the scatter of the patches, the
spectrum from which maps are drawn over halofit's, and B over E; then the deviation and skewness of kappa in Gaussian
windows, and the number of high peaks; then B over E of a small patch by its sampling.
docs/figures/structure_lensing.png: the middle of a map with its haloes.
"""

import argparse
from pathlib import Path

import healpy
import numpy as np
from lensing_spectra import FINE, SOURCES, patch, spectra
from scipy.ndimage import gaussian_filter, maximum_filter

from csstsim.universe.parameters import load_universe

ROOT = Path(__file__).resolve().parents[1]
KEPT, TARGET = ROOT / "results" / "structure_lensing", ROOT / "docs" / "figures" / "structure_lensing.png"
DEGREES, SIZE = 1.2, 400
EDGES = np.geomspace(500, 14000, 9)
WINDOWS = (1.0, 2.0, 4.0)  # Gaussian sigma, arcmin


def centres(count):
    """Return ra, dec [deg] of patches all over the sky; the first are those of lensing_spectra."""
    golden = np.arange(count) * 137.5 % 360, np.degrees(np.arcsin(np.linspace(-0.9, 0.9, count)))
    return [*FINE, *zip(*golden, strict=True)][:count]


def field_of(universe, seed, structure):
    """Return the field that lenses, of a campaign's `structure`."""
    return universe.lensing_field(seed) if structure == "none" else universe.matter_field(seed, structure == "haloes")


def maps_of(universe, seed, structure, count):
    """Yield the maps (3, sources, size, size) of each patch, drawn or as kept."""
    field = None
    for ra, dec in centres(count):
        path = KEPT / f"{structure}_{seed}_{ra:.2f}_{dec:.2f}.npy"
        if not path.exists():
            field = field or field_of(universe, seed, structure)
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, patch(field, ra, dec, np.radians(DEGREES), SIZE).astype(np.float32))
            print(path.name, flush=True)
        yield np.load(path).astype(float)


def moments(kappa, window):
    """Return the variance and third moment of one map in a Gaussian window [arcmin]."""
    sigma = np.radians(window / 60) / (np.radians(DEGREES) / SIZE)
    edge = int(3 * sigma)
    smooth = gaussian_filter(kappa, sigma)[edge:-edge, edge:-edge]
    smooth = smooth - kappa.mean()
    return (smooth**2).mean(), (smooth**3).mean()


def peaks(kappa, window):
    """Return the heights of the local maxima of one map in a Gaussian window [arcmin]."""
    sigma = np.radians(window / 60) / (np.radians(DEGREES) / SIZE)
    edge = int(3 * sigma)
    smooth = gaussian_filter(kappa, sigma)
    top = (smooth == maximum_filter(smooth, 3))[edge:-edge, edge:-edge]
    return smooth[edge:-edge, edge:-edge][top]


def tell_spectra(all_maps, limber, model):
    """Print C_l over halofit's and over that from which maps are drawn, and B over E, of each source and bin."""
    side = np.radians(DEGREES)
    middle = np.sqrt(EDGES[1:] * EDGES[:-1])
    found = np.array([[spectra(m[:, k], side / SIZE, EDGES)[0] for k in range(len(SOURCES))] for m in all_maps])
    mean, error = found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(len(found))
    print(f"{len(all_maps)} patches of {DEGREES} deg: E over halofit (error of the mean), model over halofit, B over E")
    for b, ell in enumerate(middle):
        inside = np.linspace(EDGES[b], EDGES[b + 1], 20)
        print(f"l {ell:6.0f}", end="")
        for k, z in enumerate(SOURCES):
            wanted, drawn = (np.average(f(inside, z), weights=inside) for f in (limber, model))
            e, b_mode = mean[k, 1:, b]
            print(
                f"   {e / wanted:6.3f} ({error[k, 1, b] / wanted:.3f}) {drawn / wanted:6.3f} {b_mode / e:8.1e}", end=""
            )
        print()


def tell_moments(all_maps):
    """Print the standard deviation and skewness <k^3> / <k^2>^2 of kappa, errors of the mean from the patches."""
    print("\nGaussian window [arcmin]: sigma of kappa x 1000, S3 = <k^3> / <k^2>^2, peaks above 3 sigma per deg2")
    for window in WINDOWS:
        edge = int(3 * np.radians(window / 60) / (np.radians(DEGREES) / SIZE))
        area = (DEGREES * (1 - 2 * edge / SIZE)) ** 2
        print(f"{window:g}", end="")
        for k, z in enumerate(SOURCES):
            second, third = np.array([moments(m[0, k], window) for m in all_maps]).T
            each = third / second.mean() ** 2
            high = np.mean([(peaks(m[0, k], window) > 3 * np.sqrt(second.mean())).sum() for m in all_maps]) / area
            spread = each.std(ddof=1) / np.sqrt(len(each))
            print(
                f"   z {z:g}: {1e3 * np.sqrt(second.mean()):.2f}, {each.mean():.0f} +- {spread:.0f}, {high:.1f}", end=""
            )
        print()


def tell_sampling(field):
    """Print B over E of one patch of 0.3 deg, sampled more and more finely: what is left of B is the field's own."""
    edges, side = np.array([2000, 7000, 11000, 14000]), np.radians(0.3)
    for size in (100, 200, 400):
        maps = patch(field, *FINE[0], side, size)
        for k, z in enumerate(SOURCES):
            _, e, b = spectra(maps[:, k], side / size, edges)[0]
            ratios = " ".join(f"{ratio:.1e}" for ratio in b / e)
            print(
                f"samples of {np.degrees(side / size) * 3600:4.1f} arcsec, z {z:g}: B over E {ratios} between l {edges}"
            )


def draw(matter, maps, centre):
    """Write the figure: convergence at z = 1 of the first patch, with the haloes above 1e13 in front of it."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    (ra, dec), half = centre, DEGREES / 4  # the middle half
    middle = slice(SIZE // 4, SIZE - SIZE // 4 + 1)
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
    image = axes.imshow(
        maps[0, 0][middle, middle],
        origin="lower",
        extent=(-half, half, -half, half),
        cmap="magma",
        vmin=-0.03,
        vmax=0.1,
    )
    size = 10 ** ((columns["log_mass"][shown] - 13) / 3)
    axes.scatter(x[shown], y[shown], s=60 * size**2, facecolors="none", edgecolors="w", linewidths=0.7)
    figure.colorbar(image, label=r"$\kappa$ ($z_s = 1$)", shrink=0.9)
    axes.set(xlabel="east [deg]", ylabel="north [deg]", title="circles: haloes above 1e13 solar masses, z < 0.9")
    figure.savefig(TARGET, dpi=90)
    print(TARGET)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--patches", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--structure", choices=("haloes", "field", "none"), default="haloes")
    asked = parser.parse_args()
    universe = load_universe()
    all_maps = list(maps_of(universe, asked.seed, asked.structure, asked.patches))
    field = field_of(universe, asked.seed, asked.structure)
    tell_spectra(all_maps, field.shells.limber, field.spectrum)
    tell_moments(all_maps)
    np.set_printoptions(precision=1)
    tell_sampling(field)
    if asked.structure == "haloes":
        draw(field, all_maps[0], centres(1)[0])


if __name__ == "__main__":
    main()
