"""The PSF of a chip as a density to draw from: splines through the stored cell integrals, and their alias tables.

A stored number is the light in a cell (optics.psf_file). The density is a sum of quadratic B-splines on the cells,
f(x) = sum_k c_k B_2(x - k), with c such that its integral over each cell is the stored number: since a box times
B_2 is B_3, c follows from the numbers by the cubic B-spline prefilter (Unser 1999, IEEE SPM 16, 22). Photons are a draw
of k with probability c_k and a B_2 variate (three uniforms); stamps are sums of c_k over pixels (render.stamps). Both
are the same density. Coefficients below zero, of which a smooth PSF has hardly any, count as zero and the rest make up
for them; `negative` says how much that was.

Alias tables (Walker 1977; Vose 1991): 16 bits of probability and 16 bits of index in a word; the middle of a PSF, which
takes 99% of the photons, has a table of its own that stays in cache.
"""

from dataclasses import dataclass

import numba
import numpy as np
import scipy.ndimage

INNER_PX = 16  # half the side of the middle, in pixel


@dataclass(frozen=True)
class PsfTable:
    """Sampling tables of n nodes and 4 sub-bands. `cells` to a side, `per_pixel` cells to a pixel."""

    coefficients: np.ndarray  # (n, 4, cells, cells) float32: c >= 0 as a share of a star's light
    inner: np.ndarray  # (n, 4, side^2) uint32 alias tables of the middle
    outer: np.ndarray  # (n, 4, cells^2) uint32, the middle of weight zero
    share: np.ndarray  # (n, 4, 2) light of middle and rest; what is missing to 1 lies outside the box
    negative: np.ndarray  # (n, 4) light of the coefficients that were below zero
    per_pixel: int

    @property
    def cells(self):
        return self.coefficients.shape[-1]


def make_table(psf, nodes=None):
    """Return the PsfTable of a PsfSet; `nodes` (indices) are made, the others stay zero (None: all live ones)."""
    per_pixel = psf.oversampling
    count, bands, cells = len(psf.nodes_xy), *psf.image.shape[1:3]
    side = 2 * INNER_PX * per_pixel
    table = PsfTable(
        np.zeros((count, bands, cells, cells), np.float32), np.zeros((count, bands, side * side), np.uint32),
        np.zeros((count, bands, cells * cells), np.uint32), np.zeros((count, bands, 2)), np.zeros((count, bands)),
        per_pixel,
    )  # fmt: skip
    for node in np.flatnonzero(~psf.dead) if nodes is None else nodes:
        for band, image in enumerate(psf.node(node)):
            c, table.negative[node, band] = spline_coefficients(image)
            table.coefficients[node, band] = c
            _fill(c, side, table.inner[node, band], table.outer[node, band], table.share[node, band])
    return table


def spline_coefficients(image):
    """Return (c >= 0, light below zero) of one image of cell integrals (cells, cells); sums are the image's."""
    c = scipy.ndimage.spline_filter(image.astype(np.float64), order=3, mode="mirror")
    below = -np.minimum(c, 0).sum()
    total = image.sum(dtype=np.float64)
    c = np.maximum(c, 0)
    return (c * (total / c.sum()) if total > 0 else c), below


def _fill(c, side, inner, outer, share):
    first = (len(c) - side) // 2
    middle = slice(first, first + side)
    rest = c.copy()
    rest[middle, middle] = 0
    share[:] = c[middle, middle].sum(), rest.sum()
    _alias(np.ascontiguousarray(c[middle, middle]).ravel(), inner)
    _alias(rest.ravel(), outer)


@numba.njit(cache=True)
def _alias(weight, table):
    """Fill `table` (n <= 65536) with words: probability x 65536 in the upper, alias in the lower 16 bits."""
    n = len(weight)
    total = weight.sum()
    if total <= 0:
        return
    scaled = weight * (n / total)
    small, large = np.empty(n, np.int64), np.empty(n, np.int64)
    ns, nl = 0, 0
    for i in range(n):
        if scaled[i] < 1.0:
            small[ns] = i
            ns += 1
        else:
            large[nl] = i
            nl += 1
    while ns > 0 and nl > 0:
        ns -= 1
        i, j = small[ns], large[nl - 1]
        table[i] = (np.uint32(min(scaled[i] * 65536.0 + 0.5, 65535.0)) << np.uint32(16)) | np.uint32(j)
        scaled[j] -= 1.0 - scaled[i]
        if scaled[j] < 1.0:
            nl -= 1
            small[ns] = j
            ns += 1
    for k in range(nl):
        table[large[k]] = (np.uint32(65535) << np.uint32(16)) | np.uint32(large[k])
    for k in range(ns):
        table[small[k]] = (np.uint32(65535) << np.uint32(16)) | np.uint32(small[k])
