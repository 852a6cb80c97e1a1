"""Wings of bright stars far from them, where they are smooth: gathered on a mesh and laid on the chip once.

Within NEAR px of a star its wing is drawn pixel by pixel (render.wings); between NEAR and twice that it fades over to
the mesh, by the same step that joins box and wing. The mesh of MESH px holds the sum of all stars' wings, is turned
into coefficients of a cubic spline and evaluated at each pixel. That keeps 5e-5 of a wing, 4e-4 where the fade begins
and ends, and less than that in the taper of the shortest wing.

Cost: a star's area / MESH^2, and one pass over the chip for all stars; a star of r = 6, whose wing covers the chip,
costs 20 ms instead of 0.5 s.

What each star put on the window is wanted too: light is linear in the mesh's values, so it is their sum weighted with
what a mesh point of value 1 puts there, response included (`_collect`, the transpose of spline and evaluation).
"""

import math

import numba
import numpy as np

from csstsim.render.octaves import read

MESH = 8  # px
NEAR = 96.0  # px
WHOLE = -math.inf, math.inf, -math.inf, math.inf  # of a wing that no edge cuts
_MARGIN = 14  # mesh points beyond the window; the spline's ends, taken as zero, are felt 0.27^14 = 1e-8 inside
_POLE = math.sqrt(3.0) - 2.0
_PHASE = np.arange(MESH) / MESH
_SPLINE = np.stack(  # cubic B-splines at -1, 0, 1, 2 of each place between two mesh points
    [(1 - _PHASE) ** 3, 4 - 6 * _PHASE**2 + 3 * _PHASE**3, 1 + 3 * (_PHASE + _PHASE**2 - _PHASE**3), _PHASE**3]
) / 6  # fmt: skip


