"""Monochromatic stamps of an object at the sub-pixel phases from which render.slitless.slabs makes slabs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from csstsim.render.far_wings import WHOLE, Side
from csstsim.render.pixel_sums import pixel_sums
from csstsim.render.wings import StampLight

if TYPE_CHECKING:
    from csstsim.base.types import FloatArray, IntArray
    from csstsim.render.canvas import Box
    from csstsim.render.imaging.stamper import Stamper
    from csstsim.render.scene import Scene

# Sub-pixel heights of the trace between which stamps are interpolated
_HEIGHTS_POINT = 8
_HEIGHTS_GALAXY = 4


def subpixel_stamps(stamper: Stamper, i: int, density: int, side: Side) -> FloatArray:
    """Return (4, density, heights, size, size) float32: object i, of light 1, at each wavelength of the PSF set.

    stamper: render.imaging.stamper.Stamper. The object is column / density, row / heights px from a pixel's centre.
    side: Side of the object, beyond which its light is cut off.
    """
    mixer = stamper.mixer
    scene = stamper.scene
    reach = int(stamper.reach[i])
    galaxy = stamper.plan.size[i] > 0
    size = 2 * reach + 1
    heights = _HEIGHTS_GALAXY if galaxy else _HEIGHTS_POINT
    bounds: Box = (-reach, reach + 1, -reach, reach + 1)
    out = np.empty((4, density, heights, size, size), np.float32)
    pixels = np.arange(-reach, reach + 1)
    alone = stamper.alone(i)
    for band in range(4):
        node_electrons = _of_band(scene, i, band)
        if not galaxy:
            cells = mixer.mixed_cells(scene.node[i], node_electrons)
            cells *= 1 if stamper.core is None else stamper.core
            if side != WHOLE:
                cells *= _inside(
                    (np.arange(mixer.cells) + 0.5 - mixer.cells / 2) / mixer.per_pixel, mixer.per_pixel, side
                )
            _fill_points(out[band], cells, mixer.per_pixel)
            continue
        for column, row in np.ndindex(density, heights):
            stamp, _ = alone.moved(column / density, row / heights).stamp(0, node_electrons, bounds)
            lit = np.maximum(stamp, 0.0)
            lit *= stamp.sum() / max(lit.sum(), 1e-300)
            out[band, column, row] = lit * _inside(pixels, 1, side, column / density, row / heights)
    return out


def light_inside(stamper: Stamper, i: int) -> StampLight:
    """Return the StampLight, with arrays (4,), of object i of light 1 at each wavelength of the PSF set."""
    mixer = stamper.mixer
    node = stamper.scene.node[i]
    light = np.empty((2, 4))
    for band in range(4):
        node_electrons = _of_band(stamper.scene, i, band)
        _, whole = stamper.stamp(i, node_electrons, None)
        light[:, band] = mixer.light(node, node_electrons, stamper.cored), whole
    inside, drawn = light
    return StampLight(inside, drawn, stamper.reach[i])


def _of_band(scene: Scene, i: int, band: int) -> FloatArray:
    """Return (k, 4): the electrons from an object's PSF nodes, for flux 1 at one wavelength."""
    electrons = np.zeros((len(scene.node[i]), 4))
    electrons[:, band] = scene.weight[i]
    return electrons


def _fill_points(out: FloatArray, cells: FloatArray, per_pixel: int) -> None:
    """Fill `out` (density, heights, size, size) with the sums over pixels of a point's cells at each of its phases.

    Phases that differ by a whole number of cells use the same sums, so one pass gives all of them.
    """
    density, heights, size, _ = out.shape
    offsets = [np.arange(count) * per_pixel / count for count in (density, heights)]
    parts = [np.unique(np.ceil(v) - v) for v in offsets]  # of a cell
    start = len(cells) / 2 - size / 2 * per_pixel
    fine = np.empty((size * per_pixel + per_pixel,) * 2, np.float32)
    for part_x in parts[0]:
        for part_y in parts[1]:
            pixel_sums(cells, start - per_pixel + part_y, start - per_pixel + part_x, per_pixel, 1, fine)
            for column, row in np.ndindex(density, heights):
                x = per_pixel - offsets[0][column] - part_x
                y = per_pixel - offsets[1][row] - part_y
                if x == int(x) and y == int(y):
                    whole = fine[int(y) :: per_pixel, int(x) :: per_pixel]
                    out[column, row] = whole[:size, :size]


def inside(centres: FloatArray | IntArray, low: float, high: float, per_pixel: int = 1) -> FloatArray:
    """Return the fractions of pixels (or cells, `per_pixel` to a pixel) at `centres` [px] that lie in low..high."""
    half = 0.5 / per_pixel
    return np.clip((np.minimum(centres + half, high) - np.maximum(centres - half, low)) * per_pixel, 0.0, 1.0)


def _inside(centres: FloatArray | IntArray, per_pixel: int, side: Side, x: float = 0.0, y: float = 0.0) -> FloatArray:
    """Return (n, n) float32: the fractions of squares at `centres` [px], relative to x, y, that lie in `side`."""
    across = inside(centres - y, side.y0, side.y1, per_pixel)
    along = inside(centres - x, side.x0, side.x1, per_pixel)
    return (across[:, None] * along).astype(np.float32)
