"""The PSF between nodes as a weighted sum of node images, PSF(x, y) = sum_i w_i image_i, sum_i w_i = 1.

* `idw`: w_i ~ D_i^-beta of the N nearest nodes (paper, section 5.1.2, equation 3). Works for any set of nodes. It is
  exact at a node, has zero slope there, and jumps where the set of nearest nodes changes, so its error is only linear
  in the spacing of the nodes.
* `bilinear`: the four nodes of the cell. Continuous; the error is quadratic in the spacing.
* `bicubic`: the polynomial of degree 3 in x and in y through the 4 x 4 nodes around the cell (fewer on a smaller
  grid); cells at the edge of the grid use the nodes of their neighbour. The error is of fourth order in the spacing.

`idw` and `bilinear` are convex mixtures: no weight is negative, so photons are drawn exactly by choosing nodes in
proportion to their weights. `bicubic` is not convex, and the sum may be negative where the PSF is faint.

`bilinear` and `bicubic` need the nodes on a grid of rows and columns. The spacing may vary up to fourfold. A node may
be off its line by 5% of the spacing; it is treated as on the line, an error of at most 5% of the difference between two
nodes. Dead nodes are never used. Where `bicubic` would need one, it is replaced by `bilinear`; where `bilinear` would,
by `idw` of the nearest live nodes. The PSF then jumps at the border of that cell. Nothing is extrapolated: outside the
grid `bilinear` and `bicubic` use the nearest point of its edge, `idw` the nearest nodes. Positions outside the convex
hull of the live nodes are flagged for all methods.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from csstsim.base.errors import InputError
from csstsim.base.types import BoolArray, FloatArray, IntArray, PathLike

METHODS = ("idw", "bilinear", "bicubic")
_SIMPLER = {"bilinear": "idw", "bicubic": "bilinear"}  # method used in the neighbourhood of a dead node
_STENCIL = {"bilinear": 2, "bicubic": 4}  # nodes along an axis
_SAME_LINE_PX = 1.0  # nodes that differ by less in x (y) are in one column (row)
_UNEVEN = 4  # largest ratio between the spacings of neighbouring lines
_OFF_LINE = 0.05  # largest distance of a node from its line, in line spacings
_ON_NODE_PX = 1e-6  # a position nearer than this is at the node, or on the hull


class Interpolator:
    """Weights of the nodes at any position. Attributes: `method`; `convex`, whether no weight is ever negative."""

    def __init__(
        self,
        nodes_xy: ArrayLike,
        method: str = "bilinear",
        *,
        beta: float = 2.0,
        neighbours: int = 4,
        dead: ArrayLike | None = None,
        file: PathLike | None = None,
    ) -> None:
        """`nodes_xy`: (m, 2) px; `beta` > 0, `neighbours` >= 1: of idw; `dead`: (m,) bool; `file`: named in errors.

        Raises InputError if no node is alive, or if the nodes do not form the grid that the method needs.
        """
        if method not in METHODS:
            raise InputError("unknown", key="psf.interpolation", value=method, allowed=", ".join(METHODS))
        nodes_xy = np.asarray(nodes_xy, float)
        self.method = method
        self.convex = method != "bicubic"
        self.beta = beta
        self._dead = np.zeros(len(nodes_xy), bool) if dead is None else np.asarray(dead, bool)
        self._alive = np.flatnonzero(~self._dead)
        if self._alive.size == 0:
            raise InputError("no node is alive", file=file, key="nodes_xy")
        self._live = nodes_xy[self._alive].T.copy()
        self._neighbours = min(neighbours, self._alive.size)
        self._hull = _half_planes(self._live)
        if method != "idw":
            self._axes, self._grid = _rows_and_columns(nodes_xy, method, file)

    def __call__(self, x: ArrayLike, y: ArrayLike) -> tuple[IntArray, FloatArray, BoolArray]:
        """Return (index, weight, outside) of the nodes that are mixed for the PSF at pixel positions x, y.

        For scalars the shapes are (k,), (k,), (); for arrays of N positions (N, k), (N, k), (N,). Weights sum to 1;
        a node may appear twice, or with weight 0. Raises ValueError for a position that is not finite.
        """
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        shape = x.shape
        x = x.ravel()
        y = y.ravel()
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise ValueError("the position of a PSF is not finite")
        index, weight = self._mix(self.method, x, y)
        outside = np.zeros(x.size, bool)
        for a, b, c in self._hull:
            outside |= a * x + b * y > c + _ON_NODE_PX
        k = index.shape[1]
        return index.reshape(*shape, k), weight.reshape(*shape, k), outside.reshape(shape)

    def _mix(self, method: str, x: FloatArray, y: FloatArray) -> tuple[IntArray, FloatArray]:
        if method == "idw":
            return self._idw(x, y)
        index, weight = self._tensor(_STENCIL[method], x, y)
        if self._dead.any():
            bad = self._dead[index].any(axis=1)
            instead = self._mix(_SIMPLER[method], x[bad], y[bad])
            k = max(index.shape[1], instead[0].shape[1])
            index, weight = _widen(index, weight, k)
            index[bad], weight[bad] = _widen(*instead, k)
        return index, weight

    def _idw(self, x: FloatArray, y: FloatArray) -> tuple[IntArray, FloatArray]:
        from csstsim.optics.psf.nearest_nodes import nearest_nodes  # loads numba, so only imported when used

        found, distance = nearest_nodes(x, y, self._live[0], self._live[1], self._neighbours)
        closest = distance.argmin(axis=1)[:, None]
        smallest = np.take_along_axis(distance, closest, 1)
        on_node = smallest < _ON_NODE_PX
        # Relative to the closest, so that no power overflows
        ratio = np.where(on_node, 1.0, smallest) / np.where(on_node, 1.0, distance)
        weight = np.where(on_node, np.arange(self._neighbours) == closest, ratio**self.beta)
        return self._alive[found], weight / weight.sum(axis=1, keepdims=True)

    def _tensor(self, width: int, x: FloatArray, y: FloatArray) -> tuple[IntArray, FloatArray]:
        (column, wx), (row, wy) = (_lagrange(axis, at, width) for axis, at in zip(self._axes, (x, y), strict=True))
        index = self._grid[row.T[:, :, None], column.T[:, None, :]]
        weight = wy.T[:, :, None] * wx.T[:, None, :]
        shape = x.size, len(row) * len(column)
        return index.reshape(shape), weight.reshape(shape)


def _lagrange(nodes: FloatArray, x: FloatArray, width: int) -> tuple[IntArray, FloatArray]:
    """Return (index, weight), each (k, n), of the polynomial through the k = min(width, m) nodes (m,) around x (n,).

    x beyond the ends is replaced by the end.
    """
    width = min(width, nodes.size)
    x = np.clip(x, nodes[0], nodes[-1])
    first = np.searchsorted(nodes, x, side="right") - 1 - (width // 2 - 1)
    index = np.clip(first, 0, nodes.size - width) + np.arange(width)[:, None]
    at = nodes[index]
    weight = np.ones(index.shape)
    for j in range(width):
        for i in range(width):
            if i != j:
                weight[j] *= (x - at[i]) / (at[j] - at[i])
    return index, weight


def _widen(index: IntArray, weight: FloatArray, k: int) -> tuple[IntArray, FloatArray]:
    """Return index and weight padded to k columns by repeating the last node with weight 0."""
    extra = ((0, 0), (0, k - index.shape[1]))
    return np.pad(index, extra, mode="edge"), np.pad(weight, extra)


def _rows_and_columns(
    nodes_xy: FloatArray, method: str, file: PathLike | None
) -> tuple[tuple[FloatArray, FloatArray], IntArray]:
    """Return ((x of the columns, y of the rows), node index (rows, columns)). InputError if there is no such grid."""
    (x, column), (y, row) = (_lines(axis) for axis in nodes_xy.T)
    index = np.full((y.size, x.size), -1)
    index[row, column] = np.arange(len(nodes_xy))
    off = [
        np.abs(at - line[i]).max() / np.diff(line).min(initial=np.inf)
        for at, line, i in zip(nodes_xy.T, (x, y), (column, row), strict=True)
    ]
    if x.size * y.size != len(nodes_xy) or (index < 0).any() or max(off) > _OFF_LINE:
        message = f"the nodes form no grid of rows and columns; psf.interpolation {method} needs one, idw does not"
        raise InputError(message, file=file, key="nodes_xy")
    return (x, y), index


def _lines(at: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return (coordinate of each line of nodes, line of each node) for coordinates (m,)."""
    order = np.argsort(at, kind="stable")
    line = np.empty(at.size, int)
    gap = np.diff(at[order], prepend=at[order[0]])
    line[order] = np.cumsum(gap > max(gap.max() / _UNEVEN, _SAME_LINE_PX))
    return np.array([np.median(at[line == i]) for i in range(line.max() + 1)]), line


def _half_planes(points: FloatArray) -> list[tuple[float, float, float]]:
    """Return [(a, b, c), ...], the half-planes a x + b y <= c that bound the convex hull of `points` (2, m).

    The hull is computed by Andrew's monotone chain; the bounding box is added for points that are all on one line.
    """
    low = points.min(axis=1)
    high = points.max(axis=1)
    planes = [(1.0, 0.0, high[0]), (-1.0, 0.0, -low[0]), (0.0, 1.0, high[1]), (0.0, -1.0, -low[1])]
    ordered = sorted(set(zip(*points.tolist(), strict=True)))
    for side in (ordered, ordered[::-1]):
        chain: list[tuple[float, float]] = []
        for p in side:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        for (x0, y0), (x1, y1) in pairwise(chain):
            a = (y1 - y0) / np.hypot(x1 - x0, y1 - y0)
            b = (x0 - x1) / np.hypot(x1 - x0, y1 - y0)
            planes.append((a, b, a * x0 + b * y0))
    return planes


def _turn(o: tuple[float, float], p: tuple[float, float], q: tuple[float, float]) -> float:
    """Twice the signed area of the triangle o, p, q: positive if it turns left."""
    return (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0])