class FarWings:
    """The mesh of one window. Add stars' wings with `add`, then `lay` them on the image, once."""

    def __init__(self, window, response):
        """response: (ny, nx) share of the light that is counted."""
        self.window, self._response = window, response
        shape = tuple(-(-n // MESH) + 2 * _MARGIN + 3 for n in window.shape)
        self._mesh, self._weight = np.zeros(shape), None

    def add(self, x, y, reach, table, first, side=WHOLE, soft=1.0):
        """Add a wing, a table (render.octaves) in r^2, to the mesh; return (electrons, box), None if it misses.

        side: (x0, x1, y0, y1) px from the star beyond which the wing is cut off, over `soft` px.
        """
        box = []
        for at, low, high in ((x, self.window.x0, self.window.x1), (y, self.window.y0, self.window.y1)):
            box += [max(math.ceil(at - reach), low), min(math.floor(at + reach) + 1, high)]
        if box[0] >= box[1] or box[2] >= box[3]:
            return None
        if self._weight is None:
            self._weight = np.zeros(self._mesh.shape)
            _collect(self._weight, self._response, _SPLINE)
            _coefficients(self._weight)
        u, v = ((at - low) / MESH + _MARGIN for at, low in ((x, self.window.x0), (y, self.window.y0)))
        edges = tuple(edge / MESH for edge in side)
        return _add(self._mesh, self._weight, u, v, reach / MESH, table, first, edges, soft / MESH), tuple(box)

    def lay(self, image):
        """Add the wings to `image`."""
        if self._weight is not None:
            _coefficients(self._mesh)
            _spread(image, self._mesh, self._response, _SPLINE)


@numba.njit(cache=True)
def _coefficients(mesh):
    """Turn values into coefficients of the cubic B-spline that vanishes beyond the mesh, in place; symmetric."""
    _along(mesh)
    turned = np.ascontiguousarray(mesh.T)
    _along(turned)
    mesh[:] = turned.T


@numba.njit(cache=True)
def _along(mesh):
    """Solve c[k-1] + 4 c[k] + c[k+1] = 6 f[k] along axis 0, c zero beyond the ends."""
    n, width = mesh.shape
    ratio = np.empty(n)
    ratio[0] = 0.25
    for j in range(width):
        mesh[0, j] *= 6 * ratio[0]
    for k in range(1, n):
        ratio[k] = 1.0 / (4.0 - ratio[k - 1])
        for j in range(width):
            mesh[k, j] = (6 * mesh[k, j] - mesh[k - 1, j]) * ratio[k]
    for k in range(n - 2, -1, -1):
        for j in range(width):
            mesh[k, j] -= ratio[k] * mesh[k + 1, j]


@numba.njit(inline="always")
def between(at, low, high, soft):
    """Return 1 for a place between low and high, 0 beyond, a ramp over `soft` about each."""
    return min(max((at - low) / soft + 0.5, 0.0), 1.0) * min(max((high - at) / soft + 0.5, 0.0), 1.0)


@numba.njit(cache=True)
def _add(mesh, weight, u, v, reach, table, first, side, soft):
    """Add a radial table around mesh position u, v; return the sum of what was added, weighted."""
    ny, nx = mesh.shape
    place, total, across = np.empty(1), 0.0, np.empty(nx)
    for column in range(nx):
        across[column] = between(column - u, side[0], side[1], soft)
    bits = place.view(np.int64)
    for row in range(max(0, math.ceil(v - reach)), min(ny, math.floor(v + reach) + 1)):
        dy2 = (row - v) ** 2
        half, inside = math.sqrt(max(reach**2 - dy2, 0.0)), between(row - v, side[2], side[3], soft)
        for column in range(max(0, math.ceil(u - half)), min(nx, math.floor(u + half) + 1)):
            place[0] = (dy2 + (column - u) ** 2) * MESH**2
            value = read(table, first, bits[0]) * inside * across[column]
            mesh[row, column] += value
            total += value * weight[row, column]
    return max(total, 0.0)  # beside the window, where the splines below zero outweigh the rest


@numba.njit(cache=True)
def _spread(image, mesh, response, spline):
    """Add the spline at each pixel, times the response."""
    line, value = np.empty(mesh.shape[1]), np.empty(MESH)
    for y in range(image.shape[0]):
        row, phase = y // MESH + _MARGIN - 1, y % MESH
        for j in range(len(line)):
            line[j] = (
                spline[0, phase] * mesh[row, j] + spline[1, phase] * mesh[row + 1, j]
                + spline[2, phase] * mesh[row + 2, j] + spline[3, phase] * mesh[row + 3, j]
            )  # fmt: skip
        for x in range(0, image.shape[1], MESH):
            j = x // MESH + _MARGIN - 1
            a, b, c, d = line[j], line[j + 1], line[j + 2], line[j + 3]
            for k in range(MESH):
                value[k] = spline[0, k] * a + spline[1, k] * b + spline[2, k] * c + spline[3, k] * d
            part, seen = image[y, x : x + MESH], response[y, x : x + MESH]
            for k in range(len(part)):
                part[k] += max(value[k], 0.0) * seen[k]  # a spline dips by 1e-8 where all wings end


@numba.njit(cache=True)
def _collect(weight, response, spline):
    """Add up the response that each mesh point's spline meets: the transpose of `_spread`."""
    ny, nx = response.shape
    sums = np.empty((4, -(-nx // MESH) * MESH))
    for first in range(0, ny, MESH):
        sums[:] = 0.0
        for y in range(first, min(first + MESH, ny)):
            for i in range(4):
                share, line, seen = spline[i, y - first], sums[i, :nx], response[y]
                for x in range(nx):
                    line[x] += share * seen[x]
        row = first // MESH + _MARGIN - 1
        for i in range(4):
            for x in range(0, nx, MESH):
                part, j = sums[i, x : x + MESH], x // MESH + _MARGIN - 1
                for m in range(4):
                    for k in range(MESH):
                        weight[row + i, j + m] += spline[m, k] * part[k]
