"""A point's stamp: the PSF's spline density (render.psf_table) integrated over pixels at the sub-pixel place.

No transform; the mixture is summed only over the cells that the stamp needs.
"""

import math

import numpy as np

from csstsim.render.pixel_sums import pixel_sums


def point_stamp(mixer, node, share, x, y, bounds, core=None):
    """Return the light of a point at x, y on the pixels of `bounds` (x0, x1, y0, y1; half-open), float64.

    mixer: psf_mixture.Mixer; node (k,), share (k, 4): electrons from each node and sub-band; core: (cells, cells) share
    of each cell that counts, or None: all.
    """
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
