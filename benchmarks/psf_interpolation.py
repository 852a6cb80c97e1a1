"""Interpolation of the PSF between nodes against direct optics: the paper's validation (section 5.1.2), and its cost.

    python benchmarks/psf_interpolation.py              # all bands, costs and figures
    python benchmarks/psf_interpolation.py NUV r        # these bands

Truth: the optics computed at 400 positions on a chip, one at random in each cell of a 20 x 20 grid so that no grid of
nodes is favoured. It is compared with PSFs interpolated to the same positions from grids of nodes. Images are compared
as seen by 10 um pixels (2 x 2 cells), as means of the four wavelengths. Moments are about the windowed centroid, with
a Gaussian weight of 3 px (sigma) or without weight in a box of 32 px (the paper names no weight): R = Q11 + Q22,
e = (Q11 - Q22 + 2i Q12) / R.

Polynomials ("poly 2" = all terms up to degree 2 in x and y, fitted to all nodes of the grid) are included for
comparison: they replace the nodes by one image per term.
"""

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from evidence.record import Record

import matplotlib
import numpy as np

from csstsim.base.shipped import SHIPPED
from csstsim.campaign.sections import PsfConfig
from csstsim.instrument.camera import Camera, load_camera
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.interpolation import Interpolator
from csstsim.optics.psf.psf_file import pixel_response
from csstsim.optics.psf.psf_set import chip_optics, node_positions, node_psf
from csstsim.optics.psf.sampling import oversampling_of
from csstsim.optics.psf.wavefront import load_wavefront

matplotlib.use("agg")
from matplotlib import pyplot as plt

# The chip of each band over which the wavefront varies most
CHIPS = {"NUV": 18, "u": 14, "g": 23, "r": 9, "i": 24, "z": 11, "y": 16, "GU": 3, "GV": 2, "GI": 30}
OVERSAMPLING, CELLS = 2, 64  # a box of 32 px
WINDOW_PX = 3.0
MAS_PER_PX = 74
SHOWN = 210  # index of the position, of 400, that the figure shows
GRID = PsfConfig().grid  # the default


@dataclass(frozen=True)
class Size:
    """How much is measured: positions along a side, grids of nodes, the paper's grid and the bands that have it."""

    bands: tuple[str, ...] = tuple(CHIPS)
    truth: int = 20
    grids: tuple[int, ...] = (2, 3, 4, 5, 6, 8, 10, 15)
    paper_grid: int = 30
    paper_bands: tuple[str, ...] = ("NUV", "r", "y", "GU")
    places: int = 76_000  # of a rendering, for costs

    @property
    def shown(self) -> list[tuple[str, int]]:
        """Methods and grids of the page's table."""
        idw, bilinear = (("idw 2 4", n) for n in (10, self.paper_grid)), (("bilinear", n) for n in (6, 8, 10, 15))
        return [*idw, *bilinear, ("bicubic", 3), ("bicubic", 4)]

    def grids_of(self, band: str) -> tuple[int, ...]:
        """Return the grids of a band."""
        return (*self.grids, self.paper_grid) if band in self.paper_bands else self.grids


TOY = Size(bands=("r",), truth=4, grids=(2, 4, 5, GRID), paper_grid=6, places=2000)
DRAWN = ("NUV", "r", "y")  # bands of the figure of grids
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
    """Direct PSFs of one chip, pixel-integrated means of the wavelengths; kept by position."""

    def __init__(self, camera: Camera, band: str, truth: int):
        self.camera, self.band, self.chip = camera, band, camera.chips[CHIPS[band]]
        self.positions = truth_positions(self.chip, truth)
        self._kept: dict[bytes, np.ndarray] = {}

    def _compute(self, xy):
        params = self.camera.psf
        wavefront = load_wavefront(params)
        filter_ = self.camera.filters[self.band]
        optics, kernel = chip_optics(self.chip, filter_, params, wavefront, OVERSAMPLING, CELLS)
        coefficients = chip_coefficients(wavefront, params, self.chip, *xy.T)
        return np.asarray([node_psf(optics, row, kernel, OVERSAMPLING)[0] for row in coefficients], np.float32)

    def __call__(self, xy):
        """Return the images (n, k, k) at chip pixels xy (n, 2)."""
        if xy.tobytes() not in self._kept:
            self._kept[xy.tobytes()] = seen(self._compute(xy))
        return self._kept[xy.tobytes()]


def truth_positions(chip, count):
    """Return (count**2, 2) chip pixels: one position at random in each cell of a grid."""
    step = np.random.default_rng(5).random((count, count, 2))
    share = (np.stack(np.meshgrid(np.arange(count), np.arange(count)), axis=-1) + step) / count
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
    chip, xy = optics.chip, optics.positions
    shape = np.array([chip.detector.nx, chip.detector.ny])
    for grid in grids:
        nodes = node_positions(chip, grid)
        images = optics(nodes)
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


