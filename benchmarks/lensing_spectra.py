"""Convergence and shear of the embedded universe on the sky against halofit, as in the paper's figure of lensing.

    python benchmarks/lensing_spectra.py [--seed 1]       (about ten minutes of CPU; docs/figures/lensing.png)

Patches are sampled from the field brick by brick, as galaxies are: two of 1.2 deg at full resolution, two of 6 deg
with the same field cut at l = 1000. Prints per l-bin and source redshift C_l of kappa and of the shear's E mode over
the expected spectrum (halofit, Takahashi et al. 2012, Limber), with its error from the number of modes, and B over E.
E and B come from second derivatives of the shear, which separate them exactly, before any window is applied:

    chi_E = (d11 - d22) gamma1 + 2 d12 gamma2 = laplacian kappa,     chi_B = (d11 - d22) gamma2 - 2 d12 gamma1 = 0

It also prints the CPU time of one brick of 105,000 galaxies.
"""

import argparse
import time
from pathlib import Path

import healpy
import matplotlib as mpl
import numpy as np
from scipy.ndimage import correlate1d

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.lensing.lensing_field import LensingField
from csstsim.universe.lensing.tangent_grid import TangentGrid

TARGET = Path(__file__).resolve().parents[1] / "docs" / "figures" / "lensing.png"
SOURCES = (1.0, 2.0, 3.0)
FINE = [(30.0, 10.0), (150.0, -65.0)]  # centres of patches, deg
WIDE = [(60.0, 25.0), (200.0, -50.0)]
FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])  # derivatives of order 8
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])


