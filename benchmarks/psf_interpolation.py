"""Interpolation of the PSF between nodes against direct optics: the paper's validation (section 5.1.2), and its cost.

    python benchmarks/psf_interpolation.py NUV r y              # a table for each band
    python benchmarks/psf_interpolation.py NUV r y --paper --costs --figures

Truth: the optics computed at 400 positions on a chip, one at random in each cell of a 20 x 20 grid so that no grid of
nodes is favoured. It is compared with PSFs interpolated to the same positions from grids of nodes. Images are compared
as seen by 10 um pixels (2 x 2 cells), as means of the four wavelengths. Moments are about the windowed centroid, with
a Gaussian weight of 3 px (sigma) or without weight in a box of 32 px (the paper names no weight): R = Q11 + Q22,
e = (Q11 - Q22 + 2i Q12) / R. Direct PSFs are computed once and kept under results/psf_interpolation/.

Polynomials ("poly 2" = all terms up to degree 2 in x and y, fitted to all nodes of the grid) are included for
comparison: they replace the nodes by one image per term.
"""

import argparse
import hashlib
import time
from pathlib import Path

import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.sections import PsfConfig
from csstsim.instrument.camera import load_camera
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.interpolation import Interpolator
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.optics.psf.psf_set import chip_optics, node_positions, node_psf
from csstsim.optics.psf.sampling import oversampling_of
from csstsim.optics.psf.wavefront import load_wavefront

ROOT = Path(__file__).parents[1]
STORE = ROOT / "results" / "psf_interpolation"
FIGURES = ROOT / "docs" / "figures"
# The chip of each band over which the wavefront varies most
CHIPS = {"NUV": 18, "u": 14, "g": 23, "r": 9, "i": 24, "z": 11, "y": 16, "GU": 3, "GV": 2, "GI": 30}
OVERSAMPLING, CELLS = 2, 64  # a box of 32 px
WINDOW_PX = 3.0
MAS_PER_PX = 74
SHOWN = 210  # index of the position, of 400, that the figure shows
TRUTH = 20
GRIDS = (2, 3, 4, 5, 6, 8, 10, 15)
PAPER_GRID = 30
METHODS = {
    "idw 2 4": {"method": "idw", "beta": 2.0, "neighbours": 4},
    "idw 1 4": {"method": "idw", "beta": 1.0, "neighbours": 4},
    "idw 4 4": {"method": "idw", "beta": 4.0, "neighbours": 4},
    "idw 2 9": {"method": "idw", "beta": 2.0, "neighbours": 9},
    "bilinear": {"method": "bilinear"},
    "bicubic": {"method": "bicubic"},
}
DEGREES = (2, 3, 4)


class Optics:
    """Direct PSFs of one chip, kept on disk by position."""

    def __init__(self, camera, band):
        self.camera, self.band, self.chip = camera, band, camera.chips[CHIPS[band]]
        STORE.mkdir(parents=True, exist_ok=True)

    def _compute(self, xy):
        params = self.camera.psf
        wavefront = load_wavefront(params)
        filter_ = self.camera.filters[self.band]
        optics, kernel = chip_optics(self.chip, filter_, params, wavefront, OVERSAMPLING, CELLS)
        coefficients = chip_coefficients(wavefront, params, self.chip, *xy.T)
        return np.asarray([node_psf(optics, row, kernel, OVERSAMPLING)[0] for row in coefficients], np.float32)

    def __call__(self, xy):
        """Return the images (n, 4, cells, cells) at chip pixels xy (n, 2)."""
        about = f"{self.camera.digest} {self.chip.id} {CELLS}".encode()
        path = STORE / f"{self.band}_{hashlib.sha256(about + xy.tobytes()).hexdigest()[:12]}.npy"
        if not path.exists():
            np.save(path, self._compute(xy))
        return np.load(path)


def truth_positions(chip):
    """Return (400, 2) chip pixels: one position at random in each cell of a 20 x 20 grid."""
    step = np.random.default_rng(5).random((TRUTH, TRUTH, 2))
    share = (np.stack(np.meshgrid(np.arange(TRUTH), np.arange(TRUTH)), axis=-1) + step) / TRUTH
    return share.reshape(-1, 2) * (chip.detector.nx, chip.detector.ny) - 0.5