def measure(optics: Optics, grids: Sequence[int]) -> list[tuple]:
    """Print the table of a band and return its rows: (method, grid, images kept, errors)."""
    truth = optics(optics.positions)
    print(f"\n{optics.band}, chip {optics.chip.id}, errors in 1e-5, centroid in mas")
    print("method   grid kept | dR/R mean      max  de mean      max | the same in the box      | residual | mas")
    rows = []
    for name, grid, kept, (index, weight, _), images in cases(optics, grids):
        found = compare(truth, mixed(index, weight, images))
        rows.append((name, grid, kept, found))
        parts = []
        for window in ("", " box"):
            size, e = found["size" + window], found["e" + window]
            parts.append((size.mean(), np.abs(size).max(), bias(e), np.abs(e).max()))
        parts.append([found["residual"].max()])
        text = " |".join("".join(f"{1e5 * number:9.2f}" for number in part) for part in parts)
        print(f"{name:9s} {grid:3d} {kept:4d} |{text} |{MAS_PER_PX * found['place'].max():8.4f}", flush=True)
    return rows


def largest(rows: Sequence[tuple], method: str, grid: int, key: str) -> float:
    """Return the largest error of a method and grid, NaN if it was not measured."""
    found = [np.abs(errors[key]).max() for name, size, _, errors in rows if (name, size) == (method, grid)]
    return float(found[0]) if found else np.nan


def report_summary(rows: dict[str, list[tuple]], size: Size, record: Record) -> None:
    """Record the page's table, and figures of the default and of the paper's grid over all bands."""
    texts = []
    for band, found in rows.items():
        pairs = [[1e5 * largest(found, *case, key) for key in ("size", "e")] for case in size.shown]
        texts.append([f"{band} ({CHIPS[band]})", *("-" if np.isnan(r) else f"{r:.3g}, {e:.3g}" for r, e in pairs)])
    labels = (f"{method.removesuffix(' 2 4')} {grid}" for method, grid in size.shown)
    record.table("summary", ["band (chip)", *labels], texts)

    def over(method: str, grid: int, key: str, bands: Sequence[str] = tuple(rows)) -> float:
        return np.nanmax([largest(rows[band], method, grid, key) for band in bands])

    what = f"bilinear, {GRID} x {GRID} nodes, all bands: largest error of"
    record.value("bilinear_size", over("bilinear", GRID, "size"), f"{what} R, relative", below=1e-3)
    record.value("bilinear_e", over("bilinear", GRID, "e"), f"{what} e1 or e2", below=1e-4)
    record.value("bilinear_place", MAS_PER_PX * over("bilinear", GRID, "place"), f"{what} the centroid", unit="mas")
    imaging = [band for band in rows if not band.startswith("G")] or list(rows)
    for key, goal in (("size", 1e-3), ("e", 1e-4)):
        over_goal = over("bilinear", GRID, key, imaging) / goal
        record.value(f"bilinear_{key}_over_goal", over_goal, f"bilinear, imaging bands: error of {key} over its goal")
    paper = f"idw, {size.paper_grid} x {size.paper_grid} nodes"
    record.value("idw_size", over("idw 2 4", size.paper_grid, "size"), f"{paper}: largest error of R, relative")
    record.value("idw_e", over("idw 2 4", size.paper_grid, "e"), f"{paper}: largest error of e1 or e2")
    what = "idw, 5 x 5 nodes: largest error of R, relative (paper: 1%)"
    record.value("idw_5_size", over("idw 2 4", 5, "size"), what, below=0.01)
    first = next(iter(rows))
    errors = next((e for name, grid, _, e in rows[first] if (name, grid) == ("idw 2 4", size.paper_grid)), None)
    if errors is not None:
        record.value("idw_size_bias", errors["size"].mean(), f"{paper}, {first}: mean error of R, relative")
        record.value("idw_e_bias", bias(errors["e"]), f"{paper}, {first}: mean error of e1 or e2")
    default = [e for found in rows.values() for name, grid, _, e in found if (name, grid) == ("bilinear", GRID)]
    ratios = {
        "bias": [bias(e[key]) / np.abs(e[key]).max() for e in default for key in ("size", "e")],
        "box": [np.abs(e[key + " box"]).max() / np.abs(e[key]).max() for e in default for key in ("size", "e")],
    }
    for name, what in (("bias", "mean error over the largest"), ("box", "largest error in the box over that in 3 px")):
        for word, number in (("minimum", min(ratios[name])), ("maximum", max(ratios[name]))):
            record.value(f"{name}_{word}", number, f"bilinear: {what}, R and e, {word} over bands")


