"""A point's stamp: the PSF's spline density (render.psf_table) integrated over pixels at the sub-pixel place.

No transform; the mixture is summed only over the cells that the stamp needs.
"""

import math

import numpy as np

from csstsim.render.pixel_sums import pixel_sums


def point_stamp(mixer, node, share, x, y, reach, bounds, core=None):
    """Return (stamp, light): a point at x, y on the pixels of `bounds`, float64, and the light of its whole stamp.

    mixer: psf_mixture.Mixer; node (k,), share (k, 4): electrons from each node and sub-band; reach: px, half the side
    of the whole stamp; bounds: (x0, x1, y0, y1), half-open, the part of it that is wanted, or None; core: (cells,
    cells) share of each cell that counts, or None: all.
    """
    column, row = round(x), round(y)
    whole = column - reach, column + reach + 1, row - reach, row + reach + 1
    stamp = _pixels(mixer, node, share, x, y, whole, core)
    light = stamp.sum()
    if bounds is None:
        return stamp[:0, :0], light
    return stamp[bounds[2] - whole[2] : bounds[3] - whole[2], bounds[0] - whole[0] : bounds[1] - whole[0]], light


def _pixels(mixer, node, share, x, y, bounds, core):
    """Return the light of a point on the pixels of `bounds`."""
    m, (x0, x1, y0, y1) = mixer.per_pixel, bounds
    stamp = np.zeros((y1 - y0, x1 - x0))
    start = (y0 - 0.5 - y) * m + mixer.cells / 2, (x0 - 0.5 - x) * m + mixer.cells / 2
    first = tuple(max(math.floor(s) - 1, 0) for s in start)
    last = tuple(min(math.floor(s) + k * m + 2, mixer.cells) for s, k in zip(start, stamp.shape, strict=True))
    if first[0] >= last[0] or first[1] >= last[1]:
        return stamp
    cells = mixer.mixed_cells(node, share, first, last)
    if core is not None:
        cells *= core[first[0] : last[0], first[1] : last[1]]
    return pixel_sums(cells, start[0] - first[0], start[1] - first[1], m, m, stamp)
