"""The nearest nodes of a position. Nodes are visited by increasing distance in y, until no other can be nearer."""

import numpy as np
from numba import njit

from csstsim.base.types import FloatArray, IntArray

_TIE = 1e-9  # relative difference of squared distances below which two nodes count as equally far


@njit(cache=True)
def nearest_nodes(
    x: FloatArray, y: FloatArray, node_x: FloatArray, node_y: FloatArray, k: int
) -> tuple[IntArray, FloatArray]:
    """Return (index (n, k), distance (n, k) px) of the k <= m nearest of the nodes (m,), nearest first.

    Nodes that are equally far are ordered by index, independent of rounding.
    """
    index = np.zeros((x.size, k), np.int64)
    squared = np.full((x.size, k), np.inf)
    by_y = np.argsort(node_y)
    heights = node_y[by_y]
    for p in range(x.size):
        order = index[p]
        best = squared[p]
        above = np.searchsorted(heights, y[p])
        below = above - 1
        while True:
            up = heights[above] - y[p] if above < heights.size else np.inf
            down = y[p] - heights[below] if below >= 0 else np.inf
            if not min(up, down) ** 2 <= best[k - 1] * (1 + _TIE) or min(up, down) == np.inf:
                break
            if up < down:
                i = by_y[above]
                above = above + 1
            else:
                i = by_y[below]
                below = below - 1
            d2 = (x[p] - node_x[i]) ** 2 + (y[p] - node_y[i]) ** 2
            at = k
            while at > 0 and _before(d2, i, best[at - 1], order[at - 1]):
                if at < k:
                    order[at], best[at] = order[at - 1], best[at - 1]
                at -= 1
            if at < k:
                order[at] = i
                best[at] = d2
    return index, np.sqrt(squared)


@njit(cache=True)
def _before(d2: float, i: int, other_d2: float, other: int) -> bool:
    return d2 < other_d2 * (1 - _TIE) or (d2 <= other_d2 * (1 + _TIE) and i < other)