def patch(field, ra0, dec0, side, size):
    """Return kappa, gamma1, gamma2 (3, sources, size, size) on a tangent grid of `side` rad; axes east, north at it."""
    centre, a = healpy.ang2vec(ra0, dec0, lonlat=True), np.radians(ra0)
    east = np.array([-np.sin(a), np.cos(a), 0.0])
    axes = np.stack([east, np.cross(centre, east), centre])
    n, t1, t2 = (v.reshape(-1, 3) for v in TangentGrid(axes, side / size, size // 2, size // 2).frames)
    ra, dec = healpy.vec2ang(n, lonlat=True)
    bricks = healpy.ang2pix(256, ra, dec, nest=True, lonlat=True)
    maps = np.empty((3, len(SOURCES), len(ra)))
    for pix in np.unique(bricks):
        rows = np.flatnonzero(bricks == pix)
        places = (np.tile(v[rows], len(SOURCES)) for v in (ra, dec))
        columns = field.lens(int(pix), *places, np.repeat(SOURCES, len(rows)))
        for out, column in zip(maps, columns, strict=True):
            out[:, rows] = column.reshape(len(SOURCES), -1)
    local = np.stack([-np.sin(np.radians(ra)), np.cos(np.radians(ra)), 0 * ra], axis=1)
    turn = (np.einsum("nk,nk->n", local, t1) + 1j * np.einsum("nk,nk->n", local, t2)) ** 2
    gamma = (maps[1] + 1j * maps[2]) * turn
    return np.stack([maps[0], gamma.real, gamma.imag]).reshape(3, len(SOURCES), size + 1, size + 1)


def spectra(maps, step, edges):
    """Return C_l of kappa, E and B (3, bins) and the number of modes (bins) of one patch and source."""
    kappa, gamma1, gamma2 = maps

    def cross(v):
        return correlate1d(correlate1d(v, FIRST, 0), FIRST, 1)

    def across(v):
        return correlate1d(v, SECOND, 1) - correlate1d(v, SECOND, 0)

    inner = (slice(8, -8), slice(8, -8))
    fields = kappa, (across(gamma1) + 2 * cross(gamma2)) / step**2, (across(gamma2) - 2 * cross(gamma1)) / step**2
    size = kappa[inner].shape[0]
    window = np.outer(*[np.hanning(size + 2)[1:-1]] * 2)
    ell = 2 * np.pi * np.hypot(*np.meshgrid(*[np.fft.fftfreq(size, step)] * 2))
    bins, powers = np.digitize(ell.ravel(), edges), []
    for v, whitening in zip(fields, (0, 4, 4), strict=True):
        power = np.abs(np.fft.fft2((v[inner] - v[inner].mean()) * window)) ** 2 * step**2 / (window**2).sum()
        power /= np.maximum(ell, 1.0) ** whitening
        powers.append(np.bincount(bins, power.ravel(), len(edges) + 1)[1:-1])
    modes = np.bincount(bins, minlength=len(edges) + 1)[1:-1]
    effective = (window**2).sum() ** 2 / (window**4).sum() / size**2  # the window mixes neighbouring modes
    return np.array(powers) / modes, 0.5 * modes * effective


def report(field, centres, degrees, size, edges):
    """Print the ratios of patches and return (l, spectra (sources, 3, bins), first maps)."""
    side, total, modes, first = np.radians(degrees), 0.0, 0.0, None
    for centre in centres:
        maps = patch(field, *centre, side, size)
        first = maps if first is None else first
        found = [spectra(maps[:, k], side / size, edges) for k in range(len(SOURCES))]
        total, modes = total + np.array([f[0] for f in found]), modes + found[0][1]
    total /= len(centres)
    middle = np.sqrt(edges[1:] * edges[:-1])
    print(f"\n{len(centres)} patches of {degrees} deg\n{'l':>6s} {'error':>6s}", end="")
    print("".join(f"   z_s {z:g}: kappa    E     B/E  " for z in SOURCES))
    for b, ell in enumerate(middle):
        print(f"{ell:6.0f} {np.sqrt(1 / modes[b]):6.3f}", end="")
        inside = np.linspace(edges[b], edges[b + 1], 20)
        for k, z in enumerate(SOURCES):
            wanted = np.average(field.shells.limber(inside, z), weights=inside)  # with the ring's density of modes
            kappa, e_mode, b_mode = total[k, :, b]
            print(f"     {kappa / wanted:8.3f} {e_mode / wanted:7.3f} {b_mode / e_mode:8.1e}", end="")
        print()
    return middle, total, first


def draw(field, parts, maps, degrees):
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained")
    keep = int(maps.shape[-1] / degrees)
    kappa, gamma1, gamma2 = maps[:, 0, :keep, :keep]
    shown = left.imshow(kappa, origin="lower", extent=(0, 1, 0, 1), cmap="magma", vmin=-0.05, vmax=0.05)
    figure.colorbar(shown, ax=left, label=r"$\kappa$ ($z_s = 1$)", shrink=0.85)
    every = keep // 28
    rows = np.arange(every // 2, keep, every)
    g = (gamma1 + 1j * gamma2)[np.ix_(rows, rows)]
    stick = np.abs(g) * np.exp(0.5j * np.angle(g))
    left.quiver(*np.meshgrid(rows / keep, rows / keep), stick.real, stick.imag, color="w", pivot="mid", scale=0.9,
                headwidth=0, headlength=0, headaxislength=0, width=0.002)  # fmt: skip
    left.set(xlabel="east [deg]", ylabel="north [deg]", title="convergence and shear, 1 deg x 1 deg")
    ell = np.geomspace(30, 25000, 80)
    for k, (z, scale) in enumerate(zip(SOURCES, (1, 10, 100), strict=True)):
        power = ell * (ell + 1) / (2 * np.pi) * scale * field.shells.limber(ell, z)
        right.loglog(ell, power, "k--", lw=1, zorder=3, label=None if k else "halofit")
        for n, (middle, total) in enumerate(parts):
            factor = middle * (middle + 1) / (2 * np.pi) * scale
            name = [None] * 3 if k or n else ["kappa", "shear E", "shear B ($z_s = 1$)"]
            right.loglog(middle, factor * total[k, 0], "r-", lw=1.5, label=name[0])
            right.loglog(middle, factor * total[k, 1], "b.", ms=5, label=name[1])
            if k == 0:
                right.loglog(middle, factor * total[k, 2], "g-", lw=1, label=name[2])
        right.text(32, 1.5 * power[0], f"$z_s$ = {z:g}, x {scale}")
    right.set(xlabel=r"$\ell$", ylabel=r"$\ell(\ell+1)C_\ell/2\pi$", title="halofit: Takahashi et al. 2012 (Limber)")
    right.legend(loc="lower right", fontsize=8)
    figure.savefig(TARGET, dpi=80)
    print(f"\n{TARGET}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    seed = parser.parse_args().seed
    mpl.use("Agg")
    cosmology, numbers = (read_data(SHIPPED / "universe" / f"{name}.yaml") for name in ("cosmology", "lensing"))
    start = time.process_time()
    field = LensingField(seed, cosmology, numbers)
    print(f"set-up {time.process_time() - start:.2f} CPU-s")
    wide = report(LensingField(seed, cosmology, numbers | {"l_max": 1000}), WIDE, 6.0, 400, np.geomspace(90, 900, 7))
    fine = report(field, FINE, 1.2, 400, np.geomspace(900, 18000, 10))
    draw(field, [wide[:2], fine[:2]], fine[2], 1.2)
    children = np.linspace(0, (1 << 42) - 1, 105_000).astype(int)
    ra, dec = healpy.pix2ang(1 << 29, (5 << 42) + children, nest=True, lonlat=True)
    start = time.process_time()
    field.lens(5, ra, dec, np.linspace(0, 4, len(ra)))
    print(f"one brick of {len(ra)} galaxies: {time.process_time() - start:.2f} CPU-s")


if __name__ == "__main__":
    main()