def moments(images, window_px):
    """Return (R (px^2), e1, e2, x, y (px)), each (n,), of images (n, k, k), pixel-integrated, on the 5 um lattice.

    Moments are about the centroid under the same window, a Gaussian of sigma `window_px`, or none if infinite.
    """
    axis = (np.arange(images.shape[-1]) - (images.shape[-1] - 1) / 2) / OVERSAMPLING
    centre = np.zeros((2, len(images)))
    for _ in range(30):
        wx, wy = (np.exp(-0.5 * ((axis - c[:, None]) / window_px) ** 2) for c in centre)
        dx, dy = (axis - c[:, None] for c in centre)
        total = np.einsum("nij,ni,nj->n", images, wy, wx, optimize=True)
        step = [np.einsum("nij,ni,nj->n", images, *f, optimize=True) / total for f in ((wy, wx * dx), (wy * dy, wx))]
        centre += step
        if np.abs(step).max() < 1e-8:
            break
    q11, q12, q22 = (
        np.einsum("nij,ni,nj->n", images, wy * dy**k, wx * dx ** (2 - k), optimize=True) / total for k in range(3)
    )
    return np.stack([q11 + q22, (q11 - q22) / (q11 + q22), 2 * q12 / (q11 + q22), *centre])


def seen(images):
    """Return images (n, 4, cells, cells) integrated over 10 um pixels and averaged over the wavelengths."""
    return pixel_response(images.mean(axis=1, dtype=np.float64), OVERSAMPLING)


def compare(truth, made):
    """Return a dict of the errors of `made` against `truth` (both (n, k, k))."""
    found = {}
    for name, window in (("", WINDOW_PX), (" box", np.inf)):
        true, got = moments(truth, window), moments(made, window)
        found["size" + name] = got[0] / true[0] - 1
        found["e" + name] = got[1:3] - true[1:3]
        found["relative e" + name] = np.hypot(*got[1:3]) / np.hypot(*true[1:3]) - 1
        found["place" + name] = np.hypot(*(got[3:] - true[3:]))
    found["residual"] = np.abs(made - truth).max(axis=(1, 2)) / truth.max(axis=(1, 2))
    return found


