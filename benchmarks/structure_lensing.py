"""Convergence and shear of the structured sky: spectra, B modes, skewness and peaks, compared with halofit.

    python benchmarks/structure_lensing.py [--patches 6] [--seeds 1 2] [--structure haloes]

Patches of 4 deg take two CPU-minutes each, `--patches` of them for each seed. They are kept in
results/structure_lensing, so a run goes on where it stopped. The smooth field is summed on a patch's own grid; `bricks`
is the largest difference from the maps of bricks, which galaxies see. Per l-bin and redshift of sources:

- E over halofit: C_l of the shear's E mode over Limber's integral, with the error of the mean from the scatter of the
  patches, and the same with the power of the drawn haloes, each for itself, replaced by its mean. Most of the scatter
  is theirs: few clusters have most of the power.
- what single haloes have of halofit's power.

Samples of 0.3 arcmin fold power of high multipoles back into E and B; the expected part is taken from E. Then come the
deviation and skewness of kappa in Gaussian windows, and the number of high peaks; then B over E of a small patch by its
sampling, and the spectrum from which maps are drawn.
docs/figures/structure_lensing.png: the middle of a map with its haloes.
"""

import argparse
import hashlib
import shutil
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from evidence.record import Record

import healpy
import numpy as np
from lensing_spectra import FINE, SOURCES, WIDE, patch, spectra
from scipy.ndimage import gaussian_filter, maximum_filter

from csstsim.universe.lensing.potential_field import Kernels
from csstsim.universe.lensing.tangent_grid import TangentGrid, prolong
from csstsim.universe.parameters import load_universe
from csstsim.universe.structure.halo_lensing import HaloLenses, halo_lenses, halo_shear
from csstsim.universe.structure.halo_profile import disc_transform, halo_transform
from csstsim.universe.structure.kernels import add_lensing
from csstsim.universe.structure.matter_field import MatterField

EDGES = np.array([700, 1000, 1500, 2200, 3300, 5000, 7500, 11000])  # the window of a patch adds power below
WIDEST_GRID = 24  # half the points along a side of the coarsest grid
POINTS = 200_000  # kernels summed at once
NEAR_SOURCES = (0.3, 0.6)
SAMPLED = np.array([11000, 14000])  # multipoles of B modes by sampling


@dataclass(frozen=True)
class Layout:
    """Degrees and steps along a side of a patch; arcmin of Gaussian windows; degrees along a side of the figure.

    `sampled`: degrees and steps along a side of the patches whose sampling is compared.
    """

    degrees: float
    size: int
    windows: tuple[float, ...]
    picture: float
    sampled: tuple[float, tuple[int, ...]]

    @property
    def step(self) -> float:
        return np.radians(self.degrees) / self.size


FULL = Layout(4.0, 800, (1.0, 2.0, 4.0), 0.6, (0.3, (100, 200, 400)))
TOY = Layout(0.3, 60, (1.0,), 0.06, (0.06, (40,)))


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
                kernels = Kernels(points[rows], boxes, summed.astype(np.float32), sigma**-2, reach)
                add_lensing(values, fine.frames, kernels)
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


def power_of_haloes(
    matter: MatterField, haloes: dict, lenses: HaloLenses, grid: TangentGrid, layout: Layout
) -> np.ndarray:
    """Return C_l (sources, bins) of the haloes in the window of a patch, each for itself: its mean is C_1h."""
    points = layout.size + 1 - 16  # the window of `spectra` has along a side
    plane = (lenses.direction @ grid.axes[:2].T) / (lenses.direction @ grid.centre)[:, None]
    place = plane / ((points + 1) * layout.step)
    inside = (np.abs(place) < 0.5).all(axis=1)
    chi = lenses.chi[inside]
    strength = lenses.strength[inside]
    disc = lenses.disc[inside]
    radius, c = matter.mass_function.virial_radius(10 ** haloes["log_mass"][inside]), haloes["concentration"][inside]
    chance = (np.cos(np.pi * place[inside]) ** 4).prod(axis=1)  # the window squared
    far = matter.shells.source_distance(np.array(SOURCES))[:, None]
    flux = np.pi * strength * np.maximum(1 - chi / far, 0.0)  # kappa integrated over the halo
    power = chance * flux**2 / (((np.hanning(points + 2) ** 2).sum() * layout.step) ** 2)
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


