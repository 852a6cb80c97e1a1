"""PSF photometry and star/galaxy separation of detected sources.

PSF photometry (paper, section 6: stars) is the linear least-squares amplitude of the pixel-integrated PSF at the
windowed position, with uniform weights over the stamp: F = sum(p d) / sum(p^2). p is the fraction of a point's total
flux in each pixel, so F is the total flux although the stamp is finite. Its variance is sum(p^2 (rms^2 + F p)) /
sum(p^2)^2. The stamp of the fit also gives its reduced chi2 and the spread (as SPREAD_MODEL, Desai et al. 2012):

    spread = (g.d) / (p.d) - (g.p) / (p.p),   g = PSF blurred by a Gaussian of sigma `BLUR`

0 for a point source, positive for an extended one, negative for a cosmic-ray hit.
The light of neighbours is subtracted before (measure.light.neighbours).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.types import FloatArray, IntArray
from csstsim.measure.detection.maps import BIN

if TYPE_CHECKING:
    from csstsim.optics.psf.psf_file import PsfSet

HALF = 10  # px; the stamp is 21 x 21
CORE = 3  # px; unusable pixels outside the core are left out without a flag
BLUR = 0.5  # px
CELL_PX = 576  # px: maximum size of the parts of the frame in which the PSF is constant
_MARGIN = 3  # px around the stamp: rounding (0.5), spline support (at most 1), reserve
_FILTER_EDGE = 6  # px around that, because the filters are wrong near an edge


class SourcePsfs(NamedTuple):
    """PSFs of n sources: tables of a `PsfModel`, and `cell` (n,), the number of the table of each source."""

    coefficients: FloatArray
    blurred: FloatArray
    per_pixel: int
    cell: IntArray


class PsfFits(NamedTuple):
    """Fits of the PSF to n sources, (n,); NaN where no pixel is left or a ratio is undefined.

    `flux` and its error in electrons; reduced `chi2`; `spread` and its error, no unit; `unusable`: the bits of the
    pixels within CORE.
    """

    flux: FloatArray
    flux_error: FloatArray
    chi2: FloatArray
    spread: FloatArray
    spread_error: FloatArray
    unusable: IntArray


class _Variances(NamedTuple):
    """The sums over a stamp behind a fit's flux error, spread error and chi2."""

    flux: float
    spread: float
    chi2: float