def polynomial(nodes, xy, degree, shape):
    """Return weights (n, m) of all nodes: the least-squares polynomial of x, y up to `degree`."""

    def design(at):
        u, v = (2 * at / shape - 1).T
        return np.stack([u**i * v**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)

    return design(xy) @ np.linalg.pinv(design(nodes))


def cases(optics, grids):
    """Yield (method, grid, images kept, (index, weight, outside), pixel-integrated images of the nodes)."""
    chip, xy = optics.chip, truth_positions(optics.chip)
    shape = np.array([chip.detector.nx, chip.detector.ny])
    for grid in grids:
        nodes = node_positions(chip, grid)
        images = seen(optics(nodes))
        for name, options in METHODS.items():
            yield name, grid, grid**2, Interpolator(nodes, **options)(*xy.T), images
        for degree in DEGREES:
            if grid > degree and grid <= 10:
                weight = polynomial(nodes, xy, degree, shape)
                index = np.broadcast_to(np.arange(grid**2), weight.shape)
                terms = (degree + 1) * (degree + 2) // 2
                yield f"poly {degree}", grid, terms, (index, weight, None), images


def mixed(index, weight, images):
    """Return the interpolated images, (n, k, k)."""
    return np.stack([np.einsum("k,kij->ij", w, images[i]) for i, w in zip(index, weight, strict=True)])


def measure(optics, grids):
    """Print the table of a band and return its rows: (method, grid, images kept, errors)."""
    truth = seen(optics(truth_positions(optics.chip)))
    r, e1, e2, _, _ = (f"{row.min():.4f} to {row.max():.4f}" for row in moments(truth, WINDOW_PX))
    print(f"\n{optics.band}, chip {optics.chip.id}: R {r} px^2, e1 {e1}, e2 {e2} (3 px window)")
    print(
        "in 1e-5            | dR/R mean     most  de mean     most | box: the same                     | residual | mas"
    )
    rows = []
    for name, grid, kept, (index, weight, _), images in cases(optics, grids):
        found = compare(truth, mixed(index, weight, images))
        rows.append((name, grid, kept, found))
        parts = []
        for size, e in ((found["size" + window], found["e" + window]) for window in ("", " box")):
            parts.append((size.mean(), np.abs(size).max(), np.abs(e.mean(axis=1)).max(), np.abs(e).max()))
        parts.append([found["residual"].max()])
        text = " |".join("".join(f"{1e5 * number:9.2f}" for number in part) for part in parts)
        print(f"{name:9s} {grid:3d} {kept:4d} |{text} |{MAS_PER_PX * found['place'].max():8.4f}", flush=True)
    return rows


def report_costs(camera, bands):
    """Print the cost of making and of storing a set, and of a PSF at one position."""
    wavefront = load_wavefront(camera.psf)
    print("\nto make, four wavelengths of 256 x 256 cells: CPU-s per node", end="")
    for band in bands:
        chip, oversampling = camera.chips[CHIPS[band]], oversampling_of(band, camera.psf)
        optics, kernel = chip_optics(chip, camera.filters[band], camera.psf, wavefront, oversampling)
        rows = chip_coefficients(wavefront, camera.psf, chip, *node_positions(chip, 2).T)
        node_psf(optics, rows[0], kernel, oversampling)  # compiled
        start = time.process_time()
        for row in rows:
            node_psf(optics, row, kernel, oversampling)
        print(f"  {band} {(time.process_time() - start) / 4:.3f}", end="")
    print("\nto store: 1.05 MB per node")
    rng = np.random.default_rng(8)
    images = rng.random((36, 4, 256, 256), dtype=np.float32)
    x, y = rng.uniform(0, 9215, (2, 76000))
    for grid in (10, PAPER_GRID):
        nodes = node_positions(camera.chips[9], grid)
        for name, options in METHODS.items():
            mixture = Interpolator(nodes, **options)
            index, weight, _ = mixture(x[:40], y[:40])  # compiled
            start = time.process_time()
            mixture(x, y)
            weights = time.process_time() - start
            start = time.process_time()
            for i, w in zip(index % 36, weight, strict=True):
                sum(share * images[node] for node, share in zip(i, np.float32(w), strict=True))
            cpu = (time.process_time() - start) / len(index)
            print(f"{name:9s} {grid:2d}: 76,000 positions {weights:.3f} CPU-s; one PSF {1e3 * cpu:.1f} ms")


def figure_paper(optics, grid):
    """Draw the paper's figure for a band: one PSF, its interpolations, and the errors at 400 positions."""
    import matplotlib.pyplot as plt

    chip, xy = optics.chip, truth_positions(optics.chip)
    truth = seen(optics(xy))
    made = {}
    for name, size in (("idw 2 4", PAPER_GRID), ("idw 2 4", grid), ("bilinear", grid), ("bicubic", 4)):
        nodes = node_positions(chip, size)
        index, weight, _ = Interpolator(nodes, **METHODS[name])(*xy.T)
        made[f"{name}, {size} x {size}"] = mixed(index, weight, seen(optics(nodes)))
    fig, axes = plt.subplots(2, 4, figsize=(13, 6.2), layout="constrained")
    inner = slice(15, -15)
    place = {"extent": [-8.25, 8.25, -8.25, 8.25], "origin": "lower", "interpolation": "nearest"}
    images = [(np.log10(truth[SHOWN, inner, inner]), f"{optics.band}, direct: log10 of light", {})]
    for name in list(made)[:3]:
        off = (made[name][SHOWN] / truth[SHOWN] - 1)[inner, inner]
        limit = np.abs(off).max()
        images.append((off, f"{name} / direct - 1", {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}))
    for ax, (image, title, style) in zip(axes[0], images, strict=True):
        fig.colorbar(ax.imshow(image, **place, **style), ax=ax, shrink=0.85)
        ax.set_title(title, fontsize=9)
        ax.set_xlabel("px")
    errors = {name: compare(truth, images) for name, images in made.items()}
    panels = [
        ("size", "relative error of R = Q11 + Q22", 1e-3),
        ("relative e", "relative error of |e|", None),
        ("e", "error of e1, e2", 1e-4),
    ]
    for ax, (key, label, goal) in zip(axes[1, 1:], panels, strict=True):
        for name, found in errors.items():
            off = np.log10(np.abs(found[key]).ravel() + 1e-9)
            ax.hist(
                10**off,
                np.geomspace(1e-8, 1e-2, 49),
                weights=np.full(off.size, 8 / off.size),
                histtype="step",
                label=name,
            )
        if goal:
            ax.axvline(goal, color="k", ls="--", lw=1)
        ax.set(xscale="log", xlabel=label, ylabel="PDF of log10")
    axes[1, 1].set_ylim(0, 4.2)
    axes[1, 1].legend(fontsize=7, loc="upper left")
    for name, found in errors.items():
        axes[1, 0].hist(1e4 * found["size"], np.linspace(-6, 6, 97), histtype="step", density=True, label=name)
    axes[1, 0].set(xlabel="relative error of R / 1e-4", ylabel="PDF", yscale="log")
    fig.savefig(FIGURES / "psf_interpolation.png", dpi=75)


def figure_grids(rows):
    """Draw the largest errors against the number of stored nodes: `rows` {band: rows of measure}."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(2, len(rows), figsize=(3.4 * len(rows), 6), sharex=True, sharey=True, layout="constrained")
    for column, (band, found) in zip(axes.T, rows.items(), strict=True):
        for ax, key, goal in zip(column, ("size", "e"), (1e-3, 1e-4), strict=True):
            for name in ("idw 2 4", "bilinear", "bicubic"):
                line = [(size, np.abs(errors[key]).max()) for method, size, _, errors in found if method == name]
                ax.plot(*zip(*line, strict=True), "o-", ms=3, lw=1, label=name)
            for name, marker in (("poly 2", "^"), ("poly 3", "s"), ("poly 4", "D")):
                line = [np.abs(e[key]).max() for method, size, _, e in found if method == name and size == 6]
                ax.plot(6, line, marker, ms=4, color="0.5", label=f"{name} of 6 x 6")
            ax.axhline(goal, color="k", ls="--", lw=1)
        column[0].set_title(f"{band}, chip {CHIPS[band]}")
        column[1].set_xlabel("nodes along a side (squared: MB per chip)")
    axes[0, 0].set(xscale="log", yscale="log", ylim=(1e-7, 2e-2), ylabel="largest |dR / R| at 400 positions")
    axes[0, 0].set_xticks([2, 3, 4, 6, 10, 15, 30], labels=["2", "3", "4", "6", "10", "15", "30"])
    axes[0, 0].minorticks_off()
    axes[1, 0].set_ylabel("largest |de| at 400 positions")
    axes[0, 0].legend(fontsize=7)
    fig.savefig(FIGURES / "psf_speed_accuracy.png", dpi=75)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bands", nargs="+", choices=CHIPS)
    parser.add_argument("--paper", action="store_true", help="also the paper's grid of 30 x 30")
    parser.add_argument("--costs", action="store_true", help="also CPU seconds and memory")
    parser.add_argument("--figures", action="store_true", help="draw docs/figures/psf_*.png (with --paper)")
    options = parser.parse_args()
    camera = load_camera(SHIPPED / "instrument")
    grids = (*GRIDS, PAPER_GRID) if options.paper else GRIDS
    rows = {band: measure(Optics(camera, band), grids) for band in options.bands}
    if options.costs:
        report_costs(camera, options.bands)
    if options.figures:
        figure_paper(Optics(camera, "r"), PsfConfig().grid)
        figure_grids(rows)


if __name__ == "__main__":
    main()