def bias(errors: np.ndarray) -> float:
    """Return the larger of the mean errors of e1 and e2, (2, n), or the mean error of R, (n,), without its sign."""
    return np.abs(errors.mean(axis=-1)).max()


def report_costs(camera: Camera, size: Size, record: Record) -> None:
    """Record the cost of making and of storing a set, and of a PSF at one position."""
    wavefront, per_node = load_wavefront(camera.psf), []
    for band in size.bands:
        chip, oversampling = camera.chips[CHIPS[band]], oversampling_of(band, camera.psf)
        optics, kernel = chip_optics(chip, camera.filters[band], camera.psf, wavefront, oversampling)
        rows = chip_coefficients(wavefront, camera.psf, chip, *node_positions(chip, 2).T)
        node_psf(optics, rows[0], kernel, oversampling)  # compiled
        start = time.process_time()
        for row in rows:
            image = node_psf(optics, row, kernel, oversampling)[0]
        per_node.append((time.process_time() - start) / 4)
    megabytes = np.asarray(image, np.float32).nbytes / 1e6
    rng, texts = np.random.default_rng(8), []
    images = rng.random((36, *image.shape), dtype=np.float32)
    x, y = rng.uniform(0, 9215, (2, size.places))
    for name, grid in (("idw 2 4", 30), ("bilinear", GRID), ("bicubic", 4)):
        mixture = Interpolator(node_positions(camera.chips[9], grid), **METHODS[name])
        index, weight, _ = mixture(x[:40], y[:40])  # compiled
        start = time.process_time()
        mixture(x, y)
        weights = time.process_time() - start
        start = time.process_time()
        for i, w in zip(index % 36, weight, strict=True):
            sum(share * images[node] for node, share in zip(i, np.float32(w), strict=True))
        cpu = (time.process_time() - start) / len(index)
        made = " to ".join(dict.fromkeys(f"{grid**2 * cost(per_node):.0f}" for cost in (min, max)))
        numbers = made, f"{grid**2 * megabytes:.0f}", f"{weights:.3f}", f"{1e3 * cpu:.1f}"
        texts.append([f"`{name.removesuffix(' 2 4')}` {grid}", *numbers])
    header = ["nodes along a side", "make a chip's set, CPU-s", "keep it, MB"]
    header.append(f"weights of {size.places:,} positions, CPU-s")
    record.table("costs", [*header, f"mix one PSF ({' x '.join(map(str, image.shape))} cells), CPU-ms"], texts)


def figure_paper(optics: Optics, paper_grid: int, path: Path) -> None:
    """Draw the paper's figure for a band: one PSF, its interpolations, and the errors at all positions."""
    chip, xy = optics.chip, optics.positions
    truth = optics(xy)
    shown, made = SHOWN % len(xy), {}
    for name, size in (("idw 2 4", paper_grid), ("idw 2 4", GRID), ("bilinear", GRID), ("bicubic", 4)):
        nodes = node_positions(chip, size)
        index, weight, _ = Interpolator(nodes, **METHODS[name])(*xy.T)
        made[f"{name}, {size} x {size}"] = mixed(index, weight, optics(nodes))
    fig, axes = plt.subplots(2, 4, figsize=(13, 6.2), layout="constrained")
    inner = slice(15, -15)
    place = {"extent": [-8.25, 8.25, -8.25, 8.25], "origin": "lower", "interpolation": "nearest"}
    images = [(np.log10(truth[shown, inner, inner]), f"{optics.band}, direct: log10 of light", {})]
    for name in list(made)[:3]:
        off = (made[name][shown] / truth[shown] - 1)[inner, inner]
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
    fig.savefig(path, dpi=75)
    plt.close(fig)


def figure_grids(rows: dict[str, list[tuple]], path: Path) -> None:
    """Draw the largest errors against the number of stored nodes: `rows` {band: rows of measure}."""
    fig, axes = plt.subplots(
        2, len(rows), figsize=(3.4 * len(rows), 6), sharex=True, sharey=True, layout="constrained", squeeze=False
    )
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
    fig.savefig(path, dpi=75)
    plt.close(fig)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bands", nargs="*", metavar="BAND", help=f"of {', '.join(CHIPS)}; default: all")
    with Record(parser) as record:
        size, camera = TOY if record.toy else Size(), load_camera(SHIPPED / "instrument")
        bands, rows = record.options.bands or size.bands, {}
        for band in bands:
            optics = Optics(camera, band, size.truth)
            rows[band] = measure(optics, size.grids_of(band))
            if band == "r":
                figure_paper(optics, size.paper_grid, record.figure("psf_interpolation.png"))
        report_summary(rows, size, record)
        report_costs(camera, size, record)
        if drawn := {band: rows[band] for band in DRAWN if band in rows}:
            figure_grids(drawn, record.figure("psf_speed_accuracy.png"))
