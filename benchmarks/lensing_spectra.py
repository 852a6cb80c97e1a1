"""Convergence and shear of the embedded universe on the sky against halofit, as in the paper's figure of lensing.

    python benchmarks/lensing_spectra.py [--seed 1]

Patches are sampled from the field brick by brick, as galaxies are: two of 1.2 deg at full resolution, two of 6 deg
with the same field cut at l = 1000. Per l-bin and source redshift C_l of kappa and of the shear's E mode over the
expected spectrum (halofit, Takahashi et al. 2012, Limber), with its error from the number of modes, and B over E.
E and B come from second derivatives of the shear, which separate them exactly, before any window is applied:

    chi_E = (d11 - d22) gamma1 + 2 d12 gamma2 = laplacian kappa,     chi_B = (d11 - d22) gamma2 - 2 d12 gamma1 = 0

Also the spectrum from which the field is drawn, over halofit; the difference between bricks at the border that they
share; and the CPU time of a brick of galaxies.
"""

import argparse
import time
from pathlib import Path

from evidence.record import Record

import healpy
import matplotlib as mpl
import numpy as np
from scipy.ndimage import correlate1d

from csstsim.base.shipped import SHIPPED
from csstsim.instrument.load import read_data
from csstsim.universe.lensing.lensing_field import LensingField
from csstsim.universe.lensing.tangent_grid import TangentGrid

SOURCES = (1.0, 2.0, 3.0)
FINE = [(30.0, 10.0), (150.0, -65.0)]  # centres of patches, deg
WIDE = [(60.0, 25.0), (200.0, -50.0)]
FINE_SIDE, WIDE_SIDE, SIZE = 1.2, 6.0, 400  # deg; steps along a side
TOY_FINE_SIDE, TOY_WIDE_SIDE, TOY_SIZE = 0.15, 2.0, 48
GALAXIES, TOY_GALAXIES = 105_000, 2000
BORDER = (345678, 123456)  # bricks whose borders are compared with those of a neighbour
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


def report(
    record: Record, name: str, field: LensingField, centres: list, degrees: float, size: int, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Record the ratios of patches and return l, spectra (sources, 3, bins) and first maps."""
    side, total, modes, first = np.radians(degrees), 0.0, 0.0, None
    for centre in centres:
        maps = patch(field, *centre, side, size)
        first = maps if first is None else first
        found = [spectra(maps[:, k], side / size, edges) for k in range(len(SOURCES))]
        total, modes = total + np.array([f[0] for f in found]), modes + found[0][1]
    total /= len(centres)
    middle, rows = np.sqrt(edges[1:] * edges[:-1]), []
    for b, ell in enumerate(middle):
        inside, cells = np.linspace(edges[b], edges[b + 1], 20), []
        for k, z in enumerate(SOURCES):
            wanted = np.average(field.shells.limber(inside, z), weights=inside)  # with the ring's density of modes
            cells += [f"{total[k, mode, b] / wanted:.3f}" for mode in (0, 1)]
        rows.append([f"{ell:.0f}", f"{np.sqrt(1 / modes[b]):.3f}", *cells])
    header = [f"{what}, z = {z:g}" for z in SOURCES for what in ("kappa", "E")]
    record.table(name, ["l", "error", *header], rows)
    return middle, total, first


def report_field(record: Record, field: LensingField) -> None:
    """Record the spectrum that is drawn, and the difference between bricks at the borders that they share."""
    ell = np.geomspace(3, 20000, 100)
    off = max(np.abs(field.spectrum(ell, z) / field.shells.limber(ell, z) - 1).max() for z in SOURCES)
    what = "largest departure from halofit of the spectrum of the maps, l = 3 to 20,000, z = 1 to 3"
    record.value("departure", off, what)
    apart = []
    for pix in BORDER[: 1 if record.toy else None]:
        other = int(healpy.get_all_neighbours(256, pix, nest=True)[0])
        ours, theirs = (healpy.boundaries(256, p, step=40, nest=True).T for p in (pix, other))
        shared = np.linalg.norm(ours[:, None] - theirs, axis=2).min(axis=1) < 1e-8
        ra, dec = healpy.vec2ang(ours[shared], lonlat=True)
        columns = [field.lens(p, ra, dec, np.full(len(ra), SOURCES[-1])) for p in (pix, other)]
        apart += [np.abs(one - two).max() for one, two in zip(*columns, strict=True)]
    record.value("seam", max(apart), "largest difference between bricks at their border, kappa and shear", below=1e-5)


def draw(field: LensingField, parts: list, maps: np.ndarray, degrees: float, path: Path) -> None:
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.8), layout="constrained")
    keep = min(int(maps.shape[-1] / degrees), maps.shape[-1])
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
    figure.savefig(path, dpi=80)


def main(record: Record) -> None:
    mpl.use("Agg")
    cosmology, numbers = (read_data(SHIPPED / "universe" / f"{name}.yaml") for name in ("cosmology", "lensing"))
    small = record.toy
    fine_side, wide_side, size = (TOY_FINE_SIDE, TOY_WIDE_SIDE, TOY_SIZE) if small else (FINE_SIDE, WIDE_SIDE, SIZE)
    start = time.process_time()
    field = LensingField(record.options.seed, cosmology, numbers)
    record.value("set_up", time.process_time() - start, "set-up of the field", unit="CPU-s")
    report_field(record, field)
    coarse = LensingField(record.options.seed, cosmology, numbers | {"l_max": 1000})
    some = slice(1) if small else slice(None)
    wide = report(record, "wide", coarse, WIDE[some], wide_side, size, np.geomspace(90, 900, 7))
    fine = report(record, "fine", field, FINE[some], fine_side, size, np.geomspace(900, 18000, 10))
    b_over_e = np.nanmax([np.nanmax(total[:, 2] / total[:, 1]) for _, total, _ in (wide, fine)])
    record.value("b_modes", b_over_e, "largest power of B modes over that of E modes in a bin")
    draw(field, [wide[:2], fine[:2]], fine[2], fine_side, record.figure("lensing.png"))
    count = TOY_GALAXIES if small else GALAXIES
    children = np.linspace(0, (1 << 42) - 1, count).astype(int)
    ra, dec = healpy.pix2ang(1 << 29, (5 << 42) + children, nest=True, lonlat=True)
    start = time.process_time()
    field.lens(5, ra, dec, np.linspace(0, 4, len(ra)))
    record.value("brick", time.process_time() - start, f"lensing of one brick of {count:,} galaxies", unit="CPU-s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    with Record(parser) as record:
        main(record)
