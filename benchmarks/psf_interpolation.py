"""Interpolation of the PSF between nodes against direct optics: the paper's validation (section 5.1.2), and its cost.

    python benchmarks/psf_interpolation.py NUV r y              # a table for each band
    python benchmarks/psf_interpolation.py NUV r y --figures    # also docs/figures/psf_interpolation.png, ...

Truth: the optics computed at 20 x 20 places of a chip, one at random in each cell of a 20 x 20 grid so that no
grid of nodes is favoured. Against it: the same places interpolated from grids of nodes. Images are compared as a
10 um pixel sees them (2 x 2 cells), the mean of the four wavelengths, moments about the windowed centroid, with
Gaussian weight of 3 px (sigma) or with none in a box of 32 px (the paper names no weight): R = Q11 + Q22,
e = (Q11 - Q22 + 2i Q12) / R. Direct PSFs are computed once and kept under results/psf_interpolation/.

The polynomials ("poly 2" = all terms up to degree 2 in x and y, fitted to all nodes of the grid) are here for
comparison: they replace the nodes by one image a term.
"""

import argparse
import hashlib
import time
from pathlib import Path

import numpy as np

from csstsim.config import SHIPPED
from csstsim.instrument.camera import load_camera
from csstsim.optics.interpolation import Interpolator
from csstsim.optics.psf import CELLS_PER_PIXEL, Diffraction, blur, mosaic_position, node_positions, node_psf
from csstsim.optics.psf_file import pixel_response
from csstsim.optics.wavefront import load_wavefront

ROOT = Path(__file__).parents[1]
STORE = ROOT / "results" / "psf_interpolation"
FIGURES = ROOT / "docs" / "figures"
# The chip of each band over which the wavefront varies most
CHIPS = {"NUV": 12, "u": 14, "g": 8, "r": 9, "i": 7, "z": 11, "y": 6, "GU": 4, "GV": 5, "GI": 1}
CELLS = 64  # 32 px
WINDOW_PX = 3.0
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
        self.cpu = np.nan

    def _compute(self, xy):
        cell = self.camera.telescope.pixel_scale / CELLS_PER_PIXEL
        wavefront = load_wavefront(self.camera.psf)
        waves = self.camera.filters[self.band].psf_wavelength
        optics = [Diffraction(w, self.camera.telescope.diameter_m, cell, wavefront, CELLS) for w in waves]
        kernel = blur(self.camera.psf, cell, self.camera.detector.pixel_um / CELLS_PER_PIXEL)
        start = time.process_time()
        images = [node_psf(optics, c, kernel)[0] for c in wavefront.coefficients(*mosaic_position(self.chip, *xy.T))]
        self.cpu = (time.process_time() - start) / len(xy) / len(waves)
        return np.asarray(images, np.float32)

    def __call__(self, xy):
        """Return the images (n, 4, cells, cells) at chip pixels xy (n, 2)."""
        about = f"{self.camera.digest} {self.chip.id} {CELLS}".encode()
        path = STORE / f"{self.band}_{hashlib.sha256(about + xy.tobytes()).hexdigest()[:12]}.npy"
        if not path.exists():
            np.save(path, self._compute(xy))
        return np.load(path)


def truth_positions(chip):
    """Return (400, 2) chip pixels: one place at random in each cell of a 20 x 20 grid."""
    step = np.random.default_rng(5).random((TRUTH, TRUTH, 2))
    share = (np.stack(np.meshgrid(np.arange(TRUTH), np.arange(TRUTH)), axis=-1) + step) / TRUTH
    return share.reshape(-1, 2) * (chip.detector.nx, chip.detector.ny) - 0.5


def moments(images, window_px):
    """Return (R (px^2), e1, e2), each (n,), of images (n, k, k) of what a pixel sees on the 5 um lattice.

    About the centroid under the same window: Gaussian of `window_px` (sigma), none if infinite.
    """
    axis = (np.arange(images.shape[-1]) - (images.shape[-1] - 1) / 2) / CELLS_PER_PIXEL
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
    return np.stack([q11 + q22, (q11 - q22) / (q11 + q22), 2 * q12 / (q11 + q22)])


def seen(images):
    """Return what a 10 um pixel sees, mean of the wavelengths, of images (n, 4, cells, cells)."""
    return pixel_response(images.mean(axis=1, dtype=np.float64))


def compare(truth, made):
    """Return a dict of the errors of `made` against `truth` (both (n, k, k))."""
    found = {}
    for name, window in (("", WINDOW_PX), (" box", np.inf)):
        true, got = moments(truth, window), moments(made, window)
        found["size" + name] = got[0] / true[0] - 1
        found["e" + name] = got[1:] - true[1:]
        found["relative e" + name] = np.hypot(*got[1:]) / np.hypot(*true[1:]) - 1
    found["residual"] = np.abs(made - truth).max(axis=(1, 2)) / truth.max(axis=(1, 2))
    return found


def polynomial(nodes, xy, degree, shape):
    """Return weights (n, m) of all nodes: the least-squares polynomial of x, y up to `degree`."""

    def design(at):
        u, v = (2 * at / shape - 1).T
        return np.stack([u**i * v**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)

    return design(xy) @ np.linalg.pinv(design(nodes))


def cases(optics, grids):
    """Yield (method, grid, images kept, (index, weight, outside), node images seen by a pixel)."""
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
    r, e1, e2 = moments(truth, WINDOW_PX)
    print(f"\n{optics.band}, chip {optics.chip.id}: R {r.min():.3f} to {r.max():.3f} px^2, e1 {e1.min():+.4f} to "
          f"{e1.max():+.4f}, e2 {e2.min():+.4f} to {e2.max():+.4f} (3 px window)")  # fmt: skip
    print("in 1e-5            | size: mean, largest; e: mean, largest |  the same in a box of 32 px         | residual")
    rows = []
    for name, grid, kept, (index, weight, _), images in cases(optics, grids):
        found = compare(truth, mixed(index, weight, images))
        rows.append((name, grid, kept, found))
        text = ""
        for window in ("", " box"):
            size, e = found["size" + window], found["e" + window]
            parts = size.mean(), np.abs(size).max(), np.abs(e.mean(axis=1)).max(), np.abs(e).max()
            text += " |" + "".join(f"{1e5 * part:9.2f}" for part in parts)
        print(f"{name:9s} {grid:3d} {kept:4d}{text} |{1e5 * found['residual'].max():9.2f}", flush=True)
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bands", nargs="+", choices=CHIPS)
    parser.add_argument("--paper", action="store_true", help="also the paper's grid of 30 x 30")
    options = parser.parse_args()
    camera = load_camera(SHIPPED / "instrument")
    grids = (*GRIDS, PAPER_GRID) if options.paper else GRIDS
    for band in options.bands:
        optics = Optics(camera, band)
        measure(optics, grids)
        print(f"direct: {optics.cpu:.3f} CPU-s a PSF", flush=True)


if __name__ == "__main__":
    main()