@dataclass(frozen=True)
class PsfModel:
    """Cubic B-spline coefficients of the pixel-integrated PSF, for cells x cells parts of a frame.

    `coefficients` (ncell, t, t) of the PSF and `blurred` of the PSF blurred by `BLUR`, with `per_pixel` steps along a
    pixel; the index of a cell is row * cells + column. `n_eff` (ncell,) = 1 / sum(p^2), px. `origin`: x, y of the frame
    on the chip, px; `step`: width and height of a cell, px.
    """

    coefficients: FloatArray
    blurred: FloatArray
    n_eff: FloatArray
    origin: tuple[int, int]
    step: tuple[float, float]
    cells: int
    per_pixel: int

    def cell(self, x: ArrayLike, y: ArrayLike) -> IntArray:
        """Return the cell index of chip positions [px], that of the nearest cell for positions outside the frame."""
        x0, y0 = self.origin
        width, height = self.step
        column = np.clip((np.asarray(x) - x0) // width, 0, self.cells - 1).astype(np.int64)
        row = np.clip((np.asarray(y) - y0) // height, 0, self.cells - 1).astype(np.int64)
        return row * self.cells + column

    def at(self, x: ArrayLike, y: ArrayLike) -> SourcePsfs:
        """Return the SourcePsfs of sources at chip positions (n,), px."""
        return SourcePsfs(self.coefficients, self.blurred, self.per_pixel, self.cell(x, y))

    def smallest_pairs(self, offsets: ArrayLike) -> FloatArray:
        """Return (4,): the smallest ratio of the mean of two opposite neighbours to the pixel, for a star at `offsets`.

        The pairs are left and right, above and below, and both diagonals; offsets (n,) px in x and y.
        """
        return _smallest_pairs(self.coefficients, self.per_pixel, np.asarray(offsets, float))

    def enclosed(self, radius: float) -> FloatArray:
        """Return (ncell,): the fraction of a point's flux in a circle [px], centred on a pixel."""
        import sep

        stamps = [_sample(table, self.per_pixel, HALF) for table in self.coefficients]
        fractions = np.empty(len(stamps))
        for k, stamp in enumerate(stamps):
            flux, _, _ = sep.sum_circle(stamp, [HALF], [HALF], radius, subpix=5)
            fractions[k] = flux.item()
        return fractions

    def kernel(self, half: int = 3) -> FloatArray:
        """Return the centred PSF of the middle cell on (2 half + 1)^2 pixels: the detection kernel."""
        return _sample(self.coefficients[self.cells // 2 * (self.cells + 1)], self.per_pixel, half)


def psf_model(psf: PsfSet, origin: tuple[int, int], shape: tuple[int, int], *, cell_px: int = CELL_PX) -> PsfModel:
    """Build the `PsfModel` of a frame.

    psf: optics.psf.psf_file.PsfSet, or an object with its `mixed` and `oversampling`: `psf.mixed(function)(x, y)` is a
    linear function of the PSF's cell integrals (sub-bands, n, n), which are fractions of a point's total flux, with the
    PSF's centre at the middle of the array. Sub-bands are averaged with equal weights.
    `origin` (x0, y0) and `shape` (ny, nx) are the frame's position on the chip and its shape, px. `cell_px`: maximum
    size of a cell.
    """
    cells = math.ceil(max(shape) / cell_px)
    per_pixel = table_steps(psf.oversampling)
    step = (shape[1] / cells, shape[0] / cells)
    tables_at = psf.mixed(partial(_tables, oversampling=psf.oversampling))
    middles_x, middles_y = (
        [start + (n + 0.5) * size - 0.5 for n in range(cells)] for start, size in zip(origin, step, strict=True)
    )
    tables = np.array([tables_at(x, y) for y in middles_y for x in middles_x])
    n_eff = np.array([1.0 / np.sum(_sample(table, per_pixel, HALF) ** 2) for table in tables[:, 0]])
    coefficients, blurred = np.ascontiguousarray(tables.transpose(1, 0, 2, 3))
    return PsfModel(coefficients, blurred, n_eff, origin, step, cells, per_pixel)


def _tables(images: FloatArray, oversampling: int) -> FloatArray:
    """Return (2, t, t), rows of PsfModel.coefficients and blurred, of a PSF's cell integrals (sub-bands, n, n)."""
    from scipy.ndimage import gaussian_filter, spline_filter

    from csstsim.optics.psf.psf_file import larger_cells, pixel_response

    n = table_steps(oversampling)
    image = larger_cells(np.mean(images, axis=0, dtype=np.float64), oversampling, n)
    middle = image.shape[-1] // 2
    margin = n * (HALF + _MARGIN)
    edge = n * _FILTER_EDGE
    padded = slice(middle - margin - edge, middle + margin + edge)
    table = pixel_response(image[padded, padded], n)
    kept_part = slice(edge - n // 2, edge - n // 2 + 1 + 2 * margin)
    return np.array(
        [spline_filter(i, order=3)[kept_part, kept_part] for i in (table, gaussian_filter(table, n * BLUR))]
    )


def table_steps(oversampling: int) -> int:
    """Return the number of steps of a table along a pixel, 4 or 2, for a PSF with `oversampling` cells along a pixel.

    On the cells of the PSF, the cubic spline is exactly the pixel-integrated PSF, because stars are rendered with
    splines through these cells (render.psf_table). On steps twice as long, it cuts the peak of a PSF between two
    samples: fluxes of r would be 0.14% too high a quarter pixel from the samples, and 0.07% on average.
    """
    return 4 if oversampling % 4 == 0 else 2


def psf_tables(psf: PsfSet) -> Callable[[float, float], FloatArray]:
    """Return a function of the chip position [px]: spline coefficients (t, t) of the whole pixel-integrated PSF.

    psf: as in `psf_model`. The steps are those of `table_steps`.
    """
    return psf.mixed(partial(_whole_table, oversampling=psf.oversampling))


def _whole_table(images: FloatArray, oversampling: int) -> FloatArray:
    from scipy.ndimage import spline_filter

    from csstsim.optics.psf.psf_file import larger_cells, pixel_response

    n = table_steps(oversampling)
    image = larger_cells(np.mean(images, axis=0, dtype=np.float64), oversampling, n)
    return spline_filter(pixel_response(image, n), order=3)


@numba.njit(cache=True)
def _weights(t: float, out: FloatArray) -> None:
    out[0] = (1.0 - t) ** 3 / 6.0
    out[1] = (4.0 - 6.0 * t * t + 3.0 * t**3) / 6.0
    out[2] = (1.0 + 3.0 * t + 3.0 * t * t - 3.0 * t**3) / 6.0
    out[3] = t**3 / 6.0


@numba.njit(cache=True)
def render_psf(table: FloatArray, per_pixel: int, dx: float, dy: float, out: FloatArray) -> None:
    """Fill `out` (2 half + 1)^2 with the PSF at pixel offsets -half..half from a source at (dx, dy), |dx| <= 0.5.

    per_pixel: steps of the table along a pixel.
    """
    half = out.shape[0] // 2
    centre = table.shape[0] // 2
    wx = np.empty(4)
    wy = np.empty(4)
    u = centre - per_pixel * (half + dx)
    v = centre - per_pixel * (half + dy)
    i0 = math.floor(u)
    j0 = math.floor(v)
    _weights(u - i0, wx)
    _weights(v - j0, wy)
    for r in range(2 * half + 1):
        for c in range(2 * half + 1):
            total = 0.0
            for a in range(4):
                line = 0.0
                for b in range(4):
                    line += wx[b] * table[j0 - 1 + per_pixel * r + a, i0 - 1 + per_pixel * c + b]
                total += wy[a] * line
            out[r, c] = total


@numba.njit(cache=True)
def _smallest_pairs(tables: FloatArray, per_pixel: int, offsets: FloatArray) -> FloatArray:
    stamp = np.empty((3, 3))
    smallest = np.full(4, np.inf)
    for cell in range(len(tables)):
        for dy in offsets:
            for dx in offsets:
                render_psf(tables[cell], per_pixel, dx, dy, stamp)
                for k, (r, c) in enumerate(((1, 2), (2, 1), (2, 2), (2, 0))):
                    smallest[k] = min(smallest[k], 0.5 * (stamp[r, c] + stamp[2 - r, 2 - c]) / stamp[1, 1])
    return smallest


def _sample(table: FloatArray, per_pixel: int, half: int) -> FloatArray:
    out = np.empty((2 * half + 1, 2 * half + 1))
    render_psf(table, per_pixel, 0.0, 0.0, out)
    return out


@numba.njit(cache=True)
def fit_sources(
    image: FloatArray,
    rms: FloatArray,
    unusable: IntArray,
    x: FloatArray,
    y: FloatArray,
    counted: FloatArray,
    psf: SourcePsfs,
) -> PsfFits:
    """Fit one PSF to each source.

    `image` float32 (ny, nx); `rms` float32: noise of a pixel, on bins of BIN px; `unusable` uint8 (ny, nx), bits of the
    reasons, 0 for good; `x`, `y` (n,): pixels of the frame; `counted` (n,): fraction of each source's light that was
    counted, by which `image` was divided, so that the Poisson variance of a source is flux / counted; `psf`: of
    `PsfModel.at`.
    """
    ny, nx = image.shape
    side = 2 * HALF + 1
    fits = PsfFits(
        np.full(x.size, np.nan),
        np.full(x.size, np.nan),
        np.full(x.size, np.nan),
        np.full(x.size, np.nan),
        np.full(x.size, np.nan),
        np.zeros(x.size, np.int64),
    )
    p = np.empty((side, side))
    g = np.empty((side, side))
    for k in range(x.size):
        ix = round(x[k])
        iy = round(y[k])
        render_psf(psf.coefficients[psf.cell[k]], psf.per_pixel, x[k] - ix, y[k] - iy, p)
        render_psf(psf.blurred[psf.cell[k]], psf.per_pixel, x[k] - ix, y[k] - iy, g)
        pp = 0.0
        pd = 0.0
        gd = 0.0
        gp = 0.0
        n = 0
        bad = 0
        for r in range(side):
            for c in range(side):
                row = iy + r - HALF
                col = ix + c - HALF
                if row < 0 or row >= ny or col < 0 or col >= nx:
                    continue
                if unusable[row, col]:
                    if abs(r - HALF) <= CORE and abs(c - HALF) <= CORE:
                        bad |= unusable[row, col]
                    continue
                d = float(image[row, col])
                pp += p[r, c] ** 2
                pd += p[r, c] * d
                gd += g[r, c] * d
                gp += g[r, c] * p[r, c]
                n += 1
        fits.unusable[k] = bad
        if pp <= 0.0:
            continue
        flux = pd / pp
        blur_ratio = gd / pd if pd != 0.0 else 0.0
        sums = _variances(image, rms, unusable, iy, ix, p, g, flux, blur_ratio, counted[k])
        fits.flux[k] = flux
        fits.flux_error[k] = math.sqrt(sums.flux) / pp
        fits.chi2[k] = sums.chi2 / max(n - 1, 1)
        if pd > 0.0:
            fits.spread[k] = blur_ratio - gp / pp
            fits.spread_error[k] = math.sqrt(sums.spread) / pd
    return fits


@numba.njit(cache=True)
def _variances(
    image: FloatArray,
    rms: FloatArray,
    unusable: IntArray,
    iy: int,
    ix: int,
    p: FloatArray,
    g: FloatArray,
    flux: float,
    blur_ratio: float,
    counted: float,
) -> _Variances:
    """Return the sums of a stamp about column `ix`, row `iy`; `p`, `g` (side, side): the PSF and the blurred PSF."""
    ny, nx = image.shape
    noise = 0.0
    spread_noise = 0.0
    chi2 = 0.0
    for r in range(len(p)):
        for c in range(len(p)):
            row = iy + r - HALF
            col = ix + c - HALF
            if row < 0 or row >= ny or col < 0 or col >= nx or unusable[row, col]:
                continue
            variance = float(rms[row // BIN, col // BIN]) ** 2 + max(flux * p[r, c], 0.0) / counted
            noise += p[r, c] ** 2 * variance
            spread_noise += (g[r, c] - blur_ratio * p[r, c]) ** 2 * variance
            chi2 += (image[row, col] - flux * p[r, c]) ** 2 / variance
    return _Variances(noise, spread_noise, chi2)