def make_patch(field: MatterField, layout: Layout, ra0: float, dec0: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the maps (3, sources, size + 1, size + 1) of a patch and `power_of_haloes`."""
    grid = patch_grid(ra0, dec0, layout.degrees, layout.size)
    maps = smooth_maps(field, grid, SOURCES)
    if field.haloes is None:
        return maps, np.zeros((len(SOURCES), len(EDGES) - 1))
    return maps, power_of_haloes(field, *add_haloes(maps, field, grid, SOURCES), grid, layout)


def kept_folder(record: Record, name: str) -> Path:
    """Return the folder of patches that the same code and data made; those of toy size are made anew."""
    folder = record.results / name / hashlib.sha256(repr(record.depends).encode()).hexdigest()[:12]
    if record.toy:
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def kept_patch(field: MatterField, layout: Layout, centre: tuple, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return `make_patch`, made or as kept in `path`."""
    if not path.exists():
        maps, drawn = make_patch(field, layout, *centre)
        part = path.with_suffix(".part.npz")
        np.savez(part, maps=maps, drawn=drawn)
        part.replace(path)
        print(path.name, flush=True)
    with np.load(path) as kept:
        return kept["maps"].astype(float), kept["drawn"]


def folded(spectrum, ell, step):
    """Return the part of E that samples of `step` [rad] fold back to `ell` from higher ones, mean over directions.

    A mode keeps the direction of its shear, so that cos^2 of twice the angle between both modes is E, and the rest B.
    """
    angle, shift = np.pi / 4 * (np.arange(5) + 0.5) / 5, 2 * np.pi / step * np.array([-1, 0, 1])
    first, second = (f(angle)[:, None, None] for f in (np.cos, np.sin))
    x, y = (ell[:, None, None, None] * f + at for f, at in ((first, shift), (second, shift[:, None])))
    turned = 2 * (x * first + y * second) ** 2 / (x**2 + y**2) - 1
    powers = spectrum(np.hypot(x, y).ravel()).reshape((*x.shape[:2], 3, 3)) * turned**2
    return powers.sum(axis=(2, 3)).mean(axis=1) - spectrum(ell)


def report_spectra(record: Record, layout: Layout, found: np.ndarray, drawn: np.ndarray, field: MatterField) -> None:
    """Record E over halofit of each source and bin.

    found: (patches, sources, 3, bins) of `spectra`; drawn: (patches, sources, bins) of `power_of_haloes`.
    """
    rows, root = [], np.sqrt(len(found))
    for b, (low, high) in enumerate(pairwise(EDGES)):
        ell, cells, single = np.linspace(low, high, 8), [], []
        for k, z in enumerate(SOURCES):
            halofit = field.shells.limber(ell, z)
            back = folded(lambda at, z=z: field.spectrum(at, z), ell, layout.step)
            haloes = np.zeros(len(ell))
            if field.haloes is not None:
                haloes = field.shells.weights(np.array([z]))[0] ** 2 @ field.spectra.one_halo(ell)
            wanted, back, haloes = (np.average(v, weights=ell) for v in (halofit, back, haloes))
            each = (found[:, k, 1, b] - back) / wanted
            for values in (each, each - (drawn[:, k, b] - haloes) / wanted)[k > 0 :]:
                cells.append(f"{values.mean():.3f} ± {values.std(ddof=1) / root:.3f}")
            single.append(haloes / wanted)
        rows.append([f"{np.sqrt(low * high):,.0f}", *cells, f"{single[0]:.0%}"])
    header = [f"z = {z:g}, mean haloes" for z in SOURCES]
    near = f"z = {SOURCES[0]:g}, "
    record.table("spectra", ["l", f"{near}as made", *header, f"{near}single haloes"], rows)


def report_departure(record: Record, field: MatterField) -> None:
    """Record how much the spectrum from which maps are drawn differs from halofit's."""
    ell = np.geomspace(30, 20000, 100)
    for name, sources in (("departure", SOURCES), ("departure_near", NEAR_SOURCES)):
        off = max(np.abs(field.spectrum(ell, z) / field.shells.limber(ell, z) - 1).max() for z in sources)
        words = "largest departure from halofit of the spectrum of the maps, l = 30 to 20,000, z = "
        record.value(name, off, words + ", ".join(f"{z:g}" for z in sources))


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


def report_moments(record: Record, layout: Layout, kappas: list[np.ndarray]) -> None:
    """Record deviation, skewness <k^3> / <k^2>^2 and peaks of kappa (patches, sources, rows, columns)."""
    rows = []
    for window in layout.windows:
        sigma, cells = np.radians(window / 60) / layout.step, []
        area = (layout.degrees * (1 - 2 * int(3 * sigma) / layout.size)) ** 2
        for k, z in enumerate(SOURCES):
            second, third = np.array([moments(kappa[k], sigma) for kappa in kappas]).T
            each = third / second.mean() ** 2
            high = [(peaks(kappa[k], sigma) > 3 * np.sqrt(second.mean())).sum() / area for kappa in kappas]
            (s3, s3_error), (high, high_error) = (
                (np.mean(values), np.std(values, ddof=1) / np.sqrt(len(values))) for values in (each, high)
            )
            cells += [f"{1e3 * np.sqrt(second.mean()):.2f}", f"{s3:.0f} ± {s3_error:.0f}"]
            cells += [f"{high:.1f} ± {high_error:.1f}"]
            if window == layout.windows[0]:
                words = f"at z = {z:g} in a Gaussian window of {window:g} arcmin"
                record.value(f"s3_{z:g}", s3, f"skewness S3 of convergence {words}", error=s3_error)
                what = f"peaks per deg2 of convergence above 3 times its dispersion {words}"
                record.value(f"peaks_{z:g}", high, what, error=high_error)
        rows.append([f"{window:g}", *cells])
    header = [f"z = {z:g}: {what}" for z in SOURCES for what in ("1000 sigma", "S3", "peaks per deg²")]
    record.table("windows", ["window [arcmin]", *header], rows)


def report_sampling(record: Record, layout: Layout, field: MatterField) -> None:
    """Record B over E of one patch, sampled more and more finely: what is left of B is the field's own."""
    degrees, sizes = layout.sampled
    side, rows = np.radians(degrees), []
    for size in sizes:
        maps = patch(field, *FINE[0], side, size)
        found = [spectra(maps[:, k], side / size, SAMPLED)[0] for k in range(len(SOURCES))]
        rows.append([f"{degrees / size * 3600:.1f}", *(f"{b[0] / e[0]:.0e}" for _, e, b in found)])
    record.table("sampling", ["arcsec", *(f"z = {z:g}" for z in SOURCES)], rows)


def report_bricks(record: Record, layout: Layout, maps: np.ndarray, bricks: np.ndarray) -> None:
    """Record how much the middle of a patch differs from maps sampled brick by brick on a grid twice as fine."""
    half = bricks.shape[-1] // 4
    middle = slice(layout.size // 2 - half, layout.size // 2 + half + 1)
    apart = np.abs(bricks[..., ::2, ::2] - maps[..., middle, middle]).max()
    record.value("bricks", apart, "largest difference of kappa and shear in bricks from these maps")


def draw(matter: MatterField, layout: Layout, kappa: np.ndarray, centre: tuple, path: Path) -> None:
    """Write the figure: convergence at z = 1 of the middle of a patch, with the haloes above 1e13 in front of it."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    (ra, dec), half = centre, layout.picture / 2
    v = healpy.ang2vec(ra, dec, lonlat=True)
    a = np.radians(ra)
    east = np.array([-np.sin(a), np.cos(a), 0.0])
    bricks = healpy.query_disc(256, v, np.radians(1.6 * half), nest=True, inclusive=True)
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
    figure.savefig(path, dpi=90)


def main(record: Record) -> None:
    asked, layout = record.options, TOY if record.toy else FULL
    patches, seeds = (1, [1]) if record.toy else (asked.patches, asked.seeds)
    fields = [load_universe().matter_field(seed, asked.structure == "haloes") for seed in seeds]
    found, drawn, kappas, field = [], [], [], fields[0]
    steps = int(2 * layout.picture / layout.degrees * layout.size)
    bricks = patch(field, *centres(1)[0], np.radians(layout.picture), steps)
    folder = kept_folder(record, "structure_lensing")
    for seed, one in zip(seeds, fields, strict=True):
        for ra, dec in centres(patches):
            maps, power = kept_patch(
                one, layout, (ra, dec), folder / f"{asked.structure}_{seed}_{ra:.2f}_{dec:.2f}.npz"
            )
            if not found:
                report_bricks(record, layout, maps, bricks)
            found.append([spectra(maps[:, k], layout.step, EDGES)[0] for k in range(len(SOURCES))])
            drawn.append(power)
            kappas.append(maps[0])
    report_departure(record, field)
    report_spectra(record, layout, np.array(found), np.array(drawn), field)
    report_moments(record, layout, kappas)
    report_sampling(record, layout, field)
    if field.haloes is not None:
        draw(field, layout, bricks[0, 0], centres(1)[0], record.figure("structure_lensing.png"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--patches", type=int, default=6, help="of each seed; at least 2")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--structure", choices=("haloes", "field"), default="haloes")
    with Record(parser) as record:
        main(record)
